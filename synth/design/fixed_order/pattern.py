"""A structure of a law as a static gain of a larger plant, and the way back.

A law of k states is u = D y + C x_c, v = B y + A x_c on the plant with k integrators x_c' = v (`plant/augmented.py`): its gain is
[D, C; B, A]. Laws of their own for each force make it block diagonal, up to the order of rows and columns. PI and PID are static
gains on what fixed filters make of the measurements: y, its integral, and its filtered derivative. So every structure is linear,
some entries of a gain that are free and zeros elsewhere.
"""

from dataclasses import dataclass, replace

import numpy as np

from models.common.arrays import Array
from models.laws.law_structure import LawStructure, pid_filter, side_by_side
from models.laws.linear import LinearLaw
from synth.design.descent.landscape import Landscape
from synth.plant.augmented import on_larger_plant
from synth.plant.generalized import GeneralizedPlant

SWEEPS = 10  # of balancing


@dataclass(frozen=True, eq=False)
class StructuredGain:
    """A plant on which a law of some structure is a static gain.

    Attributes:
        plant: n + k states.
        Cy, Dyw, through: matrices of the measurements, y = C_y x + Dyw w + `through` u.
        free: True for entries of the gain that may be other than zero, shape (m + k, q + k), or (m, q') of filters.
        filters: filters of the measurements, if the gain is on their outputs; None if the gain is [D, C; B, A].
        shape: shape of the law's D, (m, q).
    """

    plant: GeneralizedPlant
    Cy: Array
    Dyw: Array | None
    through: Array | None
    free: Array
    filters: LinearLaw | None
    shape: tuple[int, int]

    def law(self, gain: Array) -> LinearLaw:
        """Returns the law of a gain."""
        if self.filters is not None:
            one = self.filters
            return LinearLaw(one.A, one.B, gain @ one.C, gain @ one.D, one.sample_period)
        m, q = self.shape
        dt = self.plant.dt if len(gain) > m else None
        return LinearLaw(A=gain[m:, q:], B=gain[m:, :q], C=gain[:m, q:], D=gain[:m, :q], sample_period=dt)

    def gain(self, law: LinearLaw) -> Array:
        """Returns the gain of a law, without what the structure does not have."""
        if self.filters is not None:
            return np.where(self.free, _on(self.filters, law), 0.0)
        return np.where(self.free, np.block([[law.D, law.C], [law.B, law.A]]), 0.0)


def structured_gain(
    structure: LawStructure, plant: GeneralizedPlant, Cy: Array, Dyw: Array | None, through: Array | None
) -> StructuredGain:
    """Returns the plant on which laws of a structure are static gains.

    Args:
        structure: structure of the law; an order of 0 is a static gain.
        plant: n states, m inputs, continuous or discrete.
        Cy: shape (q, n).
        Dyw: shape (q, r); None for zero.
        through: feedthrough from forces to measurements, of a continuous plant, shape (q, m); None for zero.
    """
    q, m = len(Cy), plant.B.shape[1]
    rows = np.ones((1, q), dtype=bool) if structure.rows is None else np.array(structure.rows, dtype=bool)
    if structure.kind:
        return _on_filters(structure, rows, plant, Cy, Dyw, through)
    each, count = structure.order, len(rows)
    k = each * count
    larger, G = on_larger_plant(plant, Cy, LinearLaw(np.zeros((k, k)), np.zeros((k, q)), np.zeros((m, k)), np.zeros((m, q))))
    owner = np.repeat(np.arange(count), each)  # of each state
    own = np.equal.outer(owner, owner)
    if structure.rows is None:
        free = np.ones((m + k, q + k), dtype=bool)
    else:
        free = np.block([[rows, np.equal.outer(np.arange(m), owner)], [rows[owner], own]])
    noise = None if Dyw is None else np.vstack([Dyw, np.zeros((k, Dyw.shape[1]))])
    felt = None if through is None else np.block([[through, np.zeros((q, k))], [np.zeros((k, m + k))]])
    return StructuredGain(larger, G.Cy, noise, felt, free, None, (m, q))


def _on_filters(
    structure: LawStructure, rows: Array, plant: GeneralizedPlant, Cy: Array, Dyw: Array | None, through: Array | None
) -> StructuredGain:
    """The plant with the filters of PI or PID behind its measurements; a discrete plant has them as a computer runs them."""
    m, (q, n) = len(rows), Cy.shape
    filters = _filters(structure, rows, plant.dt)
    parts = len(filters.D) // m
    k, (d, r) = filters.states, plant.Dw.shape
    noise = np.zeros((q, r)) if Dyw is None else Dyw
    felt = np.zeros((q, m)) if through is None else through
    larger = GeneralizedPlant(
        A=np.block([[plant.A, np.zeros((n, k))], [filters.B @ Cy, filters.A]]),
        B=np.vstack([plant.B, filters.B @ felt]),
        Bw=np.vstack([plant.Bw, filters.B @ noise]),
        C=np.hstack([plant.C, np.zeros((d, k))]),
        D=plant.D,
        Dw=plant.Dw,
        dt=plant.dt,
    )
    free = np.kron(np.eye(m), np.ones((1, parts))).astype(bool)
    measured = np.hstack([filters.D @ Cy, filters.C])
    heard = None if Dyw is None else filters.D @ noise
    return StructuredGain(larger, measured, heard, None if through is None else filters.D @ felt, free, filters, (m, q))


def gains_on_filters(structure: LawStructure, law: LinearLaw) -> Array:
    """Returns kp, ki and, of PID, kd of a law of such a structure, a row for each force."""
    rows = np.array(structure.rows, dtype=float)
    filters = _filters(structure, rows, law.sample_period)
    parts = len(filters.D) // len(rows)
    gain = _on(filters, law)
    return np.array([gain[i, parts * i : parts * (i + 1)] for i in range(len(rows))])


def _on(filters: LinearLaw, law: LinearLaw) -> Array:
    """The gain on what filters give that makes a law of their states; their outputs are independent of one another."""
    made = np.hstack([filters.C, filters.D])
    return np.linalg.lstsq(made.T, np.hstack([law.C, law.D]).T, rcond=None)[0].T


def _filters(structure: LawStructure, rows: Array, period: float | None) -> LinearLaw:
    """The filters of PI or PID of all forces, from all measurements; of a discrete plant as a computer runs them."""
    one = pid_filter(structure.kind, structure.filter)
    all_of = side_by_side(one if period is None else one.sampled(period), len(rows))
    return replace(all_of, B=all_of.B @ rows, D=all_of.D @ rows)


class LawUnits:
    """Laws that differ by the units of their states, and make the same loop: those whose gains have the smallest entries."""

    def __init__(self, landscape: Landscape, states: int) -> None:
        self.landscape, self.states = landscape, states

    def smallest(self, x: Array) -> Array:
        """Returns the point whose rows and columns of each state have one size (Osborne 1960), shape (N,)."""
        if not self.states:
            return x
        gain = self.landscape.gain(x) / self.landscape.scale
        m, q = (count - self.states for count in gain.shape)
        for _ in range(SWEEPS):
            for i in range(self.states):
                row, column = np.delete(gain[m + i], q + i), np.delete(gain[:, q + i], m + i)
                into, out = np.linalg.norm(row), np.linalg.norm(column)
                if into > 0 and out > 0:
                    unit = np.sqrt(into / out)
                    gain[m + i] /= unit
                    gain[:, q + i] *= unit
        return self.landscape.of_entries(gain)
