"""Hydraulic bump stop: a spring that acts beyond its stroke, and a damper whose coefficient grows with the compression.

The compression x of the stop is measured from the point at which the suspension has travelled the stroke. While the compression
x grows at the rate w, the force of the stop is

    F = x (k + c w).

While the stop opens, the hydraulic chamber gives no force, so the force of the stop is F = k x.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from models.common.arrays import Array
from models.common.schema import SI, Section
from models.parts.part import BUMP_STOP, Limit, Part


@dataclass(frozen=True)
class HydraulicStop(Part, Section):
    """Hydraulic bump stop, which acts only in compression of the suspension."""

    contact = True

    stroke: Annotated[float, SI("m", "travel from equilibrium to the stop", 1e-4, 2.0)]
    stiffness: Annotated[float, SI("N/m", "k, stiffness of the stop")]
    damping: Annotated[float, SI("N s/m2", "c, damping coefficient per compression, only while the compression grows", 0.0)]

    def pull(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        compression = np.maximum(-d - self.stroke, 0.0)
        return -compression * (self.stiffness + self.damping * np.maximum(-v, 0.0))

    def stored(self, d: Array, z: Any = None) -> Array:
        return self.stiffness * np.square(np.maximum(-d - self.stroke, 0.0)) / 2

    def limits(self) -> Sequence[Limit]:
        """Returns the stroke of the stop as the limit of the linear range."""
        return (Limit(BUMP_STOP, "deflection", -1.0, self.stroke),)

    @property
    def words(self) -> str:
        return f"a hydraulic bump stop at {-self.stroke:g} m"
