"""Goals with an accelerometer or the force among the measurements: u = K (C x + D u), held against matrices written down here."""

import itertools

import numpy as np
import pytest

from models.common.arrays import Array
from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
from synth.design.multi_objective.objectives import Decay, EnergyPeak
from synth.design.multi_objective.peak import RoadPeak
from synth.design.multi_objective.problem import objectives_of
from synth.vehicle.designer import Designer
from synth.vehicle.multi_objective import goal_problem

OFF = 0.05  # of both sensors
READ = 'measured = ["suspension_deflection", "sprung_acceleration"]\n'
WITH_FORCE = 'measured = ["suspension_deflection", "sprung_acceleration", "control_force"]\n'
BOUNDED = (
    "bounds = [{ decay = 0.01 }, { gain = 2e4 }, "
    '{ peak = "sprung_acceleration", road = "bump", at_most = 9.0 }, '
    '{ energy_peak = "sprung_acceleration", energy = 0.02, at_most = 9.0 }]\n'
)


def car(section: str) -> Vehicle:
    """Returns the quarter-car with an accelerometer, and a controller of these keys."""
    return parse_vehicle(f"{read_vehicle('quarter_car_accelerometer').text}\n[controllers.mine]\n{section}")


def largest(gain: Array, d: float = 0.0, a: float = 0.0) -> float:
    """Returns the largest |z| per m/s of road on a grid, from Newton's equations, with readings off by d and a."""
    m, mu, k, c, kt = 504.5, 62.0, 13100.0, 400.0, 252000.0
    s = 2j * np.pi * np.concatenate([np.geomspace(0.05, 50, 4000), np.linspace(9.9, 10.4, 4000)])
    k_d, k_a, none = np.full_like(s, gain[0, 0] * (1 + d)), gain[0, 1] * (1 + a), np.zeros_like(s)
    # Of x_s, x_u and u, the road's velocity 1: Newton twice, and u = k_d (x_s - x_u) + k_a x_s''.
    spring, one = k + c * s, np.ones_like(s)
    rows = [[m * s**2 + spring, -spring, -one], [-spring, mu * s**2 + spring + kt, one], [-k_d - k_a * s**2, k_d, one]]
    moved = np.linalg.solve(np.array(rows).transpose(2, 0, 1), np.array([none, kt / s, none]).T[:, :, None])[:, :, 0]
    x_s, x_u, u = moved.T
    z = np.array([s**2 * x_s, 0.1 * (x_s - x_u), 0.2 * (x_u - 1 / s), 1e-4 * u])
    return float(np.linalg.norm(z, axis=0).max())


@pytest.mark.attack
def test_promises_hold_with_errors():
    """No loop of Newton's equations exceeds what is promised of all errors; the worst meets it, and the two steps do worse."""
    tolerance = f"tolerance = {{ suspension_deflection = {OFF}, sprung_acceleration = {OFF} }}"
    designed = Designer(car(f"{READ}{tolerance}\n")).design("mine")
    norm, worst = designed.specifications
    assert largest(designed.law.D) == pytest.approx(norm.value, rel=1e-5)  # a grid's own error
    corners = list(itertools.product((-OFF, OFF), repeat=2))
    met = [largest(designed.law.D, *off) for off in (*corners, (0.03, -0.02))]
    assert max(met) == pytest.approx(worst.value, rel=1e-5)
    assert worst.proved is not None
    assert max(met) < worst.proved < 1.02 * worst.value
    plain = Designer(car(READ)).design("mine").law.D
    assert worst.value < max(largest(plain, *off) for off in corners)


@pytest.mark.attack
def test_the_force_may_be_told():
    """With `control_force` measured, goals are designed for, and the loop of the certificate is that of Newton's equations."""
    designed = Designer(car(f"{WITH_FORCE}minimise = {{}}\n")).design("mine")
    assert designed.certificate.norm.value < Designer(car(READ)).design("mine").certificate.norm.value
    k_d, k_a, k_f = designed.law.D[0]
    assert largest(np.array([[k_d, k_a]]) / (1 - k_f)) == pytest.approx(designed.specifications[0].value, rel=1e-5)


@pytest.mark.parametrize(
    ("read", "tolerance", "sensor", "actuator"),
    [
        (WITH_FORCE, "control_force = 0.1, force = 0.02", 0.1, 0.02),
        (WITH_FORCE, "control_force = 0.1, force = 0.0", 0.1, 0.0),
        (WITH_FORCE, "control_force = 0.1", 0.1, 0.1),  # as files without `force` have always been read
        (WITH_FORCE, "force = 0.02", 0.0, 0.02),
        (READ, "control_force = 0.1", None, 0.1),
    ],
)
def test_a_force_that_is_read_has_two_errors(read, tolerance, sensor, actuator):
    """A measured force's own name is its reading's error, and `force` its actuator's, also after the way into a log and back."""
    goals = car(f"{read}tolerance = {{ {tolerance} }}\n").controllers["mine"].goals
    assert goals is not None
    kept = ", ".join(f"{name} = {share}" for name, share in goals.record["tolerance"].items())
    vehicle = car(f"{read}tolerance = {{ {kept} }}\n")
    entry = vehicle.controllers["mine"]
    assert entry.goals is not None
    errors = goal_problem(vehicle, entry, entry.goals).tolerance
    assert dict(zip(entry.measured, errors.sensors, strict=True)).get("control_force") == sensor
    assert errors.forces.tolist() == [actuator]


@pytest.mark.parametrize("read", [READ, WITH_FORCE])
def test_slopes_are_those_of_the_values(read):
    """Every goal and bound has the slope that differences of its values have, where forces are measured at once."""
    vehicle = car(read + BOUNDED)
    entry = vehicle.controllers["mine"]
    assert entry.goals is not None
    asked = goal_problem(vehicle, entry, entry.goals)
    full = asked.nominal()
    goals, bounds = objectives_of(asked, full, [asked.no_errors], 0.01)
    x = full.point(np.array([[9000.0, 130.0, 0.2][: len(entry.measured)]]))
    kinds = set()
    for term in (*goals, *bounds):
        kinds.add(type(term))
        support = term.support(x, term.value(x), 1e-3)
        i = int(np.argmax(support.values))
        for along in np.eye(len(x)) * 1e-5 * np.abs(x):
            change = (term.value(x + along) - term.value(x - along)) / 2
            # Of a value that is known to 1e-9, over a step of 1e-5; a peak over a road is that of a polygon.
            assert change == pytest.approx(float(support.slopes[i] @ along), rel=2e-2, abs=1e-8)
    assert kinds >= {Decay, EnergyPeak, RoadPeak}
