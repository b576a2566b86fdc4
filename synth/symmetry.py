"""Gains that differ and make the same loop.

Where the plant's state holds what a controller remembers (a controller of some order, written as a static gain of the larger
plant), the units of that memory are free: another choice changes the gain, and nothing else. In general, with a T for which

    T A = A T,   T B = B R,   C_y T = S C_y,   C T = 0,   T Bw = 0,

the gains e^R K e^-S make the same answer to w, for the state e^T x. So a bound on the entries of a gain counts where they are
smallest.
"""

import numpy as np
from scipy import linalg, optimize

from models.arrays import Array
from synth.landscape import Landscape
from synth.scaling import size

RANK = 1e-10  # relative; a singular value this small counts as none


class Symmetry:
    """The gains that are alike to any gain of one plant."""

    def __init__(self, landscape: Landscape) -> None:
        """Args:
        landscape: of the plant.
        """
        self.landscape = landscape
        A, B, Cy, C, Bw = (
            matrix / size(matrix) for matrix in (landscape.A, landscape.B, landscape.Cy, landscape.C, landscape.Bw)
        )
        n, m, q = len(A), B.shape[1], len(Cy)

        def rows(of_T: Array, of_R: Array | None = None, of_S: Array | None = None) -> Array:
            """Equations for T, R and S, each flattened row by row."""
            nothing = [np.zeros((len(of_T), k * k)) for k in (m, q)]
            return np.hstack([of_T, nothing[0] if of_R is None else of_R, nothing[1] if of_S is None else of_S])

        equations = [
            rows(np.kron(np.eye(n), A.T) - np.kron(A, np.eye(n))),
            rows(np.kron(np.eye(n), B.T), of_R=-np.kron(B, np.eye(m))),
            rows(np.kron(Cy, np.eye(n)), of_S=-np.kron(np.eye(q), Cy.T)),
            rows(np.kron(C, np.eye(n))),
            rows(np.kron(np.eye(n), Bw.T)),
        ]
        _, sizes, directions = np.linalg.svd(np.vstack(equations))
        free = directions[int(np.sum(sizes > RANK * sizes[0])) :]
        self.R = free[:, n * n : n * n + m * m].reshape(-1, m, m)
        self.S = free[:, n * n + m * m :].reshape(-1, q, q)

    def smallest(self, x: Array) -> Array:
        """The point alike to a point whose gain has the smallest entries, or the point itself, shape (m q,)."""
        K = self.landscape.gain(x)
        if not len(self.R) or not K.any():
            return x

        def alike(t: Array) -> Array:
            R, S = np.tensordot(t, self.R, 1), np.tensordot(t, self.S, 1)
            return linalg.expm(R) @ K @ linalg.expm(-S)

        found = optimize.minimize(lambda t: np.log(np.sum(alike(t) ** 2)), np.zeros(len(self.R)), method="BFGS")
        other = self.landscape.point(alike(found.x))
        smaller = np.abs(alike(found.x)).max() < np.abs(K).max()
        same = abs(self.landscape.norm(other)[0] / self.landscape.norm(x)[0] - 1) < 1e-9  # rounding where the units differ much
        return other if smaller and same else x
