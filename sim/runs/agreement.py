"""Physics against analysis, signal by signal, and no further than the analysis applies.

The yardstick is the exact response of the sampled loop. MuJoCo's RK4 differs from it by the integrator's own error, and that is
known: on a linear system RK4 is the Taylor polynomial of degree 4, so its response can be computed without MuJoCo. Physics and
analysis agree where they differ by no more than that.

A body that pitches and rolls is not linear, and there physics leaves the analysis with the amplitude. Then the same road is
driven at a hundredth of its height: what is geometry has gone there, in proportion or faster, and what is wrong has not. A
vehicle that has no such geometry (`models.vehicle.mjcf`), as a quarter-car, is not excused by it. What the integrator makes of a
smaller motion is the same share of it where all is linear but geometry; where curves have knots near rest it may be a larger one,
and is computed there, too.

What is wrong at large motions alone has gone at a hundredth, too: a curve beyond its line, a bump stop. So every step has to be
that of the vehicle's exact equations (`sim.runs.steps`), on the whole road and also where the linear analysis does not apply. A
kind of vehicle that turns and gives no such equations is driven at a half and a quarter of the height instead. Two terms of a
power series in the height follow from these, and foretell what geometry makes of the whole road.

Rounding does not go with the road: it is that of the vehicle's weight and lengths, and beside a hundredth of the road it counts a
hundred times as much. An unstable loop makes more and more of it, as of everything.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from models.common.arrays import Array
from models.common.printed import Shown
from models.vehicle.vehicle import Vehicle
from sim.linear.sampled_response import grown, roundings
from sim.response.regime import AT, END_NAMES, FLAT, LIFT_OFF, REGIME_ENDS, reached
from sim.response.response import Response
from sim.runs.prediction import Prediction, ScaledPrediction
from sim.runs.steps import StepAgreement, compare_steps, left_over, motion_of
from synth.controller.controller import Controller

ROUNDING = 1e-9  # of a peak, over thousands of steps
COARSEST = 1e-2  # of a peak; physics that is further off confirms nothing, even if the integrator has to be
SMALL = 1e-2  # the share of the road's height at which geometry has to have gone
PARTS = (0.5, 0.25)  # further shares of the height, from which geometry on the whole road is foretold
FORETOLD = 0.25  # of what geometry makes: the terms of higher order that are left out make less
SLACK = 1.5  # on the predicted integrator error: it is a maximum over time of one of two nearly equal curves


@dataclass(frozen=True)
class SignalAgreement:
    """Difference of one signal of the physics from its references, over the time in which the linear analysis applies.

    Attributes:
        sampled: largest difference from the exact sampled response, over that response's peak.
        continuous: the same against the continuous closed loop; it contains the effect of holding the force over a step.
        allowed: bound on `sampled` by the integrator's own error, no more than `COARSEST`, with noise and rounding.
        blur: part of `allowed` by noise and quantisation.
        rounding: part of `allowed` that is as large over any road; see `sim.linear.sampled_response`.
        scale: of all these differences, in the signal's unit.
        geometry: what `sampled` would be if physics differed from the linear analysis by geometry alone, or None if `small` was
            not needed.
        foretold: largest difference of physics from the linear response with the geometry that smaller heights foretell, or
            None for a vehicle with exact equations.
        small: `sampled` over the same road at `SMALL` of its height, or None if it was not needed.
        allowed_small: `allowed` over that road, or None.
    """

    sampled: float
    continuous: float
    allowed: float
    blur: float
    rounding: float
    scale: float
    small: float | None = None
    allowed_small: float | None = None
    geometry: float | None = None
    foretold: float | None = None

    @property
    def judged(self) -> tuple[float, float]:
        """The difference that decides, and what is allowed of it: `sampled`, or `small` with what geometry has left there."""
        if self.small is None or self.allowed_small is None:
            return self.sampled, self.allowed
        return self.small, self.allowed_small + SLACK * SMALL * self.sampled

    @property
    def is_geometry(self) -> bool:
        """Returns True unless smaller heights foretell another difference."""
        return self.foretold is None or self.foretold <= self.allowed + FORETOLD * self.sampled

    @property
    def excess(self) -> float:
        """Returns the judged difference over its allowed value."""
        difference, allowed = self.judged
        return difference / allowed

    @property
    def agrees(self) -> bool:
        """Returns True if the difference is the integrator's, or vanishes with the amplitude as that of geometry does."""
        return self.excess <= 1 and self.is_geometry


@dataclass(frozen=True, repr=False)
class Agreement(Shown):
    """The verdict on one run.

    Attributes:
        signals: by name.
        lift_off: intervals [s] in which a tyre is off the road.
        ended: when each of `REGIME_ENDS` first happens [s], by name; infinite where it does not.
        until: the comparison applies before this time [s]; infinite where it always does. What the exact response goes on beyond
            does not end it.
        blurred: whether measurements are noisy or quantised: then the comparison is with their predicted spread.
        steps: single steps against the vehicle's exact equations, also after `until`; None for a kind without them.
    """

    signals: Mapping[str, SignalAgreement]
    lift_off: tuple[tuple[float, float], ...]
    ended: Mapping[str, float]
    until: float
    blurred: bool = False
    steps: StepAgreement | None = None

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
        """The verdict on physics, and until when it holds, in words."""
        when = f"until {self.until:.4g} s" if math.isfinite(self.until) else "throughout"
        return f"{'agrees' if self.agrees else 'DOES NOT AGREE'} {when}"

    @property
    def agrees(self) -> bool:
        """Returns True if every signal agrees while the comparison applies, and every step; False if it never applies."""
        return self.until > 0 and self.step_by_step and all(signal.agrees for signal in self.signals.values())

    @property
    def step_by_step(self) -> bool:
        """Returns True unless a step is not that of the vehicle's exact equations."""
        return self.steps is None or self.steps.agrees


def compare(prediction: Prediction, physics: Response, requested_force: Array | None = None) -> Agreement:
    """Compares what MuJoCo did in one run with its prediction.

    Args:
        requested_force: what its controller asked for, see `PhysicsRuns`; None if that is not known.
    """
    vehicle, spread, diverged = prediction.vehicle, prediction.spread, physics.diverged
    sampled, integrated, continuous = prediction.sampled, prediction.integrated, prediction.continuous
    ended = dict(zip(END_NAMES, reached(vehicle, physics).tolist(), strict=True))
    until = min(*(ended[end.name] for end in REGIME_ENDS if not end.exact), _first_loose(vehicle, physics), diverged)
    # A loop that grows threefold in a step is through the road and back within one, which the prediction's own squeeze shows.
    foretold = dict(zip(END_NAMES, reached(vehicle, sampled).tolist(), strict=True))[FLAT.name]
    if foretold < until:
        ended[FLAT.name] = until = foretold
    lift_off = lift_off_intervals(vehicle, physics)
    steps = None
    if (motion := motion_of(vehicle)) is not None:
        steps = compare_steps(motion, prediction.input, physics, requested_force, steps_end(vehicle, physics, ended))
    physics, sampled, integrated, continuous = (r.until(until) for r in (physics, sampled, integrated, continuous))
    signals = {}
    controller = prediction.controller if isinstance(prediction.controller, Controller) else None
    rounding = roundings(vehicle, controller)
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
    return Agreement(signals, lift_off, ended, until, blurred=bool(spread), steps=steps)


def steps_end(vehicle: Vehicle, physics: Response, ended: Mapping[str, float]) -> float:
    """Returns the time [s] before which single steps compare: until nothing of a vehicle is left.

    The equations of a kind that gives none but a linear model hold only while all tyres are on the road.
    """
    end = min(ended[FLAT.name], physics.diverged)
    return end if vehicle.kind.motion is not None else min(end, ended[LIFT_OFF.name], _first_loose(vehicle, physics))


def look_closer(agreement: Agreement, small: ScaledPrediction, physics: Response) -> Agreement:
    """Asks of a run that does not agree whether that is geometry: then it vanishes with the amplitude.

    Args:
        small: what is predicted over the same road at `SMALL` of its height.
        physics: what MuJoCo did over that.
    """
    # As long as the comparison is of: what is allowed is, too.
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


def with_geometry(agreement: Agreement, prediction: Prediction, physics: Response, requested_force: Array | None) -> Agreement:
    """Says what geometry makes by the vehicle's exact equations: all differences but those that single steps leave.

    Arguments as for `compare`.
    """
    motion, steps = motion_of(prediction.vehicle), agreement.steps
    if motion is None or steps is None:
        return agreement
    end = agreement.until
    more: Mapping[str, Array] = {}
    if not steps.agrees:
        more = left_over(motion, prediction.input, physics, requested_force, min(end, steps.until))
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
    whole: tuple[Response, Response],
    parts: Sequence[tuple[Response, Response]],
) -> Agreement:
    """Says what geometry makes of the whole road by what it makes of smaller ones, to the third power of the height.

    Args:
        whole: physics and exact response over the whole road.
        parts: the same over `PARTS` of its height.
    """
    signals = {}
    for name, signal in agreement.signals.items():
        far, half, quarter = (
            (physics.until(agreement.until)[name] - sampled.until(agreement.until)[name]) / (share * signal.scale)
            for share, (physics, sampled) in zip((1.0, *PARTS), (whole, *parts), strict=True)
        )
        foretold = 6 * half - 8 * quarter
        signals[name] = replace(
            signal,
            geometry=float(np.abs(foretold).max(initial=0.0)),
            foretold=float(np.abs(far - foretold).max(initial=0.0)),
        )
    return replace(agreement, signals=signals)


def lift_off_intervals(vehicle: Vehicle, physics: Response) -> tuple[tuple[float, float], ...]:
    """When any tyre is off the road: first and last sample of every interval [s], in order of their start."""
    intervals = []
    for limit in LIFT_OFF.thresholds(vehicle):
        off = np.concatenate([[False], limit.towards(physics[limit.signal]) >= AT * limit.value, [False]])
        starts, ends = np.flatnonzero(off[1:] & ~off[:-1]), np.flatnonzero(off[:-1] & ~off[1:]) - 1
        intervals += [(float(physics.time[a]), float(physics.time[b])) for a, b in zip(starts, ends, strict=True)]
    return tuple(sorted(intervals))


def _first_loose(vehicle: Vehicle, physics: Response) -> float:
    """First sample [s] before which a tyre may have been off the road within a step; infinite where none may have been.

    MuJoCo holds the road at its middle over a step, so there a tyre is shorter or longer than at the samples. What paths bend
    within a step, and RK4's stages probe of it, is within their second differences.
    """
    static, first = vehicle.kind.static_tyre_deflection(vehicle.parameters), np.inf
    for wheel in vehicle.kind.wheels:
        road = physics[wheel.road_displacement]
        hub = physics[wheel.tyre_deflection] + road
        held = (road[:-1] + road[1:]) / 2
        hub_bend, road_bend = (np.abs(np.diff(path, n=2, prepend=path[0])) for path in (hub, road))
        longest = np.maximum(hub[:-1], hub[1:]) - held + hub_bend + road_bend / 8
        loose = longest >= static[wheel.tyre_deflection]
        if loose.any():
            first = min(first, float(physics.time[1 + loose.argmax()]))
    return first


def _integrator(integrated: Response, sampled: Response, signal: str) -> float:
    """Returns the bound on a signal's difference by the integrator's own error, over its scale."""
    return min(SLACK * _difference(integrated, sampled, signal) + ROUNDING, COARSEST)


def _difference(response: Response, reference: Response, signal: str) -> float:
    """Largest difference over time, over the reference's scale; 0 where neither ever moves."""
    if len(response.time) == 0:
        return 0.0
    difference = float(np.max(np.abs(response[signal] - reference[signal])))
    return difference / _scale(reference, signal)


def _scale(reference: Response, signal: str) -> float:
    """Returns the scale of a signal's differences: the reference's scale, or 1 in its unit if nothing ever moves."""
    return (reference.scale(signal) if len(reference.time) else 0.0) or 1.0
