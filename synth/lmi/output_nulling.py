"""States that a gain F can make unobservable in z: if the loop with u = F x starts in such a state, z = (C + D F) x remains 0."""

from collections.abc import Iterator

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from synth.analysis.stability import balance
from synth.plant.generalized import Plant

RANK = 1e-9  # a singular value below this multiple of the largest one counts as zero


def output_nulling_gains(plant: Plant) -> Iterator[Array]:
    """Yields gains that may make states unobservable in z: the zero gain and, if z weights every force, -D^+ C."""
    yield np.zeros_like(plant.B.T)
    W = plant.independent_inputs()
    D = plant.D @ W
    if D.shape[1] and np.any(D) and np.linalg.matrix_rank(D, RANK * np.linalg.norm(D)) == D.shape[1]:
        F = -W @ np.linalg.pinv(D) @ plant.C
        if np.linalg.norm(plant.D @ F) > RANK * np.linalg.norm(plant.C):
            yield F


def in_balanced_coordinates(plant: Plant, T: Array) -> tuple[Plant, Array]:
    """Returns the plant in coordinates in which ranks are determined (the columns of T, divided by their lengths), and these
    lengths.
    """
    lengths = np.linalg.norm(T / balance(plant.A)[1][:, None], axis=0)
    return plant.in_coordinates(T / lengths), lengths


def hides_stable_states(plant: Plant, T: Array, step: float) -> bool:
    """Returns True if some gain makes stable states unobservable in z. For T and step, see `remove_unobservable`."""
    moved, _ = in_balanced_coordinates(plant, T)
    return any(output_nulling_subspace(moved, F, step)[0].shape[1] for F in output_nulling_gains(moved))


def sees_every_state(plant: Plant) -> bool:
    """Returns True if every state is observable in z, both without control and with the gain -D^+ C."""
    return not any(output_nulling_subspace(plant, F)[1].shape[1] for F in output_nulling_gains(plant))


def output_nulling_subspace(plant: Plant, F: Array, step: float = 0.0) -> tuple[Array, Array]:
    """Returns orthonormal bases of stable states, and of all states, that are unobservable in z for u = F x; shapes (n, k)."""
    n = len(plant.A)
    loop = plant.closed_loop(F) if F.any() else plant
    terms = np.linalg.norm(plant.C, axis=1) + np.linalg.norm(plant.D, axis=1) * np.linalg.norm(F)
    lengths = np.linalg.norm(loop.C, axis=1)
    counts = lengths > RANK * terms
    rows, size = loop.C[counts] / lengths[counts, None], float(np.linalg.norm(loop.A))
    observable = np.zeros((0, n))
    while len(rows) and len(observable) < n:
        _, sizes, directions = np.linalg.svd(np.vstack([observable, rows]))
        observable = directions[: int(np.sum(sizes > RANK))]
        rows = observable @ loop.A
        rows = rows - rows @ observable.T @ observable
        lengths = np.linalg.norm(rows, axis=1)
        rows = rows[lengths > RANK * size] / size
    V = complement(observable.T)
    if not V.shape[1]:
        return V, V
    slow = RANK * size  # a mode with a smaller decay rate counts as undamped, because of rounding

    def decays(real: float, imaginary: float) -> bool:  # True for an eigenvalue s with |1 + step s| < 1
        return real + step * (real**2 + imaginary**2) / 2 < -slow

    _, vectors, count = linalg.schur(V.T @ loop.A @ V, sort=decays)  # pyright: ignore[reportAssignmentType]
    return V @ vectors[:, :count], V


def complement(V: Array) -> Array:
    """Returns an orthonormal basis of the orthogonal complement of the space that the columns of V span, shape (n, n - k)."""
    return np.linalg.svd(V.T)[2][V.shape[1] :].T
