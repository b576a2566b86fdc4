"""The barrier of `barrier.py` for one X that satisfies (20) of many loops of the same shape.

    S_v = -((20) of loop v) + t I > 0,    X > 0

with the unknowns X (symmetric) and t. With L = -[A; C], R = [I; 0] and P = S^-1 the second derivative of -log det S along unit
matrices e_p e_q' and e_s e_t' instead of X is 2 (g[t, p] g[q, s] + r[t, p] a[q, s]), where g = R' P L, r = L' P L and
a = R' P R, as in `structured_barrier.py`. The sum over the loops is one matrix product, with n^4 operations for each loop.
"""

# pyright: reportAttributeAccessIssue=false
# scipy.linalg.lapack is made by f2py and carries no stubs.

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from models.common.arrays import Array
from synth.lmi.barrier import FactoredDerivatives
from synth.lmi.structured_barrier import SHIFTS


class StackedBarrier:
    """The constraints on X and t.

    Args:
        constant: (20) of V loops with X = 0, shape (V, n + d, n + d).
        system: matrices [A; C] of the systems, shape (V, n + d, n).
    """

    def __init__(self, constant: Array, system: Array) -> None:
        n = system.shape[2]
        self.shape = system.shape
        self.constant, self.system = constant, system
        self.rows, self.columns = np.triu_indices(n)
        self.weight = np.where(self.rows == self.columns, 0.5, 1.0)  # diagonal entries would count twice
        self.upper = self.rows * n + self.columns

    def matrix(self, p: Array) -> Array:
        """Returns X of the unknowns, shape (n, n)."""
        n = self.shape[2]
        X = np.zeros((n, n))
        X[self.rows, self.columns] = X[self.columns, self.rows] = p[:-1]
        return X

    def unknowns(self, X: Array) -> Array:
        """Returns the unknowns of X."""
        return X[self.rows, self.columns]

    def change(self, X: Array, t: float) -> Array:
        """Returns the change of every loop's S by X and t, shape (V, n + d, n + d)."""
        V, k, n = self.shape
        S, left = np.tile(t * np.eye(k), (V, 1, 1)), self.system @ X
        S[:, :, :n] -= left
        S[:, :n, :] -= left.swapaxes(1, 2)
        return S

    def at(self, p: Array) -> "StackedLocal | None":
        """Returns the derivatives at a point, or None outside the feasible set."""
        n, X = self.shape[2], self.matrix(p)
        try:
            inverse = np.linalg.inv(np.linalg.cholesky(self.change(X, p[-1]) - self.constant))
            alone = np.linalg.inv(np.linalg.cholesky(X))
        except np.linalg.LinAlgError:
            return None
        P, of_x = inverse.swapaxes(1, 2) @ inverse, alone.T @ alone
        PL = -P @ self.system
        g, r, a = PL[:, :n], -self.system.swapaxes(1, 2) @ PL, P[:, :n, :n]
        trace = np.append(self._both(2 * g.sum(axis=0) + of_x), np.einsum("vii->", P))
        # X > 0 is like a loop with L = R = I / 2^(1/2), without t.
        one, two = (np.concatenate([*pair, of_x[None] / 2**0.5]).reshape(-1, n * n) for pair in ((g, r), (g, a)))
        hessian = np.empty((len(p), len(p)))
        hessian[:-1, :-1] = self._folded((one.T @ two).reshape(n, n, n, n))
        hessian[:-1, -1] = hessian[-1, :-1] = self._both(2 * (P[:, :n] @ PL).sum(axis=0))
        hessian[-1, -1] = np.vdot(P, P)
        scale = 1 / np.sqrt(np.diagonal(hessian))
        hessian *= scale[:, None] * scale
        for shift in (0.0, *SHIFTS):
            np.fill_diagonal(hessian, 1 + shift)
            triangle, failed = lapack.dpotrf(hessian, lower=0, clean=0)
            if not failed:
                return StackedLocal(trace, scale, triangle, self, inverse, alone)
        return None

    def _both(self, Z: Array) -> Array:
        """Returns the derivative of tr(Z X) with respect to every unknown of X."""
        return self.weight * (Z[self.rows, self.columns] + Z[self.columns, self.rows])

    def _folded(self, M: Array) -> Array:
        """Returns second derivatives along the unknowns of X, from half of those along e_p e_q', e_s e_t', indexed t, p, q, s."""
        n = len(M)
        both = M + M.swapaxes(1, 2)  # p and q
        both += both.transpose(3, 1, 2, 0)  # s and t
        along = both.transpose(1, 2, 3, 0).reshape(n * n, n * n)
        return 2 * self.weight[:, None] * self.weight * along[np.ix_(self.upper, self.upper)]


@dataclass(frozen=True, eq=False)
class StackedLocal(FactoredDerivatives):
    """Derivatives at a point, with inverse Cholesky factors of every S, shape (V, n + d, n + d), and of X, shape (n, n)."""

    barrier: StackedBarrier
    inverse: Array
    alone: Array

    def rates(self, step: Array) -> Array:
        """Returns `FactoredDerivatives.rates`."""
        X = self.barrier.matrix(step)
        of_loops = np.linalg.eigvalsh(self.inverse @ self.barrier.change(X, step[-1]) @ self.inverse.swapaxes(1, 2))
        return np.concatenate([of_loops.ravel(), np.linalg.eigvalsh(self.alone @ X @ self.alone.T)])
