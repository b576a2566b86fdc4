"""Statistical linearisation: straight lines that best fit the nonlinear characteristics of a vehicle on a random road.

On a random road, a signal y is nearly Gaussian, with mean m and standard deviation s. The line that fits a characteristic F(y)
with the least mean-square error has the mean force and the mean slope of F:

    F(y) ~ E F + E F' (y - m),    E F' = c_0 + sum over knots of d_i Q((k_i - m) / s),
    E F = F(first knot) + c_0 (m - first knot) + sum of d_i s (phi(a_i) - a_i Q(a_i)),    a_i = (k_i - m) / s.

The slope of F changes by d_i at the knot k_i. phi is the normal density, and Q its upper tail probability. The formulas are
exact for piecewise linear characteristics (T. K. Caughey (1963), J. Acoust. Soc. Am. 35, 1706-1711; J. B. Roberts and P. D.
Spanos, Random Vibration and Statistical Linearization, 1990, chapter 5).

With these slopes, the linear vehicle has a different mean m and standard deviation s. The computation is therefore repeated
until slopes, m and s are consistent. An asymmetric damper produces a mean force, which the springs must balance, so the mean
body height changes (the damper jacks the body down).

If two wheels share a parameter, the mean of their slopes is used, because road and car are statistically the same on both
sides.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy  # `scipy.special` is imported only when it is needed, because the import takes 0.1 s

from models.characteristics.curve import ForceCurve
from models.common.arrays import Array
from models.vehicle.vehicle import Vehicle
from synth.controller.controller import Controller
from synth.controller.loop_of import loop_of

CONSISTENT = 1e-6  # the iteration ends if the slopes change by less than this relative amount
DIRECT = 10  # number of iterations that take full steps; later iterations take shorter steps
MOST_ROUNDS = 100


@dataclass(frozen=True, eq=False)
class EquivalentLine:
    """Linear vehicle that approximates a vehicle with e nonlinear characteristics.

    Attributes:
        vehicle: linear vehicle that replaces the nonlinear vehicle.
        curves: the e characteristics. A position-dependent damper is represented by the mean of its characteristic over all
            deflections.
        signals: names of the signals on which the characteristics depend.
        deflections: names of the deflections along which the forces of the characteristics act.
        slopes: slope of the line for each characteristic, with force and motion taken at the wheel, shape (e,).
        mean: mean of every output signal, by name [unit of the signal].
        rounds: number of iterations until the slopes were consistent with the motion of the linear vehicle.
    """

    vehicle: Vehicle
    curves: tuple[ForceCurve, ...]
    signals: tuple[str, ...]
    deflections: tuple[str, ...]
    slopes: Array
    mean: Mapping[str, float]
    rounds: int


def equivalent_line(
    vehicle: Vehicle, controller: Controller, deviations: Callable[[Vehicle, Sequence[str]], Array | None]
) -> EquivalentLine | None:
    """Returns the linear vehicle that replaces a nonlinear vehicle; None if the iteration finds no consistent slopes with which
    the loop is stable.

    Args:
        vehicle: vehicle with nonlinear characteristics.
        controller: linear controller.
        deviations: function that takes a linear vehicle and the names of k signals. The function returns the standard
            deviations of the k signals on the road, shape (k,), or None if the loop is unstable.
    """
    if without_curve(vehicle):
        return None
    placed = [one for one in vehicle.parts.with_curve if one.curve.is_nonlinear]
    signals, names = [one.argument for one in placed], [one.name for one in placed]
    curves, travels = [one.curve for one in placed], [one.deflection for one in placed if one.surface is not None]
    deflections = tuple(one.deflection for one in placed)
    slopes, means, outputs = np.array([one.slope for one in curves]), np.zeros(len(curves)), dict[str, float]()
    by_name = {one.name: one for one in placed}
    for rounds in range(1, MOST_ROUNDS + 1):
        shared = {name: float(np.mean(slopes[[i for i, other in enumerate(names) if other == name]])) for name in names}
        own = {name: float(shared[name] - one.part.line.of_preload) / one.ratio**2 for name, one in by_name.items()}
        of_parameters = {name: slope for name, slope in own.items() if by_name[name].parameter}
        elements = tuple(
            one.with_slope(own[one.name], by_name[one.name].damps) if one.name in own else one
            for one in vehicle.linearised.elements
        )
        linear = replace(vehicle.linearised, parameters={**vehicle.parameters, **of_parameters}, elements=elements)
        spreads = deviations(linear, signals + travels)
        if spreads is None:
            return None
        spread, of_travels = np.split(spreads, [len(signals)])
        if travels:
            at = {name: (outputs.get(name, 0.0), float(one)) for name, one in zip(travels, of_travels, strict=True)}
            curves = [one.curve if one.surface is None else one.surface.mean(*at[one.deflection]) for one in placed]
        moments = [averages(one, m, s) for one, m, s in zip(curves, means, spread, strict=True)]
        of_line = np.array([shared[name] for name in names])
        outputs = mean_outputs(linear, controller, deflections, np.array([force for force, _ in moments]) - of_line * means)
        new_slopes, shifted = np.array([slope for _, slope in moments]), np.array([outputs[signal] for signal in signals])
        if np.all(np.abs(new_slopes - slopes) <= CONSISTENT * np.abs(new_slopes).max()) and np.all(
            np.abs(shifted - means) <= CONSISTENT * (np.abs(shifted) + spread)
        ):
            return EquivalentLine(linear, tuple(curves), tuple(signals), deflections, of_line, outputs, rounds)
        # full steps may overshoot if a controller nearly cancels the force of a spring
        step = 1.0 if rounds < DIRECT else 1 / 4
        slopes, means = slopes + step * (new_slopes - slopes), means + step * (shifted - means)
    return None


def without_curve(vehicle: Vehicle) -> tuple[str, ...]:
    """Returns the names of the nonlinear elements that have no characteristic, because their forces depend on more than one
    signal.
    """
    bent = (
        one
        for one in vehicle.parts
        if one.part.is_nonlinear and not (one.part.contact or (one.part.inputs and not one.part.states))
    )
    return tuple(dict.fromkeys(one.name for one in bent if one.part.curve is None))


def averages(curve: ForceCurve, mean: float, deviation: float) -> tuple[float, float]:
    """Returns the mean force [N] and the mean slope of a characteristic whose argument is Gaussian."""
    if deviation == 0:
        near = 1e-9 * float(np.abs(curve.x).max())
        below, at, above = (float(curve(np.array(mean + x))) for x in (-near, 0.0, near))
        return at, (above - below) / (2 * near)
    a = (curve.x - mean) / deviation
    tails, densities = scipy.special.ndtr(-a), np.exp(-(a**2) / 2) / math.sqrt(2 * math.pi)
    steps, first = np.diff(curve.slopes), float(curve.slopes[0])
    slope = first + float(steps @ tails)
    force = float(curve.force[0]) + first * (mean - float(curve.x[0])) + deviation * float(steps @ (densities - a * tails))
    return force, slope


def mean_outputs(vehicle: Vehicle, controller: Controller, deflections: Sequence[str], forces: Array) -> dict[str, float]:
    """Returns the mean of every output signal of a linear vehicle, by name.

    Args:
        vehicle: linear vehicle.
        controller: linear controller.
        deflections: names of the e deflections along which the forces act.
        forces: mean forces of the nonlinear characteristics [N], shape (e,).
    """
    outputs = vehicle.linear_model.outputs
    closed = loop_of(vehicle, controller).closed_loop.part(outputs, ())
    push, _ = vehicle.force_effects(deflections)
    rates = np.zeros(len(closed.A))
    rates[: len(push)] = push @ forces
    means = -closed.C @ np.linalg.lstsq(closed.A, rates)[0]
    # Velocities and accelerations have a mean of zero.
    still = {name for name in outputs if vehicle.kind.signal(name).unit not in ("m", "rad", "N")}
    return {name: 0.0 if name in still else float(value) for name, value in zip(outputs, means, strict=True)}
