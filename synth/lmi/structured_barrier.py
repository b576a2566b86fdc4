"""The barrier of `barrier.py` for unknowns that are entries of matrices: n^4 operations instead of the n^6 of a dense basis.

Every constraint of the central path has the form

    S = S0 + L [X; Y] R' + R [X; Y]' L' + p_N W > 0

with the unknowns X (symmetric, block diagonal), Y and p_N. With P = S^-1 the second derivative of -log det S along unit matrices
e_p e_q' and e_s e_t' instead of [X; Y] is 2 (g[t, p] g[q, s] + r[p, s] a[q, t]), where g = R' P L, r = L' P L, a = R' P R:
products of entries of three small matrices.

If S is nearly singular, the largest terms of these sums would swamp the others. So the part of P that belongs to the smallest
eigenvalues of S is left out of the sums. Its rows are added to their Cholesky factor by Householder reflections, which keeps as
many digits as the QR of all rows in `barrier.py`.
"""

import functools
import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from models.common.arrays import Array
from synth.lmi.barrier import FactoredDerivatives
from synth.lmi.unknowns import places
from synth.plant.generalized import Plant

# pyright: reportAttributeAccessIssue=false
# scipy.linalg.lapack is made by f2py and carries no stubs.


NEARLY_SINGULAR = 1e-7  # relative; Cholesky's method would lose the squares of smaller eigenvalues of S
SHIFTS = (1e-14, 1e-12, 1e-10, 1e-8, 1e-6)  # of the diagonal, relative: the first that gives the sums a Cholesky factor
PANEL = 32  # columns that are reflected together


@dataclass(frozen=True, eq=False)
class Constraint:
    """S = S0 + L [X; Y] R' + R [X; Y]' L' + p_N W > 0.

    Attributes:
        S0: shape (k, k).
        left: L, shape (k, n + m).
        right: R, shape (k, n).
        last: W, shape (k, k).
        plain: True for X > 0 and X < I, with S = X and S = I - X.
    """

    S0: Array
    left: Array
    right: Array
    last: Array
    plain: bool = False


def path_constraints(plant: Plant) -> list[Constraint]:
    """Returns the constraints -F(X, Y, eta) > 0 (24) and X > 0; p_N is eta."""
    n, m = plant.B.shape
    d = len(plant.C)
    disturbance = np.vstack([plant.Bw, plant.Dw])
    bound = Constraint(
        S0=np.diag([0.0] * n + [1.0] * d),
        left=-plant.system_matrix[:, : n + m],
        right=np.eye(n + d, n),
        last=-disturbance @ disturbance.T,
    )
    return [bound, _definite(n, m, 1.0)]


def start_constraints(plant: Plant, largest: float) -> list[Constraint]:
    """Returns the constraints A X + B Y + (..)' < p_N I, 0 < X < I and |Y| < largest."""
    n, m = plant.B.shape
    lyapunov = Constraint(np.zeros((n, n)), -plant.system_matrix[:n, : n + m], np.eye(n), np.eye(n))
    box = Constraint(largest * np.eye(m + n), np.eye(m + n, n + m, k=n), np.eye(m + n, n, k=-m), np.zeros((m + n, m + n)))
    return [lyapunov, _definite(n, m, 1.0), _definite(n, m, -1.0), box]


def path_barrier(plant: Plant, free: int) -> "StructuredBarrier":
    """Returns the barrier of (24) and X > 0."""
    n, m = plant.B.shape
    return StructuredBarrier(path_constraints(plant), n, m, free)


def start_barrier(plant: Plant, free: int, largest: float) -> "StructuredBarrier":
    """Returns the barrier of the search for a feasible point; `largest` bounds |Y|."""
    n, m = plant.B.shape
    return StructuredBarrier(start_constraints(plant, largest), n, m, free)


def _definite(n: int, m: int, sign: float) -> Constraint:
    """Returns the constraint X > 0, or X < I for a negative sign."""
    S0 = np.zeros((n, n)) if sign > 0 else np.eye(n)
    return Constraint(S0, 0.5 * sign * np.eye(n, n + m), np.eye(n), np.zeros((n, n)), plain=True)


@dataclass(frozen=True, eq=False)
class _Run:
    """Unknowns in the same row of [X; Y].

    Attributes:
        row: index of the row.
        others: columns of the other entries.
        begin, end: range of their indices.
        upper, lower: positions of the unknowns of X from `begin` on, and of their mirror images, in a flat square matrix of rows
            and columns `row` to n.
    """

    row: int
    others: slice
    begin: int
    end: int
    upper: Array
    lower: Array


@functools.cache
def _runs(n: int, m: int, free: int) -> list[_Run]:
    """Returns the runs of unknowns in the same row of [X; Y], in order."""
    rows, columns = places(n, m, free)
    of_x = int(np.sum(rows < n))
    first = np.flatnonzero(np.diff(rows, prepend=-1)).tolist()
    runs = []
    for begin, end in itertools.pairwise([*first, len(rows)]):
        row, left = int(rows[begin]), n - int(rows[begin])
        s, t = rows[begin:of_x] - row, columns[begin:of_x] - row
        others = slice(int(columns[begin]), int(columns[end - 1]) + 1)
        runs.append(_Run(row, others, begin, end, s * left + t, t * left + s))
    return runs


class StructuredBarrier:
    """Constraints on the unknowns of (22) or (25).

    Args:
        constraints: constraints with the same n and m.
        n, m, free: number of states, of inputs, and of columns of Q.
    """

    def __init__(self, constraints: Sequence[Constraint], n: int, m: int, free: int) -> None:
        self.constraints, self.shape, self.free = constraints, (n + m, n), free
        self.rows, self.columns = rows, columns = places(n, m, free)
        self.twice = rows < n  # unknowns of X, which are below the diagonal, too
        self.mirrored = np.where(self.twice, rows, 0), np.where(self.twice, columns, 0)
        self.weight = np.where(rows == columns, 0.5, 1.0)  # diagonal entries would count twice
        self.runs = _runs(n, m, free)

    def at(self, p: Array) -> "StructuredLocal | None":
        """Returns the derivatives at a point, or None outside the feasible set."""
        N = len(p)
        unknown = self.matrix(p)
        trace = np.zeros(N)
        heavy, bases, light = [], [], []
        for part in self.constraints:
            half = part.left @ unknown @ part.right.T
            factor, outside = lapack.dpotrf(part.S0 + half + half.T + p[-1] * part.last, lower=1, clean=1)
            if outside:
                return None
            inverse, singular = lapack.dtrtri(factor, lower=1)
            if singular:
                return None
            # S^-1 = U U', the columns of U by falling size; computed from the factor, the large ones keep their digits.
            _, sizes, directions = np.linalg.svd(inverse)
            U = directions.T * sizes
            bases.append(U)
            trace[:-1] += self._both(2 * ((U.T @ part.left).T @ (U.T @ part.right)))
            trace[-1] += np.sum(U * (part.last @ U))
            count = int(np.sum(sizes**-2 < NEARLY_SINGULAR * sizes[-1] ** -2))
            if count:
                heavy.append(self._rows(part, U, count))
            light.append(U[:, count:] @ U[:, count:].T)
        hessian = self._hessian(light)
        diagonal = np.diagonal(hessian).copy()
        scale = 1 / np.sqrt(np.maximum(diagonal, 1e-16 * (diagonal + sum(np.einsum("ij,ij->j", rows, rows) for rows in heavy))))
        hessian *= scale
        hessian *= scale[:, None]
        for shift in SHIFTS:
            hessian[np.arange(N), np.arange(N)] = diagonal * scale**2 + shift
            # In Fortran order, LAPACK's, the upper triangle is a lower one: nothing is copied.
            lower, failed = lapack.dpotrf(hessian.T, lower=1, clean=0)
            if not failed:
                break
        else:
            return None
        triangle = lower.T
        for rows in heavy:
            triangle = lapack.dtpqrt(0, min(PANEL, N), triangle, np.asfortranarray(rows * scale), overwrite_a=1, overwrite_b=1)[0]
        return StructuredLocal(trace, scale, triangle, self, bases)

    def matrix(self, p: Array) -> Array:
        """Returns [X; Y] of the unknowns, shape (n + m, n)."""
        unknown = np.zeros(self.shape)
        unknown[self.rows, self.columns] = p[:-1]
        unknown[self.columns[self.twice], self.rows[self.twice]] = p[:-1][self.twice]
        return unknown

    def _both(self, Z: Array) -> Array:
        """Returns the derivative of tr(Z' [X; Y]) with respect to every unknown but the last."""
        rows, columns = self.mirrored
        return self.weight * (Z[self.rows, self.columns] + self.twice * Z[columns, rows])

    def _rows(self, part: Constraint, U: Array, count: int) -> Array:
        """Returns the rows of `barrier.Barrier.at` for pairs of columns of U, one among the first `count`, shape (.., N)."""
        UL, UR = U.T @ part.left, U.T @ part.right
        rows, columns = self.mirrored
        left, right = UL[:, self.rows] * self.weight, UR[:, self.columns]
        left_mirrored, right_mirrored = UL[:, columns] * (self.weight * self.twice), UR[:, rows]
        last = U[:, :count].T @ part.last @ U
        runs = []
        for i in range(count):
            each = np.empty((len(U) - i, len(self.rows) + 1))
            each[:, :-1] = left[i] * right[i:] + right[i] * left[i:]
            each[:, :-1] += left_mirrored[i] * right_mirrored[i:] + right_mirrored[i] * left_mirrored[i:]
            each[:, -1] = last[i, i:]
            each[1:] *= np.sqrt(2.0)
            runs.append(each)
        return np.concatenate(runs)

    def _hessian(self, light: Sequence[Array]) -> Array:
        """Returns the second derivatives due to the parts P of every S^-1, upper triangle, shape (N, N).

        [X, Y'; Y, 0] is symmetric, and with R padded by zeros S is the same function of it. Its second derivative along
        e_p e_q' + e_q e_p' and e_s e_t' + e_t e_s' is the sum of four terms of the module's formula. It is an entry of a product
        of thin matrices, 2 (U V' + V U')[s, t], where U depends only on q and V on p. Every constraint adds four columns to each;
        X > 0 and X < I add one, as their four terms are equal.
        """
        (rows, n), N, of_x = self.shape, len(self.rows) + 1, int(self.twice.sum())
        hessian = np.zeros((N, N))
        within_x: list[tuple[Array, Array]] = []  # factors U and V, indexed by q or p, s or t, and column
        with_y: list[tuple[Array, Array]] = []
        for part, P in zip(self.constraints, light, strict=True):
            PL, PR = P @ part.left, P @ part.right
            if np.any(part.last):
                PW = P @ part.last
                hessian[:-1, -1] += self._both(2 * (part.left.T @ PW @ PR))
                hessian[-1, -1] += np.sum(PW * PW.T)
            if part.plain:
                within_x.append((P[..., None], P[..., None]))
                continue
            g, a, r = np.zeros((rows, rows)), np.zeros((rows, rows)), part.left.T @ PL
            g[:n], a[:n, :n] = part.right.T @ PL, part.right.T @ PR
            U, V = np.stack([g, a, g.T, r], axis=-1), np.stack([g.T, r, g, a], axis=-1)
            with_y.append((U, V))
            if np.any(part.left[:, :n]):
                within_x.append((U[:n, :n], V[:n, :n]))

        U, V = (np.concatenate(factors, axis=-1) for factors in zip(*within_x, strict=True))
        Uy, Vy = (np.concatenate(factors, axis=-1) for factors in zip(*with_y, strict=True))
        x = slice(self.free, n)  # columns of Y_R
        for run in self.runs:
            p, q, block = run.row, run.others, hessian[run.begin : run.end]
            if p < n:
                product = _products(U[q, p:], V[p, p:]).reshape(len(block), -1)
                np.add(product.take(run.upper, axis=1), product.take(run.lower, axis=1), out=block[:, run.begin : of_x])
            y = slice(max(p, n), rows)
            product = _products(Uy[q, y], Vy[p, x]) + _products(Uy[q, x], Vy[p, y]).swapaxes(1, 2)
            block[:, max(run.begin, of_x) : -1] = product.reshape(len(block), -1)
        inner, once = hessian[:-1, :-1], np.flatnonzero(self.weight < 1)
        inner *= 2
        inner[once] *= 0.5
        inner[:, once] *= 0.5
        return hessian


def _products(U: Array, V: Array) -> Array:
    """Returns U V' for every q, shape (q, s, t), for U indexed by q, s and column, and V by t and column."""
    return (U.reshape(-1, U.shape[-1]) @ V.T).reshape(*U.shape[:2], len(V))


@dataclass(frozen=True, eq=False)
class StructuredLocal(FactoredDerivatives):
    """Derivatives at a point, with U of S^-1 = U U' of every constraint, shapes (k, k)."""

    barrier: StructuredBarrier
    bases: list[Array]

    def rates(self, step: Array) -> Array:
        """Returns `FactoredDerivatives.rates`."""
        unknown = self.barrier.matrix(step)
        changes = []
        for part, U in zip(self.barrier.constraints, self.bases, strict=True):
            half = (U.T @ part.left) @ unknown @ (part.right.T @ U)
            changes.append(half + half.T + step[-1] * (U.T @ part.last @ U))
        return np.concatenate([np.linalg.eigvalsh(change) for change in changes])
