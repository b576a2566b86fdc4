"""Damper with a characteristic of force against velocity: `[curves] suspension_damping`."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from models.characteristics.curve_reading import VELOCITY
from models.characteristics.ratio_table import line
from models.characteristics.surface import ForceSurface
from models.kinds.kind import Suspension
from models.parts.characteristic import Characteristic
from models.parts.part import Part

FAST = 1.0  # velocity [m/s] at which a linear damper is assumed to reach its largest force


@dataclass(frozen=True, eq=False)
class DamperCurve(Characteristic):
    """Damper with a characteristic."""

    argument = "velocity"
    replaces = "damping", VELOCITY

    @classmethod
    def of(cls, vehicle: Any, place: Suspension) -> Iterator[tuple[Part, str]]:
        """Yields the damper of a suspension, unless the damper is semi-active.

        The damper has a characteristic in `[curves]`, or is linear with a motion ratio that changes with travel.
        """
        name, curve = place.damping, vehicle.curves.get(place.damping)
        if vehicle.adjusted(place.force) or isinstance(curve, ForceSurface):
            return
        if curve is not None:
            yield cls.with_slope(curve, vehicle.parameters[name]), name
        elif vehicle.kind.table_of(place) is not None and name in vehicle.parameters:
            yield cls(line(1.0, -FAST, FAST), vehicle.parameters[name]), name
