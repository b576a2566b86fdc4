"""Damper whose force is a table over velocity and deflection: `[curves] suspension_damping` with both."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from models.characteristics.surface import ForceSurface
from models.common.arrays import Array
from models.kinds.kind import Suspension
from models.parts.part import Line, Part


@dataclass(frozen=True, eq=False)
class SurfaceDamper(Part):
    """Force r a f(r v, r d), with f a surface. Attributes as of `models.parts.characteristic.Characteristic`."""

    argument = "velocity"  # of its section, beside the deflection

    own: ForceSurface
    factor: float = 1.0
    ratio: float = 1.0

    def pull(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        """See `Part.pull`."""
        return self.ratio * self.factor * self.own.along(self.ratio * v, self.ratio * d)

    @cached_property
    def line(self) -> Line:
        """See `Part.line`: the slope over velocity at rest."""
        return Line(0.0, self.ratio**2 * self.factor * self.own.slope)

    @property
    def bent(self) -> bool:
        """See `Part.bent`."""
        return self.own.bent

    @property
    def kinked_at_rest(self) -> bool:
        """See `Part.kinked_at_rest`."""
        return bool((self.own.pieces.start == 0).any())

    @cached_property
    def curve(self) -> ForceSurface:  # pyright: ignore[reportIncompatibleMethodOverride]
        """See `Part.curve`: the surface at the wheel."""
        return self.own.scaled(self.factor).at_wheel(self.ratio)

    @property
    def range(self) -> float:
        """See `Part.range`."""
        return self.curve.range

    def at_wheel(self, ratio: float) -> Part:
        """See `Part.at_wheel`."""
        return self if ratio == 1 else replace(self, ratio=self.ratio * ratio)

    @property
    def words(self) -> str:
        """See `Part.words`."""
        return self.own.words

    @classmethod
    def of(cls, vehicle: Any, place: Suspension) -> Iterator[tuple[Part, str]]:
        """Yields the damper of a suspension, if its table is over velocity and deflection."""
        curve = vehicle.curves.get(place.damping)
        if isinstance(curve, ForceSurface):
            factor = vehicle.parameters[place.damping] / curve.slope if curve.slope else 1.0
            yield cls(curve, factor), place.damping
