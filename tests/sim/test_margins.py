"""Margins predicted from the loop transfer function: closed forms, python-control, and the poles of the sampled loop."""

import dataclasses
import math

import control
import numpy as np
import pytest
from scipy import optimize
from scipy.linalg import expm

from models.common.arrays import Array
from models.laws.linear import LinearLaw, static_law
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from synth.controller.disk_margin import disk_margin
from synth.controller.loop_of import loop_of
from synth.controller.sample_period_margin import (
    LONGEST,
    all_sampled,
    largest_sample_period,
    sampled_growth_at,
    sampled_part,
    transitions,
)
from synth.controller.stability_margins import (
    _sign_changes,
    crossovers,
    gain_crossings,
    margins,
)
from synth.plant.loop import HoldInterval, Loop
from synth.plant.state_space import StateSpace
from synth.vehicle.designer import design
from tests.support.analysed import sampled_radius
from tests.support.shared import designed


def loop_under(A: Array, B: Array, K: Array) -> Loop:
    """x' = A x + B u, u = K x."""
    n = len(A)
    plant = StateSpace(A, B, np.eye(n), np.zeros((n, 1)), ("u",), tuple(f"x{i}" for i in range(n)))
    return Loop(plant, static_law(K), plant.outputs, plant.inputs)


def scalar(a: float, k: float) -> Loop:
    """x' = a x + u, u = -k x: every margin of it is known in closed form."""
    return loop_under(np.array([[a]]), np.array([[1.0]]), np.array([[-k]]))


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
    loop = loop_of(paper, designer.design(name))
    found, cut = margins(loop), loop.cut(loop.forces)
    open_ = control.ss(cut.A, cut.B, -cut.C, 0)
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
    whole = loop_of(paper, designer.design("I"))
    found, loop = margins(whole), whole.cut(whole.forces)
    assert found.lead == pytest.approx(0.39806, abs=1e-5)
    assert found.lead_frequency == pytest.approx(1.80846, abs=1e-5)
    corner = found.lead_frequency * math.tan(found.lead / 2)
    for side in (1 - 1e-6, 1 + 1e-6):
        poles = np.linalg.eigvals(loop.loop_matrix(np.exp(1j * side * found.lead)))
        assert (poles.real.max() > 0) == (side > 1)
        # u = (s - a) / (s + a) v has magnitude 1 and leads by 2 atan(a / w). At rest it changes the sign: |L(0)| < 1 bears that.
        a = side * corner
        filtered = np.block([[loop.loop_matrix(1.0), -2 * a * loop.B], [loop.C, np.array([[-a]])]])
        assert (np.linalg.eigvals(filtered).real.max() > 0) == (side > 1)


def test_factors_within_the_disk_of_each_force():
    """A loop of two forces bears any complex factor of each within its disk margin, which is the peak of S - I / 2."""
    vehicle = read_vehicle("half_car")
    loop = loop_of(vehicle, designed(vehicle, "I"))
    loop = loop.cut(loop.forces)
    disk, forces = disk_margin(loop), 2
    rng = np.random.default_rng(20261126)
    inside = disk.size / 2 * 0.999 * np.exp(2j * np.pi * rng.uniform(size=(200, forces)))
    factors = (1 + inside) / (1 - inside)
    assert np.linalg.eigvals(loop.A + (loop.B * factors[:, None, :]) @ loop.C).real.max() < 0
    assert disk.gain[1] <= min(factor for factor in gain_crossings(loop) if factor > 1)
    omega = np.concatenate([[0.0], np.geomspace(0.05, 500, 2000)])
    S = np.linalg.inv(np.eye(forces) - loop.response(1j * omega))
    assert 1 / disk.size == pytest.approx(np.linalg.norm(S - np.eye(forces) / 2, 2, axis=(1, 2)).max(), rel=1e-3)  # of the grid


SOFT = "suspension_damping = 400.0", "suspension_damping = 60.4735"  # its wheel's poles cross, its body's stay near the axis
OF_ACCELERATION = """[controllers.felt]
measured = ["sprung_acceleration", "sprung_velocity"]
gain = [[-217.346234361259, -54244.74533479826]]
"""


@pytest.mark.parametrize(
    ("name", "delay"), [("state_printed", 388.1), ("I_printed", 293.0), ("II_printed", 87.1), ("II", None), ("felt", None)]
)
def test_crossovers_by_another_route(paper, name, delay):
    """With one actuator the crossovers are the roots of |L(j w)| = 1 on a dense grid, and the lag is the angle of L there.

    The same holds for a loop with a direct path. The delay margin [ms] is the smallest lag over its frequency.
    """
    text = paper.text if name != "felt" else paper.text.replace(*SOFT) + OF_ACCELERATION
    vehicle = parse_vehicle(text)
    whole = loop_of(vehicle, designed(vehicle, name))
    loop = whole.cut(whole.forces)

    def excess(w):
        return abs(loop.response(1j * np.array([w]))[0, 0, 0]) - 1

    grid = np.geomspace(1e-2, 1e3, 20_000)
    signs = np.sign(np.abs(loop.response(1j * grid)[:, 0, 0]) - 1)
    changes = np.flatnonzero(np.diff(signs))
    roots = [float(optimize.root_scalar(excess, bracket=(grid[i], grid[i + 1]), xtol=1e-13).root) for i in changes]
    found = sorted(crossovers(loop), key=lambda crossover: crossover.frequency)
    np.testing.assert_allclose([one.frequency for one in found], roots, rtol=1e-9)  # both refined further
    lags = np.angle(loop.response(1j * np.array(roots))[:, 0, 0]) % (2 * np.pi)
    np.testing.assert_allclose([one.phase for one in found], lags, rtol=1e-8)
    if delay is not None:
        assert margins(whole).delay == pytest.approx(np.min(lags / roots), rel=1e-8)
        assert 1e3 * margins(whole).delay == pytest.approx(delay, abs=0.05)  # found by other means, with one decimal


def test_many_actuators():
    """At every crossing an eigenvalue of L is what it must be, for each loop and for all at once."""
    vehicle = read_vehicle("half_car")
    controller = designed(vehicle, "I")
    for actuators in ([0], list(range(len(controller.gain)))):
        whole = loop_of(vehicle, controller)
        loop = whole.cut([whole.forces[i] for i in actuators])
        for one in crossovers(loop):
            eigenvalues = np.linalg.eigvals(loop.response(1j * np.array([one.frequency]))[0])
            assert np.abs(eigenvalues * np.exp(-1j * one.phase) - 1).min() < 1e-7  # as well as poles are refined
        for factor in gain_crossings(loop):
            assert abs(np.linalg.eigvals(loop.loop_matrix(factor)).real.max()) < 1e-7 * np.linalg.norm(loop.A, 2)


@pytest.mark.parametrize(
    ("law", "damping", "low", "high"),
    [
        ("pid = { kp = 2e3, ki = -100 }", 400, math.inf, math.inf),  # its integral is lost beyond the longest period
        ("gain = [[-1e8]]", 4, 0.0, 1e-5),  # rounding hides if any period is stable
        ("gain = [[-1e9]]", 4, 0.0, 1e-5),
    ],
)
def test_extremes_of_the_sample_period(paper, law, damping, low, high):
    """The search for the largest sample period ends: it finds none up to the longest, or one next to zero."""
    text = paper.text.replace("suspension_damping = 400", f"suspension_damping = {damping}")
    vehicle = parse_vehicle(f'{text}\n[controllers.c]\nmeasured = ["suspension_deflection"]\n{law}\n')
    assert low <= largest_sample_period(loop_of(vehicle, design(vehicle, "c"))) <= high
    assert LONGEST < 2 * (13100 - 2000) / 100  # what the integral adds in a period is twice what holds the body


@pytest.mark.parametrize(
    ("kind", "name", "actuators"), [("quarter_car", "I", [0]), *(("half_car", "II", some) for some in ([0], [1], [0, 1]))]
)
def test_sampled_loop(kind, name, actuators):
    """Sample period and sampled gain margin are where the spectral radius of the whole implemented loop passes one."""
    vehicle = read_vehicle(kind)
    controller, timestep = designed(vehicle, name), 1e-2
    mine = np.isin(np.arange(len(controller.gain)), actuators)
    if all(mine):
        period = largest_sample_period(loop_of(vehicle, controller))
        radii = [sampled_radius(vehicle, controller, period * side) for side in (1 - 1e-6, 1 + 1e-6)]
        assert radii[0] < 1 < radii[1]
    loop = loop_of(vehicle, controller, timestep)
    factors = [at for at in gain_crossings(loop.cut([loop.forces[i] for i in actuators])) if at > 1]
    for factor in factors:
        for side in (1 - 1e-8, 1 + 1e-8):
            with_gain = dataclasses.replace(controller, law=controller.law.scaled(np.where(mine, side * factor, 1.0)))
            assert (sampled_radius(vehicle, with_gain, timestep) > 1) == (side > 1)
    assert len(factors) == 1


def test_a_factor_that_rounding_gives_twice_is_found():
    """A pair of poles that crosses gives its factor twice, as close as rounding: the sign on either side counts."""
    for twin in (1.5, np.nextafter(1.5, 2), 1.5 * (1 + 1e-12), 1.5 * (1 + 1e-8)):
        tried = np.array([1.5, twin, 1.5 * (1 - 1e-15), 2.0])
        (found,) = _sign_changes(lambda k: round(k - 1.5, 14), tried)
        assert found == pytest.approx(1.5, rel=1e-12)


def test_conditionally_stable_loop():
    """A loop that needs its gain has a lower gain margin, sampled too: x' = x + u, u = -3 x is stable above a third."""
    loop = scalar(1.0, 3.0)
    assert gain_crossings(loop.cut(loop.forces)) == [pytest.approx(1 / 3, rel=1e-12)]
    low, high = gain_crossings(dataclasses.replace(loop, hold=(HoldInterval(0.1, 0),)).cut(loop.forces))
    assert low == pytest.approx(1 / 3, rel=1e-9)  # a pole at 1 stays there when sampled
    assert high == pytest.approx((math.exp(0.1) + 1) / (math.exp(0.1) - 1) / 3, rel=1e-9)


@pytest.mark.parametrize("actuators", [[0, 1], [0], [1]])
def test_a_law_with_states_is_sampled_where_it_is_cut(actuators):
    """Behind filters of 10 kHz a gain has the sample period that it has without, also where its other force is not sampled."""
    vehicle = read_vehicle("half_car")
    controller = designed(vehicle, "I")
    fast = 2e4 * np.pi * np.eye(4)
    filtered = dataclasses.replace(controller, law=LinearLaw(-fast, fast, controller.gain, np.zeros((2, 4))))
    plain, behind = (
        largest_sample_period(loop, [loop.forces[i] for i in actuators])
        for loop in (loop_of(vehicle, one) for one in (controller, filtered))
    )
    assert behind == pytest.approx(plain, rel=5e-4)  # the filters' delay of 16 us, of a period of 62 ms
    assert math.isinf(plain) == (actuators == [0])


def test_integrators_that_two_forces_share_are_sampled_together():
    """A force with an integrator of its own is sampled separately, and has a period at which its loop is lost.

    Forces with a common integrator are all sampled.
    """
    vehicle = read_vehicle("half_car")
    measured = ("suspension_deflection_front", "suspension_deflection_rear")
    A, B, D = np.zeros((2, 2)), np.eye(2), -2000 * np.eye(2)
    for C, together in ((-500 * np.eye(2), False), (-500 * np.array([[1.0, 0.2], [0.2, 1.0]]), True)):
        one = dataclasses.replace(designed(vehicle, "I"), measured=measured, law=LinearLaw(A, B, C, D))
        loop = loop_of(vehicle, one)
        cuts = loop.forces[:1], loop.forces
        assert all_sampled(loop, cuts[0]) == together
        periods = [largest_sample_period(loop, forces) for forces in cuts]
        assert periods[0] == pytest.approx(periods[1], rel=1e-9)  # the ends of two bisections
        for forces, period in zip(cuts, periods, strict=True):
            part = sampled_part(loop, forces)
            assert sampled_growth_at(part, 0.99 * period) < 0 < sampled_growth_at(part, 1.01 * period)
            (batched,) = transitions(part, 0.9 * period, 0.1 * period, 1)
            assert np.abs(np.linalg.eigvals(batched)).max() == pytest.approx(1, abs=1e-9)


def test_an_instability_shorter_than_a_step_is_found():
    """A mode of 1360 rad/s that hardly decays is lost over 0.1 us, where it turns by half a turn, and held again beyond.

    The search steps by 37 us. There a pole passes -1, which is where the pole's own equation says: by another route.
    """
    mode = np.array([[-0.002, 1360.0, 0.0], [-1360.0, -0.002, 0.0], [0.0, 0.0, -30.0]])
    B, K = np.array([[0.0], [1.0], [1.0]]), np.array([[0.0, -0.05, -1.0]])
    loop = loop_under(mode, B, K)
    found = largest_sample_period(loop)
    growth = [sampled_growth_at(loop, found + shift) for shift in (-37e-6, -1e-9, 1e-9, 0.2e-6, 37e-6)]
    assert [one > 0 for one in growth] == [False, False, True, False, False]
    assert found == pytest.approx(np.pi / 1360, rel=1e-4)
    exact = expm(mode * found)
    held = np.linalg.solve(mode, exact - np.eye(3)) @ B  # the integral of exp(A s) B, as A is regular
    assert np.linalg.det(exact + held @ K + np.eye(3)) == pytest.approx(0.0, abs=1e-9)  # of 4
