"""A part whose force is a function of one argument: the velocity or the deflection of its suspension."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from models.characteristics.curve import ForceCurve
from models.common.arrays import Array
from models.parts.native import Tendon
from models.parts.part import CURVE, Limit, Line, Part, Quantity


@dataclass(frozen=True, eq=False)
class Characteristic(Part):
    """Force r a f(r x) as a function of an argument x, where f is a characteristic, r a motion ratio and a a factor.

    Attributes:
        own: characteristic f of the element, before the motion ratio is applied.
        factor: factor a; it differs from 1 if the vehicle's parameter differs from the slope of the characteristic.
        ratio: constant motion ratio r.
    """

    native = True

    own: ForceCurve
    factor: float = 1.0
    ratio: float = 1.0

    @classmethod
    def with_slope(cls, curve: ForceCurve, slope: float) -> Self:
        """Returns the part after scaling its characteristic to a prescribed slope at equilibrium."""
        return cls(curve, slope / curve.slope if curve.slope else 1.0)

    def pull(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        return self.ratio * self.factor * self.own(self.ratio * (v if self.argument == "velocity" else d))

    def beyond(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        """See `Part.beyond`. The result is exactly 0 for arguments at which the force of the part equals its linearisation."""
        x = v if self.argument == "velocity" else d
        return self.own.pieces.force(x) if self._alone else self.ratio * self.factor * self.own.pieces.force(self.ratio * x)

    @cached_property
    def _alone(self) -> bool:
        return isinstance(self.factor, float) and self.factor == 1 and isinstance(self.ratio, float) and self.ratio == 1

    @cached_property
    def line(self) -> Line:
        slope = self.ratio**2 * self.factor * self.own.slope
        return Line(0.0, slope) if self.argument == "velocity" else Line(slope)

    @property
    def is_nonlinear(self) -> bool:
        return self.own.is_nonlinear

    @property
    def kinked_at_rest(self) -> bool:
        return bool((self.own.pieces.start == 0).any())

    @cached_property
    def curve(self) -> ForceCurve:  # pyright: ignore[reportIncompatibleMethodOverride]
        return self.own.scaled(self.factor).at_wheel(self.ratio)

    def limits(self) -> Sequence[Limit]:
        """Returns the arguments below and above equilibrium beyond which the force of the part deviates too much from its
        linearisation.
        """
        return departures(self.curve, "velocity" if self.argument == "velocity" else "deflection")

    def at_wheel(self, ratio: float) -> Part:
        return self if ratio == 1 else replace(self, ratio=self.ratio * ratio)

    def write(self, tendon: Tendon) -> None:
        """Writes one MuJoCo actuator for each straight segment of the characteristic. See `Part.write`."""
        tendon.add_pieces(f"{self.argument}", self.curve.pieces, self.argument == "velocity")

    @property
    def words(self) -> str:
        return self.own.words


def departures(curve: ForceCurve, of: Quantity) -> Sequence[Limit]:
    """Returns the limits of the argument beyond which a characteristic deviates too much from its linearisation."""
    sides = zip((-1.0, 1.0), curve.departures_at, strict=True)
    return [Limit(CURVE, of, sign, abs(far)) for sign, far in sides if abs(far) < np.inf]
