"""Which suspension has which curve."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from models.common.errors import InputError
from models.suspension.curve import Curve
from models.suspension.curve_reading import DEFLECTION, VELOCITY, Argument


class Suspended(Protocol):
    """A suspension that can have curves, see `models.kinds.kind.Suspension`."""

    @property
    def deflection(self) -> str:
        """Its signal."""
        ...

    @property
    def tendon(self) -> str:
        """That it is in the MJCF."""
        ...

    @property
    def stiffness(self) -> str:
        """The parameter of its spring."""
        ...

    @property
    def damping(self) -> str:
        """The parameter of its damper."""
        ...


@dataclass(frozen=True, eq=False)
class Fitted:
    """The curve of one suspension's damper or spring.

    Attributes:
        deflection: signal of the suspension.
        tendon: that it acts along in the MJCF.
        parameter: that it stands in for.
        over: what its force is over.
        curve: it, its slope being the parameter.
    """

    deflection: str
    tendon: str
    parameter: str
    over: Argument
    curve: Curve

    @property
    def damps(self) -> bool:
        """Whether it is of a damper, and so over a velocity."""
        return self.over is VELOCITY


def curvable(suspensions: Sequence[Suspended]) -> dict[str, Argument]:
    """The parameters that a curve can stand in for, with what its force is over."""
    damping = {one.damping: VELOCITY for one in suspensions if one.damping}
    return {one.stiffness: DEFLECTION for one in suspensions if one.stiffness} | damping


def lines_at_rest(curves: Sequence[Fitted]) -> str:
    """What linear analysis takes for curves, in words: slope at rest, and from where to where it goes; empty where all are."""
    bent = {one.parameter: one.curve for one in curves if len(one.curve.pieces.slope)}
    return ", ".join(
        f"{name} {curve.slope:.4g} (elsewhere {curve.slopes.min():.4g} to {curve.slopes.max():.4g})"
        for name, curve in bent.items()
    )


def with_slopes(parameters: Mapping[str, Any], curves: Mapping[str, Curve]) -> dict[str, Any]:
    """`[parameters]` with the slopes at rest of the curves that stand in for some.

    Raises:
        InputError: one is given as a number as well.
    """
    for name in curves:
        if name in parameters:
            raise InputError(f"{name} stands in [parameters] and in [curves]; leave one out: a curve has its slope at rest")
    return {**parameters, **{name: curve.slope for name, curve in curves.items()}}


def fitted(
    suspensions: Sequence[Suspended],
    curves: Mapping[str, Curve],
    parameters: Mapping[str, float],
    dampers: Mapping[str, Curve | None],
) -> tuple[Fitted, ...]:
    """Every suspension's curves, scaled to parameters that are others than theirs.

    Args:
        suspensions: of a vehicle.
        curves: by parameter.
        parameters: of the vehicle.
        dampers: the curves of suspensions whose dampers are adjustable, by deflection; None for a straight one.
    """
    found = []
    for one in suspensions:
        for name, over in ((one.stiffness, DEFLECTION), (one.damping, VELOCITY)):
            if over is VELOCITY and one.deflection in dampers:
                curve = dampers[one.deflection]
            else:
                curve = curves.get(name)
                curve = curve.scaled(parameters[name] / curve.slope) if curve is not None and curve.slope else curve
            if curve is not None:
                found.append(Fitted(one.deflection, one.tendon, name, over, curve))
    return tuple(found)
