"""Conversion of a law with a given structure to a static gain of a larger plant, and back.

A law with k states x_c is u = D y + C x_c, v = B y + A x_c for the plant to which k integrators x_c' = v are added
(`plant/augmented.py`). For the plant with integrators, the law is the static gain [D, C; B, A]. If each force has its own law,
the gain is block diagonal after its rows and columns are sorted. PI and PID laws are static gains on the outputs of fixed
filters, which are y, its integral, and its filtered derivative. Every structure is thus represented by a gain in which some
entries are free and all other entries are zero.
"""

from dataclasses import dataclass, replace

import numpy as np

from models.common.arrays import Array
from models.laws.design_request import LawStructure
from models.laws.law_structure import pid_filter, side_by_side
from models.laws.linear import LinearLaw
from synth.design.descent.landscape import Landscape
from synth.plant.generalized import Plant, gain_law, law_gain

SWEEPS = 10  # number of iterations that balance the law


@dataclass(frozen=True, eq=False)
class StructuredGain:
    """Plant with additional states, for which a law of a given structure is a static gain.

    Attributes:
        plant: plant with n + k states, and the measurements on which the gain acts.
        free: True for entries of the gain that may be nonzero, shape (m + k, q + k); if there are filters, the shape is (m,
            number of filter outputs).
        filters: filters of the measurements, if the gain acts on their outputs; None if the gain is [D, C; B, A].
        shape: shape of the law's D, (m, q).
    """

    plant: Plant
    free: Array
    filters: LinearLaw | None
    shape: tuple[int, int]

    def law(self, gain: Array) -> LinearLaw:
        """Returns the law that a gain of the larger plant represents."""
        if self.filters is not None:
            one = self.filters
            return LinearLaw(one.A, one.B, gain @ one.C, gain @ one.D, one.sample_period)
        m, q = self.shape
        dt = self.plant.dt if len(gain) > m else None
        return gain_law(gain, m, q, dt)

    def gain(self, law: LinearLaw) -> Array:
        """Returns the gain of the larger plant that represents a law, with zeros where the structure requires them."""
        if self.filters is not None:
            return np.where(self.free, _on(self.filters, law), 0.0)
        return np.where(self.free, law_gain(law), 0.0)


def structured_gain(structure: LawStructure, plant: Plant) -> StructuredGain:
    """Returns the plant for which laws of a structure are static gains.

    Args:
        structure: structure of the law. An order of 0 stands for a static gain.
        plant: generalised plant with n states, m inputs and q measurements, continuous or discrete.
    """
    q, m = plant.Dyu.shape
    rows = np.ones((1, q), dtype=bool) if structure.rows is None else np.array(structure.rows, dtype=bool)
    if structure.kind:
        return _on_filters(structure, rows, plant)
    each, count = structure.order, len(rows)
    k = each * count
    owner = np.repeat(np.arange(count), each)  # index of the force to which each state of the law contributes
    own = np.equal.outer(owner, owner)
    if structure.rows is None:
        free = np.ones((m + k, q + k), dtype=bool)
    else:
        free = np.block([[rows, np.equal.outer(np.arange(m), owner)], [rows[owner], own]])
    return StructuredGain(plant.with_states(k), free, None, (m, q))


def _on_filters(structure: LawStructure, rows: Array, plant: Plant) -> StructuredGain:
    """Returns the plant with the filters of a PI or PID law connected to its measurements.

    For a discrete plant, the filters are discrete.
    """
    m, (q, n) = len(rows), plant.Cy.shape
    filters = _filters(structure, rows, plant.dt)
    parts = len(filters.D) // m
    k = filters.states
    larger = Plant(
        A=np.block([[plant.A, np.zeros((n, k))], [filters.B @ plant.Cy, filters.A]]),
        B=np.vstack([plant.B, filters.B @ plant.Dyu]),
        Bw=np.vstack([plant.Bw, filters.B @ plant.Dyw]),
        C=np.hstack([plant.C, np.zeros((len(plant.C), k))]),
        D=plant.D,
        Dw=plant.Dw,
        dt=plant.dt,
        Cy=np.hstack([filters.D @ plant.Cy, filters.C]),
        Dyu=filters.D @ plant.Dyu,
        Dyw=filters.D @ plant.Dyw,
    )
    free = np.kron(np.eye(m), np.ones((1, parts))).astype(bool)
    return StructuredGain(larger, free, filters, (m, q))


def gains_on_filters(structure: LawStructure, law: LinearLaw) -> Array:
    """Returns the gains kp, ki and, for PID, kd of a law with a PI or PID structure, one row for each force."""
    rows = np.array(structure.rows, dtype=float)
    filters = _filters(structure, rows, law.sample_period)
    parts = len(filters.D) // len(rows)
    gain = _on(filters, law)
    return np.array([gain[i, parts * i : parts * (i + 1)] for i in range(len(rows))])


def _on(filters: LinearLaw, law: LinearLaw) -> Array:
    """Returns the gain on the outputs of the filters that is equivalent to a law whose states are the states of the filters.

    The gain is unique, because the filter outputs are linearly independent.
    """
    made = np.hstack([filters.C, filters.D])
    return np.linalg.lstsq(made.T, np.hstack([law.C, law.D]).T, rcond=None)[0].T


def _filters(structure: LawStructure, rows: Array, period: float | None) -> LinearLaw:
    """Returns the filters of a PI or PID law for each force, from all measurements.

    The filters are discrete if a period is given.
    """
    one = pid_filter(structure.kind, structure.filter)
    all_of = side_by_side(one if period is None else one.sampled(period), len(rows))
    return replace(all_of, B=all_of.B @ rows, D=all_of.D @ rows)


def in_equal_units(landscape: Landscape, x: Array, states: int) -> Array:
    """Returns an equivalent point, shape (N,), at which the row and the column of each state of the law have equal norms
    (Osborne 1960).

    Laws that differ only in the units of their states give the same loop. Among equivalent laws, the result has the smallest
    entries.
    """
    if not states:
        return x
    gain = landscape.gain(x) / landscape.scale
    m, q = (count - states for count in gain.shape)
    for _ in range(SWEEPS):
        for i in range(states):
            row, column = np.delete(gain[m + i], q + i), np.delete(gain[:, q + i], m + i)
            into, out = np.linalg.norm(row), np.linalg.norm(column)
            if into > 0 and out > 0:
                unit = np.sqrt(into / out)
                gain[m + i] /= unit
                gain[:, q + i] *= unit
    return landscape.of_entries(gain)
