"""Responses of vehicles with nonlinear suspensions: each step is one of RK4, and runs side by side are those alone."""

import numpy as np
import pytest

from models.roads.road import Bump, RoadInput
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.linear.stepped import stepped_runs
from synth.vehicle.designer import design
from tests.support.curved import DIGRESSIVE, PROGRESSIVE, curved_text

H, PERIOD, LATE = 1e-3, 5, 2  # s; a sample of the law, and its delay, in steps
LAW = """
[implementation]
sample_period = 0.005
delay = 0.4
[controllers.law]
measured = ["suspension_deflection", "sprung_acceleration"]
A = [[-2.0]]
B = [[0.5, 1.0]]
C = [[-900.0]]
D = [[4000.0, -30.0]]
"""
AT, RATIOS = [-0.06, 0.0, 0.06], [0.76, 0.75, 0.73]
RATIO = f"motion_ratio = {{ deflection = {AT}, ratio = {RATIOS} }}"
DAMPER = 'anti_windup = 40.0\n[actuators]\nkind = "damper"\nc_min = 300.0\nc_max = 4000.0\nbandwidth = 60.0\n'
LAG = "[limits]\nactuator_bandwidth = 60.0\nsuspension_stroke = 0.01\nstop_stiffness = 1e6\n"  # stops never act here
CARS = {
    "curves": curved_text(more=LAW + LAG, suspension_damping=DIGRESSIVE, suspension_stiffness=PROGRESSIVE),
    "ratio": curved_text(more=RATIO + LAW + LAG),
    "damper": read_vehicle("quarter_car").text + LAW + DAMPER,
    "damper at a ratio": curved_text(more=RATIO + LAW + DAMPER),
}
TIME = np.arange(160) * H


def over_travel(p):
    """Pull of a spring that carries the weight W at rest, r (k D - W / r(0)) + W with D the integral of r, straight in d."""
    load, at_rest = p["sprung_mass"] * 9.81, np.interp(0.0, AT, RATIOS)

    def pull(d):
        x = np.unique(np.clip([0.0, *AT, d], min(d, 0.0), max(d, 0.0)))
        travel = np.sign(d) * np.trapezoid(np.interp(x, AT, RATIOS), x)
        return np.interp(d, AT, RATIOS) * (p["suspension_stiffness"] * travel - load / at_rest) + load

    return pull


def integrated(vehicle, road, parts):
    """Deflections of suspension and tyre and velocities of a quarter-car by (28) and its law, shape (T, 4).

    Args:
        parts: RK4's steps in a timestep.
    """
    p, law, adjusts = vehicle.parameters, vehicle.controllers["law"].law.sampled(PERIOD * H), bool(vehicle.dampers)
    curves, c = {one.part.argument: one.curve for one in vehicle.parts.with_curve}, p["suspension_damping"]
    spring = over_travel(p) if vehicle.kind.ratios else curves.get("deflection", lambda d: p["suspension_stiffness"] * d)
    damper = curves["velocity"] if "velocity" in curves and not vehicle.kind.ratios else lambda v: c * v

    def pull(x):
        d, v, r = x[0] - x[1], x[2] - x[3], np.interp(x[0] - x[1], AT, RATIOS) if vehicle.kind.ratios else 1.0
        return spring(d) + r * (damper(r * v) + (x[4] * r * v if adjusts else -x[4])), r * v

    def rate(x, z_r, target):
        f, tyre = pull(x)[0], p["tyre_stiffness"] * (x[1] - z_r)
        return np.array([x[2], x[3], -f / p["sprung_mass"], (f - tyre) / p["unsprung_mass"], 60.0 * (target - x[4])])

    windup = (law.A - np.exp(-80.0 * PERIOD * H) / law.A) / law.C  # mirrors the pole at the circle of the rate
    x, q, target, waiting, rows = np.zeros(5), np.zeros(1), 0.0, {}, []
    for k in range(len(road.time)):
        if k % PERIOD == 0:
            f, v = pull(x)
            y = np.array([x[0] - x[1], -f / p["sprung_mass"]])
            asked = waiting[k + LATE] = (law.C @ q + law.D @ y)[0]
            q = law.A @ q + law.B @ y
            if adjusts:
                waiting[k + LATE] = np.clip(-asked / (v or 1.0), 300.0 - c, 4000.0 - c)
                q = q + windup[0] * (-waiting[k + LATE] * v - asked)
        target = waiting.pop(k, target)
        rows.append([x[0] - x[1], x[1] - road.heights[k, 0], x[2], x[3]])
        for h in [H / parts] * parts:
            k1 = rate(x, road.midway[k, 0], target)
            k2 = rate(x + h / 2 * k1, road.midway[k, 0], target)
            k3 = rate(x + h / 2 * k2, road.midway[k, 0], target)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(x + h * k3, road.midway[k, 0], target))
    return np.array(rows)


@pytest.mark.parametrize("name", CARS)
def test_each_step_is_one_of_rk4(name):
    """A law with a state, a delay and a lag gives the run of the equations in this test, to rounding; `finer` is nearer to it."""
    vehicle = parse_vehicle(CARS[name])
    road = RoadInput(vehicle, Bump(0.06, 5.0, 12.5), TIME)
    runs, signals = stepped_runs([design(vehicle, "law")], [road]), vehicle.linear_model.states
    own, fine = (integrated(vehicle, road, parts) for parts in (1, 8))
    peaks = np.abs(own).max(axis=0)
    response, finer = (np.stack([one.run(0)[signal] for signal in signals], axis=-1) for one in (runs.response, runs.finer))
    assert (np.abs(response - own) / peaks).max() < 1e-11
    assert (np.abs(response - fine) / peaks).max() < 1e-4
    if "curves" in name:  # a law that switches answers to the error, too
        assert (np.abs(finer - fine) / peaks).max() < 0.7 * (np.abs(response - fine) / peaks).max()


@pytest.mark.parametrize("name", ["curves", "damper at a ratio"])
def test_controllers_side_by_side(name):
    """Runs of laws with and without states have the numbers of each alone, to rounding; states that a law lacks are 0."""
    vehicle = parse_vehicle(CARS[name])
    controllers = [design(vehicle, one) for one in ("law", "passive", "II_printed")]
    roads = [RoadInput(vehicle, Bump(height, 5.0, 12.5), TIME) for height in (0.02, 0.05, 0.06)]
    together = stepped_runs(controllers, roads).response
    for i, (controller, road) in enumerate(zip(controllers, roads, strict=True)):
        alone = stepped_runs([controller], [road]).response.run(0)
        for signal in alone.names:
            assert np.abs(together.run(i)[signal] - alone[signal]).max() <= 1e-11 * (alone.scale(signal) or 1.0), signal
    assert not together.run(1)["controller_1"].any()
