"""Maxwell element: a spring in series with a damper, as in a top mount, or in a damper with elastic bushings.

The spring has the extension x, and the damper has the velocity v - x'. The spring and the damper have the same force,

    F = k x = c (v - x').
"""

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from models.common.arrays import Array
from models.common.schema import SI, Section
from models.kinds.signals import Signal
from models.parts.part import Part


@dataclass(frozen=True)
class Maxwell(Part, Section):
    """Spring in series with a damper, as one force element."""

    states = (Signal("extension", "x", "m", "extension of the spring in series with a damper"),)

    stiffness: Annotated[float, SI("N/m", "k, stiffness of the spring")]
    damping: Annotated[float, SI("N s/m", "c, damping of the damper in series with it")]

    def pull(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        return self.stiffness * z[..., 0]

    def rate(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        return (v - self.stiffness / self.damping * z[..., 0])[..., None]

    def stored(self, d: Array, z: Any = None) -> Array:
        return self.stiffness * np.square(z[..., 0]) / 2

    @property
    def is_nonlinear(self) -> bool:
        return False

    @property
    def words(self) -> str:
        return "a spring in series with a damper"
