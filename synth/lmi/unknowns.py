"""Unknowns (optimisation variables) X, Y and eta of the LMI problems (22) and (25), and their coefficients in the matrix (24)."""

import functools
from typing import Any

import numpy as np

from models.common.arrays import Array
from synth.plant.generalized import Plant


class Basis:
    """The N unknowns p = (X_Q, X_R, Y_R, eta) of an LMI problem and their coefficient matrices, in coordinates in which (12) is
    block diagonal.

    The basis belongs to one plant, or to several plants of the same shape that are stacked along leading axes (...).

    Args:
        system: matrices [A B Bw; C D Dw], shape (..., k, n + m + r).
        n, m, free: numbers of states, of inputs, and of columns of Q.
        step: sample period of a discrete plant [s]; 0 for a continuous plant.

    Attributes:
        places: row and column indices in the matrix [X; Y] of all unknowns except the last one, shapes (N - 1,). For the
            unknowns of X, the indices are those on and above the diagonal.
        size: number N of optimisation variables.
    """

    def __init__(self, system: Array, n: int, m: int, free: int, step: float) -> None:
        self.system, self.n, self.m, self.free, self.step = system, n, m, free, step
        self.places = places(n, m, free)
        self.size = len(self.places[0]) + 1
        k = system.shape[-2]
        bordered = k + n if step else k
        self.F0 = np.zeros((bordered, bordered))
        self.F0[n:k, n:k] = -np.eye(k - n)

    @classmethod
    def of(cls, plant: Plant, free: int, step: float = 0.0) -> "Basis":
        """Returns the unknowns and their coefficient matrices for one plant."""
        n, m = plant.B.shape
        return cls(plant.system_matrix, n, m, free, step)

    @property
    def plant(self) -> Plant:
        """Plant to which the basis belongs, if the basis belongs to only one plant."""
        n, m = self.n, self.n + self.m
        top, low = self.system[:n], self.system[n:]
        return Plant(top[:, :n], top[:, n:m], top[:, m:], low[:, :n], low[:, n:m], low[:, m:])

    @property
    def X(self) -> Array:
        """Coefficient matrices of the unknowns in X, shape (N, n, n)."""
        return _units(self.n, self.m, self.free)[0]

    @property
    def Y(self) -> Array:
        """Coefficient matrices of the unknowns in Y, shape (N, m, n)."""
        return _units(self.n, self.m, self.free)[1]

    @functools.cached_property
    def F(self) -> Array:
        """Coefficient matrices F_i of the matrix (24) = F0 + sum_i p_i F_i, shape (..., N, k, k); k is larger by n for a
        discrete plant.
        """
        n, m, k = self.n, self.m, self.system.shape[-2]
        # The product [A B; C D] [X; Y] for every unknown gives the left columns of (24). The transpose of this product gives
        # the upper rows.
        left = self.system[..., None, :, : n + m] @ np.concatenate([self.X, self.Y], axis=1)
        F = np.zeros((*self.system.shape[:-2], self.size, *self.F0.shape))
        F[..., :k, :n] = left
        F[..., :n, :k] += left.swapaxes(-1, -2)
        disturbance = self.system[..., n + m :]
        F[..., -1, :k, :k] = disturbance @ disturbance.swapaxes(-1, -2)
        if self.step:
            F[..., :k, k:] = self.step**0.5 * left
            F[..., k:, :k] = self.step**0.5 * left.swapaxes(-1, -2)
            F[..., k:, k:] = -self.X
        return F

    def pack(self, X: Array, Y: Array, last: float) -> Array:
        """Returns the vector of all unknowns, given X, Y and the last unknown."""
        return np.append(np.concatenate([X, Y])[self.places], last)

    def unpack(self, p: Array) -> tuple[Array, Array, Any]:
        """Returns X, Y and the last unknown, given a vector p of all unknowns, shape (..., N)."""
        rows, columns = self.places
        unknown = np.zeros((*p.shape[:-1], self.n + self.m, self.n))
        unknown[..., rows, columns] = p[..., :-1]
        of_x = rows < self.n
        unknown[..., columns[of_x], rows[of_x]] = p[..., :-1][..., of_x]
        return unknown[..., : self.n, :], unknown[..., self.n :, :], p.T[-1]


@functools.cache
def places(n: int, m: int, free: int) -> tuple[Array, Array]:
    """Returns the row and column indices in the matrix [X; Y] of all unknowns except eta.

    The unknowns of X_Q and X_R on and above the diagonal come first, row by row. The unknowns of Y_R follow those of X_R, also
    row by row.
    """
    rows, columns = np.triu_indices(n)
    inside = (rows >= free) | (columns < free)  # False for entries that would couple the two blocks of the matrix
    index, q = np.arange(m * (n - free)), max(n - free, 1)
    places = np.concatenate([rows[inside], n + index // q]), np.concatenate([columns[inside], free + index % q])
    for each in places:
        each.flags.writeable = False  # the arrays are cached and shared by all central paths of this size
    return places


@functools.cache
def _units(n: int, m: int, free: int) -> tuple[Array, Array]:
    """Returns the coefficient matrices of the unknowns in X, shape (N, n, n), and in Y, shape (N, m, n)."""
    rows, columns = places(n, m, free)
    units, index = np.zeros((len(rows) + 1, n + m, n)), np.arange(len(rows))
    units[index, rows, columns] = 1
    of_x = rows < n
    units[index[of_x], columns[of_x], rows[of_x]] = 1
    X, Y = np.ascontiguousarray(units[:, :n]), np.ascontiguousarray(units[:, n:])
    for each in (X, Y):
        each.flags.writeable = False  # the arrays are cached and shared by all central paths of this size
    return X, Y


def direction(size: int, value: float) -> Array:
    """Returns a vector of shape (size,) that is zero except for the last unknown, eta, which has the given value."""
    c = np.zeros(size)
    c[-1] = value
    return c
