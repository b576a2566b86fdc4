"""The verdict of a run: it agrees if physics is right, over any road, time and step, and does not agree if something is wrong."""

import dataclasses
import itertools
import math

import numpy as np
import pytest

from models.laws.linear import LinearLaw, static_law
from models.roads.iso8608 import Iso8608
from models.roads.road import LOWEST, Bump
from models.vehicle.limits_and_implementation import Implementation, Limits
from models.vehicle.mjcf import has_geometry
from models.vehicle.vehicle import Vehicle, read_vehicle
from sim.drive.response import Response
from sim.linear.rounding import roundings
from sim.runs.agreement import LinearComparison
from sim.runs.report import reasons, verdict
from sim.runs.run import Run, run_controllers, sample_times
from synth.controller.controller import Controller
from synth.vehicle.designer import Designer, certify_given
from tests.support.analysed import predict, simulate
from tests.support.commands import attacks, in_the_suite
from tests.support.curved import with_curves
from tests.support.faults import miswritten
from tests.support.pages import hopper

KINDS = ["quarter_car", "half_car", "full_car"]
NAMES = ["passive", "state", "I", "II"]
WALL = '<site name="wall" pos="1 0 .3"/></worldbody>'
TIE = '<spatial name="tie" stiffness="10" springlength="1"><site site="wall"/><site site="sprung"/></spatial></tendon>'
OWN_GEOMETRY = {  # changes of an MJCF that has none
    "a spring across": lambda drawn: drawn.replace("</worldbody>", WALL).replace("</tendon>", TIE),
    "a cubic spring": lambda drawn: drawn.replace('axis="0 0 1"/>', 'axis="0 0 1" stiffness="0 0 1e6"/>'),
}


@pytest.fixture(scope="module", params=KINDS)
def vehicle(request) -> Vehicle:
    return read_vehicle(request.param)


@pytest.fixture(scope="module")
def controllers(vehicle) -> list[Controller]:
    designer = Designer(vehicle)
    return [designer.design(name) for name in NAMES]


def driven(vehicle: Vehicle, controller: Controller, road, duration: float, timestep: float = 1e-3) -> Run:
    return run_controllers(vehicle, [controller], road, sample_times(vehicle, duration, timestep))[0]


def heavier(vehicle: Vehicle, share: float) -> Vehicle:
    """The vehicle whose physics has a sprung mass that is larger by a share."""
    return miswritten(vehicle, "sprung_mass", share)


def test_rounding_is_bounded(vehicle, controllers):
    """Over a road of almost no height MuJoCo leaves RK4's linear response by rounding: within its bound, and not far below."""
    time, road = sample_times(vehicle, 0.5, 1e-3), Bump(height=1e-9)
    physics = simulate([vehicle] * 4, controllers, [road] * 4, time).response
    for i, controller in enumerate(controllers):
        integrated = predict(vehicle, controller, road, time).integrated
        allowed = roundings(vehicle, controller)
        found = {name: np.abs(physics.run(i)[name] - integrated[name]).max() for name in allowed}
        assert all(found[name] <= 0.5 * allowed[name] for name in allowed)  # measured 0.16 at most, over 20 s too
        # A bound on every signal is loose in most; in some length it is by a factor of 60 at most.
        assert max(found[name] / allowed[name] for name in allowed if allowed[name]) > 1e-2


@pytest.mark.parametrize("slow", [1e-300, -1e-6])
def test_a_slow_law_is_allowed_no_more(vehicle, slow):
    """A law with a mode slower than any run has the rounding bound of an integrator: its gain at rest does not count."""
    forces = len(vehicle.linear_model.inputs)
    measured = ("sprung_velocity" if vehicle.kind.name == "quarter_car" else "heave_velocity",)
    laws = [LinearLaw(np.array([[a]]), np.ones((1, 1)), np.ones((forces, 1)), np.zeros((forces, 1))) for a in (slow, 0.0)]
    found, integrator = (roundings(vehicle, certify_given(vehicle, "slow", measured, law)) for law in laws)
    assert found == pytest.approx(integrator, rel=1e-3)


@pytest.mark.parametrize(
    ("road", "duration", "timestep"),
    [
        (Bump(), 0.05, 1e-3),  # the rear wheels not there yet, and roll is rounding
        (Bump(height=0.03), 0.4, 4e-3),
        (Bump(height=LOWEST), 0.3, 1e-3),
        *attacks(
            [
                (Bump(), 0.2, 1e-3),
                (Iso8608("C"), 0.2, 2e-3),
                (Bump(height=1e-3, track="left"), 0.3, 1e-3),
                (Bump(height=LOWEST), 0.05, 1e-3),
                (Iso8608("A", factor=1e-3), 0.2, 1e-3),
            ]
        ),
    ],
)
def test_right_physics_agrees(vehicle, controllers, road, duration, timestep):
    """If nothing is wrong, a run agrees: over high roads and low ones, for short and long times, at any step."""
    for run in run_controllers(vehicle, controllers, road, sample_times(vehicle, duration, timestep)):
        assert run.passed, (run.controller.name, reasons(run))
        assert verdict(run).text == "MuJoCo agrees with the model; linear analysis applies over the whole run; energy balances"


@pytest.mark.parametrize(("duration", "height"), [(0.6, 0.1), (0.2, LOWEST), *attacks([(0.6, 1e-3)])])
def test_a_wrong_vehicle_does_not_agree(vehicle, controllers, height, duration):
    """A body that is heavier by a ten-thousandth is found over any road; the verdict names the time and a signal."""
    run = driven(heavier(vehicle, 1e-4), controllers[2], Bump(height=height), duration)
    steps = run.agreement.steps
    assert steps is not None
    assert not run.agrees
    assert verdict(run).text.startswith(
        f"MuJoCo DOES NOT AGREE with the equations of motion from {steps.since:.4g} s on ({steps.signal})"
    )
    (line,) = [one.text for one in reasons(run) if one.text.startswith("DOES NOT AGREE from ")]
    assert line.endswith(f"largest error {steps.error:.1e} of a peak ({steps.signal}); at most {steps.allowed:.0e} is allowed")


def test_an_exactly_linear_run_follows_its_sampled_response(vehicle, controllers):
    """Without geometry, physics may leave the sampled response by RK4's own error and rounding; with it, by any amount."""
    prediction = predict(vehicle, controllers[2], Bump(height=LOWEST), sample_times(vehicle, 0.5, 1e-4))
    sampled, allowed = prediction.sampled, roundings(vehicle, controllers[2])
    off = np.array([allowed.get(name, 0.0) for name in sampled.names])

    def moved(times: float) -> Response:
        return dataclasses.replace(sampled, values=sampled.values + times * off)

    assert LinearComparison(prediction, moved(1.0), math.inf).agrees
    # RK4's own error is 1e-10 of a peak at this step, and the 1e-9 that are allowed of any are 60 roundings of a length here.
    assert LinearComparison(prediction, moved(300.0), math.inf).agrees == has_geometry(vehicle)


def about_its_centre(kind: str) -> Vehicle:
    """The car that turns about its centre of mass: its matrices are constant, but points of its body move nonlinearly."""
    car = read_vehicle(kind)
    axes = ["pitch_centre_height", *(f"roll_centre_height_{axle}" for axle in ("front", "rear") if kind == "full_car")]
    return car.with_parameters(**dict.fromkeys(axes, car.parameters["centre_height"]))


def test_geometry_is_asked_of_the_model(tmp_path):
    """Cars that pitch or roll have geometry, cars that move vertically do not, with any limits or curves; a tendon may."""
    limited = dataclasses.replace(read_vehicle("quarter_car"), limits=Limits(suspension_stroke=0.01, actuator_bandwidth=30.0))
    knotted = with_curves(suspension_damping="{ velocity = [-1.0, 0.0, 1.0], force = [-800.0, 0.0, 2000.0] }")
    for plain in (read_vehicle("quarter_car"), limited, knotted, read_vehicle(hopper(tmp_path))):
        assert not has_geometry(plain)
    for turning in (make(kind) for make in (read_vehicle, about_its_centre) for kind in KINDS[1:]):
        assert has_geometry(turning)
    drawn = (tmp_path / "hopper.xml").read_text()
    for name, changed in OWN_GEOMETRY.items():
        (tmp_path / "hopper.xml").write_text(changed(drawn))
        assert has_geometry(read_vehicle(tmp_path / "hopper.toml")), name


TURNING = [*itertools.product(KINDS[1:], (False, True))]


def without_motion(vehicle: Vehicle) -> Vehicle:
    """The vehicle as a custom type without equations of motion."""
    return dataclasses.replace(vehicle, kind=dataclasses.replace(vehicle.kind, motion=None))


@pytest.mark.parametrize(("kind", "own"), in_the_suite([("half_car", False), ("full_car", True)], TURNING))
def test_a_car_that_turns_about_its_centre_agrees(kind, own):
    """Measurements off its axis are geometry, with equations of motion or without; a body heavier by a ten-thousandth is not."""
    car = without_motion(about_its_centre(kind)) if own else about_its_centre(kind)
    controller = Designer(car).design("passive")
    run = driven(car, controller, Bump(), 0.6)
    assert run.agrees, reasons(run)
    assert not driven(heavier(car, 1e-4), controller, Bump(), 0.6).agrees


@pytest.mark.parametrize(
    ("name", "height", "step", "noise"),
    [
        ("passive", 0.03, 8e-3, {}),  # RK4's error is as large as the effect of geometry
        ("I", 0.1, 1e-3, {"heave_velocity": 1e-5}),  # so is the effect of noise
    ],
)
def test_a_type_without_equations_is_compared_to_first_order(name, height, step, noise):
    """Geometry vanishes with the height, RK4's error and noise do not count; a body that is 1 % heavier is found, and said."""
    half = read_vehicle("half_car")
    controller = Designer(half).design(name)
    car = dataclasses.replace(without_motion(half), implementation=Implementation(noise=noise), controllers={})
    run = driven(car, controller, Bump(height=height), 0.8, step)
    assert run.agrees, reasons(run)
    assert run.agreement.steps is None
    assert any("compared with linear analysis to first order" in line.text for line in reasons(run))
    wrong = driven(heavier(car, 0.01), controller, Bump(height=height), 0.8, step)
    assert verdict(wrong).text.startswith("MuJoCo DOES NOT AGREE with linear analysis over the whole run")


@pytest.mark.parametrize("seed", [68, 89, 111])
def test_a_tyre_that_is_loose_within_a_step_ends_the_comparison(seed):
    """A road with waves as short as a step is lower where MuJoCo holds it than its samples say; a tyre that is loose there is."""
    car = read_vehicle("quarter_car")
    road = Iso8608("D", seed, 25.0)
    (run,) = run_controllers(car, [Designer(car).design("passive")], road, sample_times(car, 0.4, 3e-3), balanced=False)
    assert run.agrees, reasons(run)
    assert run.agreement.until < 0.4


NOISE = {"sprung_velocity": 1e-3}
UNSTABLE = {
    "ideal": (Implementation(), 0.0),
    "rounding": (Implementation(sample_period=0.004, delay=30), 1e-9),
    "noise": (Implementation(noise=NOISE), 1e-3),
    "quantisation": (Implementation(quantisation=NOISE), 1e-3),
    "late": (Implementation(sample_period=0.01, delay=2, noise=NOISE | {"suspension_deflection": 1e-4}), 1e-3),
}


@pytest.mark.parametrize("case", UNSTABLE)
def test_an_unstable_loop_agrees(case):
    """An unstable loop multiplies rounding, noise and quantisation: right physics agrees, and a body heavier by 1e-4 does not."""
    how, height = UNSTABLE[case]
    paper = dataclasses.replace(read_vehicle("quarter_car"), implementation=how)
    law = static_law(np.array([[20000.0, 2000.0]]))
    controller = certify_given(paper, "wild", ("suspension_deflection", "sprung_velocity"), law)
    run = driven(paper, controller, Bump(height=height), 1.0)
    assert run.prediction.radius > 1
    assert run.agrees, reasons(run)
    if height > 1e-6:
        assert not driven(heavier(paper, 1e-4), controller, Bump(height=height), 1.0).agrees


@pytest.mark.parametrize("name", ["passive", "I_printed"])
def test_a_coarse_step_is_no_disagreement(name):
    """At a step that is too coarse for a stiff tyre the run agrees, the verdict warns, and energy is not found wrong."""
    stiff = {"suspension_stiffness": 203797.0, "suspension_damping": 24758.0, "tyre_stiffness": 7.09e6}
    truck = dataclasses.replace(
        read_vehicle("quarter_car").with_parameters(sprung_mass=2208.7, unsprung_mass=201.9, **stiff),
        limits=Limits(actuator_bandwidth=92.0),
        implementation=Implementation(sample_period=0.05),
    )
    run = driven(truck, Designer(truck).design(name), Bump(), 3.0, 0.01)
    assert run.passed, reasons(run)
    assert run.agreement.steps is not None
    assert run.agreement.steps.until == math.inf
    assert "; the timestep is too coarse for accurate numbers; energy " in verdict(run).text
    assert "NOT BALANCE" not in verdict(run).text
