"""Spring with a characteristic of force against deflection: `[curves] suspension_stiffness`."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.characteristics.curve_reading import DEFLECTION
from models.characteristics.ratio_table import line
from models.common.arrays import Array
from models.kinds.kind import Suspension
from models.parts.characteristic import Characteristic
from models.parts.part import Part


@dataclass(frozen=True, eq=False)
class SpringCurve(Characteristic):
    """Spring with a characteristic."""

    argument = "deflection"
    replaces = "stiffness", DEFLECTION
    stores = True

    def stored(self, d: Array, z: Any = None) -> Array:
        return self.stored_beyond(d) + self.line.stiffness * np.square(d) / 2

    def stored_beyond(self, d: Array, z: Any = None) -> Array:
        return self.factor * self.own.work(self.ratio * d)

    @classmethod
    def of(cls, vehicle: Any, place: Suspension) -> Iterator[tuple[Part, str]]:
        """Yields the spring of a suspension.

        The spring has a characteristic in `[curves]`, or is linear with a motion ratio that changes with travel.
        """
        name, curve = place.stiffness, vehicle.curves.get(place.stiffness)
        if curve is not None:
            yield cls.with_slope(curve, vehicle.parameters[name]), name
        elif (table := vehicle.kind.table_of(place)) is not None and name in vehicle.parameters:
            ends = place.motion_ratio(vehicle.parameters) / table.at_rest * table.travel(table.x[[0, -1]])
            yield cls(line(1.0, *ends.tolist()), vehicle.parameters[name]), name
