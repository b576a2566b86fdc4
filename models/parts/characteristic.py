"""A part whose force is a curve over one argument: the velocity or the deflection of its suspension."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from models.characteristics.curve import ForceCurve
from models.common.arrays import Array
from models.parts.native import Tendon
from models.parts.part import CURVE, Limit, Line, Part


@dataclass(frozen=True, eq=False)
class Characteristic(Part):
    """Force r a f(r x) over an argument x, with f a curve.

    Attributes:
        own: f.
        factor: a, of a vehicle whose parameter is not the curve's slope.
        ratio: r, a constant motion ratio.
    """

    own: ForceCurve
    factor: float = 1.0
    ratio: float = 1.0

    def over(self, d: Array, v: Array) -> Array:
        """Returns the argument, from deflection and velocity."""
        return v if self.argument == "velocity" else d

    def pull(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        """See `Part.pull`."""
        return self.ratio * self.factor * self.own(self.ratio * self.over(d, v))

    def beyond(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        """See `Part.beyond`. It is exactly 0 along the line."""
        x = v if self.argument == "velocity" else d
        return self.own.pieces.force(x) if self._alone else self.ratio * self.factor * self.own.pieces.force(self.ratio * x)

    @cached_property
    def _alone(self) -> bool:
        return isinstance(self.factor, float) and self.factor == 1 and isinstance(self.ratio, float) and self.ratio == 1

    @cached_property
    def line(self) -> Line:
        """See `Part.line`: the slope of the curve at rest."""
        slope = self.ratio**2 * self.factor * self.own.slope
        return Line(0.0, slope) if self.argument == "velocity" else Line(slope)

    @property
    def bent(self) -> bool:
        """See `Part.bent`."""
        return self.own.bent

    @property
    def kinked_at_rest(self) -> bool:
        """See `Part.kinked_at_rest`."""
        return bool((self.own.pieces.start == 0).any())

    @cached_property
    def curve(self) -> ForceCurve:  # pyright: ignore[reportIncompatibleMethodOverride]
        """See `Part.curve`."""
        return self.own.scaled(self.factor).at_wheel(self.ratio)

    @property
    def range(self) -> float:
        """See `Part.range`."""
        return self.curve.range

    def limits(self) -> Sequence[Limit]:
        """Returns the arguments, below and above rest, at which the curve leaves its line."""
        low, high = self.curve.left_at
        of = "velocity" if self.argument == "velocity" else "deflection"
        return [Limit(CURVE, of, sign, far) for sign, far in ((-1.0, -low), (1.0, high)) if far < np.inf]

    def at_wheel(self, ratio: float) -> "Part":
        """See `Part.at_wheel`."""
        return self if ratio == 1 else replace(self, ratio=self.ratio * ratio)

    @property
    def native(self) -> bool:
        """See `Part.native`."""
        return True

    def write(self, tendon: Tendon) -> None:
        """Writes every straight piece as an actuator. See `Part.write`."""
        tendon.add_pieces(f"{self.argument}", self.curve.pieces, self.argument == "velocity")

    @property
    def words(self) -> str:
        """See `Part.words`."""
        return self.own.words
