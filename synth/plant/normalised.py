"""A plant and what it measures, in units in which all its numbers have size one, and the way back for a law.

Whatever units a plant is given in, it is the same here, to the last bit where they differ by powers of two: so a design made here
does not depend on them. A design depends on what the measurements span, and on nothing else of them: they are the rows of an
orthonormal basis here, and signals that follow from others are left out.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.laws.linear import LinearLaw
from synth.plant.generalized import GeneralizedPlant, check_continuous
from synth.plant.units import OwnUnits, independent, nearest_power, orthonormal_rows, own_units, size


@dataclass(frozen=True, eq=False)
class Measured:
    """A plant with what it measures, in its own units.

    Attributes:
        plant: n states, m inputs that are independent, numbers of size one; so time, w and z have units of its own, too.
        Cy: shape (k, n), and
        Dyw: shape (k, r): together orthonormal rows.
        norm: what a norm of one in the given units counts in these.
        kept: which of the q given measurements do not follow from those before them.
        q: how many were given.
        units: of states and inputs.
        rate: of time [rad/s].
        inputs: W, shape (m', m): u = W v of the given inputs, each in its own unit.
        rows: S, shape (k, k): what is measured and kept is S times what is measured here.
    """

    plant: GeneralizedPlant
    Cy: Array
    Dyw: Array
    norm: float
    kept: Sequence[int]
    q: int
    units: OwnUnits
    rate: float
    inputs: Array
    rows: Array

    @classmethod
    def of(cls, plant: GeneralizedPlant, Cy: Array, Dyw: Array) -> "Measured":
        """In the plant's own units.

        Args:
            plant: n states, some disturbance and some output.
            Cy: shape (q, n).
            Dyw: shape (q, r).

        Raises:
            InputError: the plant is discrete.
        """
        check_continuous(plant)
        units = own_units(plant, Cy)
        own = units.into(plant)
        W = own.independent_inputs()
        own = own.with_inputs(W)
        rate = nearest_power(size(own.A) if own.A.any() else units.rate)
        u = rate / nearest_power(size(own.B))
        z = 1 / nearest_power(size(own.C)) if own.C.any() else 1 / (u * nearest_power(size(own.D)))
        w = rate / nearest_power(size(own.Bw)) if own.Bw.any() else 1 / (z * nearest_power(size(own.Dw)))
        scaled = GeneralizedPlant(
            A=own.A / rate,
            B=own.B * (u / rate),
            Bw=own.Bw * (w / rate),
            C=own.C * z,
            D=own.D * (z * u),
            Dw=own.Dw * (z * w),
        )
        rows = np.hstack([Cy * units.states, Dyw * w])
        kept = independent(rows)
        V, S = orthonormal_rows(rows[kept])
        n = len(plant.A)
        return cls(scaled, V[:, :n], V[:, n:], z * w, kept, len(Cy), units, rate, u * W, S)

    def back(self, law: LinearLaw) -> LinearLaw:
        """A law for the plant as it was given, on all q measurements; its states keep these units."""
        from_y = np.zeros((len(self.kept), self.q))
        # Row by row: pivots would depend on units.
        from_y[:, self.kept] = linalg.solve_triangular(self.rows, np.eye(len(self.rows)), lower=True)
        inputs = self.units.inputs[:, None] * self.inputs
        return LinearLaw(self.rate * law.A, self.rate * law.B @ from_y, inputs @ law.C, inputs @ law.D @ from_y)


def missing(D: Array, share: float) -> Array:
    """Rows that a D must be joined by so that no singular value of both together is below a share; shape (m, m)."""
    m = D.shape[1]
    _, sizes, directions = np.linalg.svd(D)
    sizes = np.concatenate([sizes, np.zeros(m)])[:m]
    return np.sqrt(np.maximum(share**2 - sizes**2, 0.0))[:, None] * directions
