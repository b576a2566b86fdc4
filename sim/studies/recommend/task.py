"""Task of a recommendation: the vehicle and its linear model, the road, the goal, the sensors and the hardware limits."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from string import ascii_lowercase

import numpy as np
from scipy import linalg

from models.characteristics import SIDES
from models.common.arrays import Array
from models.common.printed import brief, three_digits
from models.kinds.kind import GRAVITY
from models.roads.iso8608 import Iso8608
from models.roads.road import Road, track_width
from models.roads.spectrum import Spectrum
from models.vehicle.names import PASSIVE
from models.vehicle.vehicle import Vehicle
from sim.studies.recommend.within import Within
from sim.studies.ride.expected import ExpectedMetrics, expect
from sim.studies.ride.scores import score_of
from synth.controller.controller import AnyController, Controller
from synth.vehicle.designer import Designer

WINDOW = 10.0  # s, time over which each road is measured
SEEDS = (0, 1, 2, 3, 4, 5)  # seeds of the random roads on which candidates are compared
ROADS = 30  # linear analysis computes the expected largest value over this many windows of length `WINDOW`
NOISE = 0.01  # noise that is assumed for a sensor without noise in the file, relative to the signal's rms without control
# limit on the stroke, relative to the passive car's peak travel, and on the force, relative to the static load, if no limits
# are given
TRAVEL, FORCE = 1.25, 0.5
SPEED = 20.0  # m/s, usual speed


@dataclass(frozen=True, eq=False)
class Task:
    """Task of a recommendation.

    Attributes:
        vehicle: vehicle that is defined by the vehicle file.
        road: road on which controllers are compared; a random road has seed 0.
        goal: quantity to minimise: "ride" (weighted acceleration), "holding" (dynamic tyre load) or "travel" (suspension
            travel).
        within: limits that a recommended controller must keep.
        timestep: timestep of the MuJoCo simulation [s].
        effort: number of candidates to evaluate, relative to the default number.
    """

    vehicle: Vehicle
    road: Road
    goal: str = "ride"
    within: Within = field(default_factory=Within)
    timestep: float = 1e-3
    effort: float = 1.0

    @property
    def random(self) -> bool:
        """True if the road is random and the response of the vehicle becomes stationary."""
        return self.road.spectrum is not None

    @property
    def roads(self) -> int:
        """Number of roads on which each candidate is simulated."""
        return len(SEEDS) if isinstance(self.road, Iso8608) else 1

    @property
    def road_words(self) -> str:
        """Text that describes the road and the speed."""
        return self.road.words.replace("random, ", "").replace(", seed 0", "")

    @property
    def spectrum(self) -> Spectrum:
        """Spectrum of the random road for which candidates are designed: the spectrum of the task's road or, if this road has
        none, that of class C.
        """
        return self.road.spectrum or Iso8608(speed=self.road.speed or SPEED, track_width=track_width(self.vehicle)).spectrum

    @property
    def coarse_step(self) -> float:
        """Timestep for expected metrics [s]: the sample period if the delay is an integer number of samples, otherwise
        `timestep`.
        """
        how = self.vehicle.implementation
        return how.sample_period if how.sample_period and how.delay == int(how.delay) else self.timestep

    @cached_property
    def pushed(self) -> Vehicle:
        """The vehicle with force actuators, and without measurement noise and quantisation."""
        vehicle = self.vehicle.with_force_actuators if self.vehicle.dampers else self.vehicle
        return replace(vehicle, implementation=vehicle.implementation.without_noise)

    @cached_property
    def designer(self) -> Designer:
        """`Designer` for the controllers of the vehicle file."""
        return Designer(self.vehicle, search=False)

    @cached_property
    def passive(self) -> Controller:
        """The passive controller, which commands no forces."""
        return self.designer.design(PASSIVE)

    @cached_property
    def expected_passive(self) -> ExpectedMetrics | None:
        """Expected metrics of the passive vehicle on the design road; None if the passive vehicle is not stable."""
        return expect(self.pushed, self.passive, self.spectrum, self.timestep, ROADS * WINDOW)

    @cached_property
    def passive_values(self) -> Mapping[str, float | None]:
        """Expected metrics of the passive vehicle that are used to compare controllers, by key; None for an unknown metric."""
        return score_of(self.pushed, PASSIVE, {} if self.expected_passive is None else self.expected_passive.mean).values

    @cached_property
    def line(self) -> Vehicle:
        """The linear vehicle: statistical linearisation of the passive vehicle or, if this fails, linearisation at
        equilibrium.
        """
        return self.pushed.linearised if self.expected_passive is None else self.expected_passive.line.vehicle

    @property
    def white(self) -> float:
        """Square root of the two-sided spectral density of the road velocity [m/s per root of Hz]."""
        return math.sqrt(self.spectrum.density / 2)

    @cached_property
    def rms(self) -> Mapping[str, float]:
        """Rms of each signal of the passive linear vehicle on a road whose velocity is white noise, by name."""
        model = self.line.linear_model
        push = self.white * model.Bw.sum(axis=1, keepdims=True)
        # Extra damping of 0.2 1/s is added, so that a body without a spring has a finite variance
        slower = model.A - 0.2 * np.eye(len(model.A))
        covariance = linalg.solve_continuous_lyapunov(slower, -push @ push.T)
        sizes = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", model.C, covariance, model.C), 0.0))
        return dict(zip(model.outputs, sizes.tolist(), strict=True))

    @cached_property
    def static_loads(self) -> Mapping[str, float]:
        """Static load of the suspension at each force [N]; the weight of 400 kg if the vehicle type does not define this load."""
        kind = self.vehicle.kind
        loads, places = kind.static_loads(self.vehicle.parameters), {one.force: one.deflection for one in kind.suspensions}
        return {name: loads.get(places.get(name, ""), 400 * GRAVITY) for name in self.vehicle.linear_model.inputs}

    @cached_property
    def strokes(self) -> Mapping[str, tuple[float, float]]:
        """Stroke in bump and rebound [m], by deflection: from the vehicle file or, if not defined there, `TRAVEL` times the
        passive peak travel.
        """
        mean, strokes = {} if self.expected_passive is None else self.expected_passive.mean, {}
        for name in (one.deflection for one in self.vehicle.kind.suspensions):
            given = self.pushed.parts.strokes.get(name, {})
            usual = math.inf if given else TRAVEL * (mean.get(f"{name}_peak") or 5 * self.rms[name])
            strokes[name] = given.get(SIDES[0], usual), given.get(SIDES[1], usual)
        return strokes

    @cached_property
    def forces(self) -> Mapping[str, float]:
        """Largest force of each actuator [N]: from the vehicle file or, if not defined there, `FORCE` times the static load."""
        return {name: self.pushed.limits.actuator_force or FORCE * load for name, load in self.static_loads.items()}

    @property
    def assumed(self) -> list[str]:
        """Sentences that state which values are assumed for limits that the vehicle file does not contain."""
        most, force, texts = (
            brief(1e3 * max(map(min, self.strokes.values()))),
            three_digits(max(self.forces.values())),
            list[str](),
        )
        if not all(self.pushed.parts.strokes.get(name) for name in self.strokes):
            texts.append(f"The file has no suspension_stroke: {most} mm are assumed, {TRAVEL:g} times the passive peak travel.")
        if self.pushed.limits.actuator_force is None and not self.vehicle.dampers:
            texts.append(f"The file has no actuator_force: {force} N are assumed, half the static load.")
        return texts

    @cached_property
    def sensors(self) -> tuple[str, ...]:
        """Signals that have noise or quantisation in the vehicle file, or that its controllers measure; by default, travels and
        accelerations.
        """
        model, how = self.vehicle.linear_model, self.vehicle.implementation
        named = [*how.noise, *how.quantisation, *(name for one in self.vehicle.controllers.values() for name in one.measured)]
        real = dict.fromkeys(name for name in named if name in model.measurable and name not in model.inputs)
        usual = [*self.strokes, *self.vehicle.ride_points.all]
        return tuple(real or (name for name in usual if name in model.measurable))

    @cached_property
    def groups(self) -> Mapping[str, tuple[str, ...]]:
        """Groups of sensors that measure one quantity at different corners, by name of the quantity."""
        endings = sorted({one.ending for one in self.vehicle.kind.suspensions if one.ending}, key=len, reverse=True)
        groups: dict[str, tuple[str, ...]] = {}
        for name in self.sensors:
            group = name.removesuffix(next((one for one in endings if name.endswith(one)), ""))
            groups[group] = (*groups.get(group, ()), name)
        return groups

    @property
    def letters(self) -> Mapping[str, str]:
        """Letter that denotes each group of sensors, by name of the group."""
        return dict(zip(self.groups, ascii_lowercase, strict=False))

    def given_noise(self, measured: Sequence[str]) -> list[float]:
        """Returns the noise rms of each sensor from the vehicle file; 0 if the file states none."""
        how = self.vehicle.implementation
        return [how.noise.get(name) or how.quantisation.get(name, 0.0) / math.sqrt(12) for name in measured]

    def noise_of(self, measured: Sequence[str]) -> Array:
        """Returns each sensor's noise density relative to that of the road velocity; noise that the file does not state is
        `NOISE` times the signal's rms.
        """
        given = zip(measured, self.given_noise(measured), strict=True)
        sizes = [noise or NOISE * self.rms[name] for name, noise in given]
        return np.array(sizes) * math.sqrt(self.vehicle.implementation.sample_period or self.timestep) / self.white


@dataclass(frozen=True, eq=False)
class Contender:
    """Contender for a recommendation.

    Attributes:
        name: name of the candidate's family in the table.
        controller: controller of the candidate.
        vehicle: vehicle that the candidate controls; a passive candidate has a different damper and spring.
        setting: text that states the parameter values of the candidate.
        own: True for a controller that the vehicle file already contains.
    """

    name: str
    controller: AnyController
    vehicle: Vehicle
    setting: str = ""
    own: bool = False

    @property
    def pushes(self) -> bool:
        """True if the candidate's controller uses force actuators."""
        return self.controller.acts and not self.vehicle.dampers
