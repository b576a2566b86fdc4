"""Normalisation of a plant and its measurements so that numbers are near 1, and conversion of a law to the units of the given
plant.

If the units of a plant change by powers of two, no bit of the normalised plant changes. A design
therefore does not depend on the units. A design depends only on the span of the measurements. The measurements are therefore
replaced by an orthonormal basis, and dependent measurements are omitted.
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
    """Plant and its measurements in units that make the entries of the matrices near 1.

    Attributes:
        plant: normalised plant with n states and m independent inputs. The units of time, w and z are also normalised. The
            matrix [Cy Dyw] of the normalised plant has k orthonormal rows.
        norm: factor that converts a norm of the given plant to normalised units.
        independent_rows: indices of the given measurements that do not depend linearly on earlier measurements.
        q: number of measurements of the given plant.
        units: normalising units of states and inputs.
        rate: rate [rad/s] that has the value 1 in normalised units of time.
        inputs: matrix W with u = W v, shape (m', m), where u are the m' given inputs in normalised units, and v the m
            independent inputs.
        rows: matrix S, shape (k, k). The given independent measurements are S times the measurements of the normalised plant.
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
        """Normalises a plant that has a disturbance, a controlled output and a measurement.

        Raises:
            InputError: the plant is discrete, not continuous.
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
        """Matrix from the given measurements to the measurements of the normalised plant, shape (k, q)."""
        from_y = np.zeros((len(self.independent_rows), self.q))
        # The triangular system is solved row by row, without pivots, because pivots would depend on the units.
        from_y[:, self.independent_rows] = linalg.solve_triangular(self.rows, np.eye(len(self.rows)), lower=True)
        return from_y

    def back(self, law: LinearLaw) -> LinearLaw:
        """Returns a law that uses all q measurements of the given plant. The states of the law stay in normalised units."""
        from_y = self.from_given
        inputs = self.units.inputs[:, None] * self.inputs
        return LinearLaw(self.rate * law.A, self.rate * law.B @ from_y, inputs @ law.C, inputs @ law.D @ from_y)


def missing(D: Array, share: float) -> Array:
    """Returns rows that, if added to D, raise all singular values of D to at least `share`; shape (m, m)."""
    m = D.shape[1]
    _, sizes, directions = np.linalg.svd(D)
    sizes = np.concatenate([sizes, np.zeros(m)])[:m]
    return np.sqrt(np.maximum(share**2 - sizes**2, 0.0))[:, None] * directions
