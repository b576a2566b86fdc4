"""Adjustable dampers in their vehicle, and what stands beside them there.

A curve of `[curves]` for the damper of a suspension that is adjustable stands beside it: what it has beyond its line at rest acts
whatever is set, as the friction of a strut does. The adjustable damper itself is in the place of the line.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from models.common.errors import InputError
from models.curves.curve import Curve
from models.curves.fitted import fitted_curve
from models.damping.damper import Damper

COEFFICIENT, MISSING = "damping", "missing_force"  # begin the names of a damper's signals
ROUNDING = 1e-9  # of what curve and line pull with


@dataclass(frozen=True)
class Adjustable:
    """An adjustable damper in its vehicle.

    Attributes:
        force: the input that it stands for, what it gives beyond the nominal damper.
        ending: of the names of what lies at its suspension.
        damper: itself.
        nominal: the coefficient of the linear model [N s/m].
        beside: the curve of `[curves]` whose pieces, what it has beyond its line, stand beside it; None for none.
    """

    force: str
    ending: str
    damper: Damper
    nominal: float
    beside: Curve | None = None

    @property
    def coefficient(self) -> str:
        """The signal of the coefficient that acts."""
        return f"{COEFFICIENT}{self.ending}"

    @property
    def missing(self) -> str:
        """The signal of the force that was asked for and that it does not give."""
        return f"{MISSING}{self.ending}"


class Suspension(Protocol):
    """What is asked of a suspension here; see `models.kind.Suspension`."""

    @property
    def force(self) -> str:
        """The input that pushes along it; empty where none does."""
        ...

    @property
    def ending(self) -> str:
        """Of the names of what lies at its corner."""
        ...

    @property
    def damping(self) -> str:
        """The parameter of its damper; empty where there is none."""
        ...


def adjustable(
    dampers: Mapping[str, Damper],
    suspensions: Sequence[Suspension],
    parameters: Mapping[str, float],
    curves: Mapping[str, Curve],
) -> tuple[Adjustable, ...]:
    """Adjustable dampers in their vehicle.

    Args:
        dampers: by force.
        suspensions: of the vehicle, in the order of its forces.
        parameters: of the vehicle, by name.
        curves: that stand in for some of these.

    Raises:
        InputError: a suspension has no nominal damper, or none that its adjustable one can be, or its curve feeds energy in.
    """
    found = []
    for one in suspensions:
        if one.force not in dampers:
            continue
        damper = dampers[one.force]
        if not one.damping:
            raise InputError(
                f"[actuators] the kind does not say which parameter is the damper at {one.force}; let its Suspension say it"
            )
        nominal = parameters[one.damping]
        if not damper.c_min <= nominal <= damper.c_max:
            raise InputError(
                f"{one.damping} = {nominal:g} N s/m, which acts where no force is asked for, is not among the "
                f"{damper.c_min:g} to {damper.c_max:g} N s/m of [actuators]; widen these or move that"
            )
        beside = fitted_curve(curves[one.damping], nominal) if one.damping in curves else None
        if beside is not None:
            _check_beside(one.damping, beside, damper)
        found.append(Adjustable(one.force, one.ending, damper, nominal, beside))
    return tuple(found)


def _check_beside(parameter: str, curve: Curve, damper: Damper) -> None:
    """Whether a damper at its softest takes energy with what a curve has beyond its line beside it, at every velocity.

    Raises:
        InputError: it does not.
    """
    pull = damper.c_min * curve.x + curve.pieces.force(curve.x)
    feeding = np.flatnonzero(pull * np.sign(curve.x) < -ROUNDING * curve.range)
    for at, slope in (*((i, None) for i in feeding[:1]), (0, curve.slopes[0]), (-1, curve.slopes[-1])):
        if slope is None or damper.c_min + slope - curve.slope < -ROUNDING * abs(curve.slope):
            where = f"at {curve.x[at]:g} m/s" if slope is None else f"beyond {curve.x[at]:g} m/s, as it goes on from there"
            raise InputError(
                f"[curves] {parameter} lies beside an adjustable damper, at every setting with what it has beyond its line of "
                f"{curve.slope:g} N s/m at rest, and so feeds energy in {where} where that is set to c_min = {damper.c_min:g} "
                "N s/m; give that line and friction alone, or a larger c_min"
            )
