"""The barrier of `barrier.py` where the unknowns are entries of matrices: n^4 operations where a dense basis takes n^6.

Every constraint of the central path has the form

    S = S0 + L [X; Y] R' + R [X; Y]' L' + p_N W > 0

with the unknowns X (symmetric, block diagonal), Y and p_N. With P = S^-1 the second derivative of -log det S along unit matrices
e_p e_q' and e_s e_t' in the place of [X; Y] is 2 (g[t, p] g[q, s] + r[p, s] a[q, t]), where g = R' P L, r = L' P L, a = R' P R:
products of entries of three small matrices.

Where S is nearly singular these sums would lose what its other directions add to them. So the part of P that belongs to the
smallest eigenvalues of S is left out of the sums, and joins their Cholesky factor as rows, by Householder's reflections: no digit
is lost that the QR of all rows in `barrier.py` would keep.
"""

# pyright: reportAttributeAccessIssue=false
# scipy.linalg.lapack is made by f2py and carries no stubs.

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from models.common.arrays import Array
from synth.lmi.barrier import Factored
from synth.plant import GeneralizedPlant

NEARLY_SINGULAR = 1e-7  # eigenvalues of S, relative to its largest: smaller ones square to what Cholesky's method would lose
SHIFTS = (1e-14, 1e-12, 1e-10, 1e-8, 1e-6)  # of the diagonal, relative: the first with which the sums have a Cholesky factor
PANEL = 32  # columns that are reflected together


@dataclass(frozen=True, eq=False)
class Constraint:
    """S = S0 + L [X; Y] R' + R [X; Y]' L' + p_N W > 0.

    Attributes:
        S0: shape (k, k).
        left: L, shape (k, n + m).
        right: R, shape (k, n).
        last: W, shape (k, k).
        plain: whether it is X > 0 or X < I: then S is X, or its distance from I.
    """

    S0: Array
    left: Array
    right: Array
    last: Array
    plain: bool = False


def path_constraints(plant: GeneralizedPlant) -> list[Constraint]:
    """-F(X, Y, eta) > 0 (24) and X > 0; p_N is eta."""
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


def start_constraints(plant: GeneralizedPlant, largest: float) -> list[Constraint]:
    """A X + B Y + (..)' < p_N I, 0 < X < I and |Y| < largest."""
    n, m = plant.B.shape
    lyapunov = Constraint(np.zeros((n, n)), -plant.system_matrix[:n, : n + m], np.eye(n), np.eye(n))
    box = Constraint(largest * np.eye(m + n), np.eye(m + n, n + m, k=n), np.eye(m + n, n, k=-m), np.zeros((m + n, m + n)))
    return [lyapunov, _definite(n, m, 1.0), _definite(n, m, -1.0), box]


def _definite(n: int, m: int, sign: float) -> Constraint:
    """X > 0, or X < I."""
    S0 = np.zeros((n, n)) if sign > 0 else np.eye(n)
    return Constraint(S0, 0.5 * sign * np.eye(n, n + m), np.eye(n), np.zeros((n, n)), plain=True)


class StructuredBarrier:
    """Constraints, and where the unknowns stand in [X; Y].

    Args:
        constraints: all of the same n and m.
        rows, columns: where the unknowns but the last stand, shapes (N - 1,), by rows; of X the upper triangle.
        n, m: number of states and of inputs.
    """

    def __init__(self, constraints: Sequence[Constraint], rows: Array, columns: Array, n: int, m: int) -> None:
        self.constraints, self.rows, self.columns, self.shape = constraints, rows, columns, (n + m, n)
        self.twice = rows < n  # of X: they stand below the diagonal, too
        self.mirrored = np.where(self.twice, rows, 0), np.where(self.twice, columns, 0)
        self.weight = np.where(rows == columns, 0.5, 1.0)  # those on the diagonal would count twice
        first = np.flatnonzero(np.diff(rows, prepend=-1))
        self.runs = list(zip(first.tolist(), [*first[1:].tolist(), len(rows)], strict=True))  # of unknowns in the same row

    def at(self, p: Array) -> "StructuredLocal | None":
        """The derivatives at a point, or None outside the feasible set."""
        N = len(p)
        unknown = self.matrix(p)
        trace, hessian = np.zeros(N), np.zeros((N, N))
        heavy, bases = [], []
        for part in self.constraints:
            half = part.left @ unknown @ part.right.T
            factor, outside = lapack.dpotrf(part.S0 + half + half.T + p[-1] * part.last, lower=1, clean=1)
            if outside:
                return None
            inverse, singular = lapack.dtrtri(factor, lower=1)
            if singular:
                return None
            # S^-1 = U U', the columns of U in order of falling size: from the factor the large ones keep their digits.
            _, sizes, directions = np.linalg.svd(inverse)
            U = directions.T * sizes
            bases.append(U)
            trace[:-1] += self._both(2 * ((U.T @ part.left).T @ (U.T @ part.right)))
            trace[-1] += np.sum(U * (part.last @ U))
            count = int(np.sum(sizes**-2 < NEARLY_SINGULAR * sizes[-1] ** -2))
            if count:
                heavy.append(self._rows(part, U, count))
            self._add(hessian, part, U[:, count:] @ U[:, count:].T)
        light = np.diagonal(hessian).copy()
        scale = 1 / np.sqrt(np.maximum(light, 1e-16 * (light + sum(np.einsum("ij,ij->j", rows, rows) for rows in heavy))))
        hessian *= scale
        hessian *= scale[:, None]
        for shift in SHIFTS:
            hessian[np.arange(N), np.arange(N)] = light * scale**2 + shift
            triangle, failed = lapack.dpotrf(hessian, lower=0, clean=1)
            if not failed:
                break
        else:
            return None
        for rows in heavy:
            triangle = lapack.dtpqrt(0, min(PANEL, N), triangle, np.asfortranarray(rows * scale), overwrite_a=1, overwrite_b=1)[0]
        return StructuredLocal(trace, scale, triangle, self, bases)

    def matrix(self, p: Array) -> Array:
        """[X; Y] of the unknowns, shape (n + m, n)."""
        unknown = np.zeros(self.shape)
        unknown[self.rows, self.columns] = p[:-1]
        unknown[self.columns[self.twice], self.rows[self.twice]] = p[:-1][self.twice]
        return unknown

    def _both(self, Z: Array) -> Array:
        """<Z, [X; Y]> of every unknown but the last."""
        rows, columns = self.mirrored
        return self.weight * (Z[self.rows, self.columns] + self.twice * Z[columns, rows])

    def _rows(self, part: Constraint, U: Array, count: int) -> Array:
        """The rows of `barrier.Barrier.at` that belong to the first columns of U, and any other, shape (.., N)."""
        seen, moved = U.T @ part.left, U.T @ part.right
        rows, columns = self.mirrored
        left, right = seen[:, self.rows] * self.weight, moved[:, self.columns]
        left_mirrored, right_mirrored = seen[:, columns] * (self.weight * self.twice), moved[:, rows]
        last = U[:, :count].T @ part.last @ U
        found = []
        for i in range(count):
            each = np.empty((len(U) - i, len(self.rows) + 1))
            each[:, :-1] = left[i] * right[i:] + right[i] * left[i:]
            each[:, :-1] += left_mirrored[i] * right_mirrored[i:] + right_mirrored[i] * left_mirrored[i:]
            each[:, -1] = last[i, i:]
            each[1:] *= np.sqrt(2.0)
            found.append(each)
        return np.concatenate(found)

    def _add(self, hessian: Array, part: Constraint, P: Array) -> None:
        """Adds the upper triangle of the second derivatives that belong to P."""
        n = self.shape[1]
        PL, PR = P @ part.left, P @ part.right
        # Every unknown e_s e_t', and of X e_t e_s' beside it: the entries that it takes from each row, as pairs of factors.
        of_x = int(self.twice.sum())
        begins, ends = (0 if np.any(part.left[:, :n]) else of_x), (of_x if part.plain else len(self.rows))
        s, t = self.rows[:ends], self.columns[:ends]
        weight, again = 2 * self.weight[:ends], 2 * (self.weight * self.twice)[:ends]
        if part.plain:  # g, r and a are P, but for their factors: of the products two differ
            pairs = [(P[:, t], P[:, s] * weight), (P[:, s], P[:, t] * weight)]
        else:
            g, r, a = part.right.T @ PL, part.left.T @ PL, part.right.T @ PR
            mirrored = self.mirrored[0]
            pairs = [(g.T[:, t], g[:, s] * weight), (r[:, s] * weight, a[:, t])]
            pairs += [(g.T[:, mirrored], g[:, t] * again), (r[:, t] * again, a[:, mirrored])]
        for begin, end in self.runs:
            if not begins <= begin < ends:  # the constraint has no such unknown
                continue
            row, others, after = self.rows[begin], slice(self.columns[begin], self.columns[end - 1] + 1), slice(begin, None)
            block = np.zeros((end - begin, ends - begin))
            product = np.empty_like(block)
            for first, second in pairs:
                block += np.multiply(first[row, after], second[others, after], out=product)
                if row < n and not part.plain:
                    block += np.multiply(first[others, after], second[row, after], out=product)
            if row < n:
                block *= self.weight[begin:end, None]
            hessian[begin:end, begin:ends] += block
        if np.any(part.last):
            PW = P @ part.last
            hessian[:-1, -1] += self._both(2 * (part.left.T @ PW @ PR))
            hessian[-1, -1] += np.sum(PW * PW.T)


@dataclass(frozen=True, eq=False)
class StructuredLocal(Factored):
    """Derivatives at a point; S^-1 = U U' of every constraint, shapes (k, k)."""

    barrier: StructuredBarrier
    bases: list[Array]

    def rates(self, step: Array) -> Array:
        """As `Factored.rates`."""
        unknown = self.barrier.matrix(step)
        changes = []
        for part, U in zip(self.barrier.constraints, self.bases, strict=True):
            half = (U.T @ part.left) @ unknown @ (part.right.T @ U)
            changes.append(half + half.T + step[-1] * (U.T @ part.last @ U))
        return np.concatenate([np.linalg.eigvalsh(change) for change in changes])
