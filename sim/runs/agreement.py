"""Verdict on a run: MuJoCo's steps are those of the vehicle's equations, and its commands are those of the control law.

A run agrees if two local checks hold:

1. Every MuJoCo step equals one RK4 step of the vehicle's exact nonlinear equations from the same state (`sim.runs.steps`). This
   covers lift-off, stops, characteristics, dampers, and large angles.
2. Every command equals the control law evaluated on the measurements of the run itself (`sim.runs.commands`). This covers
   sampling, delay, noise, quantisation, limits, and exported code.

Its trajectory then is that of the equations and the law. The distance from the linear response is a measurement, with a cause:
the integrator, geometry, noise, or an event that ends the linear regime.

One comparison with the linear response remains a check, for loops that are exactly linear until that event: MuJoCo must follow
the exact response of the sampled loop to within RK4's own error. RK4 is the matrix exponential's Taylor polynomial of degree 4.
With characteristics the response of the sampled loop is that of RK4, and RK4's own error is estimated (`SteppedRuns.finer`).

A vehicle type that rotates and has no equations of motion is compared to first order: the same road is driven at `SMALL` of its
height, where the relative difference from the linear response must have fallen by the same factor.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from models.document.document import Document
from models.document.text import Shown, facts
from models.roads.road import RoadInput
from models.vehicle.vehicle import Vehicle
from sim.linear.sampled_response import roundings
from sim.physics.simulate import Commanded
from sim.response.regime import AT, END_NAMES, FLAT, LIFT_OFF, REGIME_ENDS, reached
from sim.response.response import Response
from sim.runs.code_effect import CodeEffect
from sim.runs.commands import CommandAgreement, compare_commands
from sim.runs.prediction import Prediction
from sim.runs.steps import DIFFERENCE, WHEN, StepAgreement, compare_steps, from_steady, motion_of

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


@dataclass(frozen=True, repr=False)
class Agreement(Shown):
    """The verdict on one run.

    Attributes:
        signals: differences of each output signal from linear analysis, by name.
        lift_off: intervals [s] in which a tyre is off the ground.
        ended: time of the first of each of `REGIME_ENDS` [s], by name; infinite if it does not happen.
        until: time before which linear analysis applies [s]; infinite for all of the run.
        cause: largest cause of the differences from linear analysis, in words.
        steps: steps against the vehicle's exact equations, also after `until`; None for a vehicle type without them.
        commands: commands against the control law; None if they are not known, as in the log of a law in Python.
        code_effect: difference of exported code from the law, which must be small; None without such code.
        coarse: True if RK4's own error on the linear response is larger than `COARSEST`.
    """

    signals: Mapping[str, SignalAgreement]
    lift_off: tuple[tuple[float, float], ...]
    ended: Mapping[str, float]
    until: float
    cause: str
    steps: StepAgreement | None = None
    commands: CommandAgreement | None = None
    code_effect: CodeEffect | None = None
    coarse: bool = False

    @property
    def shown(self) -> Document:
        """Returns whether the run agrees, what ended the linear regime, and each signal's largest difference, as text."""
        ended = {name: f"at {WHEN.text(at)}" for name, at in self.ended.items() if math.isfinite(at)}
        signals = {name: f"{DIFFERENCE.cell(signal.sampled)} of its peak" for name, signal in self.signals.items()}
        return facts(f"agreement: {'agrees with the model' if self.agrees else 'DOES NOT AGREE'}", ended | signals)

    @property
    def agrees(self) -> bool:
        """Returns True if every step and every command is right, as far as they are known, and nothing contradicts them."""
        checked = self.until > 0 or (self.steps is not None and self.steps.until > 0)
        checks = (self.steps, self.commands, self.code_effect)
        return checked and self.follows_linear and all(one is None or one.agrees for one in checks)

    @property
    def follows_linear(self) -> bool:
        """Returns False if an exactly linear run leaves its sampled response by more than RK4 does, else True."""
        return all(signal.agrees for signal in self.signals.values())

    @property
    def lost(self) -> bool:
        """Returns True if the comparison ends because the vehicle's exact equations do not take the state of physics."""
        return self.steps is not None and self.steps.lost and self.steps.until == self.until


def compare(prediction: Prediction, physics: Response, commanded: Commanded | None = None) -> Agreement:
    """Returns the verdict on one run of MuJoCo.

    Args:
        prediction: linear responses of the run.
        commanded: measurements and commands of its controller; None if they are unknown, which leaves linear analysis alone.
    """
    vehicle, road, diverged = prediction.vehicle, prediction.input, physics.diverged
    sampled, continuous = prediction.sampled, prediction.continuous
    ended = dict(zip(END_NAMES, reached(vehicle, physics, prediction.controller.has_anti_windup).tolist(), strict=True))
    loose = first_loose(road, physics)
    until = min(*(ended[end.name] for end in REGIME_ENDS if not end.exact), loose, diverged)
    # A loop that grows threefold in a step passes through the road and back within a step, as the predicted deflections show.
    if prediction.is_linear:
        foretold = dict(zip(END_NAMES, reached(vehicle, sampled).tolist(), strict=True))[FLAT.name]
        if foretold < until:
            ended[FLAT.name] = until = foretold
    lift_off = lift_off_intervals(vehicle, physics)
    rounding, steps, commands = roundings(vehicle, prediction.controller), None, None
    if commanded is not None:
        if (motion := motion_of(vehicle)) is not None:
            end = min(ended[FLAT.name], diverged)
            if vehicle.kind.motion is None:  # its linear model holds only while all tyres are on the road
                end = min(end, ended[LIFT_OFF.name], loose)
            steps = compare_steps(motion, road, physics, commanded, end, rounding)
            if steps.lost:
                until = min(until, steps.until)
        if not prediction.replayed:
            commands = compare_commands(prediction.controller, road, from_steady(road, physics), commanded, diverged)
    physics, sampled, continuous = (r.until(until) for r in (physics, sampled, continuous))
    own_errors = _own_errors(prediction, until, rounding)
    cause, signals, coarse = prediction.cause, {}, False
    for name, rounded in rounding.items():
        scale = _scale(sampled if prediction.is_linear else physics, name)
        own = own_errors[name]
        coarse |= own > COARSEST
        allowed = SLACK * own + ROUNDING + rounded / scale if not cause and prediction.radius <= 1 else math.nan
        signals[name] = SignalAgreement(
            _difference(physics, sampled, name), _difference(physics, continuous, name), allowed, scale
        )
    return Agreement(
        signals,
        lift_off,
        ended,
        until,
        cause or ("RK4's own error" if prediction.finer is None else "rounding"),
        steps=steps,
        commands=commands,
        code_effect=prediction.code_effect,
        coarse=coarse,
    )


def to_first_order(agreement: Agreement, prediction: Prediction, physics: Response) -> Agreement:
    """Adds the differences at `SMALL` of the road's height, for a vehicle type that rotates without equations of motion.

    Args:
        prediction: prediction of the run over the whole road, to which the linear responses are proportional.
        physics: response of MuJoCo over `SMALL` of it.
    """
    physics, sampled = (one.until(agreement.until) for one in (physics, prediction.sampled))
    smaller, rounding = Response(sampled.time, sampled.signals, SMALL * sampled.values), roundings(prediction.vehicle, None)
    own_errors, signals = _own_errors(prediction, agreement.until, agreement.signals), {}
    for name, signal in agreement.signals.items():
        scale = _scale(smaller, name)
        allowed = SLACK * own_errors[name] + ROUNDING + rounding[name] / scale
        signals[name] = replace(signal, small=_difference(physics, smaller, name), allowed=allowed)
    return replace(agreement, signals=signals)


def _own_errors(prediction: Prediction, until: float, names: Iterable[str]) -> dict[str, float]:
    """Returns RK4's own error of each signal before a time [s], over the peak of the response without that error."""
    exact = prediction.sampled if prediction.finer is None else prediction.finer
    integrated, exact = prediction.integrated.until(until), exact.until(until)
    return {name: _difference(integrated, exact, name) for name in names}


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
