"""Faults in the physics of a vehicle are found: whatever number of its MJCF is off, in whatever regime."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

import contextlib
import dataclasses

import numpy as np
import pytest

from models.common.errors import InputError
from models.roads.road import Bump, RoadInput
from models.vehicle.mjcf import build_spec
from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
from sim.physics import sensor_readout
from sim.physics.simulate import simulate
from sim.runs.agreement import compare
from sim.runs.report import verdict, verdict_lines
from sim.runs.run import Run, run_controllers, sample_times
from synth.vehicle.designer import Designer
from tests.conftest import random_vehicles
from tests.support.commands import attacks
from tests.support.curved import AXLES, DIGRESSIVE, PROGRESSIVE, curved_text
from tests.support.faults import Fault, built_with, miswritten, places, scaled

STOPS = "\n[limits]\nsuspension_stroke = { bump = 0.03, rebound = 0.035 }\nstop_stiffness = [4e4, 2e6, 3e8]\n"
FORCE = "\n[limits]\nactuator_force = 400.0\nactuator_bandwidth = 60.0\n"
KINDS = ("quarter_car", "half_car", "full_car")
REGIMES = {
    "plain": (Bump(0.06), "I"),
    "curves": (Bump(0.06), "passive"),
    "stops": (Bump(0.12, speed=8.0), "passive"),
    "flight": (Bump(0.2, speed=20.0), "passive"),
    "force": (Bump(0.1), "I"),
}
UNHEARD = 1e-9  # of a peak: a number that changes no signal by more is none of the physics, such as an inertia that hardly turns


def driven(kind: str, regime: str) -> tuple[Vehicle, Bump, str]:
    """A vehicle in a regime, its road, and the name of its controller. A full car's left wheels alone meet a low bump."""
    road, name = REGIMES[regime]
    text = read_vehicle(kind).text + {"stops": STOPS, "force": FORCE}.get(regime, "")
    if regime == "curves":
        both = {"suspension_damping": DIGRESSIVE, "suspension_stiffness": PROGRESSIVE}
        text = curved_text(kind, **(both if kind == "quarter_car" else AXLES))
    if kind == "full_car" and road.height < 0.1:
        road = dataclasses.replace(road, track="left")
    return parse_vehicle(text), road, name


def judged(vehicle: Vehicle, road: Bump, name: str, fault: Fault | None = None, duration: float = 0.5) -> Run:
    """The run of a vehicle, with a fault in its physics."""
    time, controller = sample_times(vehicle, duration, 1e-3), Designer(vehicle).design(name)
    with built_with(fault or (lambda spec: None)):
        return run_controllers(vehicle, [controller], road, time)[0]


def changed(run: Run, clean: Run) -> float:
    """The largest change of a signal, over its peak."""
    names = run.vehicle.linear_model.outputs
    return max(
        float(np.abs(run.physics[name] - clean.physics[name]).max()) / (clean.physics.scale(name) or 1.0) for name in names
    )


def stronger(part: str, share: float) -> Fault:
    """A fault of all curves of the dampers, or of all stops."""

    def fault(spec):
        for actuator in spec.actuators:
            if part == "curves" and actuator.name.startswith("fitted_velocity"):
                actuator.biasprm[:3] *= 1 + share
                actuator.forcerange *= 1 + share
        for tendon in spec.tendons:
            if part == "stops" and tendon.name.startswith("stop"):
                tendon.stiffness *= 1 + share

    return fault


@pytest.mark.parametrize(("kind", "part"), [("quarter_car", "stops"), *attacks([("half_car", "curves"), ("half_car", "stops")])])
def test_what_is_wrong_at_large_motions_alone_is_found(kind, part):
    """Damper curves that are 2.5 % too strong are no geometry, stops that are 2 % too stiff are found, and a clean run agrees."""
    vehicle, road, name = driven(kind, part)
    clean, wrong = (
        judged(vehicle, road, name, fault) for fault in (None, stronger(part, {"curves": 0.025, "stops": 0.02}[part]))
    )
    assert clean.passed
    assert clean.agreement.steps is not None
    assert clean.agreement.steps.error < 1e-12  # rounding
    assert changed(wrong, clean) > 1e-5
    assert not wrong.agreement.agrees
    assert verdict(wrong).startswith("DOES NOT AGREE step by step")
    assert any(line.startswith("DOES NOT AGREE step by step: from") for line in verdict_lines(wrong))


def found(clean: Run, vehicle: Vehicle, fault: Fault | None = None) -> bool:
    """True if a step of the vehicle with a fault is not that of the clean run's equations; the rest of a verdict is dearer."""
    with built_with(fault or (lambda spec: None)):
        made = simulate([clean.controller], [RoadInput(vehicle, clean.road, clean.physics.time)])
    return not compare(clean.prediction, made.run(0), made.requested_force[0]).step_by_step


def clipped(vehicle: Vehicle, clean: Run, signal: str) -> Fault:
    """A fault of a sensor: it reads the signal only up to half of its largest value."""
    names, (_, readout) = vehicle.linear_model.outputs, sensor_readout.prepared(vehicle, 1e-3)
    most = abs(readout.rest[names.index(signal)]) + 0.5 * float(clean.physics[signal].max())

    def fault(spec):
        spec.sensor(signal).cutoff = most

    return fault


def displaced(spec):
    """A fault of the sensors of the body's centre: they sit 1 cm above it."""
    spec.site("centre").pos[2] += 0.01


@pytest.mark.parametrize("signal", ["heave_acceleration", "unsprung_acceleration_front", ""])
def test_signals_that_are_wrong_at_large_motions_alone_are_found(signal):
    """A sensor that clips, or one beside its place, is no geometry: it has gone at a hundredth of the height.

    The state tells every acceleration: those of a correct half-car are as exact as its steps.
    """
    text = read_vehicle("half_car").text.replace("[performance]", "[performance]\nunsprung_acceleration_front = 1e-3", 1)
    vehicle, road = parse_vehicle(text), Bump(0.1)
    clean = judged(vehicle, road, "passive", duration=0.4)
    assert clean.passed
    assert clean.agreement.steps is not None
    assert clean.agreement.steps.error < 1e-12  # rounding
    fault = clipped(vehicle, clean, signal) if signal else displaced
    wrong = judged(vehicle, road, "passive", fault, duration=0.4)
    steps = wrong.agreement.steps
    assert steps is not None
    assert all(one.agrees for one in wrong.agreement.signals.values())  # nothing else finds it
    assert not steps.agrees
    assert steps.signal == (signal or "heave_acceleration")
    apart = np.abs(wrong.physics[steps.signal] - clean.physics[steps.signal])
    assert steps.since == wrong.physics.time[(apart > steps.allowed * wrong.physics.scale(steps.signal)).argmax()]
    assert verdict(wrong).startswith("DOES NOT AGREE step by step")


@pytest.mark.attack
@pytest.mark.parametrize("kind", KINDS)
def test_sensors_count(kind):
    """Every sensor that clips its signal is found: in the air, and where forces are at their limit."""
    for regime in ("flight", "force"):
        vehicle, road, name = driven(kind, regime)
        clean = judged(vehicle, road, name)
        sensors = [each for each in vehicle.linear_model.outputs if each not in vehicle.kind.combined]
        heard = [each for each in sensors if clean.physics[each].max() > 1e-6 * clean.physics.scale(each)]
        assert len(heard) > len(sensors) / 2
        assert [each for each in heard if not found(clean, vehicle, clipped(vehicle, clean, each))] == []


def numbers(kind: str, regime: str) -> list[tuple[str, str, str, int]]:
    """The numbers that are put wrong: all in the plain regime, in others what is new and a third of the rest; no right wheels.

    Of curves, whose actuators are many and alike, it is a fifth of what is new.
    """
    plain, there = (
        [place for place in places(build_spec(driven(kind, name)[0], 1e-3)) if not place[1].endswith("right")]
        for name in ("plain", regime)
    )
    new = [place for place in there if place not in plain]
    return plain if regime == "plain" else new[:: 5 if regime == "curves" else 1] + plain[::3]


CASES = [(KINDS[0], regime) for regime in REGIMES] + [("half_car", "stops"), ("full_car", "plain"), ("full_car", "force")]


@pytest.mark.attack
@pytest.mark.parametrize(("kind", "regime"), CASES)
def test_numbers_count(kind, regime):
    """A number of an element that changes the motion at all is found where it is off by 2 %.

    Cars with curves are left to the quick test: their elements are those of a quarter-car, and take minutes.
    """
    vehicle, road, name = driven(kind, regime)
    clean, missed = judged(vehicle, road, name), []
    assert clean.passed
    cases: list[tuple[object, Vehicle, Fault | None]] = [
        *((place, vehicle, scaled(place, 0.02)) for place in numbers(kind, regime)),
        *((parameter, miswritten(vehicle, parameter, 0.02), None) for parameter in vehicle.parameters),
    ]
    for what, other, fault in cases:
        with contextlib.suppress(InputError):  # it is refused
            if not found(clean, other, fault):
                run = judged(other, road, name, fault)
                if run.passed and changed(run, clean) > UNHEARD:
                    missed.append(what)
    assert not missed


@pytest.mark.attack
@pytest.mark.parametrize("regime", ["plain", "stops", "flight"])
@pytest.mark.parametrize("kind", KINDS)
def test_random_vehicles_raise_no_alarm(kind, regime):
    """Correct vehicles drawn at random hold in every regime."""
    vehicle, road, _ = driven(kind, regime)
    for other in random_vehicles(vehicle, 8, 0.3):
        run = judged(other, road, "passive")
        assert run.agreement.steps is not None
        assert run.passed or run.broke_off is not None, (other.parameters, verdict_lines(run))
