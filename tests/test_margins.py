"""Margins: predicted from the loop transfer function, and found where MuJoCo turns from decay to growth."""

import dataclasses
import json
import math

import numpy as np
import pytest
from scipy import optimize

from models.errors import InputError
from models.vehicle import parse_vehicle, read_vehicle
from sim.bisection import Search, run_searches
from sim.growth import Growth
from sim.linear import sampled_radius
from sim.loop import Loop, crossovers, cut, gain_crossings, largest_sample_period, margins, sampled_gain_crossings
from sim.loop_margins import find_margins, searches
from sim.margins import main
from sim.robustness import robustness
from synth.certificate import certify
from synth.controller import Designer, design
from tests.conftest import recorded_runs

# Found before by other means: delay [ms], its crossover [rad/s], and half of the delay's last digit. That of II was for -8970.
KNOWN = {"II_printed": (87.097, 18.18, 0.005), "I_printed": (293.0, 7.70, 0.05), "state_printed": (388.1, 7.01, 0.05)}


def scalar(a: float, k: float) -> Loop:
    """x' = a x + u, u = -k x: every margin of it is known in closed form."""
    return Loop(np.array([[a]]), np.array([[1.0]]), np.array([[-k]]))


@pytest.mark.parametrize(("a", "k"), [(-1.0, 3.0), (1.0, 3.0), (-1.0, 0.5)])
def test_scalar_loop(a, k):
    """A first-order loop: w = sqrt(k^2 - a^2), theta = acos(a / k), sample period log((k + a) / (k - a)) / a."""
    found = margins(scalar(a, k))
    assert found.gain == math.inf
    assert found.gain_lower == pytest.approx(max(a / k, 0), rel=1e-12)
    if k > abs(a):
        w = math.sqrt(k**2 - a**2)
        assert found.frequency == pytest.approx(w, rel=1e-9)
        assert found.delay == pytest.approx(math.acos(a / k) / w, rel=1e-9)
        assert found.sample_period == pytest.approx(math.log((k + a) / (k - a)) / a, rel=1e-9)
    else:  # |L| < 1 everywhere: any delay, any sample period
        assert found.crossovers == ()
        assert found.delay == found.sample_period == found.smallest_phase == math.inf


@pytest.mark.parametrize("name", KNOWN)
def test_known_delay_margins(paper, designer, name):
    """The delay margins of the printed gains are those found by other means."""
    delay, frequency, digits = KNOWN[name]
    found = margins(cut(paper, designer.design(name), [0]))
    assert 1e3 * found.delay == pytest.approx(delay, abs=digits)
    assert found.frequency == pytest.approx(frequency, abs=0.005)


@pytest.mark.parametrize("name", ["state", "I", "II"])
def test_crossovers_by_another_route(paper, designer, name):
    """With one actuator the crossovers are the roots of |L(j w)| = 1 on a dense grid, and the lag is the angle of L there."""
    loop = cut(paper, designer.design(name), [0])

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


@pytest.mark.parametrize("kind", ["half_car", "full_car"])
def test_many_actuators(kind):
    """At every crossing an eigenvalue of L is what it must be, for each loop and for all at once."""
    vehicle = read_vehicle(kind)
    controller = design(vehicle, "I")
    for actuators in ([0], list(range(len(controller.gain)))):
        loop = cut(vehicle, controller, actuators)
        for one in crossovers(loop):
            eigenvalues = np.linalg.eigvals(loop.transfer(np.array([one.frequency]))[0])
            assert np.abs(eigenvalues * np.exp(-1j * one.phase) - 1).min() < 1e-7  # as well as poles are refined
        for factor in gain_crossings(loop):
            assert abs(np.linalg.eigvals(loop.A + factor * loop.M).real.max()) < 1e-7 * np.linalg.norm(loop.A, 2)


def test_sampled_loop(paper, designer):
    """Sample period and sampled gain margin are where the spectral radius of the implemented loop passes one."""
    controller = designer.design("I")
    loop = cut(paper, controller, [0])
    period = largest_sample_period(loop)
    assert sampled_radius(paper, controller, period * (1 - 1e-6)) < 1 < sampled_radius(paper, controller, period * (1 + 1e-6))
    for factor in sampled_gain_crossings(loop, 0.01):
        for side in (1 - 1e-6, 1 + 1e-6):
            with_gain = dataclasses.replace(controller, gain=side * factor * controller.gain)
            assert (sampled_radius(paper, with_gain, 0.01) > 1) == (side > 1)


def test_conditionally_stable_loop():
    """A loop that needs its gain has a lower gain margin, sampled too: x' = x + u, u = -3 x is stable above a third."""
    assert gain_crossings(scalar(1.0, 3.0)) == [pytest.approx(1 / 3, rel=1e-12)]
    low, high = sampled_gain_crossings(scalar(1.0, 3.0), 0.1)
    assert low == pytest.approx(1 / 3, rel=1e-9)  # a pole at 1 stays there when sampled
    assert high == pytest.approx((math.exp(0.1) + 1) / (math.exp(0.1) - 1) / 3, rel=1e-9)


def test_search_does_not_believe_its_expectation(monkeypatch):
    """Physics decides: the search ends at its own answer, wherever it was told to look first, or not at all."""
    monkeypatch.setattr("sim.bisection.grow", lambda trials, timestep, progress: [Growth(amount > 17.5) for amount in trials])
    for expected in (3.0, 17.0, 18.0, 200.0, math.inf):
        search = Search(lambda amount: amount, expected, most=100.0, step=1.0)  # type: ignore[arg-type]
        run_searches([search], 1.0)
        assert (search.stable, search.unstable) == (17.0, 18.0)
    never = Search(lambda amount: amount, math.inf, most=10.0, step=1.0)  # type: ignore[arg-type]
    run_searches([never], 1.0)
    assert never.unstable == math.inf


def test_margins_in_physics(capsys, tmp_path):
    """The command finds II's margins in MuJoCo where they are predicted, agrees, draws them and records both sides of one."""
    pytest.importorskip("matplotlib", reason="pictures are in the extra [report]")
    assert main(["--controller", "II", "--json", "--picture", str(tmp_path / "m.svg"), "--logs", str(tmp_path)]) == 0
    captured = capsys.readouterr()
    result = json.loads(captured.out)
    assert captured.err == ""
    assert "</svg>" in (tmp_path / "m.svg").read_text()
    assert recorded_runs(result["logs"]["mcap"]) == {"II_173_samples_late", "II_174_samples_late"}
    assert result["gain"]["predicted"] is None
    assert result["gain"]["found"] is None
    sampled = result["gain"]["sampled"]  # the hold ends it, and at half the step physics bore 1.5 times as much
    assert sampled["found"] == pytest.approx(sampled["predicted"], rel=5e-3)  # asked for; the section ends at 0.2 %
    assert result["delay"]["found"] == pytest.approx(0.0870, abs=1e-9)  # 173 samples decay, 174 grow
    assert abs(result["delay"]["found"] - result["delay"]["predicted"]) < 5e-4  # one sample
    assert result["phase"]["found"] == pytest.approx(result["delay"]["found"] * result["phase"]["frequency"])
    assert abs(result["sample_period"]["found"] - result["sample_period"]["predicted"]) < 5e-4
    box = result["robustness"]
    assert box["worst_norm"] >= max(corner["norm"] for corner in box["corners"])
    assert len(box["corners"]) == 4
    assert all(corner["stable"] and corner["agrees"] for corner in box["corners"])
    assert set(box["at"]) == {"sprung_mass", "tyre_stiffness"}


@pytest.mark.parametrize(("name", "timestep"), [("I", 1e-3), ("state", 2e-3)])
def test_gain_and_delay_in_physics(paper, designer, name, timestep):
    """I and the state feedback: the delay to one sample, the gain to 0.5 %."""
    one = searches(paper, designer.design(name), [0], timestep)
    run_searches([one.gain, one.delay], timestep)
    assert abs(one.delay.unstable - one.predicted.delay) <= timestep
    assert one.found_gain == pytest.approx(one.predicted.gain, rel=5e-3)  # asked for; the section ends at 0.2 %


@pytest.mark.parametrize("actuators", [[0, 1], [1]])
def test_two_actuators_in_physics(actuators):
    """Two actuators with a common factor or delay end where L's eigenvalues say; one of them where its own loop does."""
    vehicle, timestep = read_vehicle("half_car"), 2e-3
    one = searches(vehicle, design(vehicle, "I"), actuators, timestep)
    run_searches([one.gain, one.delay, one.sample_period], timestep)
    assert abs(one.delay.unstable - one.predicted.delay) <= timestep  # one sample
    assert abs(one.found_sample_period - one.predicted.sample_period) <= timestep
    assert one.gain.found == pytest.approx(one.sampled_gain, rel=5e-3)


def test_infinite_margins_in_physics(paper):
    """Where |L| < 1 everywhere no delay and no sample period destabilises, and no gain but the sampling's; nor in MuJoCo."""
    name, gain = "weak", -250.0
    text = f'{paper.text}\n[controllers.{name}]\nmeasured = ["sprung_velocity"]\ngain = [[{gain}]]\n'
    vehicle = parse_vehicle(text)
    found = find_margins(vehicle, design(vehicle, name), 8e-3)[""]
    assert found.predicted.delay == found.predicted.sample_period == found.predicted.gain == math.inf
    assert found.delay.unstable == found.sample_period.unstable == found.found_gain == found.found_phase == math.inf
    assert found.found_gain_lower == 0
    assert found.agrees


def test_worst_norm_is_inside_or_on_the_box(paper, designer):
    """No vehicle drawn from the box has a larger norm than the worst."""
    controller = designer.design("I")
    box = robustness(paper, controller, 2e-3)
    rng = np.random.default_rng(20261121)
    for mass, tyre in zip(rng.uniform(0.7, 1.4, 20), rng.uniform(0.75, 1.25, 20), strict=True):
        parameters = {**paper.parameters}
        parameters["sprung_mass"] *= mass
        parameters["tyre_stiffness"] *= tyre
        other = dataclasses.replace(paper, parameters=parameters, controllers={})
        norm = certify(Designer(other).plant, controller.state_gain(other)).norm.value
        assert norm <= box.norm
    assert box.holds


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], ["--controller", "I, II", "state"]),
        (["--controller", "passive"], ["'passive'", "no gain", "no margin"]),
        (["--controller", "III"], ["unknown controller 'III'"]),
        (["--controller", "II", "--timestep", "0"], ["timestep", "above 0"]),
        (["--controller", "II", "--timestep", "1"], ["timestep", "RK4"]),
        (["--controller", "II", "--timestep", "x"], ["not a number"]),
    ],
)
def test_bad_input(arguments, words):
    """One line says what was found and what to give."""
    with pytest.raises(InputError) as raised:
        main(arguments)
    assert "\n" not in str(raised.value)
    for word in words:
        assert word in str(raised.value)


@pytest.mark.parametrize(("gain", "word"), [("[[0.0]]", "no gain"), ("[[90000.0]]", "unstable as it is")])
def test_loops_without_margins(tmp_path, paper, gain, word):
    """A gain of zero makes no loop, and an unstable loop has no margin to lose."""
    file = tmp_path / "own.toml"
    file.write_text(paper.text + f'[controllers.own]\nmeasured = ["sprung_velocity"]\ngain = {gain}\n')
    with pytest.raises(InputError, match=word):
        main(["--controller", "own", "--vehicle", str(file)])
