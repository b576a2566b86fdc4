"""Bouc-Wen hysteresis in its simple form: a force element of the tests alone, with a state that is not linear."""

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from models.common.arrays import Array
from models.common.schema import SI, Section
from models.kinds.signals import Signal
from models.parts.part import Part


@dataclass(frozen=True)
class BoucWen(Part, Section):
    """Hysteresis of a bushing: pull = a k d + (1 - a) k z, z' = v - b |v| z - g v |z|."""

    states = (Signal("hysteresis", "z", "m", "hysteretic displacement"),)

    stiffness: Annotated[float, SI("N/m", "k")]
    share: Annotated[float, SI("1", "a", 0.0, 1.0)]
    beta: Annotated[float, SI("1/m", "b")]
    gamma: Annotated[float, SI("1/m", "g")]

    def pull(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        return self.stiffness * (self.share * d + (1 - self.share) * z[..., 0])

    def rate(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        x = z[..., 0]
        return (v - self.beta * x * v * np.sign(np.real(v)) - self.gamma * v * x * np.sign(np.real(x)))[..., None]

    def stored(self, d: Array, z: Any = None) -> Array:
        return self.stiffness * (self.share * np.square(d) + (1 - self.share) * np.square(z[..., 0])) / 2
