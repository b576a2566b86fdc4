"""Damper with a curve of force over velocity: `[curves] suspension_damping`."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from models.characteristics.curve_reading import VELOCITY
from models.characteristics.ratio_table import line
from models.characteristics.surface import ForceSurface
from models.kinds.kind import Suspension
from models.parts.characteristic import Characteristic
from models.parts.part import Part

FAST = 1.0  # m/s, of a straight damper, whose force there is its largest one


@dataclass(frozen=True, eq=False)
class DamperCurve(Characteristic):
    """Damper with a curve."""

    argument = "velocity"
    replaces = "damping", VELOCITY

    @classmethod
    def of(cls, vehicle: Any, place: Suspension) -> Iterator[tuple[Part, str]]:
        """Yields the damper of a suspension, unless it is adjustable: its curve, or its line at a motion ratio over travel."""
        name, curve = place.damping, vehicle.curves.get(place.damping)
        if vehicle.adjusted(place.force) or isinstance(curve, ForceSurface):
            return
        if curve is not None:
            yield cls.with_slope(curve, vehicle.parameters[name]), name
        elif vehicle.kind.table_of(place) is not None and name in vehicle.parameters:
            yield cls(line(1.0, -FAST, FAST), vehicle.parameters[name]), name
