"""The MJCF is the vehicle of the equations, at rest, in motion and off the ground."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

import math

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from models.roads.road import Bump
from models.vehicle.mjcf import build_model, mjcf_text
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.drive.regime import SATURATION
from sim.runs.report import reasons
from sim.runs.run import run_controllers, sample_times
from tests.conftest import random_vehicles
from tests.support.shared import designed


@pytest.fixture(params=range(3))
def vehicle(request, paper):
    return [paper, *random_vehicles(paper, 2)][request.param]


def test_attached_mjcf_is_the_model_that_ran(vehicle):
    """The MJCF text that goes into the logs compiles to the same model, bit for bit."""
    again, model = mujoco.MjModel.from_xml_string(mjcf_text(vehicle, 5e-4)), build_model(vehicle, 5e-4)
    for field in ("body_mass", "tendon_stiffness", "tendon_damping", "tendon_lengthspring"):
        np.testing.assert_array_equal(getattr(again, field), getattr(model, field))
    assert again.opt.timestep == model.opt.timestep


def test_sensors_are_named_as_the_signals(paper):
    """Every output of the linear model is a sensor of that name, with a direction to read it along."""
    model = build_model(paper, 1e-3)
    for name in paper.linear_model.outputs:
        assert np.linalg.norm(model.sensor(name).user) == 1.0


def by_hand(p, gain, most, rate, order):
    """Requests and forces [N] and the suspension's deflection [m], shape (3, 120), every 5 ms over the bump (61).

    The equations are written out for positions, and scipy integrates them.
    """

    def limited(value, where):
        return min(max(value, -most), most) if order == where else value

    def slope(t, x, request):
        z_s, z_u, v_s, v_u, f = x
        road = 0.05 * (1 - math.cos(2 * math.pi * t / 0.4)) if t < 0.4 else 0.0
        strut = limited(f, "force") - p["suspension_stiffness"] * (z_s - z_u) - p["suspension_damping"] * (v_s - v_u)
        wheel = (-strut - p["tyre_stiffness"] * (z_u - road)) / p["unsprung_mass"]
        return [v_s, v_u, strut / p["sprung_mass"], wheel, rate * (limited(request, "command") - f)]

    x, samples = np.zeros(5), []
    for t in 5e-3 * np.arange(120):
        request = float(gain @ [x[0] - x[1], x[2]])
        samples.append([request, limited(x[4], "force"), x[0] - x[1]])
        x = solve_ivp(slope, (t, t + 5e-3), x, args=(request,), rtol=1e-7, atol=1e-9).y[:, -1]
    return np.transpose(samples)


@pytest.mark.parametrize(
    ("order", "says"), [("force", "reaches its largest force"), ("command", "is limited before the actuator's lag")]
)
def test_a_limit_acts_behind_the_lag_or_before(order, says):
    """`limit` chooses whether the force behind the lag is limited or its command, as in the car that is written out by hand.

    MuJoCo's steps are those of the equations in both orders, and linear analysis ends with what is limited first.
    """
    most, rate = 500.0, 30.0
    text = f'\n[limits]\nactuator_force = {most}\nactuator_bandwidth = {rate}\nlimit = "{order}"\n[implementation]\n'
    vehicle = parse_vehicle(read_vehicle("quarter_car").text + text + "sample_period = 0.005\n")
    controller = designed(vehicle, "I")
    assert controller.measured == ("suspension_deflection", "sprung_velocity")
    (run,) = run_controllers(vehicle, [controller], Bump(0.1, 5.0, 12.5), sample_times(vehicle, 0.6, 1e-3))
    request, force, stroke = by_hand(vehicle.parameters, controller.gain[0], most, rate, order)
    assert run.passed
    forces, strokes = (run.physics[name][:-1:5] for name in ("control_force", "suspension_deflection"))
    assert np.abs(forces - force).max() < 5e-5 * most  # limits and kinks within a step; the other order is off by a quarter
    assert np.abs(strokes - stroke).max() < 5e-5 * np.abs(stroke).max()
    limited = np.abs(request if order == "command" else force) >= most
    assert 0 < run.agreement.end_times[SATURATION.name] == pytest.approx(5e-3 * limited.argmax())
    assert 40 < limited.sum() < 80  # of 120 samples
    assert any(says in line.text for line in reasons(run))
