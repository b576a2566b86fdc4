"""Actuator whose motion ratio changes with travel.

If the motion ratio is constant, the linear model contains the whole actuator force, so no part for the actuator is needed.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.kinds.kind import Suspension
from models.parts.part import Part


@dataclass(frozen=True, eq=False)
class Actuator(Part):
    """Actuator force that pushes body and wheel apart. The input u of the actuator is its force [N]."""

    inputs = 1

    def pull(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        return np.negative(u)

    @property
    def is_nonlinear(self) -> bool:
        return False

    @classmethod
    def of(cls, vehicle: Any, place: Suspension) -> Iterator[tuple[Part, str]]:
        """Yields the actuator of a suspension whose motion ratio changes with travel."""
        inputs = vehicle.kind.model(vehicle.parameters).inputs
        if vehicle.kind.table_of(place) is not None and place.force in inputs and place.force not in vehicle.dampers:
            yield cls(), ""
