"""Exact algebra in integers, and error bounds, for proofs of lower bounds.

Elimination is fraction-free (Bareiss 1968): every intermediate entry is a minor of the matrix, so the size of the integers grows
only with the number of rows.
"""

from fractions import Fraction

import numpy as np

from models.common.arrays import Array
from synth.analysis.rigorous import product, zeros


def identity(n: int) -> Array:
    """Returns the identity matrix in Python integers, shape (n, n)."""
    eye = zeros(n, n)
    eye[np.arange(n), np.arange(n)] = 1
    return eye


PRIME = 2**31 - 1  # the product of two remainders fits into 64 bits


def span_all(rows: Array, step: Array) -> bool:
    """Returns True only if the rows of R, R S, R S^2, ... span the whole space, where R is the matrix `rows` and S the matrix
    `step`.

    If R and S are the output matrix and the state matrix of a plant, the plant is then observable. The rank is computed modulo
    a prime, and it never exceeds the true rank. The result True is therefore a proof, but the result False may only be due to
    an unlucky prime.

    Args:
        rows: matrix of integers, shape (d, n).
        step: matrix of integers, shape (n, n).
    """
    n = len(step)
    moved = (step % PRIME).astype(np.int64)
    basis, pivots = np.zeros((0, n), dtype=np.int64), list[int]()
    new = (rows % PRIME).astype(np.int64).reshape(-1, n)
    while len(new) and len(pivots) < n:
        known = len(pivots)
        for row in new:
            for one, j in zip(basis, pivots, strict=True):
                row = (row - row[j] * one) % PRIME
            if row.any():
                j = int(np.flatnonzero(row)[0])
                basis = np.vstack([basis, row * pow(int(row[j]), -1, PRIME) % PRIME])
                pivots.append(j)
        new = (basis[known:, :, None] * moved % PRIME).sum(axis=1) % PRIME
    return len(pivots) == n


class Nullspace:
    """Solutions Phi of K' Phi = 0 for a matrix of integers K, shape (N, c). Some rows of Phi, the free rows, determine the
    remaining rows.

    Attributes:
        pivots: indices of those rows of Phi that follow from the free rows; the number of pivots is the rank of K.
        free: indices of those rows of Phi that may be chosen freely.
        independent: indices of those columns of K that form a basis of the column space of K.
    """

    def __init__(self, K: Array) -> None:
        rows, self._shift = _similar_columns(K.T.copy())
        c, N = rows.shape
        order, columns = list(range(c)), []
        before = 1
        for k in range(min(c, N)):
            rest = np.abs(rows[k:])
            rest[:, columns] = 0
            at = int(rest.argmax())
            i, j = k + at // N, at % N
            if rows[i, j] == 0:
                break
            rows[[k, i]] = rows[[i, k]]
            order[k], order[i] = order[i], order[k]
            columns.append(j)
            pivot = rows[k, j]
            rows[k + 1 :] = (pivot * rows[k + 1 :] - np.outer(rows[k + 1 :, j], rows[k])) // before
            before = pivot
        self._rows, self._last = rows[: len(columns)], before
        self.pivots, self.independent = columns, order[: len(columns)]
        taken = set(columns)
        self.free = [j for j in range(N) if j not in taken]

    def complete(self, values: Array) -> Array:
        """Returns the solution Phi that has the free rows `values`, up to a common factor.

        Args:
            values: free rows of Phi, integers, shape (len(free), k).

        Returns:
            All rows of Phi, integers, shape (N, k).
        """
        Phi = zeros(self._rows.shape[1], values.shape[1])
        Phi[self.free] = self._last * values * (self._shift.max(initial=1) // self._shift[self.free])[:, None]
        for row, j in zip(self._rows[::-1], self.pivots[::-1], strict=True):
            Phi[j] = -product(row[None], Phi)[0] // row[j]  # this division has no remainder, by Cramer's rule
        return Phi * self._shift[:, None]


def _similar_columns(rows: Array) -> tuple[Array, Array]:
    """Divides the rows by their common factors, and scales the columns to similar size by powers of two. Returns the scaled
    rows and the powers of two.
    """
    for i, row in enumerate(rows):
        rows[i] = row // (np.gcd.reduce(row) or 1)
    if not rows.size:
        return rows, zeros(rows.shape[1]) + 1
    bits = np.array([[abs(x).bit_length() for x in row] for row in rows])
    relative = np.where(bits, bits - bits.max(axis=1, keepdims=True), np.iinfo(int).min // 2).max(axis=0)
    shift = np.array([1 << int(-each) if each > np.iinfo(int).min // 4 else 1 for each in relative], dtype=object)
    return rows * shift, shift


def without_factors(columns: Array) -> tuple[Array, int]:
    """Divides the columns of a matrix by their common factors, and scales the columns to similar size.

    Returns:
        The new columns, and a power of two close to the largest entry of every column.
    """
    columns = columns.copy()
    for j in range(columns.shape[1]):
        columns[:, j] //= np.gcd.reduce(columns[:, j]) or 1
    bits = [max(abs(x).bit_length() for x in column) for column in columns.T]
    most = max(bits, default=0)
    for j, each in enumerate(bits):
        columns[:, j] *= 1 << (most - each)
    return columns, 1 << most


def root_below(square: Fraction) -> float:
    """Returns a float that is at most the square root of a number."""
    return float(np.nextafter(np.nextafter(float(square) ** 0.5, 0.0), 0.0)) if square > 0 else 0.0


def radius_of_solution(residual: float, contraction: float, curvature: float) -> float | None:
    """Returns a radius around a point x within which a quadratic equation f(x) = 0 provably has a solution; None if the proof
    fails.

    The proof uses Brouwer's fixed-point theorem: x - R f(x) maps the ball around the point into itself (Krawczyk).

    Args:
        residual: bound on |R f| at the point x, where R approximates the inverse of the derivative f'.
        contraction: bound on |I - R f'| at the point x.
        curvature: bound on twice the quadratic part of |R f|, divided by the square of the distance from the point x.
    """
    if not contraction < 0.5:
        return None
    radius = 2 * residual / (1 - contraction)
    return radius if residual + contraction * radius + curvature * radius**2 / 2 <= radius else None
