"""The verdict of a run: agreement where physics is right, over whatever road, time and step, and none where a fault is."""

import dataclasses
import math

import numpy as np
import pytest

from models.laws.linear import LinearLaw, static_law
from models.roads.iso8608 import Iso8608
from models.roads.road import LOWEST, Bump, Road
from models.vehicle.limits_and_implementation import Implementation, Limits
from models.vehicle.mjcf import has_geometry
from models.vehicle.vehicle import Vehicle, read_vehicle
from sim.linear.sampled_response import roundings
from sim.response.response import Response
from sim.runs.agreement import SMALL, compare, look_closer
from sim.runs.prediction import Prediction, smaller
from sim.runs.report import verdict, verdict_lines
from sim.runs.run import Run, compare_runs, run_controllers, sample_times
from synth.controller.controller import Controller
from synth.vehicle.designer import Designer, certify_given
from tests.support.analysed import predict, simulate
from tests.support.commands import attacks, in_the_suite
from tests.support.curved import with_curves
from tests.support.pages import hopper

KINDS = ["quarter_car", "half_car", "full_car"]
NAMES = ["passive", "state", "I", "II"]
DURATIONS = (0.05, 3.0)  # s
HEIGHTS = (LOWEST, 0.15)  # m, of bumps
STEPS = (2.5e-4, 5e-4, 1e-3, 2e-3, 4e-3)  # s
MOST = 2000  # samples
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


def judged(prediction: Prediction, built: Vehicle) -> Run:
    """The verdict on a prediction where MuJoCo drives another vehicle than was predicted."""
    physics = simulate([built], [prediction.controller], [prediction.road], prediction.time).response.run(0)
    met = dataclasses.replace(prediction.input, vehicle=built)
    return compare_runs([dataclasses.replace(prediction, input=met)], [physics])[0]


def heavier(vehicle: Vehicle, share: float) -> Vehicle:
    """The vehicle with a sprung mass that is more by a share."""
    parameters = {**vehicle.parameters, "sprung_mass": (1 + share) * vehicle.parameters["sprung_mass"]}
    return dataclasses.replace(vehicle, parameters=parameters)


def scaled(vehicle: Vehicle, factors: dict[str, float]) -> Vehicle:
    """The vehicle with those parameters whose name begins so multiplied."""
    parameters = {
        name: value * math.prod(factor for begins, factor in factors.items() if name.startswith(begins))
        for name, value in vehicle.parameters.items()
    }
    return dataclasses.replace(vehicle, parameters=parameters)


def light(vehicle: Vehicle) -> Vehicle:
    """The vehicle with 0.3 times its masses, on tyres that are four times as stiff."""
    masses = dict.fromkeys(("sprung_mass", "unsprung_mass", "pitch_inertia", "roll_inertia"), 0.3)
    return scaled(vehicle, {**masses, "tyre_stiffness": 4.0})


def too_strong(vehicle: Vehicle) -> list[Vehicle]:
    """The vehicle with springs that are 2 % too stiff, and with dampers that are 2 % too strong."""
    return [scaled(vehicle, {name: 1.02}) for name in ("suspension_stiffness", "suspension_damping")]


def delayed(vehicle: Vehicle) -> Vehicle:
    """The vehicle with forces that are late by a step."""
    return dataclasses.replace(vehicle, implementation=Implementation(delay=1))


def test_rounding_is_bounded(vehicle, controllers):
    """Over a road that does next to nothing MuJoCo leaves RK4's linear response by rounding: within its bound, and not far."""
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
    """A law that integrates but for a mode slower than any run is judged as the integrator is: its gain at rest is of no run."""
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
    """If nothing is wrong the verdict is agreement: over high roads and low ones, for a moment and for long, at any step."""
    for run in run_controllers(vehicle, controllers, road, sample_times(vehicle, duration, timestep)):
        assert run.passed, (run.controller.name, verdict_lines(run))


@pytest.mark.parametrize(("duration", "height"), [(0.6, 0.1), (0.2, LOWEST), *attacks([(0.6, 1e-3)])])
def test_a_wrong_vehicle_does_not_agree(vehicle, controllers, height, duration):
    """A body that is heavier by a ten-thousandth, or a force that is late by a step, is found over any road."""
    controller, time = controllers[2], sample_times(vehicle, duration, 1e-3)
    prediction = predict(vehicle, controller, Bump(height=height), time)
    assert judged(prediction, vehicle).agreement.agrees
    for wrong in (heavier(vehicle, 1e-4), delayed(vehicle)):
        run = judged(prediction, wrong)
        assert not run.agreement.agrees
        _says_what_is_wrong(run)


@pytest.mark.parametrize("height", [0.1, 1e-3])
def test_a_quarter_car_has_no_geometry_to_excuse_it(height):
    """Forces that are a thousandth too large, over the full height alone, are no geometry of a car that only goes up and down."""
    paper = read_vehicle("quarter_car")
    controller, road, time = Designer(paper).design("I"), Bump(height=height), sample_times(paper, 1.0, 1e-3)
    prediction = predict(paper, controller, road, time)
    stronger = dataclasses.replace(controller, law=controller.law.scaled(1.001))
    (run,) = compare_runs([prediction], [simulate([paper], [stronger], [road], time).response.run(0)])
    assert not run.agreement.agrees
    assert all(signal.small is None for signal in run.agreement.signals.values())
    assert "first order" not in _says_what_is_wrong(run)


def about_its_centre(kind: str) -> Vehicle:
    """The car that turns about its centre of mass: its matrices are constant, but points of its body move nonlinearly."""
    car = read_vehicle(kind)
    axes = ["pitch_centre_height", *(f"roll_centre_height_{axle}" for axle in ("front", "rear") if kind == "full_car")]
    return car.with_parameters(**dict.fromkeys(axes, car.parameters["centre_height"]))


def test_geometry_is_asked_of_the_model(tmp_path):
    """Cars that pitch or roll have it however light they are, cars that go up and down have not, of any kind; springs may."""
    limited = dataclasses.replace(read_vehicle("quarter_car"), limits=Limits(suspension_stroke=0.01, actuator_bandwidth=30.0))
    knotted = with_curves(suspension_damping="{ velocity = [-1.0, 0.0, 1.0], force = [-800.0, 0.0, 2000.0] }")
    paper, own = read_vehicle("quarter_car"), read_vehicle(hopper(tmp_path))
    for plain in (paper, limited, knotted, light(paper), own):
        assert not has_geometry(plain)
    for turning in (make(kind) for make in (read_vehicle, about_its_centre) for kind in KINDS[1:]):
        assert has_geometry(turning)
        assert has_geometry(light(turning))
    drawn = (tmp_path / "hopper.xml").read_text()
    for name, changed in OWN_GEOMETRY.items():
        (tmp_path / "hopper.xml").write_text(changed(drawn))
        assert has_geometry(read_vehicle(tmp_path / "hopper.toml")), name


@pytest.mark.parametrize("own", [False, True])
@pytest.mark.parametrize("kind", KINDS[1:])
def test_a_car_that_turns_about_its_centre_agrees(kind, own):
    """Read-outs off its axis are geometry, with equations of its own or without; a body heavier by a ten-thousandth is not."""
    car = about_its_centre(kind)
    if own:
        car = dataclasses.replace(car, kind=dataclasses.replace(car.kind, motion=None))
    prediction = predict(car, Designer(car).design("passive"), Bump(), sample_times(car, 0.6, 1e-3))
    run = judged(prediction, car)
    assert run.agreement.agrees, verdict_lines(run)
    assert not judged(prediction, heavier(car, 1e-4)).agreement.agrees


@pytest.mark.parametrize(
    ("name", "height", "step", "noise"),
    [
        ("passive", 0.03, 8e-3, {}),  # RK4's error is as large as what geometry makes
        ("I", 0.1, 1e-3, {"heave_velocity": 1e-5}),  # so is the spread of noise
    ],
)
def test_geometry_is_foretold_beside_what_every_height_has(name, height, step, noise):
    """RK4's error and noise are the same share of every height, no geometry: a kind without `motion` is right with either."""
    car = read_vehicle("half_car")
    car = dataclasses.replace(
        car, kind=dataclasses.replace(car.kind, motion=None), implementation=Implementation(noise=noise), controllers={}
    )
    controller = Designer(read_vehicle("half_car")).design(name)
    prediction = predict(car, controller, Bump(height=height), sample_times(car, 0.8, step))
    run = judged(prediction, car)
    assert run.agreement.agrees, verdict_lines(run)
    assert all(signal.foretold is not None for signal in run.agreement.signals.values())
    assert not judged(prediction, heavier(car, 0.01)).agreement.agrees


@pytest.mark.parametrize("seed", [68, 89, 111])
def test_a_tyre_that_is_loose_within_a_step_ends_the_comparison(seed):
    """A road with waves as short as a step is lower where MuJoCo holds it than its samples say; a tyre that is loose there is."""
    car = read_vehicle("quarter_car")
    road = Iso8608("D", seed, 25.0)
    (run,) = run_controllers(car, [Designer(car).design("passive")], road, sample_times(car, 0.4, 3e-3), balanced=False)
    assert run.agreement.agrees, verdict_lines(run)
    assert run.agreement.until < 0.4


@pytest.mark.parametrize("kind", in_the_suite(("quarter_car",), KINDS))
def test_a_light_car_on_stiff_tyres_is_judged_as_any_other(kind):
    """Tyres that its weight squeezes by 2 mm are no excuse and no fault; a spring or damper that is 2 % too strong is one."""
    for vehicle in (read_vehicle(kind), light(read_vehicle(kind))):
        road = Bump(height=0.03, length=20.0, track="left" if kind == "full_car" else "both")
        prediction = predict(vehicle, Designer(vehicle).design("passive"), road, sample_times(vehicle, 1.0, 1e-3))
        run = judged(prediction, vehicle)
        assert run.agreement.agrees, verdict_lines(run)
        assert run.agreement.until > 0.1
        for wrong in too_strong(vehicle):
            assert not judged(prediction, wrong).agreement.agrees


NOISY = {
    "noise": Implementation(noise={"sprung_velocity": 1e-3}),
    "quantisation": Implementation(quantisation={"sprung_velocity": 1e-3}),
    "slow": Implementation(sample_period=0.05, noise={"sprung_velocity": 1e-3}),
    "late": Implementation(sample_period=0.01, delay=2, noise={"sprung_velocity": 1e-3, "suspension_deflection": 1e-4}),
}


@pytest.mark.parametrize("how", NOISY)
@pytest.mark.parametrize("height", [1e-3])
def test_noise_in_an_unstable_loop_agrees(how, height):
    """The effect of noise grows with an unstable loop; physics that is right stays within that, a heavier body does not."""
    paper = dataclasses.replace(read_vehicle("quarter_car"), implementation=NOISY[how])
    controller = certify_given(
        paper, "wild", ("suspension_deflection", "sprung_velocity"), static_law(np.array([[20000.0, 2000.0]]))
    )
    prediction = predict(paper, controller, Bump(height=height), sample_times(paper, 1.0, 1e-3))
    assert prediction.radius > 1
    run = judged(prediction, paper)
    assert run.agreement.agrees, verdict_lines(run)
    assert run.agreement.blurred
    assert not judged(predict(paper, controller, Bump(height=0.1), prediction.time), heavier(paper, 1.0)).agreement.agrees


@pytest.mark.parametrize(
    ("how", "height"), [(Implementation(), 0.0), *((Implementation(sample_period=0.004, delay=30), h) for h in (1e-4, 1e-9))]
)
def test_rounding_grows_with_an_unstable_loop(how, height):
    """Over a road that does next to nothing an unstable loop makes much of rounding, and that is no disagreement."""
    paper = dataclasses.replace(read_vehicle("quarter_car"), implementation=how)
    controller = certify_given(
        paper, "wild", ("suspension_deflection", "sprung_velocity"), static_law(np.array([[20000.0, 2000.0]]))
    )
    time = sample_times(paper, 2.0, 1e-3)
    prediction = predict(paper, controller, Bump(height=height), time)
    assert prediction.radius > 1
    run = judged(prediction, paper)
    assert run.agreement.agrees, verdict_lines(run)
    if height == 1e-4:
        assert not judged(prediction, heavier(paper, 1e-4)).agreement.agrees


def _says_what_is_wrong(run: Run) -> str:
    """Holds and returns the sentence of a run that does not agree: it names a signal that fails, by the numbers that judge it."""
    assert verdict(run).startswith("DOES NOT AGREE")
    (line,) = [one for one in verdict_lines(run) if "DOES NOT AGREE" in one]
    name, numbers = line.split("(worst ")[1].split(", ", 1)
    signal = run.agreement.signals[name]
    assert not signal.agrees
    where = "" if signal.small is None else " at 0.01 of this road's height"
    difference, allowed = signal.judged
    assert numbers == f"{difference:.1e} of its peak{where}; {allowed:.1e} is allowed)"
    assert difference > allowed
    return line


def test_rounding_counts_alike_over_every_height(vehicle, controllers):
    """The effect of rounding is allowed over the road and over a hundredth of it; three hundred times as much is over neither."""
    prediction = predict(vehicle, controllers[2], Bump(height=LOWEST), sample_times(vehicle, 0.5, 1e-4))
    sampled, allowed = prediction.sampled, roundings(vehicle, controllers[2])
    off = np.array([allowed.get(name, 0.0) for name in sampled.names])

    def moved(height: float, times: float) -> Response:
        return dataclasses.replace(sampled, values=height * sampled.values + times * off)

    agreement = compare(prediction, moved(1.0, 1.0))
    assert agreement.agrees
    assert look_closer(agreement, smaller(prediction, SMALL), moved(SMALL, 1.0)).agrees
    # RK4's own error is 1e-10 of a peak at this step, and the 1e-9 that are allowed of any are 60 roundings of a length here.
    assert not compare(prediction, moved(1.0, 300.0)).agrees
    assert not look_closer(agreement, smaller(prediction, SMALL), moved(SMALL, 300.0)).agrees


def random_road(rng: np.random.Generator) -> Road:
    speed = float(rng.uniform(3, 35))
    if rng.random() < 0.6:
        height = float(np.exp(rng.uniform(*np.log(HEIGHTS))))
        return Bump(height, float(rng.uniform(0.5, 10)), speed, str(rng.choice(["both", "left", "right"])))
    return Iso8608(str(rng.choice(list("ABCDE"))), int(rng.integers(100)), speed, 1.5, factor=float(10 ** rng.uniform(-4, 0)))


@pytest.mark.attack
@pytest.mark.parametrize("seed", range(4))
def test_right_physics_agrees_anywhere(vehicle, controllers, seed):
    """The same over roads, times and steps drawn at random."""
    rng = np.random.default_rng(seed)
    road, step = random_road(rng), float(rng.choice(STEPS))
    duration = min(float(np.exp(rng.uniform(*np.log(DURATIONS)))), MOST * step)
    for run in run_controllers(vehicle, controllers, road, sample_times(vehicle, duration, step)):
        assert run.agreement.agrees, (road.describe(), duration, step, run.controller.name, verdict_lines(run))
