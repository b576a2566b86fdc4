"""Comparison of MuJoCo with linear analysis, signal by signal, while the linear analysis applies.

The reference is the exact response of the sampled loop. MuJoCo integrates with RK4, whose error on a linear system is known: RK4
is the Taylor polynomial of degree 4 of the matrix exponential. A run agrees if its difference from the reference does not exceed
this error.

Pitch and roll make a vehicle nonlinear, so its difference from the analysis grows with the amplitude. Two further checks separate
this geometric effect from errors of the model:

- Reduced height. The same road is driven at a hundredth of its height. The relative difference due to geometry falls at least by
  the same factor; that due to an error does not. If the difference is larger than expected, a run at half that height decides.
  Vehicles without such geometry (`models.vehicle.mjcf`), such as a quarter-car, do not get this allowance.
- Single steps. Each step of MuJoCo is compared with the vehicle's exact equations of motion (`sim.runs.steps`), also at large
  motions and after the linear regime ends. A vehicle type that rotates but has no such equations is driven at half and a quarter
  of the height instead. The two runs give two terms of a power series in the height, which predict the effect of geometry.

The integrator's relative error does not depend on the height, unless a curve has knots near rest. It is computed at both heights.

Rounding errors are relative to the weight and the lengths of the vehicle, not to the road. At a hundredth of the height they
count a hundred times as much. In an unstable loop they grow with time.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from models.common.arrays import Array
from models.common.printed import Shown
from models.roads.road import RoadInput
from models.vehicle.vehicle import Vehicle
from sim.linear.sampled_response import grown, roundings
from sim.response.regime import AT, END_NAMES, FLAT, LIFT_OFF, REGIME_ENDS, reached
from sim.response.response import Response
from sim.runs.code_effect import CodeEffect
from sim.runs.prediction import Prediction, ScaledPrediction
from sim.runs.steps import StepAgreement, compare_steps, from_steady, left_over, motion_of
from synth.controller.controller import Controller, has_anti_windup

ROUNDING = 1e-9  # of a peak, over thousands of steps
COARSEST = 1e-2  # of a peak; a larger difference confirms nothing, even if the integrator's own error is as large
SMALL = 1e-2  # share of the road's height at which the effect of geometry has to vanish
HALVED = SMALL / 2  # a further share, which tells the effect of geometry at `SMALL` from a mistake
PARTS = (0.5, 0.25)  # further shares of the height, from which the effect of geometry on the whole road is predicted
FORETOLD = 0.25  # of the effect of geometry: the neglected terms of higher order are smaller
SLACK = 1.5  # factor on the predicted integrator error, which is a maximum over time of one of two nearly equal curves


@dataclass(frozen=True)
class SignalAgreement:
    """Difference of one signal of the physics from its references, while the linear analysis applies.

    Attributes:
        sampled: largest difference from the exact sampled response, over that response's peak.
        continuous: difference from the continuous closed loop, including the effect of holding the force over a step.
        allowed: bound on `sampled` by the integrator's own error, no more than `COARSEST`, with noise and rounding.
        blur: part of `allowed` for noise and quantisation.
        rounding: part of `allowed` that does not depend on the road; see `sim.linear.sampled_response`.
        scale: scale of all these differences, in the signal's unit.
        geometry: value of `sampled` if physics differed from the linear analysis by geometry and the integrator's error alone,
            or None if `small` was not needed.
        foretold: largest difference of physics from RK4's linear response plus the effect of geometry that smaller heights
            predict, or None for a vehicle with exact equations.
        small: `sampled` over the same road at `SMALL` of its height, or None if it was not needed.
        allowed_small: `allowed` over that road, or None.
        small_geometry: effect of geometry there, found by halving that height. None if `SMALL` of `sampled` was enough, or if the
            difference does not vanish with the height.
    """

    sampled: float
    continuous: float
    allowed: float
    blur: float
    rounding: float
    scale: float
    small: float | None = None
    allowed_small: float | None = None
    small_geometry: float | None = None
    geometry: float | None = None
    foretold: float | None = None

    @property
    def judged(self) -> tuple[float, float]:
        """The deciding difference and its limit: `sampled`, or `small`, whose limit includes the remaining effect of geometry."""
        if self.small is None or self.allowed_small is None:
            return self.sampled, self.allowed
        geometry = SLACK * SMALL * self.sampled if self.small_geometry is None else SLACK * self.small_geometry
        return self.small, self.allowed_small + geometry

    @property
    def is_geometry(self) -> bool:
        """Returns True unless smaller heights predict another difference.

        With F = 6 f(1/2) - 8 f(1/4), noise is the same share n of every height, and leaves 3 n of f(1) - F. Rounding r is of no
        height, so that it may come to (1 + 12 + 32) r.
        """
        allowed = self.allowed + 2 * self.blur + 44 * self.rounding
        return self.foretold is None or self.foretold <= allowed + FORETOLD * self.sampled

    @property
    def excess(self) -> float:
        """Returns the judged difference over its allowed value."""
        difference, allowed = self.judged
        return difference / allowed

    @property
    def agrees(self) -> bool:
        """Returns True if the difference is the integrator's, or vanishes with the amplitude as an effect of geometry does."""
        return self.excess <= 1 and self.is_geometry


@dataclass(frozen=True, repr=False)
class Agreement(Shown):
    """The verdict on one run.

    Attributes:
        signals: agreement of each signal, by name.
        lift_off: intervals [s] in which a tyre is off the road.
        ended: time of the first of each of `REGIME_ENDS` [s], by name; infinite if it does not happen.
        until: time before which the comparison applies [s]; infinite for all of the run. An event that the exact response covers
            does not end it. A state that the vehicle's exact equations do not take does.
        blurred: True if measurements are noisy or quantised, or exported code rounds: then differences up to their spread are
            allowed.
        steps: single steps against the vehicle's exact equations, also after `until`; None for a kind without them.
        code_effect: difference of exported code from the law, which must be small; None without such code.
    """

    signals: Mapping[str, SignalAgreement]
    lift_off: tuple[tuple[float, float], ...]
    ended: Mapping[str, float]
    until: float
    blurred: bool = False
    steps: StepAgreement | None = None
    code_effect: CodeEffect | None = None

    @property
    def shown(self) -> tuple[str, dict[str, str]]:
        """Returns the verdict, and each signal's largest difference from the sampled response, as text."""
        ended = {name: f"at {at:.4g} s" for name, at in self.ended.items() if math.isfinite(at)}
        differences = {
            name: f"{signal.sampled:.1e} of its peak, {signal.allowed:.1e} allowed" for name, signal in self.signals.items()
        }
        return f"agreement: {self.verdict}", ended | differences

    @property
    def verdict(self) -> str:
        """The verdict on physics, and the time until which it holds, in words."""
        when = f"until {self.until:.4g} s" if math.isfinite(self.until) else "throughout"
        return f"{'agrees' if self.agrees else 'DOES NOT AGREE'} {when}"

    @property
    def agrees(self) -> bool:
        """Returns True if every signal agrees while the comparison applies, and every step; False if it never applies."""
        coded = self.code_effect is None or self.code_effect.holds
        return self.until > 0 and self.step_by_step and coded and all(signal.agrees for signal in self.signals.values())

    @property
    def lost(self) -> bool:
        """Returns True if the comparison ends because the vehicle's exact equations do not take the state of physics."""
        return self.steps is not None and self.steps.lost and self.steps.until == self.until

    @property
    def step_by_step(self) -> bool:
        """Returns False if a step differs from the vehicle's exact equations, else True."""
        return self.steps is None or self.steps.agrees


def compare(prediction: Prediction, physics: Response, requested_force: Array | None = None) -> Agreement:
    """Returns the comparison of one run of MuJoCo with its prediction.

    Args:
        requested_force: the controller's requests, see `PhysicsRuns`; None if they are not known.
    """
    vehicle, spread, diverged = prediction.vehicle, prediction.spread, physics.diverged
    sampled, integrated, continuous = prediction.sampled, prediction.integrated, prediction.continuous
    ended = dict(zip(END_NAMES, reached(vehicle, physics, has_anti_windup(prediction.controller)).tolist(), strict=True))
    until = min(*(ended[end.name] for end in REGIME_ENDS if not end.exact), _first_loose(prediction.input, physics), diverged)
    # A loop that grows threefold in a step passes through the road and back within a step, as the predicted deflections show.
    foretold = dict(zip(END_NAMES, reached(vehicle, sampled).tolist(), strict=True))[FLAT.name]
    if foretold < until:
        ended[FLAT.name] = until = foretold
    lift_off = lift_off_intervals(vehicle, physics)
    controller = prediction.controller if isinstance(prediction.controller, Controller) else None
    steps, rounding = None, roundings(vehicle, controller)
    if (motion := motion_of(vehicle)) is not None:
        end = steps_end(prediction.input, physics, ended)
        steps = compare_steps(motion, prediction.input, physics, requested_force, end, rounding)
        if steps.lost:  # what no step confirms is not called geometry
            until = min(until, steps.until)
    physics, sampled, integrated, continuous = (r.until(until) for r in (physics, sampled, integrated, continuous))
    signals = {}
    if prediction.loop is not None and prediction.radius > 1:
        rounding = grown(rounding, prediction.loop, len(physics.time))
    for name, rounded in rounding.items():
        scale = _scale(sampled, name)
        blur = float(spread[name][: len(physics.time)].max(initial=0.0)) if spread else 0.0
        signals[name] = SignalAgreement(
            sampled=_difference(physics, sampled, name),
            continuous=_difference(physics, continuous, name),
            allowed=_integrator(integrated, sampled, name) + (blur + rounded) / scale,
            blur=blur / scale,
            rounding=rounded / scale,
            scale=scale,
        )
    return Agreement(signals, lift_off, ended, until, blurred=bool(spread), steps=steps, code_effect=prediction.code_effect)


def steps_end(road: RoadInput, physics: Response, ended: Mapping[str, float]) -> float:
    """Returns the time [s] before which single steps are compared: until a tyre is flat, or the run diverges.

    A kind without equations of its own has those of its linear model, which hold only while all tyres are on the road.
    """
    end = min(ended[FLAT.name], physics.diverged)
    return end if road.vehicle.kind.motion is not None else min(end, ended[LIFT_OFF.name], _first_loose(road, physics))


def look_closer(agreement: Agreement, small: ScaledPrediction, physics: Response) -> Agreement:
    """Checks if the difference of a run that does not agree is due to geometry: then it vanishes with the amplitude.

    Args:
        small: prediction over the same road at `SMALL` of its height.
        physics: response of MuJoCo over that road.
    """
    # Over the same time as the comparison, as its limits are.
    physics, sampled = physics.until(agreement.until), small.sampled.until(agreement.until)
    integrated = None if small.integrated is None else small.integrated.until(agreement.until)
    signals = {}
    for name, signal in agreement.signals.items():
        if integrated is None:
            allowed = signal.allowed + (1 / SMALL - 1) * signal.rounding
        else:
            grown_by = signal.scale / _scale(sampled, name)
            allowed = _integrator(integrated, sampled, name) + grown_by * (SMALL * signal.blur + signal.rounding)
        signals[name] = replace(signal, small=_difference(physics, sampled, name), allowed_small=allowed)
    return replace(agreement, signals=signals)


def halve_geometry(
    agreement: Agreement, small: tuple[Response, ScaledPrediction], half: tuple[Response, ScaledPrediction]
) -> Agreement:
    """Adds the effect of geometry at `SMALL` of the height, if the relative difference from RK4 vanishes with the height.

    A difference a + g s at the share s of the height changes by g s / 2 at half of it. So twice the change is the effect of
    geometry, up to a share s of it. What is left at no height, twice the difference there less the one here, is a mistake: a, or
    more of an offset, which grows relative to a smaller motion.

    Args:
        small: response of MuJoCo and prediction at `SMALL` of the height.
        half: response and prediction at `HALVED` of the height.
    """
    (physics, known), (nearer, known_nearer), end = small, half, agreement.until
    signals = {}
    for name, signal in agreement.signals.items():
        scale = _scale(known.sampled.until(end), name)
        far, near = (
            (SMALL / share) * (of.until(end)[name] - (by.integrated or by.sampled).until(end)[name]) / scale
            for share, of, by in ((SMALL, physics, known), (HALVED, nearer, known_nearer))
        )
        geometry, mistake, most = (float(np.abs(each).max(initial=0.0)) for each in (2 * (far - near), 2 * near - far, far))
        if mistake <= (signal.allowed_small or 0.0) + FORETOLD * most:
            signal = replace(signal, small_geometry=geometry)
        signals[name] = signal
    return replace(agreement, signals=signals)


def with_geometry(agreement: Agreement, prediction: Prediction, physics: Response, requested_force: Array | None) -> Agreement:
    """Adds the effect of geometry by the vehicle's exact equations: all differences except those that single steps leave.

    Arguments as for `compare`.
    """
    motion, steps = motion_of(prediction.vehicle), agreement.steps
    if motion is None or steps is None:
        return agreement
    end = agreement.until
    more: Mapping[str, Array] = {}
    if not steps.agrees:
        more = left_over(motion, prediction.input, physics, requested_force, end)
    signals = {}
    for name, signal in agreement.signals.items():
        geometry = signal.sampled
        if name in more:
            far = physics[name][: len(more[name])] - prediction.sampled[name][: len(more[name])] - more[name]
            geometry = float(np.abs(far).max(initial=0.0)) / signal.scale
        signals[name] = replace(signal, geometry=geometry)
    return replace(agreement, signals=signals)


def foretell(
    agreement: Agreement,
    prediction: Prediction,
    physics: Response,
    parts: Sequence[tuple[Response, ScaledPrediction]],
) -> Agreement:
    """Adds the effect of geometry on the whole road as smaller heights predict it, to the third power of the height.

    That effect is what leaves RK4's own response: the integrator's error is the same share of every height, no power of it.

    Args:
        prediction: prediction over the whole road.
        physics: response of MuJoCo over it.
        parts: responses and predictions over `PARTS` of the height.
    """
    whole, end, signals = prediction.integrated, agreement.until, {}
    for name, signal in agreement.signals.items():
        far = (physics.until(end)[name] - whole.until(end)[name]) / signal.scale
        half, quarter = (
            (made.until(end)[name] - (known.integrated.until(end)[name] if known.integrated else share * whole.until(end)[name]))
            / (share * signal.scale)
            for share, (made, known) in zip(PARTS, parts, strict=True)
        )
        foretold = 6 * half - 8 * quarter
        integrator = (whole.until(end)[name] - prediction.sampled.until(end)[name]) / signal.scale
        signals[name] = replace(
            signal,
            geometry=float(np.abs(foretold + integrator).max(initial=0.0)),
            foretold=float(np.abs(far - foretold).max(initial=0.0)),
        )
    return replace(agreement, signals=signals)


def lift_off_intervals(vehicle: Vehicle, physics: Response) -> tuple[tuple[float, float], ...]:
    """Returns the intervals in which any tyre is off the road: first and last sample [s], in order of their start."""
    intervals = []
    for limit in LIFT_OFF.thresholds(vehicle):
        off = np.concatenate([[False], limit.towards(limit.of(physics)) >= AT * limit.value, [False]])
        starts, ends = np.flatnonzero(off[1:] & ~off[:-1]), np.flatnonzero(off[:-1] & ~off[1:]) - 1
        intervals += [(float(physics.time[a]), float(physics.time[b])) for a, b in zip(starts, ends, strict=True)]
    return tuple(sorted(intervals))


def _first_loose(met: RoadInput, physics: Response) -> float:
    """Returns the first sample [s] before which a tyre may have been off the road within a step; infinite without one.

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


def _integrator(integrated: Response, sampled: Response, signal: str) -> float:
    """Returns the bound on a signal's difference by the integrator's own error, over its scale."""
    return min(SLACK * _difference(integrated, sampled, signal) + ROUNDING, COARSEST)


def _difference(response: Response, reference: Response, signal: str) -> float:
    """Returns the largest difference over time, over the reference's scale; 0 if neither ever moves."""
    if len(response.time) == 0:
        return 0.0
    difference = float(np.max(np.abs(response[signal] - reference[signal])))
    return difference / _scale(reference, signal)


def _scale(reference: Response, signal: str) -> float:
    """Returns the scale of a signal's differences: the reference's scale, or 1 in its unit if nothing ever moves."""
    return (reference.scale(signal) if len(reference.time) else 0.0) or 1.0
