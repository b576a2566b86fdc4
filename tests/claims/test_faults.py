"""The fault experiment: every compiled number or parameter that is 2 % off is found, and so is every wrong road or command."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

import contextlib
import dataclasses
from collections.abc import Callable
from functools import cache, partial

import numpy as np
import pytest

from models.common.errors import InputError
from models.laws.python_law import of_function
from models.roads.road import Bump, RoadInput
from models.vehicle.limits_and_implementation import Implementation
from models.vehicle.mjcf import build_spec
from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
from sim.drive import sensor_readout
from sim.drive.computer import Computer
from sim.drive.driver import RunDriver
from sim.runs.report import reasons, verdict
from sim.runs.run import Run, compare_runs, run_controllers, sample_times
from synth.vehicle.designer import driver_of
from tests.support.analysed import Runs
from tests.support.analysed import simulate_inputs as simulate
from tests.support.commands import attacks
from tests.support.curved import AXLES, DIGRESSIVE, PROGRESSIVE, curved_text
from tests.support.faults import Fault, built_with, miswritten, places, scaled
from tests.support.pairs import CORNERS, VELOCITIES

KINDS = ("quarter_car", "half_car", "half_car_roll", "full_car")
FORCE = "[limits]\nactuator_force = 150.0\nactuator_bandwidth = 60.0\n"
STOPS = "[limits]\nsuspension_stroke = { bump = 0.03, rebound = 0.035 }\nstop_stiffness = [4e4, 2e6, 3e8]\n"
TABLES = """[limits.stop]
bump = { compression = [0.02, 0.03, 0.05], force = [0, 400, 4000] }
rebound = { deflection = [0, 0.03, 0.06], force = [0, 0, 9e3] }
"""
VALVE = '[actuators]\nkind = "damper"\nc_min = 200.0\nc_max = 4000.0\nbandwidth = 100.0\n'
REGIMES = {  # a road, a controller, and sections of the vehicle file
    "linear": (Bump(0.03), "law", ""),
    "lift-off": (Bump(0.2, speed=20.0), "passive", ""),
    "stops": (Bump(0.12, length=3.0, speed=15.0), "passive", STOPS),
    "stops with tables": (Bump(0.12, length=3.0, speed=15.0), "passive", TABLES),
    "saturation": (Bump(0.1, length=3.0, speed=15.0), "law", FORCE),
    "rate limit": (Bump(0.1, length=3.0, speed=15.0), "law", FORCE + "force_rate = 5e3\n"),
    "semi-active": (Bump(0.06), "sky", VALVE),
    "curves": (Bump(0.06), "passive", ""),
}
SHARE = 0.02
UNHEARD = 1e-9  # of a peak: a number that changes no signal by more has no effect, such as an inertia about a fixed axis


BUILT = Implementation(sample_period=4e-3, delay=2, noise={"$": 1e-3}, quantisation={"$": 2e-3})  # $: the body's velocity


@cache
def clean_run(kind: str, regime: str, law: str = "", built: bool = False) -> Run:
    """The correct run of a built-in vehicle in a regime, perhaps with another law, and as `BUILT`.

    The bump of a vehicle with two tracks is under its left wheels alone.
    """
    road, usual, sections = REGIMES[regime]
    corners, measured = CORNERS[kind], VELOCITIES[kind]
    gain = [[-2000.0, *[-300.0 * (-1) ** i] * (len(measured) - 1)] for i, _ in enumerate(corners)]
    sections += f"[controllers.law]\nmeasured = {measured}\nA = [[-2.0]]\nB = {[[1.0] * len(measured)]}\n"
    sections += f"C = {[[-900.0]] * len(corners)}\nD = {gain}\n" + "anti_windup = 20.0\n" * (
        regime in ("saturation", "rate limit")
    )
    sections += '[controllers.sky]\nsemi_active = "skyhook_linear"\n' * (regime == "semi-active")
    text = f"{read_vehicle(kind).text}\n{sections}"
    if regime == "curves":
        both = {"suspension_damping": DIGRESSIVE, "suspension_stiffness": PROGRESSIVE}
        text = curved_text(kind, sections, **(both if kind == "quarter_car" else AXLES))
    vehicle = parse_vehicle(text)
    if built:
        noise, steps = ({measured[0]: table["$"]} for table in (BUILT.noise, BUILT.quantisation))
        vehicle = dataclasses.replace(vehicle, implementation=dataclasses.replace(BUILT, noise=noise, quantisation=steps))
    if any(wheel.side for wheel in vehicle.kind.wheels):
        road = dataclasses.replace(road, track="left")

    def in_python(sample, state):
        state = 0.9 * (state or 0.0) + sample.y[0]
        return [-2000.0 * sample.y[0] - 100.0 * state] * len(corners), state

    vars(in_python)["measured"] = measured
    driver = of_function(in_python, vehicle.linear_model.measurable) if law == "python" else driver_of(vehicle, law or usual)
    (run,) = run_controllers(vehicle, [driver], road, sample_times(vehicle, 0.4, 1e-3))
    assert run.passed, reasons(run)
    return run


def faulty(clean: Run, vehicle: Vehicle | None = None, fault: Fault | None = None, driver: RunDriver | None = None) -> Run:
    """What a clean run becomes with another vehicle, a fault of its model or another controller, judged as the clean one."""
    with built_with(fault or (lambda spec: None)):
        met = RoadInput(vehicle or clean.vehicle, clean.road, clean.physics.time)
        made = simulate([driver or clean.controller], [met])
        return judged(clean, made)


def judged(clean: Run, made: Runs) -> Run:
    """The verdict on physics by the prediction of a clean run, without its energy."""
    return compare_runs([clean.prediction], made.recordings)[0]


def changed(run: Run, clean: Run) -> bool:
    """True if a signal changes by more than `UNHEARD` of its peak."""
    pairs = ((run.physics[name] - clean.physics[name], clean.physics.scale(name)) for name in run.vehicle.linear_model.outputs)
    return any(float(np.abs(far).max()) > UNHEARD * (scale or 1.0) for far, scale in pairs)


def clipped(clean: Run, signal: str) -> Fault:
    """A fault of a sensor: it reads the signal only up to half of its largest value."""
    names, (_, readout) = clean.vehicle.linear_model.outputs, sensor_readout.prepared_readout(clean.vehicle, 1e-3)
    most = abs(readout.rest[names.index(signal)]) + 0.5 * float(np.abs(clean.physics[signal]).max())

    def fault(spec):
        spec.sensor(signal).cutoff = most

    return fault


def displaced(spec):
    """A fault of the sensors of the body's centre: they sit 1 cm above it."""
    spec.site("centre").pos[2] += 0.01


def experiment(kind: str, regime: str) -> list[tuple[object, Callable[[Run], Run]]]:
    """All faults of a vehicle in a regime: every compiled number and every parameter is 2 % off, and every sensor clips."""
    vehicle = clean_run(kind, regime).vehicle
    numbers = [(place, partial(faulty, fault=scaled(place, SHARE))) for place in places(build_spec(vehicle, 1e-3))]
    written = [(name, partial(faulty, vehicle=miswritten(vehicle, name, SHARE))) for name in vehicle.parameters]
    sensors = [name for name in vehicle.linear_model.outputs if name not in vehicle.kind.combined]
    return [*numbers, *written, *((name, lambda clean, name=name: faulty(clean, fault=clipped(clean, name))) for name in sensors)]


def missed(kind: str, regime: str, part: slice) -> tuple[list[object], int]:
    """The faults of a regime that change a signal and are not found, and how many are found."""
    clean, lost, found = clean_run(kind, regime), [], 0
    for what, make in experiment(kind, regime)[part]:
        with contextlib.suppress(InputError):  # the vehicle is refused
            run = make(clean)
            found += not run.agrees
            if run.agrees and changed(run, clean):
                lost.append(what)
    return lost, found


ALL = [(kind, regime, slice(None)) for kind in KINDS for regime in REGIMES if regime != "curves" or kind == "quarter_car"]


FEW = [
    ("half_car", "linear", slice(8, None, 9)),
    ("half_car_roll", "linear", slice(4, None, 9)),
    ("quarter_car", "stops", slice(2, None, 5)),
    ("quarter_car", "stops with tables", slice(2, None, 7)),
]


@pytest.mark.parametrize(("kind", "regime", "part"), [*FEW, *attacks(ALL)])
def test_every_number_counts(kind, regime, part):
    """A number that is 2 % off and changes a signal at all is found: in the linear regime, in the air, on stops, at limits."""
    lost, found = missed(kind, regime, part)
    assert lost == []
    assert found > 3, "most numbers change a signal"


@pytest.mark.parametrize("signal", ["heave_acceleration", ""])
def test_sensors_that_are_wrong_at_large_motions_alone_are_found(signal):
    """A sensor that clips, or one that is displaced, is found by the steps alone, which name the signal and the time."""
    clean = clean_run("half_car", "linear")
    run = faulty(clean, fault=clipped(clean, signal) if signal else displaced)
    steps = run.agreement.steps
    assert steps is not None
    assert steps.signal == "heave_acceleration"
    apart = np.abs(run.physics[steps.signal] - clean.physics[steps.signal])
    assert steps.since == run.physics.time[(apart > steps.allowed * run.physics.scale(steps.signal)).argmax()]
    assert verdict(run).text.startswith(
        f"MuJoCo DOES NOT AGREE with the equations of motion from {steps.since:.4g} s on (heave_acceleration)"
    )
    said = f"DOES NOT AGREE from {steps.since:.4g} s on: not every MuJoCo step"
    assert any(line.text.startswith(said) for line in reasons(run))


def late(values: np.ndarray) -> np.ndarray:
    """The same one step later."""
    return np.concatenate([np.zeros_like(values[:1]), values[:-1]])


WHERE = ("heights", "midway", "velocities", "held_velocities")  # of `RoadInput`
ROADS = {
    "late": (late, WHERE),
    "held late": (late, WHERE[1:2]),
    "rear late": (lambda z: np.where(np.arange(z.shape[1]) < z.shape[1] // 2, z, late(z)), WHERE),
    "tracks swapped": (lambda z: z[:, [1, 0, 3, 2][: z.shape[1]]], WHERE),
}


@pytest.mark.parametrize(
    ("kind", "wrong"),
    [
        ("half_car", "rear late"),
        *attacks([("quarter_car", "late"), ("half_car_roll", "tracks swapped"), *(("full_car", name) for name in ROADS)]),
    ],
)
@pytest.mark.parametrize("regime", ["linear", *attacks(["lift-off", "semi-active"])])
def test_a_wrong_road_is_found(kind, wrong, regime):
    """Physics that meets the road one step late, at the rear wheels or at all, or on the other side, is found."""
    clean, (change, where) = clean_run(kind, regime), ROADS[wrong]
    met = RoadInput(clean.vehicle, clean.road, clean.physics.time)
    vars(met).update({name: change(getattr(met, name)) for name in where})
    run = judged(clean, simulate([clean.controller], [met]))
    assert changed(run, clean)
    assert run.agreement.steps is not None
    assert not run.agreement.steps.agrees


LAWS = [("saturation", "law"), ("semi-active", "sky"), ("semi-active", "law"), ("linear", "python")]
HOW = {
    "delay": {"delay": 3},
    "no noise": {"noise": {}},
    "other noise": {"seed": 1},
    "no quantisation": {"quantisation": {}},
    "sample period": {"sample_period": 2e-3, "delay": 4},
}


@pytest.mark.parametrize(("regime", "law"), [("linear", "law"), *attacks(LAWS)])
def test_wrong_commands_are_found(regime, law, monkeypatch):
    """Commands that are late by a sample, all of them or one, or that answer other measurements, are found, and named."""
    clean = clean_run("quarter_car", regime, law, built=True)
    vehicle = clean.vehicle
    runs = {
        name: faulty(clean, dataclasses.replace(vehicle, implementation=dataclasses.replace(vehicle.implementation, **how)))
        for name, how in HOW.items()
    }
    step, at = Computer.step, []

    def one_late(self, k, signals, commands):
        before = commands.copy()
        step(self, k, signals, commands)
        if k >= 100 and not at and np.any(commands != before):
            at.append(k)
        if at and k < at[0] + 4:
            commands[:] = before

    monkeypatch.setattr(Computer, "step", one_late)
    runs["one command"] = faulty(clean)
    commands = runs["one command"].agreement.commands
    assert commands is not None
    assert commands.since == clean.physics.time[at[0]]
    for name, run in runs.items():
        assert changed(run, clean), name
        assert verdict(run).text.startswith("COMMANDS DO NOT AGREE with the control law from "), name


@pytest.mark.parametrize("law", ["law", *attacks(["python"])])
@pytest.mark.parametrize("kind", ["quarter_car", *attacks(["half_car", "full_car"])])
def test_another_rate_limit_is_found(kind, law):
    """A rate limit of physics that is 2 % off is found by the first command at the limit, 8 ms after its sample, or by the law's
    states after this sample.
    """
    clean = clean_run(kind, "rate limit", law, built=True)
    limits = clean.vehicle.limits
    assert limits.force_rate is not None
    other = dataclasses.replace(clean.vehicle, limits=dataclasses.replace(limits, force_rate=(1 + SHARE) * limits.force_rate))
    commands, ended = faulty(clean, other).agreement.commands, clean.agreement.end_times["rate limit"]
    assert ended == clean.agreement.until < clean.physics.time[-1]
    assert commands is not None
    assert not commands.agrees
    assert commands.since == pytest.approx(ended - 4e-3 * (law == "law"))
    assert np.isfinite(clean.agreement.end_times["force saturation"])


@pytest.mark.parametrize("regime", ["saturation", *attacks(["linear", "semi-active"])])
@pytest.mark.parametrize("number", ["A", "B", "C", "D", "anti_windup"])
def test_every_number_of_a_law_counts(regime, number):
    """A matrix of a dynamic controller, or its anti-windup rate, that is 2 % off is found."""
    clean = clean_run("quarter_car", regime, "law")
    law = clean.controller.law
    if getattr(law, number) is not None:
        other = dataclasses.replace(law, **{number: (1 + SHARE) * getattr(law, number)})
        found = faulty(clean, driver=dataclasses.replace(clean.controller, law=other)).agreement.commands
        assert found is not None
        assert not found.agrees
