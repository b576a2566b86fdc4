"""Inerter: a force that is proportional to the relative acceleration of its ends, F = b v' (M. C. Smith, 2002)."""

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from models.common.arrays import Array
from models.common.schema import SI, Section
from models.parts.part import Number, Part


@dataclass(frozen=True)
class Inerter(Part, Section):
    """Inerter between body and wheel."""

    stores = True

    inertance: Annotated[float, SI("kg", "b, force per relative acceleration of its ends")]

    def pull(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        return np.zeros(np.shape(d))

    def inertance_at(self, d: Array) -> Number:
        return self.inertance

    @property
    def is_nonlinear(self) -> bool:
        return False

    @property
    def words(self) -> str:
        return f"an inerter of {self.inertance:g} kg"
