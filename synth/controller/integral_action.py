"""Integral action: a law whose states are integrals of its readings, as a law on these integrals, and the way back.

An integral that z weighs has to return to zero, or z has no norm. So a law that is designed for it feeds it back: its first
states are integrals of its readings, x_c' = S y. Those are states of the plant, too, and a loop that had both would hold a
difference of the two that never decays. So it has them once: the law is taken as one on [y; integrals].

A law without them may have a norm all the same, where what is integrated is zero at 0 rad/s whatever the road does. With
x' = A x + B w of the loop and c x + d w integrated, the integral is then c A^-1 x: its derivative is c x + c A^-1 B w, and
c A^-1 B = d says that the transfer function d - c A^-1 B is zero there.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from models.common.arrays import Array
from models.laws.linear import LinearLaw
from synth.analysis.stability import beside_weights, is_stable
from synth.plant.generalized import Plant

RETURNS = 1e-9  # relative to the sum of the terms' sizes: less is zero at 0 rad/s


def with_integrators(law: LinearLaw, integrated: Array) -> LinearLaw:
    """Returns the law on readings y of a law on [y; integrals of S y], S of shape (j, q): the integrals are its first states."""
    (j, q), k = integrated.shape, law.states
    A = np.block([[np.zeros((j, j + k))], [law.B[:, q:], law.A]])
    B = np.vstack([integrated, law.B[:, :q]])
    return LinearLaw(A, B, np.hstack([law.D[:, q:], law.C]), law.D[:, :q], law.sample_period, law.anti_windup)


def integrators_of(law: LinearLaw, integrated: Array | None) -> dict[int, tuple[int, float]]:
    """Returns the integrals that a continuous law keeps: its state of each, and that state over the integral, by row of S.

    Args:
        integrated: S, shape (j, q); None for none.
    """
    states: dict[int, tuple[int, float]] = {}
    for row, factors in enumerate(() if integrated is None else integrated):
        at = int(np.flatnonzero(factors)[0])
        for i in np.flatnonzero(~np.any(law.A, axis=1) & (law.B[:, at] != 0)).tolist():
            ratio = float(law.B[i, at] / factors[at])
            if np.array_equal(law.B[i], ratio * factors) and i not in [state for state, _ in states.values()]:
                states[row] = i, ratio
                break
    return states


def on_integrals(law: LinearLaw, integrated: Array | None, kept: Mapping[int, tuple[int, float]]) -> LinearLaw:
    """Returns the law on [y; integrals of S y] of a law on readings y, without the states that are such integrals.

    Args:
        integrated: S, shape (j, q); None for none.
        kept: result of `integrators_of`; integrals that the law does not keep are measured, and act on nothing.
    """
    if integrated is None:
        return law
    own = [i for i in range(law.states) if i not in [state for state, _ in kept.values()]]
    (m, q), j = law.D.shape, len(integrated)
    B, D = np.zeros((len(own), q + j)), np.zeros((m, q + j))
    B[:, :q], D[:, :q] = law.B[own], law.D
    for row, (i, ratio) in kept.items():
        B[:, q + row], D[:, q + row] = law.A[own, i] * ratio, law.C[:, i] * ratio
    return LinearLaw(law.A[np.ix_(own, own)], B, law.C[:, own], D, anti_windup=law.anti_windup)


def settled_integrals(loop: Plant, plant: Plant, lacking: Sequence[int]) -> Array | None:
    """Returns integrals as combinations of the other states of a loop, shape (len(lacking), n - len(lacking)).

    None if such an integral does not return to zero: the rest of the loop does not decay, or w moves what is integrated at
    0 rad/s.

    Args:
        loop: n states, of which the integrals act on z alone.
        plant: plant without the law's states, which follow its own.
        lacking: states that are such integrals.
    """
    stay = np.setdiff1d(np.arange(len(loop.A)), lacking)
    A, c, d = loop.A[stay][:, stay], loop.A[lacking][:, stay], loop.Bw[lacking]
    others = beside_weights(plant, loop.A)  # weights' states stand behind the integrals
    if not is_stable(np.delete(np.delete(others, lacking, axis=0), lacking, axis=1)):
        return None
    rows = np.linalg.solve(A.T, c.T).T
    left, size = np.abs(d - rows @ loop.Bw[stay]), np.abs(d) + np.abs(rows) @ np.abs(loop.Bw[stay])
    return rows if np.all(left <= RETURNS * size) else None
