"""Margins: predicted from the loop transfer function, and found where MuJoCo turns from decay to growth."""

import dataclasses
import itertools
import json
import math
import pkgutil
import re

import control
import numpy as np
import pytest
from scipy import optimize
from scipy.linalg import expm

import sim.studies.stability.fragility
from models.common.errors import InputError
from models.figures.figure import Curve
from models.kinds.kind import Variation
from models.laws.linear import LinearLaw
from models.vehicle.limits_and_implementation import Implementation, Limits
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.command import margins_options
from sim.margins import _which_loop, main
from sim.studies.stability import growth_test
from sim.studies.stability.bisection import Bisection, run_searches
from sim.studies.stability.delayed import delayed_rate
from sim.studies.stability.figure import margins_figure
from sim.studies.stability.fragility import find_fragility, with_errors
from sim.studies.stability.growth_test import BUMP, Growth, Trial, grows
from sim.studies.stability.late_loop import LateLoop, late_loop
from sim.studies.stability.margin_search import GainMargin, find_margins, searches
from sim.studies.stability.report import _fragile_lines, _loop_lines, _loop_object
from sim.studies.stability.robustness import _worst, read_variations, robustness, varied_text
from sim.studies.stability.slowest_mode import slowest_rate
from synth.analysis.certificate import certify
from synth.analysis.norm import hinf_norm
from synth.controller import stability_margins
from synth.controller.disk_margin import disk_margin
from synth.controller.loop_transfer import LoopTransfer, loop_transfer, sampled_loop_transfer
from synth.controller.open_loop import LoopModel
from synth.controller.problem import generalized_plant
from synth.controller.stability_margins import (
    LONGEST,
    _products,
    _sign_changes,
    crossovers,
    gain_crossings,
    largest_sample_period,
    margins,
    sampled_gain_crossings,
)
from synth.vehicle.designer import Designer, design
from tests import pages
from tests.analysed import sampled_radius
from tests.commands import attacks, once
from tests.conftest import recorded_runs
from tests.shared import designed

# Found before by other means: delay [ms], its crossover [rad/s], and half of the delay's last digit. That of II was for -8970.
KNOWN = {"II_printed": (87.097, 18.18, 0.005), "I_printed": (293.0, 7.70, 0.05), "state_printed": (388.1, 7.01, 0.05)}


def scalar(a: float, k: float) -> LoopTransfer:
    """x' = a x + u, u = -k x: every margin of it is known in closed form."""
    return LoopTransfer(np.array([[a]]), np.array([[1.0]]), np.array([[-k]]), np.zeros((1, 1)))


@pytest.mark.parametrize(("a", "k"), [(-1.0, 3.0), (1.0, 3.0), (-1.0, 0.5)])
def test_scalar_loop(a, k):
    """A first-order loop: w = sqrt(k^2 - a^2), theta = acos(a / k), sample period log((k + a) / (k - a)) / a."""
    found = margins(scalar(a, k))
    assert found.gain == math.inf
    assert found.gain_lower == pytest.approx(max(a / k, 0), rel=1e-12)
    assert found.disk.size == pytest.approx(2 / max(1, (k + a) / (k - a)), rel=1e-6)  # S - I / 2 is (s - a - k) / (s - a + k) / 2
    if k > abs(a):
        w = math.sqrt(k**2 - a**2)
        assert found.frequency == pytest.approx(w, rel=1e-9)
        assert found.delay == pytest.approx(math.acos(a / k) / w, rel=1e-9)
        assert found.lead == pytest.approx(2 * math.pi - math.acos(a / k), rel=1e-9)
        assert found.sample_period == pytest.approx(math.log((k + a) / (k - a)) / a, rel=1e-9)
    else:  # |L| < 1 everywhere: any delay, any sample period
        assert found.crossovers == ()
        assert found.delay == found.sample_period == found.smallest_phase == found.lead == math.inf


@pytest.mark.parametrize("name", ["state", "I", "II"])
def test_phase_and_disk_margins_are_those_of_python_control(paper, designer, name):
    """The smaller one of lag and lead is the phase margin of python-control, and the disk margin is its own; II leads by more."""
    loop = loop_transfer(paper, designer.design(name), [0])
    found, open_ = margins(loop), control.ss(loop.A, loop.B, -loop.G, 0)
    _, phase, _, _, frequency, _ = control.stability_margins(open_)
    assert min(found.smallest_phase, found.lead) == pytest.approx(math.radians(abs(phase)), rel=1e-6)
    assert frequency == pytest.approx(found.frequency if name == "II" else found.lead_frequency, rel=1e-6)
    grid = np.concatenate([[0.0], np.geomspace(0.1, 100, 2000)])
    size, gain, phase = control.disk_margins(open_, grid)
    assert found.disk.size == pytest.approx(size, rel=1e-4)  # of its grid
    assert found.disk.phase == pytest.approx(math.radians(phase), rel=1e-4)
    assert found.disk.gain[1] == pytest.approx(10 ** (gain / 20), rel=1e-3)  # near 2 it is steep


def test_a_lead_makes_the_loop_unstable(paper, designer):
    """A lead of 0.398 rad is controller I's phase margin, by the poles of a turned gain and of a causal filter."""
    loop = loop_transfer(paper, designer.design("I"), [0])
    found = margins(loop)
    assert found.lead == pytest.approx(0.39806, abs=1e-5)
    assert found.lead_frequency == pytest.approx(1.80846, abs=1e-5)
    corner = found.lead_frequency * math.tan(found.lead / 2)
    for side in (1 - 1e-6, 1 + 1e-6):
        poles = np.linalg.eigvals(loop.closed(np.exp(1j * side * found.lead)))
        assert (poles.real.max() > 0) == (side > 1)
        # u = (s - a) / (s + a) v has magnitude 1 and leads by 2 atan(a / w). At rest it changes the sign: |L(0)| < 1 bears that.
        a = side * corner
        filtered = np.block([[loop.A + loop.M, -2 * a * loop.B], [loop.G, np.array([[-a]])]])
        assert (np.linalg.eigvals(filtered).real.max() > 0) == (side > 1)


def test_factors_within_the_disk_of_each_force():
    """A loop of two forces bears any complex factor of each within its disk margin, which is the peak of S - I / 2."""
    vehicle = read_vehicle("half_car")
    loop = loop_transfer(vehicle, designed(vehicle, "I"), [0, 1])
    disk, forces = disk_margin(loop), 2
    rng = np.random.default_rng(20261126)
    inside = disk.size / 2 * 0.999 * np.exp(2j * np.pi * rng.uniform(size=(200, forces)))
    factors = (1 + inside) / (1 - inside)
    assert np.linalg.eigvals(loop.A + (loop.B * factors[:, None, :]) @ loop.G).real.max() < 0
    assert disk.gain[1] <= min(factor for factor in gain_crossings(loop) if factor > 1)
    omega = np.concatenate([[0.0], np.geomspace(0.05, 500, 2000)])
    S = np.linalg.inv(np.eye(forces) - loop.transfer(omega))
    assert 1 / disk.size == pytest.approx(np.linalg.norm(S - np.eye(forces) / 2, 2, axis=(1, 2)).max(), rel=1e-3)  # of the grid


@pytest.mark.parametrize("name", KNOWN)
def test_known_delay_margins(paper, designer, name):
    """The delay margins of the printed gains are those found by other means."""
    delay, frequency, digits = KNOWN[name]
    found = margins(loop_transfer(paper, designer.design(name), [0]))
    assert 1e3 * found.delay == pytest.approx(delay, abs=digits)
    assert found.frequency == pytest.approx(frequency, abs=0.005)


SOFT = "suspension_damping = 400.0", "suspension_damping = 60.4735"  # its wheel's poles cross, its body's stay near the axis
OF_ACCELERATION = """[controllers.felt]
measured = ["sprung_acceleration", "sprung_velocity"]
gain = [[-217.346234361259, -54244.74533479826]]
"""


@pytest.mark.parametrize("name", ["state", "I", "II", "felt"])
def test_crossovers_by_another_route(paper, name):
    """With one actuator the crossovers are the roots of |L(j w)| = 1 on a dense grid, and the lag is the angle of L there.

    So it is of a loop with a direct path, whose crossovers are those of its poles with the lag.
    """
    text = paper.text if name != "felt" else paper.text.replace(*SOFT) + OF_ACCELERATION
    vehicle = parse_vehicle(text)
    loop = loop_transfer(vehicle, designed(vehicle, name), [0])

    def excess(w):
        return abs(loop.transfer(np.array([w]))[0, 0, 0]) - 1

    grid = np.geomspace(1e-2, 1e3, 20_000)
    signs = np.sign(np.abs(loop.transfer(grid)[:, 0, 0]) - 1)
    changes = np.flatnonzero(np.diff(signs))
    roots = [float(optimize.root_scalar(excess, bracket=(grid[i], grid[i + 1]), xtol=1e-13).root) for i in changes]
    found = sorted(crossovers(loop), key=lambda crossover: crossover.frequency)
    np.testing.assert_allclose([one.frequency for one in found], roots, rtol=1e-9)  # both refined further
    lags = np.angle(loop.transfer(np.array(roots))[:, 0, 0]) % (2 * np.pi)
    np.testing.assert_allclose([one.phase for one in found], lags, rtol=1e-8)


@pytest.mark.parametrize("kind", ["half_car", *attacks(["full_car"])])
def test_many_actuators(kind):
    """At every crossing an eigenvalue of L is what it must be, for each loop and for all at once."""
    vehicle = read_vehicle(kind)
    controller = designed(vehicle, "I")
    for actuators in ([0], list(range(len(controller.gain)))):
        loop = loop_transfer(vehicle, controller, actuators)
        for one in crossovers(loop):
            eigenvalues = np.linalg.eigvals(loop.transfer(np.array([one.frequency]))[0])
            assert np.abs(eigenvalues * np.exp(-1j * one.phase) - 1).min() < 1e-7  # as well as poles are refined
        for factor in gain_crossings(loop):
            assert abs(np.linalg.eigvals(loop.A + factor * loop.M).real.max()) < 1e-7 * np.linalg.norm(loop.A, 2)


def test_a_loop_that_no_sample_period_up_to_the_longest_loses(paper):
    """Of a loop with an integral, which a period beyond the longest loses alone, the search ends and finds none."""
    vehicle = parse_vehicle(
        f'{paper.text}[controllers.K]\nmeasured = ["suspension_deflection"]\npid = {{ kp = 2e3, ki = -100 }}\n'
    )
    loop = loop_transfer(vehicle, designed(vehicle, "K"), [0])
    assert largest_sample_period(loop) == math.inf
    assert LONGEST < 2 * (13100 - 2000) / 100  # the first one: what the integral adds in it is twice what holds the body


def test_sampled_loop(paper, designer):
    """Sample period and sampled gain margin are where the spectral radius of the implemented loop passes one."""
    controller = designer.design("I")
    loop = loop_transfer(paper, controller, [0])
    period = largest_sample_period(loop)
    assert sampled_radius(paper, controller, period * (1 - 1e-6)) < 1 < sampled_radius(paper, controller, period * (1 + 1e-6))
    for factor in sampled_gain_crossings(*sampled_loop_transfer(paper, controller, 0.01)):
        for side in (1 - 1e-6, 1 + 1e-6):
            with_gain = dataclasses.replace(controller, law=controller.law.scaled(side * factor))
            assert (sampled_radius(paper, with_gain, 0.01) > 1) == (side > 1)


@pytest.mark.parametrize("actuators", [[0], [1], [0, 1]])
def test_sampled_loop_of_one_actuator(actuators):
    """The others' forces are sampled and held as its own: its gain margin is where the whole sampled loop's radius passes one."""
    vehicle, timestep = read_vehicle("half_car"), 1e-2
    controller = designed(vehicle, "II")
    mine, radius = np.isin([0, 1], actuators), {}
    (factor,) = (at for at in sampled_gain_crossings(*sampled_loop_transfer(vehicle, controller, timestep, actuators)) if at > 1)
    for side in (1 - 1e-9, 1 + 1e-9):
        with_gain = dataclasses.replace(controller, law=controller.law.scaled(np.where(mine, side * factor, 1.0)))
        radius[side] = sampled_radius(vehicle, with_gain, timestep)
    below, above = radius.values()
    assert below < 1 < above


def test_a_factor_that_rounding_gives_twice_is_found():
    """A pair of poles that crosses gives its factor twice, as close as rounding: the sign on either side counts."""
    for twin in (1.5, np.nextafter(1.5, 2), 1.5 * (1 + 1e-12), 1.5 * (1 + 1e-8)):
        tried = np.array([1.5, twin, 1.5 * (1 - 1e-15), 2.0])
        (found,) = _sign_changes(lambda k: round(k - 1.5, 14), tried)
        assert found == pytest.approx(1.5, rel=1e-12)


def test_conditionally_stable_loop():
    """A loop that needs its gain has a lower gain margin, sampled too: x' = x + u, u = -3 x is stable above a third."""
    assert gain_crossings(scalar(1.0, 3.0)) == [pytest.approx(1 / 3, rel=1e-12)]
    held = (math.exp(0.1) - 1) * np.ones((1, 1))
    low, high = sampled_gain_crossings(np.array([[math.exp(0.1)]]), held, np.array([[-3.0]]))
    assert low == pytest.approx(1 / 3, rel=1e-9)  # a pole at 1 stays there when sampled
    assert high == pytest.approx((math.exp(0.1) + 1) / (math.exp(0.1) - 1) / 3, rel=1e-9)


def test_search_does_not_believe_its_expectation(monkeypatch):
    """Physics decides: the search ends at its own answer, wherever it was told to look first, or not at all."""
    monkeypatch.setattr(
        "sim.studies.stability.bisection.grows", lambda trials, timestep, progress: [Growth(amount > 17.5) for amount in trials]
    )
    for expected in (3.0, 17.0, 18.0, 200.0, math.inf):
        search = Bisection(lambda amount: amount, expected, most=100.0, step=1.0)  # type: ignore[arg-type]
        run_searches([search], 1.0)
        assert (search.stable, search.unstable) == (17.0, 18.0)
    never = Bisection(lambda amount: amount, math.inf, most=10.0, step=1.0)  # type: ignore[arg-type]
    run_searches([never], 1.0)
    assert never.unstable == math.inf


@pytest.mark.parametrize(("step", "edge"), [(1.0, 17.5), (0.0, 17.25)])
def test_what_is_expected_takes_two_runs(monkeypatch, step, edge):
    """If physics decays just below what is expected and grows just above it, no third run is asked for."""
    asked = []

    def told(trials, timestep, progress):
        asked.extend(trials)
        return [Growth(amount > edge) for amount in trials]

    monkeypatch.setattr("sim.studies.stability.bisection.grows", told)
    search = Bisection(lambda amount: amount, edge, most=100.0, step=step)  # type: ignore[arg-type]
    run_searches([search], 1.0)
    assert sorted(asked) == [search.stable, search.unstable]
    assert search.stable < edge < search.unstable
    assert search.unstable - search.stable <= (step or 2e-3 * edge)  # a sample, or where the section ends


@pytest.mark.attack
@pytest.mark.parametrize("timestep", [3e-3])
def test_margins_in_physics(capsys, tmp_path, timestep):
    """The command finds II's margins in MuJoCo where they are predicted, agrees, draws them and records both sides of one."""
    pytest.importorskip("matplotlib", reason="pictures are in the extra [report]")
    asked = ["--controller", "II", "--timestep", f"{timestep}", "--json"]
    assert main([*asked, "--picture", str(tmp_path / "m.svg"), "--logs", str(tmp_path)]) == 0
    captured = capsys.readouterr()
    result = json.loads(captured.out)
    assert captured.err == ""
    assert "</svg>" in (tmp_path / "m.svg").read_text()
    late = round(0.0870 / timestep)
    assert recorded_runs(result["logs"]["mcap"]) == {f"II_{late}_samples_late" for late in (late - 1, late)}
    assert result["gain"]["predicted"] is None
    assert result["gain"]["found"] is None
    coarse, fine = result["gain"]["sampled"]  # the hold ends it, and at half the step physics bears twice as much
    for sampled in (coarse, fine):
        assert sampled["found"] == pytest.approx(sampled["predicted"], rel=5e-3)  # asked for; the section ends at 0.2 %
    assert coarse["timestep"] == 2 * fine["timestep"] == timestep
    assert fine["found"] == pytest.approx(2 * coarse["found"], rel=2e-2)  # first order in the step
    assert result["delay"]["found"] == pytest.approx(0.0870, abs=1e-9)  # a sample less decays
    assert abs(result["delay"]["found"] - result["delay"]["predicted"]) < timestep  # one sample
    assert result["phase"]["found"] == pytest.approx(result["delay"]["found"] * result["phase"]["frequency"])
    assert abs(result["sample_period"]["found"] - result["sample_period"]["predicted"]) < timestep
    box = result["robustness"]
    assert box["worst_norm"] >= max(corner["norm"] for corner in box["corners"])
    assert len(box["corners"]) == 4
    assert all(corner["stable"] and corner["agrees"] for corner in box["corners"])
    assert set(box["at"]) == {"sprung_mass", "tyre_stiffness"}


@pytest.mark.parametrize(("name", "timestep"), [("I", 1e-3), *attacks([("state", 2e-3)])])
def test_gain_and_delay_in_physics(paper, designer, name, timestep):
    """I and the state feedback: the delay to one sample, the gain to 0.5 %."""
    one = searches(paper, designer.design(name), [0], timestep)
    run_searches([one.gain.search, one.delay], timestep)
    assert abs(one.delay.unstable - one.predicted.delay) <= timestep
    assert one.gain.found == pytest.approx(one.predicted.gain, rel=5e-3)  # asked for; the section ends at 0.2 %


def test_a_faint_mode_that_creeps(monkeypatch):
    """Errors 0.7 % beyond those that a law with states bears make a mode grow in 100 s, which a bump hardly moves.

    The law's own states are in the run's record, so that the mode is told from all others within two seconds.
    """
    entry = '[controllers.best]\nmeasured = ["suspension_deflection", "sprung_acceleration", "control_force"]\norder = "full"\n'
    vehicle, timestep = parse_vehicle(read_vehicle("quarter_car").text + entry), 2e-3
    controller, signs = designed(vehicle, "best"), np.array([1, -1, -1])
    off = [dataclasses.replace(controller, law=controller.law.read_as(1 + size * signs)) for size in (0.110, 0.112)]
    rates = [math.log(LoopModel(vehicle, one, timestep).radius) / timestep for one in off]
    assert -0.02 < rates[0] < 0 < rates[1] < 0.02  # the other modes decay by 5 1/s
    monkeypatch.setattr("sim.studies.stability.growth_test._growth", lambda *rest: pytest.fail("it is not settled in time"))
    found = grows([Trial(vehicle, one) for one in off], timestep)
    assert [one.grows for one in found] == [False, True]
    assert [one.rate for one in found] == pytest.approx(rates, rel=0.1)  # of what geometry makes of a faint mode


@pytest.mark.parametrize("measured", ["suspension_deflection", "sprung_acceleration"])
def test_periods_side_by_side(paper, measured):
    """Transitions by the powers of one exponential are those that are made one by one, also of a force that is measured."""
    law = f'[controllers.c]\nmeasured = ["{measured}"]\nA = [[-3.0, 1.0], [0.0, 0.0]]\nB = [[1.0], [2.0]]\n'
    vehicle = parse_vehicle(f"{paper.text}\n{law}C = [[50.0, -100.0]]\nD = [[-200.0]]\n")
    controller = design(vehicle, "c")
    together = loop_transfer(vehicle, controller, [0]).from_sample_to_sample(0.02, 0.03, 40)
    for i in (0, 7, 39):
        Phi, Gamma, G = sampled_loop_transfer(vehicle, controller, 0.02 + 0.03 * (i + 1))
        np.testing.assert_allclose(together[i], Phi + Gamma @ G, rtol=0, atol=1e-12 * np.abs(together[i]).max())  # of 40 products


@pytest.mark.attack
def test_each_force_of_a_pid_has_margins():
    """Each force alone of a half-car's PID has margins, with an integrator that turns nothing."""
    pid = 'measured = ["suspension_deflection_front", "suspension_deflection_rear"]\n'
    pid += "pid = { kp = -2000.0, ki = -500.0, kd = -200.0, filter = 0.02 }\n"
    vehicle = parse_vehicle(f"{read_vehicle('half_car').text}\n[controllers.pid]\n{pid}")
    for actuators in ([0], [1], [0, 1]):
        loop = loop_transfer(vehicle, design(vehicle, "pid"), actuators)
        found = margins(loop)
        assert found.delay > 0.01
        assert loop.sampled_growth(0.99 * found.sample_period) < 0 < loop.sampled_growth(1.01 * found.sample_period)


@pytest.mark.parametrize("actuators", [[0, 1], [0], [1]])
def test_a_law_with_states_is_sampled_where_it_is_cut(actuators):
    """Behind filters of 10 kHz a gain has the sample period that it has without, also where its other force is not sampled."""
    vehicle = read_vehicle("half_car")
    controller = designed(vehicle, "I")
    fast = 2e4 * np.pi * np.eye(4)
    filtered = dataclasses.replace(controller, law=LinearLaw(-fast, fast, controller.gain, np.zeros((2, 4))))
    plain, behind = (largest_sample_period(loop_transfer(vehicle, one, actuators)) for one in (controller, filtered))
    assert behind == pytest.approx(plain, rel=5e-4)  # the filters' delay of 16 us, of a period of 62 ms
    assert math.isinf(plain) == (actuators == [0])


def test_one_force_sampled_in_physics():
    """A lagging law's rear force alone bears a sample period of 85.4 ms, by 2.6 ms more than both do; so it is in MuJoCo."""
    vehicle = read_vehicle("half_car")
    controller, lags = designed(vehicle, "I"), np.diag([40.0, 60.0, 50.0, 70.0])
    lagging = dataclasses.replace(controller, law=LinearLaw(-lags, lags, controller.gain, np.zeros((2, 4))))
    assert largest_sample_period(loop_transfer(vehicle, lagging, [0, 1])) == pytest.approx(0.0828, abs=1e-4)
    one = searches(vehicle, lagging, [1], 2e-3)
    run_searches([one.sample_period], 2e-3)
    assert one.predicted.sample_period == pytest.approx(0.0854, abs=1e-4)
    assert 0 <= one.predicted.sample_period - one.found_sample_period < 2e-3  # a timestep
    whole = dataclasses.replace(one, predicted=dataclasses.replace(one.predicted, all_sampled=True))
    told = ["all forces sampled" in "\n".join(_loop_lines("the loop", each, None)) for each in (one, whole)]
    assert told == [False, True]


def test_integrators_that_two_forces_share_are_sampled_together():
    """A force with an integrator of its own is sampled by itself; forces with a common one are all sampled."""
    vehicle = read_vehicle("half_car")
    measured = ("suspension_deflection_front", "suspension_deflection_rear")
    A, B, D = np.zeros((2, 2)), np.eye(2), -2000 * np.eye(2)
    for C, together in ((-500 * np.eye(2), False), (-500 * np.array([[1.0, 0.2], [0.2, 1.0]]), True)):
        one = dataclasses.replace(designed(vehicle, "I"), measured=measured, law=LinearLaw(A, B, C, D))
        alone, whole = (loop_transfer(vehicle, one, actuators) for actuators in ([0], [0, 1]))
        assert alone.sampling is not None
        assert alone.sampling.whole == together
        assert (largest_sample_period(alone) == largest_sample_period(whole)) == together


@pytest.mark.parametrize("gain", [-1e8, -1e9])
def test_a_loop_far_stiffer_than_its_plant_has_no_period(paper, gain):
    """Where rounding hides if any period is stable, the largest one is next to none, and nothing is raised."""
    law = f'[controllers.c]\nmeasured = ["suspension_deflection"]\ngain = [[{gain}]]\n'
    vehicle = parse_vehicle(f"{paper.text.replace('suspension_damping = 400', 'suspension_damping = 4')}\n{law}")
    assert largest_sample_period(loop_transfer(vehicle, design(vehicle, "c"), [0])) < 1e-5


def test_unstable_transitions_are_told_by_their_powers():
    """Powers tell stable from unstable matrices as eigenvalues do, near the unit circle, far from normal, and infinite."""
    rng = np.random.default_rng(20261126)
    some = rng.standard_normal((200, 5, 5)) + np.triu(rng.uniform(0, 30, (200, 5, 5)), 1)
    some *= (rng.uniform(0.9, 1.1, 200) / np.abs(np.linalg.eigvals(some)).max(axis=1))[:, None, None]
    some[17, 0, 0] = np.inf
    expected = [i for i in range(200) if i == 17 or np.abs(np.linalg.eigvals(some[i])).max() > 1]
    assert [i for i, product in enumerate(_products(some)) if not product > 0] == expected


def test_an_instability_shorter_than_a_step_is_found():
    """A mode of 1360 rad/s that hardly decays is lost over 0.1 us, where it turns by half a turn, and held again beyond.

    The search steps by 37 us. There a pole passes -1, which is where the pole's own equation says: by another route.
    """
    mode = np.array([[-0.002, 1360.0, 0.0], [-1360.0, -0.002, 0.0], [0.0, 0.0, -30.0]])
    loop = LoopTransfer(mode, np.array([[0.0], [1.0], [1.0]]), np.array([[0.0, -0.05, -1.0]]), np.zeros((1, 1)))
    found = largest_sample_period(loop)
    growth = [loop.sampled_growth(found + shift) for shift in (-37e-6, -1e-9, 1e-9, 0.2e-6, 37e-6)]
    assert [one > 0 for one in growth] == [False, False, True, False, False]
    assert found == pytest.approx(np.pi / 1360, rel=1e-4)
    exact = expm(mode * found)
    held = np.linalg.solve(mode, exact - np.eye(3)) @ loop.B  # the integral of exp(A s) B, as A is regular
    assert np.linalg.det(exact + held @ loop.G + np.eye(3)) == pytest.approx(0.0, abs=1e-9)  # of 4


THROWN = """
type = "half_car"
[parameters]
sprung_mass = 511.5
pitch_inertia = 798.2
axle_distance_front = 1.158
axle_distance_rear = 1.603
unsprung_mass_front = 58.42
unsprung_mass_rear = 54.47
suspension_stiffness_front = 22290
suspension_stiffness_rear = 32400
suspension_damping_front = 767.7
suspension_damping_rear = 759.5
tyre_stiffness_front = 184500
tyre_stiffness_rear = 159100
[performance]
heave_acceleration = 1.0
control_force_front = 2e-4
[controllers.c]
measured = ["suspension_deflection_front"]
gain = [[10278.0], [5003.0]]
"""


def test_a_margin_is_that_of_wheels_on_the_road():
    """A force of 1.5 MN per metre at its rear axle lifts a wheel over 2 mm, and no such run grows or decays."""
    vehicle, timestep = parse_vehicle(THROWN), 1e-3
    gain = searches(vehicle, design(vehicle, "c"), [1], timestep).gain
    run_searches([gain.search], timestep)
    assert gain.search.found == pytest.approx(gain.sampled[0], rel=5e-3)  # asked for; the section ends at 0.2 %


@pytest.mark.parametrize("actuators", [[0, 1], [1]])
def test_two_actuators_in_physics(actuators):
    """Two actuators with a common factor or delay end where L's eigenvalues say; one of them where its own loop does."""
    vehicle, timestep = read_vehicle("half_car"), 3e-3
    one = searches(vehicle, designed(vehicle, "I"), actuators, timestep)
    run_searches([one.gain.search, one.delay, one.sample_period], timestep)
    assert abs(one.delay.unstable - one.predicted.delay) <= timestep  # one sample
    assert abs(one.found_sample_period - one.predicted.sample_period) <= timestep
    assert one.gain.search.found == pytest.approx(one.gain.sampled[0], rel=5e-3)  # as above


def test_a_sample_period_that_sees_nothing_of_the_bump_is_not_run(paper, designer, monkeypatch):
    """From 13.8 time constants of the vehicle on, e^-13.8 being 1e-6, no sample sees the bump: 2 s is the longest run."""
    slowest = -float(np.linalg.eigvals(paper.linear_model.A).real.max())
    for times, longest in ((13.8, 13.8 / slowest), (13.9, 2.0)):
        monkeypatch.setattr(stability_margins, "largest_sample_period", lambda loop, at=times / slowest: at)
        one = searches(paper, designer.design("I"), [0], 1e-3)
        tried = one.sample_period.next()
        assert max(tried) == pytest.approx(longest, abs=1e-3)  # a sample
        one.sample_period.tried |= dict.fromkeys(tried, Growth(grows=False))
        assert ("a longer one sees nothing of the bump" in "\n".join(_loop_lines("the loop", one, None))) == (longest == 2.0)


def test_a_delay_that_takes_hours_is_not_run(paper):
    """A slow integral bears minutes of delay: runs have 2 s at most, and what they do not decide is no disagreement."""
    pid = 'measured = ["suspension_deflection"]\npid = { kp = -500, ki = -50, kd = -50, filter = 0.02 }\n'
    vehicle = parse_vehicle(f"{paper.text}\n[controllers.slow]\n{pid}")
    controller = design(vehicle, "slow")
    one = find_margins(vehicle, controller, 4e-3)[""]
    assert one.predicted.delay > 60
    assert max(one.delay.tried) == pytest.approx(2.0)
    assert one.agrees
    assert math.isnan(one.found_phase)
    assert "not found within 2 s; runs of the predicted delay" in "\n".join(_loop_lines("the loop", one, None))


@pytest.mark.parametrize("rate", [-1e-3, 1e-3])
def test_a_run_does_not_decide_a_mode_that_creeps(rate):
    """A run that does not show what moves by 3 % in 32 s does not contradict its loop; one that grows fast does."""
    loop = LateLoop(np.array([[math.exp(1e-3 * rate)]]), np.zeros((1, 1)), np.zeros((1, 1)), 0, 1, 1e-3)
    assert growth_test._creeps(loop, Growth(rate < 0, -5e-4 if rate > 0 else 5e-4))
    assert not growth_test._creeps(loop, Growth(rate > 0))
    assert not growth_test._creeps(loop, Growth(True, 0.1))
    search = Bisection(
        lambda amount: pytest.fail("it has run"), 1.0, 2.0, tried={0.999: Growth(False), 1.001: Growth(True, decided=False)}
    )
    assert math.isnan(search.found)


@pytest.mark.attack
def test_margins_of_a_law_that_creeps():
    """A full-order law with a gain margin of 1.5 %, at which a pole creeps through 0, has its margins in MuJoCo."""
    text = read_vehicle("quarter_car").text.partition("[controllers")[0]
    vehicle = parse_vehicle(
        f"{text}[limits]\nactuator_bandwidth = 50.0\n[implementation]\nsample_period = 0.005\ndelay = 1\n"
        "noise = { suspension_deflection = 5e-4, sprung_acceleration = 0.05 }\n[controllers.both]\n"
        'measured = ["suspension_deflection", "sprung_acceleration"]\norder = "full"\nsampled = true\nnoise = true\nlag = true\n'
    )
    one = find_margins(dataclasses.replace(vehicle, implementation=Implementation()), design(vehicle, "both"), 5e-4)[""]
    assert one.agrees
    assert one.predicted.gain < 1.1


def test_an_integrator_almost_without_readings_does_not_grow(monkeypatch):
    """Errors of nearly 100 % leave an integrator's pole at 1 but for rounding, which is no edge of the sampled loop."""
    monkeypatch.setattr(sim.studies.stability.fragility, "run_searches", lambda *arguments: None)
    pid = 'measured = ["suspension_deflection_front", "suspension_deflection_rear"]\n'
    pid += "pid = { kp = -500.0, ki = -50.0, kd = -50.0, filter = 0.02 }\n"
    vehicle = parse_vehicle(f"{read_vehicle('half_car').text}\n[controllers.slow]\n{pid}")
    assert find_fragility(vehicle, design(vehicle, "slow"), 5e-4).edge.sampled == (math.inf, math.inf)


def test_infinite_margins_in_physics(paper):
    """If |L| < 1 everywhere no delay and no sample period destabilises, and no gain but the sampling's; nor in MuJoCo."""
    name, gain = "weak", -250.0
    text = f'{paper.text}\n[controllers.{name}]\nmeasured = ["sprung_velocity"]\ngain = [[{gain}]]\n'
    vehicle = parse_vehicle(text)
    found = find_margins(vehicle, design(vehicle, name), 16e-3)[""]
    assert found.predicted.delay == found.predicted.sample_period == found.predicted.gain == math.inf
    assert found.delay.unstable == found.sample_period.unstable == found.gain.found == found.found_phase == math.inf
    assert found.found_gain_lower == 0
    assert found.agrees


def test_worst_norm_is_inside_or_on_the_box(paper, designer):
    """No vehicle drawn from the box has a larger norm than the worst."""
    controller = designer.design("I")
    (box,) = robustness(paper, [controller], 2e-3)
    assert box is not None
    rng = np.random.default_rng(20261121)
    for mass, tyre in zip(rng.uniform(0.7, 1.4, 8), rng.uniform(0.75, 1.25, 8), strict=True):
        parameters = {**paper.parameters}
        parameters["sprung_mass"] *= mass
        parameters["tyre_stiffness"] *= tyre
        other = dataclasses.replace(paper, parameters=parameters, controllers={})
        norm = certify(Designer(other).plant, controller.state_gain(other)).norm.value
        assert norm <= box.norm
    assert box.holds


@pytest.mark.parametrize(("until", "samples", "still"), [(140, 4, True), (160, 4, False), (100, 90, True), (120, 90, False)])
def test_a_run_is_still_over_what_is_on_its_way(until, samples, still):
    """A run of 200 samples has no motion in its last quarter, nor in as many as a force may be on its way."""
    states = np.ones((2, 200))
    states[:, until:] = 0.0
    assert growth_test._still(states, samples) is still


@pytest.mark.parametrize("last", [False, True])
def test_a_run_of_which_nothing_is_left_decays(last):
    """A run of which nothing is left in its last windows decays, whether a longer one may follow or not."""
    states = np.ones((2, 200))
    states[:, 100:] = 0.0
    assert growth_test._grows(states, math.nan, last) is False


@pytest.mark.parametrize(
    ("rate", "follows", "grows"), [(0, True, False), (0, False, None), (2e-9, True, True), (-2e-9, True, False)]
)
def test_a_state_that_stands_does_not_grow(paper, designer, rate, follows, grows):
    """A state that stays, as of an integrator that nothing reads, does not grow if the run follows its loop; a slow mode may."""
    timestep, modes = 2e-3, np.array([rate, -3.0, -5.0])
    mixed = np.array([[1.0, 0.5, 0.2], [-0.3, 1.0, 0.4], [0.1, -0.6, 1.0]])
    loop = LateLoop(mixed * np.exp(modes * timestep) @ np.linalg.inv(mixed), np.zeros((3, 1)), np.zeros((1, 3)), 0, 1, timestep)
    time = np.arange(2000) * timestep
    states = mixed @ np.exp(modes[:, None] * time) + (1e-9 if follows else 0.2) * np.sin(700 * time)
    trial = Trial(paper, designer.design("I"))
    found = growth_test._confirmed(trial, loop, states, np.ones(3), np.zeros((0, 2000)), timestep, 4.0)
    assert (None if found is None else found.grows) is grows


def test_a_rate_is_read_before_a_wheel_may_lift():
    """The rate of a run that grows is that of its first course, however small: what is 25 times its first energy is left out."""
    time = np.arange(4000) * 1e-3
    lifts = 3.3  # s; the energy of its first second is 25 times as large at 3.16 s
    size = 1e-2 * np.exp(0.9 * np.minimum(time, lifts) - 3.0 * np.maximum(time - lifts, 0.0))
    states = size * np.stack([np.cos(8 * time), np.sin(8 * time)])
    assert growth_test._rate(states, 1e-3, 1) == pytest.approx(0.9, rel=1e-6)


def test_a_worst_norm_between_the_points_of_its_grid_is_found():
    """From a grid's best points the worst norm of a smooth one is refined to its top, inside the box and on its side."""
    box = [Variation("mass", 0.7, 1.4), Variation("tyre", 0.75, 1.25)]
    for top, at in ((7.0, (1.0137, 0.9031)), (7.0 - 2 * 0.05**2, (1.0137, 1.25))):
        tyre = 0.9031 if at[1] < 1.25 else 1.30
        _, norms, worst, where = _worst(lambda point, t=tyre: 7.0 - (point[0] - 1.0137) ** 2 - 2 * (point[1] - t) ** 2, box)
        assert norms.max() < worst == pytest.approx(top, rel=1e-9)
        assert where == pytest.approx(at, abs=1e-4)


def test_what_varies_may_be_asked_for(paper, designer, monkeypatch):
    """The box is the one that is asked for, and its worst norm is the largest of as many vehicles as it says, no other."""
    norms = []

    def counted(system):
        norms.append(hinf_norm(system))
        return norms[-1]

    monkeypatch.setattr("sim.studies.stability.robustness.hinf_norm", counted)
    variations = read_variations(paper, ["suspension_damping:0.5:1.25"])
    (box,) = robustness(paper, [designer.design("I")], 4e-3, variations=variations)
    assert box is not None
    assert box.holds
    assert box.text == "suspension damping -50 to +25 %"
    assert [corner.parameters for corner in box.corners] == [{"suspension_damping": 200.0}, {"suspension_damping": 500.0}]
    assert box.computed == len(norms) > 81  # a grid, refined
    assert box.norm == max(norm.value for norm in norms)
    both = read_variations(read_vehicle("half_car"), ["tyre_stiffness:0.9:1.1"])
    assert list(both.values()) == [("tyre_stiffness_front", "tyre_stiffness_rear")]


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        (["mass:0.8:1.2"], "'mass' is no parameter"),
        (["sprung_mass:0.8"], "not name:low:high"),
        (["sprung_mass:0.8:x"], "not name:low:high"),
        (["sprung_mass:1.1:1.2"], "give one above 0 and at most 1"),
        (["sprung_mass:0.8:1.2"] * 2, "sprung_mass is varied twice"),
        (["sprung_mass:0.8:inf"], "give finite multiples above 0"),
        (["sprung_mass:0:1"], "give finite multiples above 0"),
        (["sprung_mass:0.8:1e12"], "--vary reaches|sprung mass varies"),
    ],
)
def test_ranges_that_are_none(paper, asked, words):
    """What cannot vary, or not so far, is refused in one line that says what may."""
    with pytest.raises(InputError, match=words):
        read_variations(paper, asked)


def search_that_found(amount: float) -> Bisection:
    """A search that has ended there; nowhere if it is infinite."""
    tried = {1.0: Growth(False)} if math.isinf(amount) else {0.9995 * amount: Growth(False), 1.0005 * amount: Growth(True)}
    return Bisection(lambda amount: amount, amount, most=32.0, tried=tried)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("own", "sampled", "found", "agrees"),
    [
        (14.24, (13.62, 13.93), (13.62, 13.93), True),  # the hold's share goes with the step
        (14.24, (13.62, 13.93), (14.1, 14.17), False),  # tends to the loop's own, but is not the sampled loop
        (14.24, (13.62, 13.62), (13.62, 13.62), False),  # is the sampled loop, which does not tend to the loop's own
        (104.31, (81.46, 91.47), (81.46, 91.47), True),  # an actuator's lag: the hold's share has a second power of the step, too
        (108.0, (81.46, 91.47), (81.46, 91.47), False),  # by more than half of what the halving moved
        (math.inf, (225.0, 450.0), (225.0, 450.0), True),
        (math.inf, (225.0, 450.0), (225.0, 226.0), False),
        (math.inf, (math.inf, math.inf), (20.0, 20.0), False),  # no margin was predicted, and there is one
    ],
)
def test_gain_margin_is_held_against_both_loops(own, sampled, found, agrees):
    """The margin in physics must be the sampled loop's at every step, and tend to the loop's own: one is not enough."""
    search, finer = (search_that_found(amount) for amount in found)
    assert GainMargin(own, sampled, search, finer).agrees is agrees


@pytest.mark.parametrize("step", [False, True])
def test_a_limit_of_two_runs_is_no_run(paper, designer, step):
    """A gain that MuJoCo has at no step of its own is said to be extrapolated, in words and in --json; one that it ran is not."""
    one = searches(paper, designer.design("I"), [0], 1e-3)
    coarse, fine = (search_that_found(one.predicted.gain + away) for away in ((-0.02, -0.01) if step else (0.0, 0.0)))
    fine = fine if step else dataclasses.replace(fine, tried={})
    gain = GainMargin(one.predicted.gain, (coarse.found, fine.found), coarse, fine)
    lower = dataclasses.replace(one.gain_lower, search=search_that_found(math.inf))
    one = dataclasses.replace(one, gain=gain, gain_lower=lower)
    (row,) = (line for line in _loop_lines("the loop", one, None) if line.startswith("  gain, factor"))
    assert gain.found == pytest.approx(one.predicted.gain, rel=1e-6)
    assert row.endswith("  extrapolated; down to 0, too" if step else "1.21014  down to 0, too")
    assert _loop_object(one)["gain"]["extrapolated"] == step


@pytest.mark.attack
def test_lagging_actuator(paper):
    """With an actuator's lag the hold takes 4 % of II's gain margin, and MuJoCo tends to the margin that is left without it."""
    lagged = parse_vehicle(f"{paper.text}\n[limits]\nactuator_bandwidth = 60.0\n")
    timestep = 5e-4
    one = searches(lagged, design(lagged, "II"), [0], timestep)
    assert one.gain.sampled[0] < 0.96 * one.gain.own
    run_searches([one.gain.search], timestep)
    run_searches([one.gain.finer], timestep / 2)
    assert one.gain.doubtful
    assert one.gain.found == pytest.approx(one.gain.own, rel=5e-3)  # asked for
    assert one.gain.agrees


@pytest.mark.parametrize("amount", [0.3, 0.9])
def test_points_of_the_picture_are_the_slowest_pole(paper, designer, amount):
    """The stated decay of a run of MuJoCo is the slowest pole of its sampled loop, not what the bump excites most."""
    controller, timestep = designer.design("II"), 1e-3
    one = searches(paper, controller, [0], timestep)
    for search, unit in ((one.gain.search, one.gain.sampled[0]), (one.delay, one.predicted.delay)):
        trial = search.trial(amount * unit if search is one.gain.search else round(amount * unit / timestep) * timestep)
        (growth,) = grows([trial], timestep)
        rate = math.log(sampled_radius(trial.vehicle, trial.controller, timestep)) / timestep
        assert growth.rate == pytest.approx(rate, rel=1e-3)  # what is left unexplained is below 1e-4 of the samples


@pytest.mark.attack
def test_what_becomes_of_a_run_does_not_depend_on_company(paper, designer):
    """Beside others, that settle sooner or later and measure something else, a run has the rate that it has alone, to the bit."""
    timestep, trials = 4e-3, []
    for name in ("I", "II"):
        one = searches(paper, designer.design(name), [0], timestep)
        for search in (one.gain.search, one.delay, one.sample_period):
            trials += [search.trial(amount) for amount in search.next()[:3]]
    assert len({trial.vehicle.implementation.ideal for trial in trials}) == 2
    alone = [grows([trial], timestep)[0] for trial in trials]
    assert len({round(one.rate, 6) for one in alone}) == len(trials)  # they are different runs
    assert grows(trials, timestep) == alone


@pytest.mark.parametrize(("kind", "name"), [("quarter_car", "I"), ("full_car", "II")])
@pytest.mark.parametrize("delay", [0, 1, 10, 70])
def test_a_delayed_loop_needs_no_eigenvalue_of_what_is_on_its_way(kind, name, delay):
    """The rate by the map over a whole delay is that of the loop from sample to sample, whichever of the two ways finds it."""
    vehicle, timestep = read_vehicle(kind), 5e-4
    controller = designed(vehicle, name)
    late = dataclasses.replace(vehicle, implementation=Implementation(delay=delay))
    expected = math.log(sampled_radius(late, controller, timestep)) / timestep
    found = delayed_rate(vehicle, controller, timestep, delay)
    assert found == pytest.approx(expected, abs=1e-7)  # rounding of the eigenvalues over a timestep; measured 2e-8


def of_every_kind(vehicle, controller, timestep):
    """Trials on either side of every margin, and a weak loop with a delay far beyond its memory."""
    one = searches(vehicle, controller, [0], timestep)
    trials = [search.trial(amount) for search in (one.gain.search, one.delay, one.sample_period) for amount in search.next()[:2]]
    weak = dataclasses.replace(controller, law=controller.law.scaled(0.1))
    return [*trials, searches(vehicle, weak, [0], timestep).delay.trial(1.5)]


@pytest.mark.attack
@pytest.mark.parametrize("kind", ["quarter_car", "half_car"])
def test_a_loop_that_is_not_the_runs_confirms_nothing(kind, monkeypatch):
    """Held against its loop a run ends sooner, and says what it says alone, or held against a loop that does the contrary."""
    vehicle, timestep = read_vehicle(kind), 4e-3
    trials, told = of_every_kind(vehicle, designed(vehicle, "I"), timestep), []
    for what in (late_loop, lambda *asked: None, contrary):
        monkeypatch.setattr("sim.studies.stability.growth_test.late_loop", what)
        told.append([one.grows for one in grows(trials, timestep)])
    assert {*told[0]} == {True, False}
    assert told[0] == told[1] == told[2]


def contrary(*asked):
    """A loop that grows where the trial's decays, and the other way round, by as much as it can be told apart."""
    loop = late_loop(*asked)
    assert loop is not None
    return dataclasses.replace(loop, Phi=loop.Phi * math.exp(-2.2 * loop.rate * loop.timestep))


def test_a_run_is_ended_by_its_loop(paper, designer, monkeypatch):
    """A run that the loop confirms takes two or four seconds, not up to 32; a delay of 1.5 s takes eight, not 36."""
    timestep, taken, confirmed = 2e-3, [], growth_test._confirmed
    trials = of_every_kind(paper, designer.design("II"), timestep)
    monkeypatch.setattr("sim.studies.stability.growth_test._growth", lambda *rest: None)

    def timed(*rest):
        if (found := confirmed(*rest)) is not None:
            taken.append(rest[-1])
        return found

    monkeypatch.setattr("sim.studies.stability.growth_test._confirmed", timed)
    for trial in trials:
        grows([trial], timestep)
    assert len(taken) == len(trials)
    assert {*taken[:-1]} <= {2.0, 4.0}
    assert taken[-1] == 8.0


@pytest.mark.parametrize("how", [{}, {"delay": 1}, {"delay": 40}, {"sample_period": 0.06}])
@pytest.mark.parametrize(("kind", "actuators"), [("quarter_car", [0]), ("half_car", [0, 1]), ("half_car", [1])])
def test_late_loop(kind, actuators, how):
    """Its rate is that of the loop as it is implemented, and what it makes of its own past is its own future, mode and all."""
    vehicle, timestep = read_vehicle(kind), 2e-3
    controller = designed(vehicle, "I")
    mine = np.isin(np.arange(len(vehicle.linear_model.inputs)), actuators)
    late, rest = (dataclasses.replace(controller, law=controller.law.only(part)) for part in (mine, ~mine))
    vehicle = dataclasses.replace(vehicle, implementation=Implementation(**how))
    loop = late_loop(vehicle, late, rest if rest.law.acts else None, timestep)
    assert loop is not None
    if not rest.law.acts:
        expected = sampled_radius(vehicle, controller, timestep)
        assert loop.rate == pytest.approx(math.log(expected) / timestep, rel=1e-4)  # of RK4 and rounding
    run = loop.goes_on(np.ones((len(loop.Phi), 1)) * np.eye(1, 3000), 0)
    np.testing.assert_array_equal(loop.goes_on(np.where(np.arange(3000) > 600, np.nan, run), 600), run)
    rate, off = loop.slowest_mode(run, 240)  # a sample of each, after the longest delay
    assert off < 1e-6  # rounding, of what has grown or decayed over 5.5 s
    assert rate == pytest.approx(loop.rate, rel=1e-6)
    over = [np.linalg.norm(run[:, k : k + 500]) for k in (1000, 2500)]
    assert math.log(over[1] / over[0]) / (1500 * timestep) == pytest.approx(loop.rate, abs=1.0)  # what is left of it


def test_late_loop_of_one_of_two_forces_with_states():
    """A law with states whose one force is late and whose other is not has the loop that is written out by the whole law."""
    vehicle, timestep, late = read_vehicle("half_car"), 2e-3, 3
    whole = designed(vehicle, "I")
    filtered = LinearLaw(np.diag([-30.0, -40.0]), np.eye(2, 4), 1e3 * np.ones((2, 2)), whole.gain)
    whole = dataclasses.replace(whole, law=filtered)
    mine, other = (dataclasses.replace(whole, law=filtered.only(np.array(one))) for one in ([False, True], [True, False]))
    loop = late_loop(dataclasses.replace(vehicle, implementation=Implementation(delay=late)), mine, other, timestep)
    assert loop is not None
    Phi, Gamma, G = sampled_loop_transfer(vehicle, whole, timestep, [1])
    n, m = Gamma.shape
    pending = np.eye((late - 1) * m, late * m, m)  # the forces on their way, the next to act first
    written = np.block(
        [[Phi, Gamma, np.zeros((n, (late - 1) * m))], [np.zeros(((late - 1) * m, n)), pending], [G, np.zeros((m, late * m))]]
    )
    assert loop.rate == pytest.approx(math.log(np.abs(np.linalg.eigvals(written)).max()) / timestep, rel=1e-4)  # of RK4
    assert late_loop(vehicle, mine, whole, timestep) is None  # both have the second


def test_slowest_mode_of_known_modes():
    """A mode a millionth as loud as the others is found; noise is no mode; what grows beyond all linearity is left out."""
    time = np.arange(4000) * 1e-3
    modes = [np.exp(-3.0 * time) * np.cos(60 * time), np.exp(-2.0 * time) * np.sin(5 * time), 1e-6 * np.exp(-0.5 * time)]
    states = np.array([[1.0, 0.5, 1.0], [0.3, -1.0, 2.0], [0.1, 0.2, -1.0]]) @ np.array(modes)
    assert slowest_rate(states, 1e-3, 1) == pytest.approx(-0.5, rel=1e-6)
    assert slowest_rate(states, 1e-3, 300) == pytest.approx(-0.5, rel=1e-6)  # a controller that holds for long
    assert math.isnan(slowest_rate(np.random.default_rng(0).standard_normal((3, 4000)), 1e-3, 1))


OWN = """
type = "{kind}"
[parameters]
weight = 200.0
rate = 150000.0
[performance]
sprung_acceleration = 1.0
control_force = 1e-4
[controllers.I]
measured = ["sprung_velocity"]
"""


@pytest.fixture
def hopper(tmp_path, request):
    """The README's hopper with parameters of other names, and what its kind says of their variation."""
    pages.hopper(tmp_path)
    source = (tmp_path / "hopper.py").read_text(encoding="utf-8")
    source = source.replace('p["mass"]', 'p["weight"]').replace('p["stiffness"]', 'p["rate"]')
    weight, rate = request.param
    source = source.replace('"mass", "kg", "all of it"', f'"weight", "kg", "all of it"{weight}')
    source = source.replace('"stiffness", "N/m", "of its tyre"', f'"rate", "N/m", "of its tyre"{rate}')
    source = source.replace("import GRAVITY, ", "import GRAVITY, Variation, ")
    (tmp_path / "hopper.py").write_text(source)
    (tmp_path / "own.toml").write_text(OWN.format(kind="hopper"))
    return tmp_path / "own.toml"


@pytest.fixture
def of_one_search(monkeypatch):
    """Words and `--json` are of one search."""
    for module, name in (("margin_search", "find_margins"), ("fragility", "find_fragility"), ("robustness", "robustness")):
        path = f"sim.studies.stability.{module}.{name}"
        monkeypatch.setattr(path, once(pkgutil.resolve_name(path)))


@pytest.mark.attack
@pytest.mark.parametrize("hopper", [("", "")], indirect=True)
def test_a_kind_that_varies_nothing_says_so(hopper, capsys, of_one_search):
    """Nothing is claimed of other vehicles where the kind says of no parameter how far it varies, in words and in --json."""
    main(["--vehicle", str(hopper), "--controller", "I", "--timestep", "4e-3"])
    printed = capsys.readouterr().out
    assert "nothing is varied" in printed
    assert "worst norm" not in printed
    assert "30" not in printed.split("other vehicles")[1]
    main(["--vehicle", str(hopper), "--controller", "I", "--timestep", "4e-3", "--json"])
    assert json.loads(capsys.readouterr().out)["robustness"] is None


VARIED = (', varied=Variation("weight", 0.9, 1.2)', ', varied=Variation("tyre rate", 0.75, 1.0)')


@pytest.mark.attack
@pytest.mark.parametrize("hopper", [VARIED, (VARIED[0], "")], indirect=True, ids=["two", "one"])
def test_the_kind_says_what_varies(hopper, monkeypatch):
    """The box, its worst norm and its words are of the parameters that the kind lets vary, as far as it does, and no others."""
    monkeypatch.setattr("synth.design.uncertainty.fragility.SHARES", ())  # errors of readings are not asked about
    vehicle = read_vehicle(hopper)
    controller = design(vehicle, "I")
    (box,) = robustness(vehicle, [controller], 4e-3)
    assert box is not None
    ends = {"weight": (180.0, 240.0), "rate": (112500.0, 150000.0)}
    names = ["weight", "rate"][: len(box.varied)]
    assert varied_text(vehicle.kind) == ", ".join(["weight -10 to +20 %", "tyre rate -25 to +0 %"][: len(names)])
    corners = {tuple(corner.parameters.items()) for corner in box.corners}
    assert corners == {tuple(zip(names, at, strict=True)) for at in itertools.product(*(ends[name] for name in names))}
    assert set(box.at) == set(names)
    for corner in box.corners:
        other = dataclasses.replace(vehicle, parameters={**vehicle.parameters, **corner.parameters})
        assert corner.norm == pytest.approx(hinf_norm(generalized_plant(other).closed_loop(controller.state_gain(other))).value)
        assert corner.norm <= box.norm
    assert box.holds
    fragile, found = find_fragility(vehicle, controller, 4e-3), find_margins(vehicle, controller, 4e-3)[""]
    figure = margins_figure(vehicle, controller, found, fragile, box, 4e-3)
    panel = figure.panels[-1]
    assert panel.xlabel == "weight [% off]"
    assert panel.ylabel == ("tyre rate [% off]" if len(names) == 2 else "H-infinity norm")
    drawn = np.concatenate(
        [curve.x for curve in panel.curves if isinstance(curve, Curve) and curve.marker in "ox" and curve.marker]
    )
    assert set(drawn.round(9)) == {-10.0, 20.0}  # rounding of 100 (factor - 1)


@pytest.mark.parametrize(
    ("smallest", "largest"), [(1.1, 1.4), (0.7, 0.9), (0.0, 1.2), (1.0, 1.0), (0.5, math.inf), (math.nan, 2)]
)
def test_variations_that_are_none(smallest, largest):
    """A range of factors must hold the vehicle itself and others."""
    with pytest.raises(InputError, match=r"mass varies by factors|(smallest|largest) = \S+ is not allowed"):
        Variation("mass", smallest, largest)


def test_printed_margins_are_those_of_json(paper, designer, capsys, of_one_search):
    """Every number of the table with -v is that of --json, in the table's units; without, a terminal shows all."""
    assert main(["--controller", "I", "--timestep", "4e-3"]) == 0
    brief = capsys.readouterr().out
    assert main(["--controller", "I", "--timestep", "4e-3", "-v"]) == 0
    printed = capsys.readouterr().out
    assert brief.count("\n") <= 24  # what a terminal shows
    assert main(["--controller", "I", "--timestep", "4e-3", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    for label, key, scale in (("gain, factor", "gain", 1), ("phase lag, rad", "phase", 1), ("delay, ms", "delay", 1e3)):
        (line,) = re.findall(rf"^  {label} +(\S+) +(\S+)", printed, re.M)
        assert [float(word) for word in line] == pytest.approx(
            [scale * result[key][of] for of in ("predicted", "found")], rel=1e-5
        )
    assert result["phase"]["smallest"] == result["phase"]["lead"]["predicted"] < result["phase"]["predicted"]
    for label, value in (("phase lead, rad", result["phase"]["lead"]["predicted"]), ("disk margin", result["disk"]["margin"])):
        (line,) = re.findall(rf"^  {label} +(\S+) +(\S+)", brief, re.M)
        assert (float(line[0]), line[1]) == (pytest.approx(value, rel=1e-5), "-")  # predicted alone
    (line,) = re.findall(r"^  sample period, ms +(\S+) +(\S+)", printed, re.M)
    assert [float(word) for word in line] == pytest.approx(
        [1e3 * result["sample_period"][of] for of in ("predicted", "found")], rel=1e-5
    )
    _check_fragility(printed, result["fragility"])
    _check_rows_of_steps(paper, designer.design("I"), pkgutil.resolve_name("sim.studies.stability.fragility.find_fragility")())
    assert f"of {result['robustness']['computed']} vehicles computed, not proved between" in " ".join(brief.split())
    ranges = re.findall(r"([\w ]+?) (-\d+) to \+(\d+) %", printed)
    varied = {name.strip(): [1 + float(low) / 100, 1 + float(high) / 100] for name, low, high in ranges}
    assert varied == result["robustness"]["varied"] == {"sprung mass": [0.7, 1.4], "tyre stiffness": [0.75, 1.25]}
    masses = {corner["sprung_mass"] / paper.parameters["sprung_mass"] for corner in result["robustness"]["corners"]}
    assert sorted(masses) == pytest.approx(varied["sprung mass"])


def _check_rows_of_steps(vehicle, controller, fragile) -> None:
    """Checks that errors of a loop that needs two steps are in percent at each."""
    edge = dataclasses.replace(fragile.edge, sampled=(0.2, 0.25), search=search_that_found(0.19), finer=search_that_found(0.24))
    rows = [line.split() for line in _fragile_lines(vehicle, controller, dataclasses.replace(fragile, edge=edge), True)]
    rows = [row[2:6] for row in rows if row[:2] == ["sampled", "every"]]
    assert [row[:2] for row in rows] == [["4", "ms"], ["2", "ms"]]
    assert [[float(word) for word in row[2:]] for row in rows] == [pytest.approx(each, rel=1e-4) for each in ([20, 19], [25, 24])]


def _check_fragility(printed: str, fragile) -> None:
    """Checks that printed errors are those of --json, in percent."""
    stable, said = fragile["stable"], " ".join(printed.split())
    (line,) = re.findall(r"^  of readings(?: and forces)? +(\S+) +(\S+)", printed, re.M)
    assert [float(word) for word in line] == pytest.approx([100 * stable["found"], 100 * fragile["mujoco"]], rel=1e-5)
    named = re.findall(r"(\w+) ([+-][\d.]+) %[,\s]", said[said.index("bears errors up to, %") : said.index("stable with each")])
    assert {name: float(error) for name, error in named} == pytest.approx(
        {name: 100 * error for name, error in stable["readings"].items()}, rel=1e-3
    )
    assert f"stable with each off by up to {100 * stable['proved']:.4g} %, which is proved" in said
    for one in fragile["within"]:
        assert (
            f"the norm within {100 * one['share']:g} % up to {100 * one['proved']:.4g} %, and not at {100 * one['found']:.4g} %"
            in said
        )
    for name, one in fragile["rounding"].items():
        assert f"as {name} {one['norm']:.7g} (" in said
        assert f"proved below {one['bound']:.7g})" in said


def test_fragility_in_physics(paper, designer):
    """Printed controller I dies in MuJoCo, too, where its readings are 21.03 % off, as it cancels the spring there."""
    found = find_fragility(paper, designer.design("I_printed"), 1e-3)
    assert found.edge.own == pytest.approx(13100 / 10824 - 1, rel=1e-8)  # eigenvalues near 0 have half the digits
    assert found.edge.found == pytest.approx(found.edge.own, rel=2e-3)  # where the section ends
    assert found.agrees
    off = with_errors(designer.design("I_printed"), found.predicted, found.edge.own)
    assert off.gain == pytest.approx(np.array([[13100.0, -2071.0 * (1 - found.edge.own)]]), rel=1e-6)  # the spring's stiffness
    assert found.rounding["float16"].bound is not None
    assert found.rounding["float16"].norm.value < found.rounding["float16"].bound


@pytest.mark.attack
def test_errors_are_borne_by_the_loop_with_its_lag(paper, monkeypatch):
    """A gain that bears any error of an actuator without lag is lost with one at 27.7 %; MuJoCo tends to that with its step."""
    monkeypatch.setattr("synth.design.uncertainty.fragility.SHARES", ())  # what errors cost of the norm is not asked
    vehicle = parse_vehicle(f'{paper.text}\n[controllers.strong]\nmeasured = ["sprung_velocity"]\ngain = [[-1e5]]\n')
    slow, strong = dataclasses.replace(vehicle, limits=Limits(actuator_bandwidth=60.0)), design(vehicle, "strong")
    assert find_fragility(vehicle, strong, 8e-3).predicted.stable.smallest_violation == math.inf
    found = find_fragility(slow, strong, 1e-3)
    (factor,) = (at for at in gain_crossings(loop_transfer(slow, strong, [0])) if at > 1)
    assert found.edge.own == pytest.approx(factor - 1, rel=1e-6)  # the gain margin, by another way
    assert found.edge.finer.tried
    assert found.edge.found == pytest.approx(found.edge.own, rel=2e-2)  # second order in the step
    assert found.agrees


@pytest.mark.parametrize(
    ("gain", "word"), [("[[0.0]]", "no gain"), ("[[90000.0]]", r"not stable as it is \(unstable: a pole at 170.7 1/s\)")]
)
def test_loops_without_margins(tmp_path, paper, gain, word):
    """A gain of zero makes no loop, and an unstable loop has no margin to lose."""
    file = tmp_path / "own.toml"
    file.write_text(paper.text + f'[controllers.own]\nmeasured = ["sprung_velocity"]\ngain = {gain}\n')
    with pytest.raises(InputError, match=word):
        main(["--controller", "own", "--vehicle", str(file)])


def test_which_loop_is_said(paper):
    """The sections of a vehicle file beyond parameters are in the margins or left out of them; it is said which."""
    plain = _which_loop(dataclasses.replace(paper, limits=Limits(actuator_force=1e3)))
    assert plain == "the loop has no actuator lag; norms of other vehicles are of the ideal loop"
    built = dataclasses.replace(paper, limits=Limits(actuator_bandwidth=60.0), implementation=Implementation(delay=1))
    assert "has the lag of its actuators; delay and sample period below are totals" in _which_loop(built)
    assert "left out" not in _which_loop(built)
    blurred = dataclasses.replace(built, implementation=Implementation(noise={"sprung_velocity": 0.01}))
    assert "noise is left out;" in _which_loop(blurred)


def test_logs_of_earlier_versions_are_of_margins_too(paper):
    """A log's road is that of a margin, as it is or as it was a hundred times as high, and no other."""
    asks = margins_options.expected_log(paper, margins_options.parser().parse_args(["--controller", "II"]))
    assert [asks.road(dataclasses.replace(BUMP, height=height).describe()) for height in (2e-5, 2e-3, 1e-3)] == [
        True,
        True,
        False,
    ]
