"""Stability proofs for all loops of a box of errors by a parameter-dependent Lyapunov function.

    minimise t   so that   (the inequality of `synth/analysis/uncertainty_box.py`)  <=  t I,   X_i > 0,

by Newton's method on a barrier, in coordinates in which the middle of the box has X = I and its fastest pole the rate 1; once t
is below zero, it is proved.
"""

import warnings

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from synth.analysis.uncertainty_box import Box, Loops, ParameterDependentLyapunov, ScaledGain, left_side
from synth.lmi.barrier import Barrier, newton

MOST_UNKNOWNS = 700  # of one problem: a second
CLOSER = (1e-3, 1e-2, 0.1)  # relative; how far above the largest norm met a bound is tried
PARTS = 12  # into which a box may fall
BEGIN = 0.1  # G at the start, in the coordinates of the middle
FASTER, CENTRES, NEAR = 8.0, 16, 1e-2  # of the path, as in `worst_case.py`
LARGEST = 1e3  # of X, F and G, where the middle's X is I: the inequality is homogeneous, and they would grow without end


def unknowns(gain: ScaledGain, box: Box) -> int:
    """Returns the number of unknowns of the problem of a box."""
    n = len(gain.plant.A)
    return 2 ** len(box.uncertain) * n * (n + 1) // 2 + 2 * n * n + 1


def stable_throughout(gain: ScaledGain, box: Box) -> list[tuple[Box, ParameterDependentLyapunov]] | None:
    """Returns parts that fill a box, each with a stability proof of all its loops; None if no proof is found.

    Args:
        box: box with as many free factors as `MOST_UNKNOWNS` allows.
    """
    if unknowns(gain, box) > MOST_UNKNOWNS:
        return None
    todo, done = [box], []
    while todo:
        part = todo.pop()
        try:
            proof = moving_x(gain, part)
        except (np.linalg.LinAlgError, ValueError):  # rounding leaves no answer
            proof = None
        if proof is not None and proof.holds(gain, part):
            done.append((part, proof))
        elif len(todo) + len(done) + 2 > PARTS or not len(part.uncertain):
            return None
        else:
            todo += part.bisect(int(part.uncertain[np.argmax((part.high - part.low)[part.uncertain])]))
    return done


def bound_throughout(gain: ScaledGain, box: Box, largest: float) -> float:
    """Returns a proved bound on all norms of a box, just above the largest norm found; infinite if none is proved."""
    if unknowns(gain, box) > MOST_UNKNOWNS:
        return np.inf
    for above in CLOSER:
        try:
            proof = moving_x(gain, box, largest * (1 + above))
        except (np.linalg.LinAlgError, ValueError):  # rounding leaves no answer
            continue
        if proof is not None and proof.holds(gain, box):
            return proof.gamma
    return np.inf


def moving_x(gain: ScaledGain, box: Box, gamma: float = np.inf) -> ParameterDependentLyapunov | None:
    """Returns matrices that satisfy the inequality at all corners of a box; None if it is infeasible, or nearly.

    Args:
        gamma: a bound on its norms; infinite for stability alone.

    Raises:
        LinAlgError: rounding leaves no answer.
    """
    if not gain.well_posed(box):
        return None
    everywhere, middle = gain.loops(box.vertices), gain.loops(box.middle)
    if not np.all(np.linalg.eigvals(everywhere.A).real < 0) or not np.all(np.linalg.eigvals(middle.A).real < 0):
        return None
    T, rate = own_coordinates(middle.A)
    whole = np.isfinite(gamma)
    if whole:  # what w moves x by has size one
        T = T * (np.linalg.norm(np.linalg.solve(T, middle.Bw), 2) / rate)
    inverse, unit = np.linalg.inv(T), gamma if whole else 1.0
    A, Bw, C, Dw = everywhere
    own = Loops(inverse @ A @ T / rate, inverse @ Bw / rate, C @ T / unit, Dw / unit)
    start = _own_x(own, 1.0 if whole else np.inf)
    if start is None:
        return None
    X, F, G = (unit / rate * inverse.T @ matrix @ inverse for matrix in (start.X, start.F, start.G / rate))
    return ParameterDependentLyapunov((X + X.swapaxes(-1, -2)) / 2, F, G, gamma)


def _own_x(loops: Loops, gamma: float) -> ParameterDependentLyapunov | None:
    """The same in coordinates and units in which all numbers have size one."""
    (V, n, r), d = loops.Bw.shape, loops.C.shape[1]
    k = 2 * n + (r + d if np.isfinite(gamma) else 0)
    rows, columns = np.triu_indices(n)
    N = len(rows)
    count = V * N + 2 * n * n + 1
    symmetric = np.zeros((N, n, n))
    symmetric[np.arange(N), rows, columns] = symmetric[np.arange(N), columns, rows] = 1.0
    general, zero = np.eye(n * n).reshape(n * n, n, n), np.zeros((n, n))
    blocks = []
    for i in range(V):
        one, at = Loops(*(part[i : i + 1] for part in loops)), slice(i * N, (i + 1) * N)
        constant = -left_side(one, zero, zero, zero, gamma)[0]
        F, alone = np.zeros((count, k, k)), np.zeros((count, n, n))
        F[at] = [-left_side(one, X, zero, zero, gamma)[0] - constant for X in symmetric]
        F[V * N : V * N + n * n] = [-left_side(one, zero, part, zero, gamma)[0] - constant for part in general]
        F[V * N + n * n : -1] = [-left_side(one, zero, zero, part, gamma)[0] - constant for part in general]
        F[-1], alone[at] = np.eye(k), symmetric
        blocks += [(constant, F), (zero, alone), (LARGEST * np.eye(n), -alone)]
    for start in (V * N, V * N + n * n):  # norms of F and G
        among = np.zeros((count, 2 * n, 2 * n))
        among[start : start + n * n, :n, n:], among[start : start + n * n, n:, :n] = general, general.swapaxes(-1, -2)
        blocks.append((LARGEST * np.eye(2 * n), among))
    p = np.zeros(count)
    p[: V * N] = np.tile((rows == columns).astype(float), V)
    p[V * N : V * N + n * n] = np.eye(n).ravel()
    p[V * N + n * n : -1] = BEGIN * np.eye(n).ravel()
    least = max(-float(np.linalg.eigvalsh(F0 + np.tensordot(p, F, 1))[0]) for F0, F in blocks[: 3 * V : 3])
    p[-1] = 1.5 * max(least, 1e-3)
    barrier, c, weight = Barrier(blocks), np.zeros(count), 1.0 / p[-1]
    for _ in range(CENTRES):
        c[-1] = weight
        p, _, _ = newton(barrier, p, c, NEAR, leave=lambda p: p[-1] < 0)
        if p[-1] < 0:
            X = np.zeros((V, n, n))
            X[:, rows, columns] = X[:, columns, rows] = p[: V * N].reshape(V, N)
            F, G = p[V * N : -1].reshape(2, n, n)
            return ParameterDependentLyapunov(X, F, G, gamma)
        weight *= FASTER
    return None


def own_coordinates(A: Array) -> tuple[Array, float]:
    """Returns T with x = T (new coordinates), in which a stable A has the Lyapunov matrix I, and A's fastest rate [1/s].

    Raises:
        LinAlgError: A is not stable beyond rounding.
    """
    balanced, units = linalg.matrix_balance(A, permute=False)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        try:
            X = linalg.solve_continuous_lyapunov(balanced.T, -np.eye(len(A)))
        except RuntimeWarning as error:  # LAPACK has solved for other coefficients: two poles add up to zero, to rounding
            raise np.linalg.LinAlgError("the loop is marginally stable to rounding") from error
    return units @ np.linalg.inv(np.linalg.cholesky((X + X.T) / 2).T), float(np.abs(np.linalg.eigvals(A)).max())
