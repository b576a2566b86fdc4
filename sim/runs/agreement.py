"""Verdict on a run: MuJoCo's steps are those of the vehicle's equations, and its commands are those of the control law.

A run agrees if two local checks hold:

1. Every MuJoCo step equals one RK4 step of the vehicle's exact nonlinear equations from the same state (`sim.observers.steps`).
   This covers lift-off, stops, characteristics, dampers, and large angles.
2. Every command equals the control law evaluated on the measurements of the run itself (`sim.observers.commands`). This covers
   sampling, delay, noise, quantisation, limits, and exported code.

Its trajectory then is that of the equations and the law. The distance from the linear response is a measurement, with a cause:
the integrator, geometry, noise, or an event that ends the linear regime.

Linear analysis applies to such a run because the equations are linear until that event, or nearly. `LinearComparison`
computes the distance only when it is needed, and the verdict does not need it.

A vehicle type that rotates and has no equations of motion is compared to first order: the same road is driven at `SMALL` of its
height, where the relative difference from the linear response must have fallen by the same factor.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from models.common.extensions import OBSERVERS
from models.document.document import Document
from models.document.text import ShownResult, facts
from models.kinds.kind import MOST_SQUEEZE
from models.roads.road import RoadInput
from models.vehicle.vehicle import Vehicle
from sim.drive.regime import AT, END_NAMES, FLAT, LIFT_OFF, REGIME_ENDS, end_times
from sim.drive.response import Response
from sim.linear.prediction import Prediction
from sim.linear.rounding import effect_on_states, roundings
from sim.observers.recorder import Recording, from_steady
from sim.observers.results import DIFFERENCE, WHEN, CommandAgreement, StepAgreement

if TYPE_CHECKING:
    from sim.runs.code_effect import CodeEffect

ROUNDING = 1e-9  # of a peak, over thousands of steps
COARSEST = 1e-2  # of a peak; where RK4's own error is larger, the timestep is too coarse for an accurate run
SMALL = 1e-2  # share of the road's height at which the effect of geometry has to vanish
NO_REFERENCE = "no linear analysis"
SLACK = 1.5  # factor on the predicted integrator error, which is a maximum over time of one of two nearly equal curves


@dataclass(frozen=True)
class SignalAgreement:
    """Difference of one signal of the physics from linear analysis, while that applies.

    Attributes:
        sampled: largest difference from the exact sampled response, over that response's peak; NaN without such a response.
        continuous: difference from the continuous closed loop, including the effect of holding the force over a step; likewise.
        allowed: bound on `sampled` by RK4's own error and rounding; NaN where the difference is a measurement alone.
        scale: scale of these differences, in the signal's unit.
        small: `sampled` over the same road at `SMALL` of its height, or None if it was not needed.
    """

    sampled: float
    continuous: float
    allowed: float
    scale: float
    small: float | None = None

    @property
    def excess(self) -> float:
        """Returns the difference over its allowed value: at `SMALL` of the height if the run was repeated there."""
        if self.small is None:
            return self.sampled / self.allowed
        return self.small / (SLACK * SMALL * self.sampled + self.allowed)

    @property
    def agrees(self) -> bool:
        """Returns True if the difference is allowed, or a measurement alone."""
        return not self.excess > 1


@dataclass(frozen=True, eq=False)
class LinearComparison:
    """Differences of a run from its linear responses, while linear analysis applies.

    Attributes:
        prediction: linear responses of the run.
        physics: response of MuJoCo.
        until: time before which linear analysis applies [s]; infinite for all of the run.
        small: response of MuJoCo over `SMALL` of the road's height, to which the linear responses are proportional; None without.
    """

    prediction: Prediction
    physics: Response
    until: float
    small: Response | None = None

    @property
    def cause(self) -> str:
        """Largest cause of the differences, in words."""
        own = "rounding" if self.prediction.vehicle.parts.nonlinear and self.prediction.is_linear else "RK4's own error"
        return self.prediction.cause or own

    @cached_property
    @np.errstate(over="ignore", invalid="ignore")  # of an unstable loop
    def signals(self) -> Mapping[str, SignalAgreement]:
        """Differences of each output signal, by name."""
        prediction, signals = self.prediction, dict[str, SignalAgreement]()
        responses = (self.physics, prediction.sampled, prediction.continuous)
        physics, sampled, continuous = (one.until(self.until) for one in responses)
        linear = not prediction.cause and prediction.radius <= 1
        for name, rounded in roundings(prediction.vehicle, prediction.controller).items():
            scale = _scale(sampled if prediction.is_linear else physics, name)
            allowed = SLACK * self._own_errors[name] + ROUNDING + rounded / scale if linear else math.nan
            apart = _difference(physics, sampled, name), _difference(physics, continuous, name)
            signals[name] = SignalAgreement(*apart, allowed, scale)
        return signals if self.small is None else self._to_first_order(signals, sampled, self.small.until(self.until))

    @property
    def agrees(self) -> bool:
        """Returns False if an exactly linear run leaves its sampled response by more than RK4 does, else True."""
        return all(signal.agrees for signal in self.signals.values())

    @property
    def coarse(self) -> bool:
        """Returns True if RK4's own error on the linear response is larger than `COARSEST`."""
        rate, prediction = effect_on_states(self.prediction.vehicle)[0], self.prediction
        # RK4 turns exp(z) into a polynomial that differs by z^5 / 120, at each of the steps. Sharp knots may make more.
        most = rate * float(prediction.time[-1]) * (rate * prediction.timestep) ** 4 / 120
        doubtful = most > COARSEST / 4 or prediction.vehicle.parts.nonlinear
        return doubtful and any(error > COARSEST for error in self._own_errors.values())

    @cached_property
    @np.errstate(over="ignore", invalid="ignore")  # of an unstable loop
    def _own_errors(self) -> dict[str, float]:
        """Returns RK4's own error of each signal, over the peak of the response without that error."""
        exact = self.prediction.sampled if self.prediction.finer is None else self.prediction.finer
        integrated, exact = self.prediction.integrated.until(self.until), exact.until(self.until)
        return {name: _difference(integrated, exact, name) for name in self.prediction.vehicle.linear_model.outputs}

    def _to_first_order(
        self, signals: Mapping[str, SignalAgreement], sampled: Response, physics: Response
    ) -> dict[str, SignalAgreement]:
        """Adds the differences at `SMALL` of the road's height, for a vehicle type that rotates without equations of motion."""
        smaller = Response(sampled.time, sampled.signals, SMALL * sampled.values)
        rounding, done = roundings(self.prediction.vehicle, None), dict[str, SignalAgreement]()
        for name, signal in signals.items():
            allowed = SLACK * self._own_errors[name] + ROUNDING + rounding[name] / _scale(smaller, name)
            done[name] = replace(signal, small=_difference(physics, smaller, name), allowed=allowed)
        return done


@dataclass(frozen=True, repr=False)
class Agreement(ShownResult):
    """The verdict on one run.

    Attributes:
        lift_off: intervals [s] in which a tyre is off the ground.
        end_times: time of the first of each of `REGIME_ENDS` [s], by name; infinite if it does not happen.
        linear: differences from linear analysis, while that applies.
        steps: steps against the vehicle's exact equations, also after `until`; None if they are not known.
        commands: commands against the control law; None if they are not known, as in the log of a law in Python.
        code_effect: difference of exported code from the law, which must be small; None without such code.
    """

    lift_off: tuple[tuple[float, float], ...]
    end_times: Mapping[str, float]
    linear: LinearComparison
    steps: StepAgreement | None = None
    commands: CommandAgreement | None = None
    code_effect: "CodeEffect | None" = None

    @property
    def summary(self) -> Document:
        """Returns whether the run agrees, what ended the linear regime, and each signal's largest difference, as text."""
        ended = {name: f"at {WHEN.text(at)}" for name, at in self.end_times.items() if math.isfinite(at)}
        signals = {name: f"{DIFFERENCE.cell(signal.sampled)} of its peak" for name, signal in self.signals.items()}
        return facts(f"agreement: {'agrees with the model' if self.agrees else 'DOES NOT AGREE'}", ended | signals)

    @property
    def signals(self) -> Mapping[str, SignalAgreement]:
        """Differences of each output signal from linear analysis, by name."""
        return self.linear.signals

    @property
    def until(self) -> float:
        """Time before which linear analysis applies [s]; infinite for all of the run."""
        return self.linear.until

    @property
    def cause(self) -> str:
        """Largest cause of the differences from linear analysis, in words."""
        return self.linear.cause

    @property
    def coarse(self) -> bool:
        """Returns True if the timestep is too coarse for accurate numbers, by RK4's own error on the linear response."""
        return self.linear.coarse

    @property
    def agrees(self) -> bool:
        """Returns True if every step and every command is right, as far as they are known, and nothing contradicts them."""
        checked = self.until > 0 or (self.steps is not None and self.steps.until > 0)
        checks = (self.steps, self.commands, self.code_effect)
        return checked and self.follows_linear and all(one is None or one.agrees for one in checks)

    @property
    def follows_linear(self) -> bool:
        """Returns False if a run whose steps cannot be checked leaves its linear response, else True."""
        return self.steps is not None or self.linear.agrees

    @property
    def equations_invalid(self) -> bool:
        """Returns True if the comparison ends because the vehicle's exact equations do not take the state of physics."""
        return self.steps is not None and self.steps.equations_invalid and self.steps.until == self.until


def compare(prediction: Prediction, recording: Recording, code_effect: "CodeEffect | None" = None) -> Agreement:
    """Returns the verdict on one run of MuJoCo.

    Args:
        prediction: linear responses of the run.
        recording: the run.
        code_effect: difference of exported code from the law, or None without such code.
    """
    vehicle, road, physics, diverged = prediction.vehicle, prediction.input, recording.response, recording.diverged
    ended = dict(zip(END_NAMES, end_times(vehicle, physics, prediction.controller.has_anti_windup).tolist(), strict=True))
    loose = first_loose(road, physics)
    until = min(*(ended[end.name] for end in REGIME_ENDS if not end.exact), loose, diverged)
    # A loop that grows threefold in a step passes through the road and back within a step, as the predicted deflections show.
    if prediction.is_linear and _passes_through(vehicle, physics):
        foretold = dict(zip(END_NAMES, end_times(vehicle, prediction.sampled).tolist(), strict=True))[FLAT.name]
        if foretold < until:
            ended[FLAT.name] = until = foretold
    rounding, steps, commands = roundings(vehicle, prediction.controller), None, None
    if (compare_steps := OBSERVERS.load_if_known("steps")) is not None:
        end = min(ended[FLAT.name], diverged)
        if vehicle.kind.motion is None:  # its linear model holds only while all tyres are on the road
            end = min(end, ended[LIFT_OFF.name], loose)
        steps = compare_steps(road, recording, end, rounding)
        if steps is not None and steps.equations_invalid:
            until = min(until, steps.until)
    if not prediction.replayed and (compare_commands := OBSERVERS.load_if_known("commands")) is not None:
        commands = compare_commands(prediction.controller, road, recording)
    linear = LinearComparison(prediction, physics, until)
    return Agreement(lift_off_intervals(vehicle, physics), ended, linear, steps, commands, code_effect)


def _passes_through(vehicle: Vehicle, physics: Response) -> bool:
    """Returns True if a tyre reads so long or short that a hub may have been through the road between two samples."""
    return any(np.abs(physics[wheel.tyre_deflection]).max(initial=0.0) > MOST_SQUEEZE / 2 for wheel in vehicle.kind.wheels)


def lift_off_intervals(vehicle: Vehicle, physics: Response) -> tuple[tuple[float, float], ...]:
    """Returns the intervals in which any tyre is off the ground: first and last sample [s], in order of their start."""
    intervals = []
    for limit in LIFT_OFF.thresholds(vehicle):
        off = np.concatenate([[False], limit.towards(limit.of(physics)) >= AT * limit.value, [False]])
        starts, ends = np.flatnonzero(off[1:] & ~off[:-1]), np.flatnonzero(off[:-1] & ~off[1:]) - 1
        intervals += [(float(physics.time[a]), float(physics.time[b])) for a, b in zip(starts, ends, strict=True)]
    return tuple(sorted(intervals))


def first_loose(met: RoadInput, physics: Response) -> float:
    """Returns the first sample [s] before which a tyre may have been off the ground within a step; infinite without one.

    MuJoCo holds the road at one height over a step, so within it a tyre is shorter or longer than at the samples. The
    curvature of a hub's path within a step, as RK4's stages see it, is bounded by its second difference.
    """
    vehicle, first, physics = met.vehicle, np.inf, from_steady(met, physics)
    static = vehicle.kind.static_tyre_deflection(vehicle.parameters)
    damped = vehicle.kind.damped_tyres(vehicle.parameters)
    for i, (wheel, held) in enumerate(zip(vehicle.kind.wheels, met.midway.T, strict=True)):
        hub = physics[wheel.tyre_deflection] + physics[wheel.road_displacement]
        if (tyre := damped.get(wheel.tyre_deflection)) is not None:
            hub = hub + tyre.time * physics[tyre.hub]
            held = held + tyre.time * met.held_velocities[:, i]
        bend = np.abs(np.diff(hub, n=2, prepend=hub[0]))
        longest = np.maximum(hub[:-1], hub[1:]) - held[: len(hub) - 1] + bend
        loose = longest >= static[wheel.tyre_deflection]
        if loose.any():
            first = min(first, float(physics.time[1 + loose.argmax()]))
    return first


def _difference(response: Response, reference: Response, signal: str) -> float:
    """Returns the largest difference over time, over the reference's scale; 0 if neither ever moves, NaN without a reference."""
    if len(response.time) == 0:
        return 0.0
    difference = float(np.max(np.abs(response[signal] - reference[signal])))
    return difference / _scale(reference, signal)


def _scale(reference: Response, signal: str) -> float:
    """Returns the scale of a signal's differences: the reference's scale, or 1 in its unit if nothing ever moves."""
    return (reference.scale(signal) if len(reference.time) else 0.0) or 1.0
