"""Curves on the suspensions of a vehicle."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.printed import rough
from models.suspension.curve import ForceCurve
from models.suspension.curve_reading import DEFLECTION, VELOCITY, Argument
from models.suspension.motion_ratio import RatioTable
from models.suspension.surface import ForceSurface


class Suspended(Protocol):
    """Suspension of a vehicle; see `models.kinds.kind.Suspension`."""

    @property
    def deflection(self) -> str:
        """Signal of its extension."""
        ...

    @property
    def tendon(self) -> str:
        """Its tendon in the MJCF."""
        ...

    @property
    def force(self) -> str:
        """The input that pushes along it; empty for a passive one."""
        ...

    @property
    def ending(self) -> str:
        """Suffix of the names at its corner."""
        ...

    @property
    def stiffness(self) -> str:
        """The parameter of its spring; empty if it has no spring."""
        ...

    @property
    def damping(self) -> str:
        """The parameter of its damper; empty if it has no damper."""
        ...

    @property
    def ratio(self) -> str:
        """The parameter of its motion ratio; empty if it has none."""
        ...

    def motion_ratio(self, parameters: Mapping[str, float]) -> float:
        """Returns its motion ratio."""
        ...


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
    """

    deflection: str
    tendon: str
    parameter: str
    over: Argument
    curve: ForceCurve
    ratio: float = 1.0

    @property
    def damps(self) -> bool:
        """True for a damper's curve, over velocity."""
        return self.over is VELOCITY

    @property
    def surface(self) -> ForceSurface | None:
        """The damper's force over velocity and deflection; None if it depends on one of them."""
        return self.curve if isinstance(self.curve, ForceSurface) else None

    def beyond(self, deflection: Array, velocity: Array) -> Array:
        """Returns the force beyond its line at deflections [m] and velocities [m/s] of the suspension [N], shape (...)."""
        if self.surface is not None:
            return self.surface.beyond(velocity, deflection)
        return self.curve.pieces.force(velocity if self.damps else deflection)


def curvable(suspensions: Sequence[Suspended]) -> dict[str, Argument]:
    """Returns the parameters that a curve can replace, each with the curve's argument."""
    damping = {suspension.damping: VELOCITY for suspension in suspensions if suspension.damping}
    return {suspension.stiffness: DEFLECTION for suspension in suspensions if suspension.stiffness} | damping


def lines_at_rest(curves: Sequence[SuspensionCurve]) -> str:
    """Describes the lines of curves in linear analysis: slope at rest, and the range of slopes; empty if all are straight."""
    bent = {placed.parameter: placed.curve.at_wheel(1 / placed.ratio) for placed in curves if placed.curve.bent}
    slopes = (f"{rough(curve.slope)} (elsewhere {' to '.join(map(rough, curve.slope_range))})" for curve in bent.values())
    return ", ".join(map(" ".join, zip(bent, slopes, strict=True)))


def with_slopes(parameters: Mapping[str, Any], slopes: Mapping[str, float]) -> dict[str, Any]:
    """Returns `[parameters]` with the slopes at rest of the curves that replace some, and motion ratios at rest.

    Raises:
        InputError: a parameter is given both ways.
    """
    for name in slopes:
        if name in parameters:
            raise InputError(f"{name} is in [parameters] and in [curves]; omit one: a curve has its slope at rest")
    return {**parameters, **slopes}


def fitted(
    suspensions: Sequence[Suspended],
    curves: Mapping[str, ForceCurve],
    parameters: Mapping[str, float],
    dampers: Mapping[str, ForceCurve | None],
    ratios: Mapping[str, RatioTable],
    loads: Mapping[str, float],
) -> tuple[SuspensionCurve, ...]:
    """Returns every suspension's curves at the wheel, scaled to the vehicle's parameters.

    Args:
        dampers: the curves of adjustable dampers, by the suspension's deflection; None for a straight one.
        ratios: motion ratios that change with travel, by parameter.
        loads: the body's weight on each suspension [N], by its deflection.
    """
    placed = []
    for suspension in suspensions:
        ratio, table = suspension.motion_ratio(parameters), ratios.get(suspension.ratio)
        table = None if table is None or table.straight else table.scaled(ratio)
        for name, over in ((suspension.stiffness, DEFLECTION), (suspension.damping, VELOCITY)):
            if over is VELOCITY and suspension.deflection in dampers:
                curve = dampers[suspension.deflection]
            else:
                curve = curves.get(name)
                curve = curve.scaled(parameters[name] / curve.slope) if curve is not None and curve.slope else curve
            if table is not None and name in parameters:
                rate, load = parameters[name], loads[suspension.deflection]
                at_wheel = table.spring(curve, rate, load) if over is DEFLECTION else table.damper(curve, rate)
                placed.append(SuspensionCurve(suspension.deflection, suspension.tendon, name, over, at_wheel, ratio))
            elif curve is not None:
                placed.append(SuspensionCurve(suspension.deflection, suspension.tendon, name, over, curve.at_wheel(ratio), ratio))
    return tuple(placed)
