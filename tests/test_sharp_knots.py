"""Cars whose curves bend within mm/s of rest: RK4 makes a larger share of a small motion there, and the verdict knows it."""

from dataclasses import replace

import numpy as np
import pytest

from models.damping.laws import SemiActive
from models.roads.road import LOWEST, Bump
from models.vehicle import Vehicle, parse_vehicle, read_vehicle
from sim.physics.simulate import simulate
from sim.response.response import Response
from sim.runs.agreement import COARSEST, SLACK, SMALL, Agreement, compare, look_closer
from sim.runs.made import predict_made, reference_at
from sim.runs.prediction import Prediction, Smaller, predict, smaller
from sim.runs.run import driven, run_all, sample_times
from sim.runs.words import verdict, verdict_lines
from synth.controller import Controller
from synth.designer import Designer
from tests.test_curves_beside import with_tables
from tests.test_dampers import BOTH

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


def controller_of(vehicle: Vehicle, name: str) -> Controller | SemiActive:
    """A shipped law of a vehicle file, or a design for it."""
    law = vehicle.controllers[name].semi_active if name in vehicle.controllers else None
    return SemiActive(name, law) if law else Designer(vehicle).design(name)


def judged(vehicle: Vehicle, built: Vehicle, name: str, road: Bump) -> tuple[Agreement, Smaller, Response]:
    """The verdict where MuJoCo drives another vehicle than is written down; what is predicted and made of the small road."""
    controller, time = controller_of(vehicle, name), sample_times(vehicle, 1.0, 1e-3)
    made = simulate([built], [controller], [road], time)
    prediction = predicted(vehicle, controller, road, time, made.run(0), made.asked[0])
    small = simulate([built], [driven(prediction, time, SMALL)], [road.scaled(SMALL)], time).response.run(0)
    reference = reference_at(SMALL, prediction, small)
    return look_closer(compare(prediction, made.run(0)), reference, small), reference, small


def predicted(vehicle, controller, road, time, physics, asked) -> Prediction:
    """What is predicted of a run, of physics where that is needed."""
    if vehicle.dampers:
        return predict_made(vehicle, controller, road, time, physics, asked)
    return predict(vehicle, controller, road, time)


@pytest.mark.parametrize("name", CARS)
def test_right_physics_agrees(name):
    """What RK4 makes of knots near rest is more of a hundredth of the road than of all of it, and is allowed there."""
    text, controller, height = CARS[name]
    vehicle = parse_vehicle(text)
    (run,) = run_all(vehicle, [controller_of(vehicle, controller)], Bump(height, 5.0, 12.5), sample_times(vehicle, 1.0, 1e-3))
    assert run.holds
    assert verdict(run).startswith("agrees to first order throughout")
    signals = run.agreement.signals.values()
    whole = [one.allowed + (1 / SMALL - 1) * one.rounding + SLACK * SMALL * one.sampled for one in signals]
    # What is allowed of the whole road would have been too little: otherwise this test says nothing.
    assert any(one.small > most for one, most in zip(signals, whole, strict=True) if one.small is not None)
    assert all(one.excess < 0.8 for one in signals)  # 1 / SLACK, and geometry


@pytest.mark.parametrize("name", CARS)
@pytest.mark.parametrize(
    "wrong",
    [
        "suspension_stiffness",
        pytest.param("suspension_damping", marks=pytest.mark.slow),
        pytest.param("sprung_mass", marks=pytest.mark.slow),
    ],
)
def test_a_force_that_nobody_wrote_down_is_found(name, wrong):
    """A body, a damper or a spring that is 1 % more than is written is no integrator's error, and disagrees."""
    text, controller, height = CARS[name]
    vehicle = parse_vehicle(text)
    parameter = next(one for one in vehicle.parameters if one.startswith(wrong))
    built = replace(vehicle, parameters={**vehicle.parameters, parameter: 1.01 * vehicle.parameters[parameter]})
    agreement, _, _ = judged(vehicle, built, controller, Bump(height, 5.0, 12.5))
    assert max(one.excess for one in agreement.signals.values()) > 2  # measured 2.7, of much friction, and 1e2 in the mean


@pytest.mark.parametrize("name", CARS)
def test_rk4_is_foretold_over_a_share_of_the_road(name):
    """Over a hundredth of it MuJoCo is what RK4 is foretold to make, but for geometry: that is within 3e-7 of a peak there.

    RK4 itself is 3e-5 to 2e-3 off the exact response.
    """
    text, controller, height = CARS[name]
    vehicle, road = parse_vehicle(text), Bump(height, 5.0, 12.5)
    _, reference, physics = judged(vehicle, vehicle, controller, road)
    integrated = reference.integrated
    assert integrated is not None
    for signal in vehicle.linear_model.outputs:
        assert np.abs(physics[signal] - integrated[signal]).max() <= 3e-7 * integrated.scale(signal)


@pytest.mark.parametrize("kind", ["half_car", "full_car"])
def test_what_is_in_proportion_is_not_computed_again(kind):
    """Of a car without curves the integrator's share of a smaller motion is that of the whole, to the last bit."""
    vehicle = read_vehicle(kind)
    (run,) = run_all(vehicle, [Designer(vehicle).design("I")], Bump(), sample_times(vehicle, 0.5, 1e-3))
    share = smaller(run.prediction, SMALL)
    assert share.integrated is None
    assert np.array_equal(share.sampled.values, SMALL * run.sampled.values)
    for one in run.agreement.signals.values():
        assert one.judged[1] == one.allowed + (1 / SMALL - 1) * one.rounding + SLACK * SMALL * one.sampled


@pytest.mark.parametrize("name", CARS)
def test_over_the_lowest_roads_rounding_counts(name):
    """Where a bump is next to none and friction holds, right physics agrees, too."""
    text, controller, _ = CARS[name]
    vehicle = parse_vehicle(text)
    for height in (LOWEST, 1e-4):
        road, time = Bump(height, 5.0, 12.5), sample_times(vehicle, 0.5, 1e-3)
        (run,) = run_all(vehicle, [controller_of(vehicle, controller)], road, time)
        assert run.agreement.agrees


def test_a_step_that_is_too_coarse_for_a_small_motion_is_said():
    """Where RK4 cannot follow friction near rest at a step, though it can over the whole bump, that is said; a quarter agrees."""
    text, controller, height = CARS["much friction"]
    vehicle = parse_vehicle(text)

    def run_at(step):
        time = sample_times(vehicle, 0.6, step)
        return run_all(vehicle, [controller_of(vehicle, controller)], Bump(height, 5.0, 12.5), time)[0]

    coarse = run_at(2e-3)
    worst = max(coarse.agreement.signals.values(), key=lambda one: one.excess)
    assert worst.allowed < COARSEST  # over the whole bump
    assert "the timestep is too coarse, give a smaller one" in verdict_lines(coarse)[-1]
    assert run_at(5e-4).holds


def random_car(rng: np.random.Generator) -> str:
    """A half-car, pushed, with adjustable dampers or with a measured pair, and random friction, as sharp as 2 mm/s."""
    text, friction = (PUSHED, BOTH, PAIR)[int(rng.integers(3))], float(np.exp(rng.uniform(*np.log([5.0, 300.0]))))
    front, rear = np.exp(rng.uniform(np.log(0.002), np.log(0.05), 2)).tolist()
    return rough(text, friction, front=front, rear=rear)


@pytest.mark.attack
@pytest.mark.parametrize("seed", range(10))
def test_right_physics_agrees_anywhere(seed):
    """The same of random friction over random bumps, at random steps."""
    rng = np.random.default_rng(seed)
    vehicle = parse_vehicle(random_car(rng))
    road = Bump(float(np.exp(rng.uniform(*np.log([1e-3, 0.1])))), float(rng.uniform(2, 10)), float(rng.uniform(5, 30)))
    time = sample_times(vehicle, 0.8, float(rng.choice([2.5e-4, 5e-4, 1e-3])))
    for name in ("passive", "sky"):
        (run,) = run_all(vehicle, [controller_of(vehicle, name)], road, time)
        assert run.holds, (name, verdict(run))
