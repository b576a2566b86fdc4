"""Smooth functions that support the norm from below, each of one frequency and two unit vectors."""

from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array


@dataclass(frozen=True, eq=False)
class Cuts:
    """F functions Re u' T(j omega; K) v.

    Attributes:
        omega: frequencies [rad/s], shape (F,).
        u: unit vectors, complex, shape (F, d).
        v: unit vectors, complex, shape (F, r).
    """

    omega: Array
    u: Array
    v: Array

    def __getitem__(self, index: Array | slice) -> "Cuts":
        return Cuts(self.omega[index], self.u[index], self.v[index])

    def __add__(self, other: "Cuts") -> "Cuts":
        return Cuts(
            np.concatenate([self.omega, other.omega]), np.concatenate([self.u, other.u]), np.concatenate([self.v, other.v])
        )
