"""Physics against analysis: MuJoCo is RK4 on the linear system, to rounding, and everything else follows from that."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from models.roads.road import Bump
from sim.linear.sampled_response import taylor4
from sim.runs.agreement import lift_off_intervals
from tests.conftest import random_vehicles
from tests.support.analysed import continuous_response, sampled_response, simulate

CONFIGURATIONS = ["passive", "state", "I", "II"]
STEPS = np.array([2e-3, 1e-3, 5e-4, 2.5e-4])


def times(timestep, duration=3.0):
    return np.arange(round(duration / timestep) + 1) * timestep


def error(response, reference, signal):
    """Largest difference over time, over the reference's peak."""
    difference = np.max(np.abs(response[signal] - reference[signal]))
    return difference / (float(reference.peak(signal)) or 1.0)


def physics_of(vehicle, controller, road, time):
    return simulate([vehicle], [controller], [road], time).response.run(0)


@pytest.fixture(scope="module", params=CONFIGURATIONS)
def controller(request, designer):
    return designer.design(request.param)


@pytest.mark.parametrize("index", [None, 0, 1, 2])
def test_mujoco_is_rk4_on_the_linear_system(paper, controller, index):
    """Every signal of MuJoCo is that of the linear system with its exponential cut after the fourth power, to rounding.

    A vehicle that nobody tuned for agrees to rounding as well: its numbers reach the MJCF and the equations alike.
    """
    vehicle, time, road = paper, times(1e-3), Bump()
    if index is not None:
        vehicle, time, road = random_vehicles(paper, 3)[index], times(1e-3, 1.0), Bump(height=0.02)  # no wheel leaves the road
    physics = physics_of(vehicle, controller, road, time)
    predicted = sampled_response(vehicle, controller, road, time, exponential=taylor4)
    for signal in vehicle.linear_model.outputs:
        assert error(physics, predicted, signal) < 1e-12  # 3000 steps of rounding; measured 3e-14


def test_orders_of_the_step(paper, controller):
    """The difference from the exact sampled response falls with the fourth power of the step; at 1 ms it is within 2e-6.

    From the continuous one, holding the force costs first order, holding the road at its midpoint only second.
    """
    errors, held = [], []
    for step in STEPS:
        time = times(step, 1.0)
        physics, continuous = physics_of(paper, controller, Bump(), time), continuous_response(paper, controller, Bump(), time)
        held.append(error(physics, continuous, "suspension_deflection"))
        if len(errors) < 3:
            sampled = sampled_response(paper, controller, Bump(), time)
            errors.append(error(physics, sampled, "tyre_deflection"))
            if step == 1e-3:  # measured 7.4e-7 in tyre deflection
                assert max(error(physics, sampled, signal) for signal in paper.linear_model.outputs) < 2e-6
    slopes, of_held = (np.diff(np.log(one)) / np.diff(np.log(STEPS[: len(one)])) for one in (errors, held))
    np.testing.assert_allclose(slopes, 4.0, atol=0.1)  # the next order, and peaks that fall between samples
    np.testing.assert_allclose(of_held, 2.0 if controller.name == "passive" else 1.0, atol=0.05)  # the next order


def test_continuous_response_is_that_of_an_ode_solver(paper, controller):
    """The quadrature gives what DOP853 gives at its tightest tolerance, started anew at each kink of the road."""
    road, model = Bump(), paper.linear_model
    time = times(1e-3, 1.0)
    A = model.A + model.B @ controller.state_gain(paper)
    x = np.zeros(4)
    pieces = []
    for start, end in ((0.0, road.duration), (road.duration, 1.0)):
        inside = time[(time >= start) & (time < end)] if end < 1.0 else time[time >= start]
        solution = solve_ivp(
            lambda t, x: A @ x + model.Bw[:, 0] * road.velocity(np.array(t)),
            (start, end),
            x,
            method="DOP853",
            rtol=1e-12,
            atol=1e-14,
            dense_output=True,
        )
        pieces.append(solution.sol(inside))
        x = solution.y[:, -1]
    response = continuous_response(paper, controller, road, time)
    for i, state in enumerate(model.states):
        reference = np.concatenate([piece[i] for piece in pieces])
        assert np.abs(response[state] - reference).max() < 1e-9 * np.abs(reference).max()  # DOP853's dense output


def test_a_kink_between_samples_is_not_stepped_across(paper, designer):
    """The continuous response at common samples does not depend on the step, though the bump ends between two samples."""
    road, controller = Bump(length=5.01, speed=12.5), designer.design("I")  # ends at 0.4008 s
    coarse, fine = (continuous_response(paper, controller, road, times(step, 1.0)) for step in (1e-3, 1e-4))
    for signal in paper.linear_model.outputs:
        assert np.abs(coarse[signal] - fine[signal][::10]).max() < 1e-11 * float(fine.peak(signal))  # rounding


def test_linear_until_lift_off(paper, designer):
    """Over a short high bump the wheel flies: physics is linear to rounding until then, and not after."""
    road, controller, time = Bump(height=0.12, length=1.5), designer.design("I"), times(1e-3, 1.0)
    physics = physics_of(paper, controller, road, time)
    predicted = sampled_response(paper, controller, road, time, exponential=taylor4)
    intervals = lift_off_intervals(paper, physics)
    assert intervals
    first = intervals[0][0]
    assert error(physics.until(first), predicted.until(first), "tyre_deflection") < 1e-12
    assert error(physics, predicted, "tyre_deflection") > 1e-2
