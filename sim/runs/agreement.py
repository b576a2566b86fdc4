"""Verdict on a run: do the steps of MuJoCo follow the vehicle's equations, and do the commands follow the control law?

A run agrees with the model if two local checks hold:

1. Every MuJoCo step equals one RK4 step of the vehicle's exact nonlinear equations that starts in the same state
   (`sim.observers.steps`). The check of steps includes lift-off, stops, characteristics, dampers and large angles.
2. Every command equals the command of the control law for the measurements of the run (`sim.observers.commands`). The check of
   commands includes sampling, delay, noise, quantisation, limits and exported code.

If both checks hold, the trajectory is a solution of the equations of motion and the control law. The difference from the linear
response is then a result, not an error. This difference is caused by the integrator, geometry, noise, or an event that ends the
linear regime.

Linear analysis applies to a run until such an event, because the equations are linear, or nearly linear, until then.
`LinearComparison` computes the difference from the linear response only if the difference is needed. The verdict does not
depend on the difference from the linear response.

For a vehicle type with rotating bodies but without equations of motion, only the linear (first-order) behaviour is checked. The
run is repeated on the same road with all heights multiplied by `SMALL`, and compared with linear analysis. The relative
difference from the linear response must then be smaller by the factor `SMALL`.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
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

ROUNDING = 1e-9  # largest rounding error of a signal after thousands of steps, relative to the signal's peak
# largest error of RK4 in an accurate run, relative to a signal's peak; if the error is larger, the time step is too coarse
COARSEST = 1e-2
SMALL = 1e-2  # factor for the road height; on a road that is this low, nonlinear geometry must have no effect
NO_REFERENCE = "no linear analysis"
# Factor that multiplies the predicted error of the integrator, because the prediction is a maximum over time for one of two
# nearly equal curves
SLACK = 1.5


@dataclass(frozen=True)
class SignalAgreement:
    """Difference between one simulated signal and linear analysis, as long as linear analysis applies.

    Attributes:
        sampled: largest difference from the exact sampled response, relative to the peak of the sampled response; NaN if there
            is no sampled response.
        continuous: largest difference from the response of the continuous closed loop, relative to the peak of this response;
            NaN if there is no such response. The difference is partly due to the force, which is constant during each step.
        allowed: bound on `sampled` that allows for the error of RK4 and for rounding; NaN if the difference has no bound.
        scale: value by which the differences are divided [unit of the signal].
        small: value of `sampled` for the same road with all heights multiplied by `SMALL`; None if this value was not needed.
    """

    sampled: float
    continuous: float
    allowed: float
    scale: float
    small: float | None = None

    @property
    def excess(self) -> float:
        """Difference from linear analysis, divided by the allowed difference. If the run was repeated on a lower road
        (`SMALL`), the difference on the lower road is used.
        """
        if self.small is None:
            return self.sampled / self.allowed
        return self.small / (SLACK * SMALL * self.sampled + self.allowed)

    @property
    def agrees(self) -> bool:
        """True if the difference from linear analysis does not exceed its bound, or if there is no bound."""
        return not self.excess > 1


@dataclass(frozen=True, eq=False)
class LinearComparison:
    """Differences between a simulated run and the linear responses, as long as linear analysis applies.

    Attributes:
        prediction: linear responses of the run.
        physics: response that MuJoCo simulates.
        until: time until which linear analysis applies [s]; infinite if linear analysis applies to the whole run.
        small: simulated response on the same road with all heights multiplied by `SMALL`; None if this response was not
            simulated. The linear responses are proportional to the road height.
    """

    prediction: Prediction
    physics: Response
    until: float
    small: Response | None = None

    @property
    def cause(self) -> str:
        """Text that states the main cause of the differences from linear analysis."""
        own = "rounding" if self.prediction.vehicle.parts.nonlinear and self.prediction.is_linear else "RK4's own error"
        return self.prediction.cause or own

    @cached_property
    @np.errstate(over="ignore", invalid="ignore")  # signals of an unstable loop may overflow
    def signals(self) -> Mapping[str, SignalAgreement]:
        """Differences of each output signal from linear analysis, by name."""
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
        """False if the run should be exactly linear, but a difference exceeds the error of RK4; otherwise True."""
        return all(signal.agrees for signal in self.signals.values())

    @property
    def coarse(self) -> bool:
        """True if the error of RK4 in the linear response exceeds `COARSEST`."""
        rate, prediction = effect_on_states(self.prediction.vehicle)[0], self.prediction
        # With z = eigenvalue times step, RK4 replaces exp(z) in each step by a polynomial, whose error is about z^5 / 120.
        # Sharp knots of characteristics may increase this error.
        most = rate * float(prediction.time[-1]) * (rate * prediction.timestep) ** 4 / 120
        doubtful = most > COARSEST / 4 or prediction.vehicle.parts.nonlinear
        return doubtful and any(error > COARSEST for error in self._own_errors.values())

    @cached_property
    @np.errstate(over="ignore", invalid="ignore")  # signals of an unstable loop may overflow
    def _own_errors(self) -> dict[str, float]:
        """Error of RK4 in each signal, relative to the signal's peak in the response without this error."""
        exact = self.prediction.sampled if self.prediction.finer is None else self.prediction.finer
        integrated, exact = self.prediction.integrated.until(self.until), exact.until(self.until)
        return {name: _difference(integrated, exact, name) for name in self.prediction.vehicle.linear_model.outputs}

    def _to_first_order(
        self, signals: Mapping[str, SignalAgreement], sampled: Response, physics: Response
    ) -> dict[str, SignalAgreement]:
        """Adds the differences on the lower road (`SMALL`), for a vehicle type with rotating bodies but without equations of
        motion.
        """
        smaller = Response(sampled.time, sampled.signals, SMALL * sampled.values)
        rounding, done = roundings(self.prediction.vehicle, None), dict[str, SignalAgreement]()
        for name, signal in signals.items():
            allowed = SLACK * self._own_errors[name] + ROUNDING + rounding[name] / _scale(smaller, name)
            done[name] = replace(signal, small=_difference(physics, smaller, name), allowed=allowed)
        return done


@dataclass(frozen=True, eq=False, repr=False)
class Agreement(LinearComparison, ShownResult):
    """Verdict on one run: differences from linear analysis, as long as linear analysis applies, and checks of steps and
    commands.

    Attributes:
        lift_off: time intervals in which at least one tyre is off the ground, each as (start, end) [s].
        end_times: first time of each of `REGIME_ENDS` [s], by name; infinite for an end that does not occur.
        steps: comparison of all steps, including those after `until`, with the vehicle's exact equations of motion; None if
            these equations are unknown.
        commands: comparison of the commands with the control law; None if the law is unknown, as in the log of a Python control
            law.
        code_effect: effect of exported code on the run, which must be small; None if there is no exported code.
    """

    lift_off: tuple[tuple[float, float], ...] = ()
    end_times: Mapping[str, float] = field(default_factory=dict[str, float])
    steps: StepAgreement | None = None
    commands: CommandAgreement | None = None
    code_effect: "CodeEffect | None" = None

    @property
    def summary(self) -> Document:
        """Document that contains the verdict, the ends of the linear regime, and the largest difference of each signal."""
        ended = {name: f"at {WHEN.text(at)}" for name, at in self.end_times.items() if math.isfinite(at)}
        signals = {name: f"{DIFFERENCE.cell(signal.sampled)} of its peak" for name, signal in self.signals.items()}
        return facts(f"agreement: {'agrees with the model' if self.agrees else 'DOES NOT AGREE'}", ended | signals)

    @property
    def agrees(self) -> bool:
        """True if all checks of steps and commands that were made hold, and at least one comparison was made."""
        checked = self.until > 0 or (self.steps is not None and self.steps.until > 0)
        checks = (self.steps, self.commands, self.code_effect)
        return checked and self.follows_linear and all(one is None or one.agrees for one in checks)

    @property
    def follows_linear(self) -> bool:
        """False if the steps of a run cannot be checked and the run differs from the linear response; otherwise True."""
        return self.steps is not None or super().agrees

    @property
    def equations_invalid(self) -> bool:
        """True if the comparison ends because the vehicle's exact equations are not valid for the simulated state."""
        return self.steps is not None and self.steps.equations_invalid and self.steps.until == self.until


def compare(prediction: Prediction, recording: Recording, code_effect: "CodeEffect | None" = None) -> Agreement:
    """Returns the verdict on one MuJoCo run.

    Args:
        prediction: linear responses of the run.
        recording: recording of the run.
        code_effect: effect of exported code on the run; None if there is no exported code.
    """
    vehicle, road, physics, diverged = prediction.vehicle, prediction.input, recording.response, recording.diverged
    ended = dict(zip(END_NAMES, end_times(vehicle, physics, prediction.controller.has_anti_windup).tolist(), strict=True))
    loose = first_loose(road, physics)
    until = min(*(ended[end.name] for end in REGIME_ENDS if not end.exact), loose, diverged)
    # If an unstable loop's motion triples in every step, a hub may pass through the road and back within a step. The predicted
    # deflections show whether this happens.
    if prediction.is_linear and _passes_through(vehicle, physics):
        foretold = dict(zip(END_NAMES, end_times(vehicle, prediction.sampled).tolist(), strict=True))[FLAT.name]
        if foretold < until:
            ended[FLAT.name] = until = foretold
    rounding, steps, commands = roundings(vehicle, prediction.controller), None, None
    if (compare_steps := OBSERVERS.load_if_known("steps")) is not None:
        end = min(ended[FLAT.name], diverged)
        # without equations of motion, the linear model of a vehicle type is valid only while all tyres are in contact
        if vehicle.kind.motion is None:
            end = min(end, ended[LIFT_OFF.name], loose)
        steps = compare_steps(road, recording, end, rounding)
        if steps is not None and steps.equations_invalid:
            until = min(until, steps.until)
    if not prediction.replayed and (compare_commands := OBSERVERS.load_if_known("commands")) is not None:
        commands = compare_commands(prediction.controller, road, recording)
    lifted = lift_off_intervals(vehicle, physics)
    return Agreement(prediction, physics, until, None, lifted, ended, steps, commands, code_effect)


def _passes_through(vehicle: Vehicle, physics: Response) -> bool:
    """Returns True if a tyre is so long or so short at a sample that the hub may have passed through the road between two
    samples.
    """
    return any(np.abs(physics[wheel.tyre_deflection]).max(initial=0.0) > MOST_SQUEEZE / 2 for wheel in vehicle.kind.wheels)


def lift_off_intervals(vehicle: Vehicle, physics: Response) -> tuple[tuple[float, float], ...]:
    """Returns the time intervals in which a tyre is off the ground, in order, each as the times of the first and last sample
    [s].
    """
    intervals = []
    for limit in LIFT_OFF.thresholds(vehicle):
        off = np.concatenate([[False], limit.towards(limit.of(physics)) >= AT * limit.value, [False]])
        starts, ends = np.flatnonzero(off[1:] & ~off[:-1]), np.flatnonzero(off[:-1] & ~off[1:]) - 1
        intervals += [(float(physics.time[a]), float(physics.time[b])) for a, b in zip(starts, ends, strict=True)]
    return tuple(sorted(intervals))


def first_loose(met: RoadInput, physics: Response) -> float:
    """Returns the end of the first step within which a tyre may have been off the ground [s]; infinity if there is no such
    step.

    In MuJoCo, the road height is constant during a step. Within a step, a tyre may therefore be shorter or longer than at the
    samples. The curvature of a hub's path within a step, as the stages of RK4 evaluate it, is bounded by the second difference
    of the path.
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
    """Returns a signal's largest difference between two responses over time, relative to the reference's scale; 0 if nothing
    moves, NaN if the reference is NaN.
    """
    if len(response.time) == 0:
        return 0.0
    difference = float(np.max(np.abs(response[signal] - reference[signal])))
    return difference / _scale(reference, signal)


def _scale(reference: Response, signal: str) -> float:
    """Returns the value by which differences of a signal are divided: the scale of the reference, or 1 if nothing moves."""
    return (reference.scale(signal) if len(reference.time) else 0.0) or 1.0
