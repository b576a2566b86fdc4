"""Normalisation of a plant and its measurements to numbers of size one, and the way back for a law.

The normalised plant is bit for bit independent of the given units if these differ by powers of two. So a design does not
depend on them either. A design depends only on the span of the measurements: they are replaced by an orthonormal basis, and
dependent signals are left out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.laws.linear import LinearLaw
from synth.plant.generalized import Plant, check_continuous
from synth.plant.units import OwnUnits, independent, nearest_power, orthonormal_rows, own_units, size


@dataclass(frozen=True, eq=False)
class NormalisedPlant:
    """A plant and its measurements in the plant's own units.

    Attributes:
        plant: n states, m inputs that are independent, numbers of size one; so time, w and z have units of its own, too. [Cy Dyw]
            has k orthonormal rows.
        norm: value in these units of a norm of one in the given units.
        independent_rows: indices of the given measurements that do not follow from earlier ones.
        q: number of given measurements.
        units: units of states and inputs.
        rate: rate of the time scale [rad/s].
        inputs: W, shape (m', m): u = W v of the given inputs, each in its own unit.
        rows: S, shape (k, k): the kept measurements are S times those of this plant.
    """

    plant: Plant
    norm: float
    independent_rows: Sequence[int]
    q: int
    units: OwnUnits
    rate: float
    inputs: Array
    rows: Array

    @classmethod
    def of(cls, plant: Plant) -> "NormalisedPlant":
        """Returns a plant with some disturbance, output and measurement in its own units.

        Raises:
            InputError: the plant is discrete.
        """
        check_continuous(plant)
        units = own_units(plant, measured=True)
        own = units.into(plant)
        W = own.independent_inputs()
        own = own.with_inputs(W)
        rate = nearest_power(size(own.A) if own.A.any() else units.rate)
        u = rate / nearest_power(size(own.B))
        z = 1 / nearest_power(size(own.C)) if own.C.any() else 1 / (u * nearest_power(size(own.D)))
        w = rate / nearest_power(size(own.Bw)) if own.Bw.any() else 1 / (z * nearest_power(size(own.Dw)))
        scaled = Plant(
            A=own.A / rate,
            B=own.B * (u / rate),
            Bw=own.Bw * (w / rate),
            C=own.C * z,
            D=own.D * (z * u),
            Dw=own.Dw * (z * w),
        )
        rows = np.hstack([own.Cy, own.Dyw * w])
        independent_rows = independent(rows)
        V, S = orthonormal_rows(rows[independent_rows])
        n = len(plant.A)
        return cls(replace(scaled, Cy=V[:, :n], Dyw=V[:, n:]), z * w, independent_rows, len(rows), units, rate, u * W, S)

    @cached_property
    def from_given(self) -> Array:
        """The measurements of this plant from the given ones, shape (k, q)."""
        from_y = np.zeros((len(self.independent_rows), self.q))
        # Row by row: pivots would depend on units.
        from_y[:, self.independent_rows] = linalg.solve_triangular(self.rows, np.eye(len(self.rows)), lower=True)
        return from_y

    def back(self, law: LinearLaw) -> LinearLaw:
        """Returns a law for the given plant, on all q measurements; its states keep these units."""
        from_y = self.from_given
        inputs = self.units.inputs[:, None] * self.inputs
        return LinearLaw(self.rate * law.A, self.rate * law.B @ from_y, inputs @ law.C, inputs @ law.D @ from_y)


def missing(D: Array, share: float) -> Array:
    """Returns rows that raise all singular values of D, joined by them, to a share; shape (m, m)."""
    m = D.shape[1]
    _, sizes, directions = np.linalg.svd(D)
    sizes = np.concatenate([sizes, np.zeros(m)])[:m]
    return np.sqrt(np.maximum(share**2 - sizes**2, 0.0))[:, None] * directions
