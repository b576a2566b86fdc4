"""Task of a recommendation: the car, its road and goal, its linear twin, its sensors and the limits of its hardware."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np
from scipy import linalg

from models.characteristics import SIDES
from models.common.arrays import Array
from models.roads.iso8608 import Iso8608
from models.roads.road import Road, track_width
from models.roads.spectrum import Spectrum
from models.vehicle.names import PASSIVE
from models.vehicle.vehicle import Vehicle
from sim.runs.run import sample_times
from sim.studies.recommend.within import FORCE, TRAVEL, Room, Within
from sim.studies.ride.expected import ExpectedMetrics, expect
from synth.controller.controller import AnyController, Controller
from synth.vehicle.designer import Designer

Goal = Literal["ride", "holding", "travel"]
GOALS: Mapping[Goal, str] = {"ride": "ride", "holding": "dynamic_load", "travel": "peak_travel"}  # and their columns
SEEDS = (0, 1, 2, 3, 4, 5)  # of the roads of the search
WINDOW = 10.0  # s, measured on each road
ROADS = 30  # of this window, whose largest value the linear stage expects
USUAL_CLASS = "C"  # of the random road for which candidates are designed if the road is not random
NOISE = 0.01  # of a signal's rms without control: noise of a sensor for which the file gives none


@dataclass(frozen=True, eq=False)
class Task:
    """Task of a recommendation.

    Attributes:
        vehicle: the vehicle as in its file.
        road: the road, with seed 0 if it is random.
        goal: what is minimised.
        within: limits that a candidate keeps.
        timestep: timestep of the physics [s].
    """

    vehicle: Vehicle
    road: Road
    goal: Goal = "ride"
    within: Within = field(default_factory=Within)
    timestep: float = 1e-3

    @property
    def spectrum(self) -> Spectrum:
        """Spectrum of the random road for which candidates are designed: the road's own, or that of class `USUAL_CLASS`."""
        if self.road.spectrum is not None:
            return self.road.spectrum
        speed = self.road.speed or 20.0
        return Iso8608(USUAL_CLASS, speed=speed, track_width=track_width(self.vehicle)).spectrum

    @property
    def sample_times(self) -> Array:
        """Sample times of the longest runs [s]."""
        return sample_times(self.vehicle, WINDOW, self.timestep)

    @cached_property
    def coarse_step(self) -> float:
        """Timestep of expectations [s]: the sample period, if the delay is a number of samples."""
        how = self.vehicle.implementation
        return how.sample_period if how.sample_period and how.delay == int(how.delay) else self.timestep

    @cached_property
    def pushed(self) -> Vehicle:
        """The vehicle with force actuators, without noise in its loop."""
        vehicle = self.vehicle.with_force_actuators if self.vehicle.dampers else self.vehicle
        return replace(vehicle, implementation=vehicle.implementation.without_noise)

    @cached_property
    def designer(self) -> Designer:
        """Designer of the file's controllers."""
        return Designer(self.vehicle, search=False)

    @cached_property
    def passive(self) -> Controller:
        """The controller without forces."""
        return self.designer.design(PASSIVE)

    @cached_property
    def expected_passive(self) -> ExpectedMetrics | None:
        """Expected metrics of the passive vehicle over the road of the designs; None without a stable linear loop."""
        return expect(self.pushed, self.passive, self.spectrum, self.timestep, ROADS * WINDOW)

    @cached_property
    def line(self) -> Vehicle:
        """The linear vehicle: with the lines of statistical linearisation of the passive vehicle, or else those at rest."""
        expected = self.expected_passive
        return self.pushed.linearised if expected is None else expected.line.vehicle

    def offset(self, deflection: str) -> float:
        """Returns the mean of a deflection of the passive vehicle on the road [m]; curves that are not symmetric make it."""
        return 0.0 if self.expected_passive is None else self.expected_passive.line.mean.get(deflection, 0.0)

    @cached_property
    def rms(self) -> Mapping[str, float]:
        """Rms of every signal of the passive linear vehicle on a road of white velocity of this spectrum, by name."""
        model = self.line.linear_model
        n, across = len(model.A), np.ones((len(model.disturbances), 1))
        slow = 0.2 * np.eye(n)  # 1/s, so that a body without a spring has a variance, too
        push = model.Bw @ across * self.white
        covariance = linalg.solve_continuous_lyapunov(model.A - slow, -push @ push.T)
        sizes = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", model.C, covariance, model.C), 0.0))
        return dict(zip(model.outputs, sizes.tolist(), strict=True))

    @property
    def white(self) -> float:
        """Root of the two-sided intensity of the road's velocity [m/s per root of Hz]."""
        return math.sqrt(self.spectrum.density / 2)

    @cached_property
    def static_loads(self) -> Mapping[str, float]:
        """Static load of the suspension of every force [N]."""
        kind, model = self.vehicle.kind, self.vehicle.linear_model
        loads, tyres = kind.static_loads(self.vehicle.parameters), kind.static_tyre_deflection(self.vehicle.parameters)
        each = {one.force: loads.get(one.deflection) for one in kind.suspensions if one.force}
        usual = 9.81 * 400.0 * max(len(tyres), 1) / len(model.inputs) if not any(each.values()) else 0.0
        return {force: each.get(force) or usual for force in model.inputs}

    @cached_property
    def room(self) -> Room:
        """Limits of the hardware, given or assumed."""
        vehicle, assumed = self.pushed, list[str]()
        given, peaks = vehicle.parts.strokes, self.passive_peaks
        lacking = [one.deflection for one in vehicle.kind.suspensions if not given.get(one.deflection)]
        strokes = {
            one.deflection: tuple(given.get(one.deflection, {}).get(side, math.inf) for side in SIDES)
            for one in vehicle.kind.suspensions
        }
        if lacking:
            strokes |= {name: (TRAVEL * peaks[name],) * 2 for name in lacking}
            largest = 1e3 * max(strokes[name][0] for name in lacking)
            assumed.append(
                f"The file has no suspension_stroke: the assumed stroke is {largest:.0f} mm, {TRAVEL:g} times passive's travel."
            )
        force = vehicle.limits.actuator_force
        forces = {name: force or FORCE * load for name, load in self.static_loads.items()}
        if force is None and not self.vehicle.dampers:
            assumed.append(
                f"The file has no actuator_force: the assumed limit is {max(forces.values()):.0f} N, half of the static load."
            )
        return Room(strokes, forces, tuple(assumed))

    @cached_property
    def passive_peaks(self) -> Mapping[str, float]:
        """Expected peak of every deflection of the passive vehicle [m]; five times its rms without an expectation."""
        mean = {} if self.expected_passive is None else self.expected_passive.mean
        names = [one.deflection for one in self.vehicle.kind.suspensions]
        return {name: mean.get(f"{name}_peak") or 5 * self.rms[name] for name in names}

    @cached_property
    def sensors(self) -> tuple[str, ...]:
        """Sensors of the file: signals with noise or in a controller; without any, travel and accelerations."""
        model, how = self.vehicle.linear_model, self.vehicle.implementation
        named = dict.fromkeys([*how.noise, *how.quantisation])
        for one in self.vehicle.controllers.values():
            named |= dict.fromkeys(one.measured)
        real = [name for name in named if name in model.measurable and name not in model.inputs]
        usual = [*(one.deflection for one in self.vehicle.kind.suspensions), *self.vehicle.ride_points.all]
        return tuple(real or [name for name in usual if name in model.measurable])

    @cached_property
    def groups(self) -> Mapping[str, tuple[str, ...]]:
        """Sensors by what they measure, those of all corners together."""
        endings = sorted({one.ending for one in self.vehicle.kind.suspensions if one.ending}, key=len, reverse=True)
        groups: dict[str, list[str]] = {}
        for name in self.sensors:
            ending = next((one for one in endings if name.endswith(one)), "")
            groups.setdefault(name.removesuffix(ending), []).append(name)
        return {name: tuple(signals) for name, signals in groups.items()}

    def noise_of(self, measured: Sequence[str]) -> list[float]:
        """Returns the white noise of sensors [their unit times root of s]: of the file, or `NOISE` of the signal."""
        how, period = self.vehicle.implementation, self.vehicle.implementation.sample_period or self.timestep
        sizes = [
            how.noise.get(name) or how.quantisation.get(name, 0.0) / math.sqrt(12) or NOISE * self.rms[name] for name in measured
        ]
        return [size * math.sqrt(period) for size in sizes]


def body_rows(vehicle: Vehicle, names: Sequence[str]) -> Array:
    """Returns orthogonal sums of some signals with the same sum of squares, a row of coefficients each, shape (k, signals)."""
    C, D = vehicle.linear_model.rows(names)
    turned, sizes, _ = np.linalg.svd(np.hstack([C, D]), full_matrices=False)
    return turned.T[sizes > 1e-9 * sizes[0]]


@dataclass(frozen=True, eq=False)
class Candidate:
    """Candidate for a recommendation.

    Attributes:
        name: name in the table.
        family: family of candidates, which are searched together.
        controller: the controller.
        vehicle: the vehicle that it drives; the passive family changes it.
        setting: its numbers in words.
        own: True for a controller of the file.
    """

    name: str
    family: str
    controller: AnyController
    vehicle: Vehicle
    setting: str = ""
    own: bool = False

    @property
    def sensors(self) -> tuple[str, ...]:
        """Signals that it measures."""
        return tuple(self.controller.measured) if self.controller.acts else ()
