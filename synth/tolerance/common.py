"""One X of (20) for all corners of a box at once, by Newton's method on a barrier.

    minimise t   so that   (20) of every loop  <=  t I,   X > 0,

in coordinates in which a first X is I; once t is below zero, X will do. Few corners decide: those at which an X fails join the
ones that it is found for, and others need not.
"""

import numpy as np

from models.common.arrays import Array
from synth.certificate.box import Box, Loops, ScaledGain, lmi
from synth.lmi.barrier import Barrier, newton

FASTER = 8.0  # how much weight t gains from one centre to the next
CENTRES = 14  # of the path; then t is known to eight digits
NEAR = 1e-2  # of the Newton decrement at a centre
JOIN = 4  # corners that join in a round


def common_x(gain: ScaledGain, box: Box, start: Array, eta: float) -> Array | None:
    """An X that satisfies (20) at all corners of a box, shape (n, n); None where there is none, or next to none.

    Args:
        gain: its loops.
        box: of no more than `certificate.box.MOST` free factors.
        start: X > 0 to start from, as near as is known, shape (n, n).
        eta: gamma^-2.

    Raises:
        LinAlgError: rounding leaves no answer.
    """
    everywhere, X = gain.loops(box.corners), start
    among = np.zeros(0, dtype=int)
    while True:
        highest = _highest(everywhere, X, eta)
        # The first X is on the verge wherever it does: rounding would leave no proof.
        failing = np.setdiff1d(np.flatnonzero(highest >= 0), among) if len(among) else np.arange(len(highest))
        if not len(failing):
            return X if highest.max() < 0 else None
        among = np.concatenate([among, failing[np.argsort(-highest[failing], kind="stable")[:JOIN]]])
        found = _for_all(Loops(*(part[among] for part in everywhere)), X, eta)
        if found is None:
            return None
        X = found


def _highest(loops: Loops, X: Array, eta: float) -> Array:
    """The largest eigenvalue of (20) of each loop, in coordinates in which X is I, shape (V,)."""
    n, k = len(X), len(X) + loops.C.shape[-2]
    inverse = np.eye(k)
    inverse[:n, :n] = np.linalg.inv(np.linalg.cholesky(X))
    return np.linalg.eigvalsh(inverse @ lmi(loops, X, eta) @ inverse.T)[:, -1]


def _for_all(loops: Loops, start: Array, eta: float) -> Array | None:
    """An X that satisfies (20) of every loop; None where there is none."""
    T = np.linalg.cholesky(start)
    inverse = np.linalg.inv(T)
    own = Loops(inverse @ loops.A @ T, inverse @ loops.Bw, loops.C @ T, loops.Dw)
    n, k = len(T), len(T) + own.C.shape[-2]
    rows, columns = np.triu_indices(n)
    units, index = np.zeros((len(rows), n, n)), np.arange(len(rows))
    units[index, rows, columns] = units[index, columns, rows] = 1.0
    system = np.concatenate([own.A, own.C], axis=-2)
    constant = -lmi(own, np.zeros((n, n)), eta)
    blocks = [(np.zeros((n, n)), np.concatenate([units, np.zeros((1, n, n))]))]
    for F0, left in zip(constant, system[:, None] @ units, strict=True):
        F = np.zeros((len(units) + 1, k, k))
        F[:-1, :, :n] -= left
        F[:-1, :n, :] -= left.swapaxes(-1, -2)
        F[-1] = np.eye(k)
        blocks.append((F0, F))
    barrier = Barrier(blocks)
    p = np.append((rows == columns).astype(float), 0.0)
    least = max(float(-np.linalg.eigvalsh(F0 + np.tensordot(p, F, 1))[0]) for F0, F in blocks[1:])
    p[-1] = 1.5 * max(least, 1e-3)
    c, weight, count = np.zeros(len(p)), 1.0 / p[-1], n + len(constant) * k
    for _ in range(CENTRES):
        c[-1] = weight
        p, _, _ = newton(barrier, p, c, NEAR, leave=lambda p: p[-1] < 0)
        if p[-1] < 0:
            X = np.zeros((n, n))
            X[rows, columns] = X[columns, rows] = p[:-1]
            X = T @ X @ T.T
            return (X + X.T) / 2
        if p[-1] > 2 * count / weight:  # a centre's t is no further than that from the least
            return None
        weight *= FASTER
    return None
