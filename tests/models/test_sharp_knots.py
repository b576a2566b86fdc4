"""Cars whose curves bend within mm/s of rest: RK4 makes a larger share of a small motion there, and the verdict knows it."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from models.laws.semi_active import SemiActive
from models.roads.road import LOWEST, Bump
from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
from sim.response.response import Response
from sim.runs.agreement import COARSEST, SLACK, SMALL, Agreement, compare, look_closer
from sim.runs.prediction import Prediction, ScaledPrediction, reference_at
from sim.runs.report import verdict, verdict_lines
from sim.runs.run import Run, driver_again, run_controllers, sample_times
from synth.controller.controller import Controller
from synth.vehicle.designer import Designer
from tests.models.test_curves_beside import with_tables
from tests.models.test_semi_active_dampers import BOTH
from tests.support.analysed import predict, predict_replayed, simulate
from tests.support.commands import in_the_suite

PUSHED = BOTH.split("[actuators.front]")[0] + BOTH[BOTH.index("[controllers.sky]") :]
SOFT = "{ velocity = [-1.0, -0.005, 0.0, 0.005, 1.0], force = [-700, -4, 0, 5, 900] }"
FIRM = "{ velocity = [-1.0, -0.005, 0.0, 0.003, 1.0], force = [-1700, -18, 0, 17, 2000] }"
PAIR = BOTH.replace("c_min = 300.0\nc_max = 3000.0", f"c_min = {SOFT}\nc_max = {FIRM}")
LAW = '[controllers.skyhook]\nsemi_active = "skyhook"\n'


def rough(text, friction, line=1000.0, front=0.004, rear=0.003):
    """A car both of whose axles have a friction that turns at millimetres a second beside the line of their dampers."""

    def table(velocity):
        straight = f"velocity = [-1.0, 0.0, 1.0], force = [-{line}, 0.0, {line}]"
        return f"{{ {straight}, friction = {friction}, friction_velocity = {velocity} }}"

    return with_tables(text, suspension_damping_front=table(front), suspension_damping_rear=table(rear))


SHARP = with_tables(PUSHED, suspension_damping_front=FIRM, suspension_damping_rear=FIRM)
CARS = {  # a file, one of its controllers, the height of a bump
    "friction": (rough(PUSHED, 60.0), "sky", 0.05),
    "much friction": (rough(PUSHED, 200.0), "passive", 0.05),
    "bends": (SHARP, "sky", 0.1),
    "adjustable, with friction": (rough(BOTH, 200.0), "passive", 0.05),
    "measured pair": (PAIR, "sky", 0.05),
    "measured pair, with friction": (rough(PAIR, 60.0, front=0.003, rear=0.004) + LAW, "skyhook", 0.02),
    "full car": (rough(read_vehicle("full_car").text, 60.0, 1500.0), "passive", 0.05),
}


SOME = in_the_suite(("measured pair, with friction",), CARS)


def controller_of(vehicle: Vehicle, name: str) -> Controller | SemiActive:
    """A shipped law of a vehicle file, or a design for it."""
    law = vehicle.controllers[name].semi_active if name in vehicle.controllers else None
    return SemiActive(name, law) if law else Designer(vehicle).design(name)


@cache
def car(name: str) -> tuple[Vehicle, Controller | SemiActive, Bump]:
    """One of the cars, its controller and its bump, which takes 0.4 s."""
    text, controller, height = CARS[name]
    vehicle = parse_vehicle(text)
    return vehicle, controller_of(vehicle, controller), Bump(height, 5.0, 12.5)


@cache
def right_run(name: str) -> Run:
    """The run of one of the cars as it is written down."""
    vehicle, controller, road = car(name)
    return run_controllers(vehicle, [controller], road, sample_times(vehicle, 0.35, 1e-3))[0]


def over_a_share(prediction: Prediction, built: Vehicle) -> tuple[ScaledPrediction, Response]:
    """Returns what is predicted, and made of a vehicle, over a hundredth of the road."""
    time, road = prediction.time, prediction.road.scaled(SMALL)
    small = simulate([built], [driver_again(prediction, time, SMALL)], [road], time).response.run(0)
    return reference_at(SMALL, prediction, small), small


def judged(name: str, built: Vehicle) -> Agreement:
    """The verdict where MuJoCo drives another vehicle than is written down."""
    vehicle, controller, road = car(name)
    time = sample_times(vehicle, 0.35, 1e-3)
    made = simulate([built], [controller], [road], time)
    prediction = predicted(vehicle, controller, road, time, made.run(0), made.requested_force[0])
    return look_closer(compare(prediction, made.run(0)), *over_a_share(prediction, built))


def predicted(vehicle, controller, road, time, physics, asked) -> Prediction:
    """Returns what is predicted of a run, of physics where that is needed."""
    if vehicle.dampers:
        return predict_replayed(vehicle, controller, road, time, physics, asked)
    return predict(vehicle, controller, road, time)


@pytest.mark.parametrize("name", SOME)
def test_right_physics_agrees(name):
    """The effect of RK4 at knots near rest is more of a hundredth of the road than of all of it, and is allowed there."""
    run = right_run(name)
    assert run.passed
    assert verdict(run).startswith("agrees to first order throughout")
    signals = run.agreement.signals.values()
    whole = [one.allowed + (1 / SMALL - 1) * one.rounding + SLACK * SMALL * one.sampled for one in signals]
    # What is allowed of the whole road would have been too little: otherwise this test says nothing.
    assert any(one.small > most for one, most in zip(signals, whole, strict=True) if one.small is not None)
    assert all(one.excess < 0.8 for one in signals)  # 1 / SLACK, and geometry


@pytest.mark.attack
@pytest.mark.parametrize("name", SOME)
@pytest.mark.parametrize("wrong", ["suspension_stiffness", "suspension_damping", "sprung_mass"])
def test_a_force_that_nobody_wrote_down_is_found(name, wrong):
    """A body, a damper or a spring that is 1 % more than is written is no integrator's error, and disagrees."""
    vehicle, _, _ = car(name)
    parameter = next(one for one in vehicle.parameters if one.startswith(wrong))
    built = replace(vehicle, parameters={**vehicle.parameters, parameter: 1.01 * vehicle.parameters[parameter]})
    excess = max(one.excess for one in judged(name, built).signals.values())
    assert excess > 2  # measured 2.7, of much friction, and 1e2 in the mean


@pytest.mark.attack
@pytest.mark.parametrize("name", SOME)
def test_rk4_is_foretold_over_a_share_of_the_road(name):
    """Over a hundredth of it MuJoCo is what RK4 is foretold to make, but for geometry: that is within 3e-7 of a peak there.

    RK4 itself is 3e-5 to 2e-3 off the exact response.
    """
    run = right_run(name)
    reference, physics = over_a_share(run.prediction, run.vehicle)
    integrated = reference.integrated
    assert integrated is not None
    for signal in run.vehicle.linear_model.outputs:
        assert np.abs(physics[signal] - integrated[signal]).max() <= 3e-7 * integrated.scale(signal)


@pytest.mark.attack
@pytest.mark.parametrize("name", SOME)
def test_over_the_lowest_roads_rounding_counts(name):
    """If a bump is next to none and friction holds, right physics agrees, too."""
    vehicle, controller, road = car(name)
    time = sample_times(vehicle, 0.35, 1e-3)
    (run,) = run_controllers(vehicle, [controller], replace(road, height=LOWEST), time)
    assert run.agreement.agrees


@pytest.mark.attack
def test_a_step_that_is_too_coarse_for_a_small_motion_is_said():
    """If RK4 cannot follow friction near rest at a step, though it can over the whole bump, that is said; a quarter agrees."""
    vehicle, controller, road = car("much friction")

    def run_at(step):
        return run_controllers(vehicle, [controller], road, sample_times(vehicle, 0.35, step))[0]

    coarse = run_at(2e-3)
    worst = max(coarse.agreement.signals.values(), key=lambda one: one.excess)
    assert worst.allowed < COARSEST  # over the whole bump
    assert any("the timestep is too coarse, give a smaller one" in line for line in verdict_lines(coarse))
    assert run_at(5e-4).passed
