"""Gains that differ and make the same loop.

If the plant's state holds a controller's states, as with a law written as a static gain of the larger plant, their units are
free. Another choice changes the gain, and nothing else. In general, with a T for which

    T A = A T,   T B = B R,   C_y T = S C_y,   C T = 0,   T Bw = 0,   S Dyw = 0,

the gains e^R K e^-S make the same answer to w, for the state e^T x. So a bound on the entries of a gain counts where they are
smallest.
"""

import numpy as np
from scipy import linalg, optimize

from models.common.arrays import Array
from synth.design.descent.landscape import Landscape
from synth.lmi.unobservable import output_nulling_subspace
from synth.plant.generalized import Plant
from synth.plant.units import size

RANK = 1e-10  # relative; a singular value this small counts as none
SAME = 1e-9  # relative; what rounding makes of an entry that is the same for all that are alike
SMALL = (
    16  # states; with more, T is sought where it must lie: C T = 0 and T A = A T keep it where z sees nothing, T Bw = 0 likewise
)


class Symmetry:
    """The gains that are alike to any gain of one plant."""

    def __init__(self, landscape: Landscape) -> None:
        self.landscape = landscape
        plant = landscape.plant
        A, B, Cy, C, Bw, Dyw = (each / size(each) for each in (plant.A, plant.B, plant.Cy, plant.C, plant.Bw, plant.Dyw))
        n, m = B.shape
        into, out = (np.eye(n), np.eye(n)) if n <= SMALL else (_silent(A, C), _silent(A.T, Bw.T))
        # T = into M out', and S follows from T.
        shape, blind = (into.shape[1], out.shape[1]), linalg.null_space(Cy)
        of_M = [
            np.kron(np.eye(shape[0]), out.T @ A.T @ out) - np.kron(into.T @ A @ into, np.eye(shape[1])),
            np.kron(C @ into, np.eye(shape[1])),
            np.kron(np.eye(shape[0]), Bw.T @ out),
            np.kron(Cy @ into, blind.T @ out),
            np.kron(Cy @ into, (np.linalg.pinv(Cy) @ Dyw).T @ out),
        ]
        with_R = np.hstack([np.kron(into, B.T @ out), -np.kron(B, np.eye(m))])
        alone = np.vstack(of_M)
        free = linalg.null_space(np.vstack([np.hstack([alone, np.zeros((len(alone), m * m))]), with_R]), RANK).T
        T = into @ free[:, : shape[0] * shape[1]].reshape(len(free), *shape) @ out.T
        self.R = free[:, shape[0] * shape[1] :].reshape(len(free), m, m)
        self.S = Cy @ T @ np.linalg.pinv(Cy)

    def smallest(self, x: Array) -> Array:
        """The point alike to a point whose gain has the smallest entries, or the point itself, shape (m q,)."""
        K = self.landscape.gain(x)
        if not len(self.R) or not K.any():
            return x

        def alike(t: Array) -> Array:
            R, S = np.tensordot(t, self.R, 1), np.tensordot(t, self.S, 1)
            return linalg.expm(R) @ K @ linalg.expm(-S)

        def log_size(t: Array) -> float:
            return float(np.log(np.sum(alike(t) ** 2)))

        nothing = np.zeros(len(self.R))
        start, minimum = log_size(nothing), optimize.minimize(log_size, nothing, method="BFGS")
        other = self.landscape.point(alike(minimum.x))
        # The largest entry may be one that is the same in all; of no other may it be one.
        smaller = minimum.fun < start and np.abs(alike(minimum.x)).max() <= np.abs(K).max() * (1 + SAME)
        norm, moved = self.landscape.norm(x)[0], self.landscape.norm(other)[0]
        same = abs(moved - norm) <= 1e-9 * min(moved, norm)  # rounding where the units differ much
        return other if smaller and same else x


def _silent(A: Array, C: Array) -> Array:
    """An orthonormal basis of the states that C never shows while A moves them, shape (n, k)."""
    n = len(A)
    nothing = np.zeros((n, 1))
    return output_nulling_subspace(Plant(A, nothing, nothing, C, np.zeros((len(C), 1)), np.zeros((len(C), 1))), nothing.T)[1]
