"""Curves on the suspensions of a vehicle."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from models.common.arrays import Array
from models.common.printed import rough
from models.suspension import SuspensionParts
from models.suspension.curve import ForceCurve
from models.suspension.curve_reading import DEFLECTION, VELOCITY, Argument
from models.suspension.motion_ratio import RatioTable
from models.suspension.surface import ForceSurface


@dataclass(frozen=True, eq=False)
class SuspensionCurve:
    """ForceCurve of one suspension's damper or spring.

    Attributes:
        deflection: signal of the suspension.
        tendon: name of the tendon in the MJCF.
        parameter: the parameter that it replaces.
        over: argument of the curve.
        curve: the curve at the wheel; its slope is the parameter's value times the square of the motion ratio.
        ratio: motion ratio of the element.
        of_preload: part of the slope that the preload adds by a motion ratio over travel [N/m].
    """

    deflection: str
    tendon: str
    parameter: str
    over: Argument
    curve: ForceCurve
    ratio: float = 1.0
    of_preload: float = 0.0

    @property
    def damps(self) -> bool:
        """True for a damper's curve, over velocity."""
        return self.over == VELOCITY  # also in another process

    @property
    def surface(self) -> ForceSurface | None:
        """The damper's force over velocity and deflection; None if it depends on one of them."""
        return self.curve if isinstance(self.curve, ForceSurface) else None

    def beyond(self, deflection: Array, velocity: Array) -> Array:
        """Returns the force beyond its line at deflections [m] and velocities [m/s] of the suspension [N], shape (...)."""
        if self.surface is not None:
            return self.surface.beyond(velocity, deflection)
        return self.curve.pieces.force(velocity if self.damps else deflection)


def curvable(suspensions: Sequence[SuspensionParts]) -> dict[str, Argument]:
    """Returns the parameters that a curve can replace, each with the curve's argument."""
    damping = {suspension.damping: VELOCITY for suspension in suspensions if suspension.damping}
    return {suspension.stiffness: DEFLECTION for suspension in suspensions if suspension.stiffness} | damping


def lines_at_rest(curves: Sequence[SuspensionCurve]) -> str:
    """Describes the lines of curves in linear analysis: slope at rest, and the range of slopes; empty if all are straight.

    Slopes are the elements' own, as in `[parameters]`, without what a preload adds.
    """
    bent = {one.parameter: one for one in curves if one.curve.bent}
    slopes = {
        name: [(slope - one.of_preload) / one.ratio**2 for slope in (one.curve.slope, *one.curve.slope_range)]
        for name, one in bent.items()
    }
    return ", ".join(
        f"{name} {rough(at)} (slope of the whole curve: {rough(low)} to {rough(high)})"
        for name, (at, low, high) in slopes.items()
    )


def fitted(
    suspensions: Sequence[SuspensionParts],
    curves: Mapping[str, ForceCurve],
    parameters: Mapping[str, float],
    dampers: Mapping[str, ForceCurve | None],
    tables: Mapping[str, RatioTable],
    loads: Mapping[str, float],
) -> tuple[SuspensionCurve, ...]:
    """Returns every suspension's curves at the wheel, scaled to the vehicle's parameters.

    Args:
        dampers: the curves of adjustable dampers, by the suspension's deflection; None for a straight one.
        tables: motion ratios that change with travel, by the suspension's deflection.
        loads: the body's weight on each suspension [N], by its deflection.
    """
    placed = []
    for suspension in suspensions:
        ratio, table = suspension.motion_ratio(parameters), tables.get(suspension.deflection)
        for name, over in ((suspension.stiffness, DEFLECTION), (suspension.damping, VELOCITY)):
            if over is VELOCITY and suspension.deflection in dampers:
                curve = dampers[suspension.deflection]
            else:
                curve = curves.get(name)
                curve = curve.scaled(parameters[name] / curve.slope) if curve is not None and curve.slope else curve
            if table is not None and name in parameters:
                rate, load = parameters[name], loads[suspension.deflection]
                at_wheel = table.spring(curve, rate, load) if over is DEFLECTION else table.damper(curve, rate)
                own = (ratio, at_wheel.slope - ratio**2 * rate)
            elif curve is not None:
                at_wheel, own = curve.at_wheel(ratio), (ratio,)
            else:
                continue
            placed.append(SuspensionCurve(suspension.deflection, suspension.tendon, name, over, at_wheel, *own))
    return tuple(placed)
