"""Damper whose force is given by a table, as a function of velocity and deflection: `[curves] suspension_damping`."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from models.characteristics.surface import ForceSurface
from models.common.arrays import Array
from models.kinds.kind import Suspension
from models.parts.characteristic import Characteristic
from models.parts.part import Part


@dataclass(frozen=True, eq=False)
class SurfaceDamper(Characteristic):
    """Force r a f(r v, r d) with a table f.

    Methods that are inherited from `Characteristic` use the section of the table at deflection 0.
    """

    argument = "velocity"
    native = False

    own: ForceSurface

    def pull(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        return self.ratio * self.factor * self.own.along(self.ratio * v, self.ratio * d)

    beyond, limits = Part.beyond, Part.limits  # the inherited methods of `Characteristic` are valid only at deflection 0

    @classmethod
    def of(cls, vehicle: Any, place: Suspension) -> Iterator[tuple[Part, str]]:
        """Yields the damper of a suspension if a table gives its force as a function of velocity and deflection."""
        curve = vehicle.curves.get(place.damping)
        if isinstance(curve, ForceSurface):
            yield cls.with_slope(curve, vehicle.parameters[place.damping]), place.damping
