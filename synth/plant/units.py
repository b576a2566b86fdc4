"""Coordinates and units in which the entries of the matrices of one or more plants are near 1."""

import functools
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from synth.plant.generalized import Plant

# A^n counts as 0 if its size, relative to |A|^n, is smaller than this; all poles are then 0, as in a chain of integrators
NILPOTENT = 1e-14
CANCELLED_SUM = 1e-9  # a sum counts as possibly zero if its size, relative to its terms, is smaller than this
TOGETHER = 1e-4  # weight of the equations that give all disturbances w a common unit, and all outputs z a common unit
# If an eigenvalue of the normal equations is below this multiple of the largest eigenvalue, it belongs to an undetermined unit.
# All other eigenvalues exceed 1e-8 times the largest.
OPEN = 1e-11
# resolution of the base-2 logarithm of a unit; it is coarser than rounding errors, so that equal units give equal powers of two
FINEST = 2.0**-20
ALIKE = 1e-6  # two units count as equally undetermined if their relative difference is smaller than this
# offset that is added to exponents before rounding down; it is not 0.5, so that a unit half-way between two powers of two is
# not ambiguous
UPWARDS = 0.53
DEPENDENT = 1e-10  # rows of length 1 count as linearly independent if their smallest singular value is larger than this


def reachable(plant: Plant, free: int) -> Array:
    """Returns coordinates with the block structure of (12), in which the inputs and the disturbance affect all states equally.

    The coordinates are computed block by block, as the square root of a controllability Gramian. For the Gramian, A is shifted
    by a multiple of I that is large enough to make all modes decay. Neither the shift nor the result depends on the
    coordinates.
    """
    n = len(plant.A)
    _, (diagonal, _) = linalg.matrix_balance(plant.A, permute=False, separate=True)
    balanced = plant.in_coordinates(np.diag(diagonal))
    A = balanced.A / size(balanced.A)  # A is made dimensionless, so that the unit of time has no effect
    poles = np.linalg.eigvals(A)
    shift = 1.0 if are_integrators(A) else poles.real.max() + np.abs(poles).max()
    inputs = np.hstack([balanced.B / size(balanced.B), balanced.Bw / size(balanced.Bw)])
    gramian = linalg.solve_continuous_lyapunov(A - shift * np.eye(n), -inputs @ inputs.T)
    # This term keeps the scale finite for states on which inputs and disturbances have hardly any effect
    gramian += 1e-5 * np.trace(gramian) * np.eye(n)
    blocks = [np.linalg.cholesky(block) for block in (gramian[:free, :free], gramian[free:, free:])]
    return diagonal[:, None] * np.asarray(linalg.block_diag(*blocks))


@dataclass(frozen=True, eq=False)
class OwnUnits:
    """Units in which the matrix entries of a plant and of C_y are near 1. The resulting units do not depend on the units in
    which the plant is given.

    The units are powers of two, so that conversion in either direction causes no rounding.

    Attributes:
        states: unit of each state in which matrix entries are near 1, expressed in the given unit of this state, shape (n,).
        inputs: unit of each input in which matrix entries are near 1, expressed in the given unit of this input, shape (m,).
        exact: units of states and inputs before they are rounded to powers of two, shapes (n,) and (m,). The resulting units do
            not depend on the units in which the plant is given.
        rate: characteristic rate of the plant [rad/s]; see `own_units`. The units do not change the unit of time.
    """

    states: Array
    inputs: Array
    exact: tuple[Array, Array]
    rate: float

    def into(self, plant: Plant) -> Plant:
        """Converts a plant from its given units to the units of this object."""
        return _in_units(plant, self.states, self.inputs)

    def back(self, plant: Plant) -> Plant:
        """Converts a plant from the units of this object to its given units."""
        return _in_units(plant, 1 / self.states, 1 / self.inputs)

    def rows(self, Cy: Array) -> tuple[Array, Array]:
        """Returns C_y, in the state units of this object, as a product S V, where V has orthonormal rows.

        A design depends only on the span of the rows. Rows that are nearly dependent would lose digits in every product. A
        design therefore uses V, and inverts S only once, at the end.

        Args:
            Cy: matrix with independent rows, shape (q, n).

        Returns:
            V, shape (q, n), and the lower triangular S, shape (q, q), with y = S V x.
        """
        return orthonormal_rows(Cy * self.states)


def orthonormal_rows(rows: Array) -> tuple[Array, Array]:
    """Decomposes a matrix, given by its rows, into a product S V.

    The rows of V are orthonormal and do not depend on the units, and S is lower triangular.
    """
    # Lengths are rounded to powers of two, so that rounding errors do not depend on the units
    lengths = _powers(np.log2(np.linalg.norm(rows, axis=1)))
    basis, triangle = np.linalg.qr((rows / lengths[:, None]).T)
    # These signs make the diagonal positive, so that the result is unique
    signs = np.where(np.diagonal(triangle) < 0, -1.0, 1.0)
    return (basis * signs).T, lengths[:, None] * (signs[:, None] * triangle).T


def independent(rows: Array) -> list[int]:
    """Returns the indices of rows that do not depend linearly on earlier rows, in ascending order.

    No row may be zero. The units of the rows have no influence on the result.
    """
    rows, _ = unit_rows(rows)
    kept: list[int] = []
    for i in range(len(rows)):
        if np.linalg.svd(rows[[*kept, i]], compute_uv=False)[-1] > DEPENDENT and len(kept) < rows.shape[1]:
            kept.append(i)
    return kept


def unit_rows(Cy: Array) -> tuple[Array, Array]:
    """Returns the rows scaled to length 1, and the former lengths of the rows, shape (q,).

    After rows have been scaled in this way, no row is negligible because of its unit.
    """
    lengths = np.linalg.norm(Cy, axis=1)
    return Cy / lengths[:, None], lengths


@functools.lru_cache(maxsize=4)  # the results are cached, because a design needs the units often and a plant does not change
def own_units(plant: Plant, measured: bool = False) -> OwnUnits:
    """Returns units of states and inputs in which the matrix entries of the plant are near 1, and the rate of the plant.

    The units result from a least-squares fit to the logarithms of all nonzero matrix entries. The units of disturbances,
    outputs and measurements are also unknowns of the least-squares fit. The function `balance` would ignore states that do not
    drive other states, or do not depend on other states. A norm requires one unit for all disturbances w, and one unit for all
    outputs z. The units of w and z affect the result only if nothing else determines the speed of the plant. For example,
    integrators have the rate at which motion and driving force have the same weight in z.

    The pattern of zeros in the matrices may leave some units undetermined. Where a choice remains, a unit is kept as given,
    preferably the unit of the disturbance. As a result, a plant that is given in two sets of units, which differ by powers of
    two, is identical bit for bit after conversion.

    Args:
        plant: plant with n states. For a discrete plant, the units are those of `Plant.differences`.
        measured: True if the entries of C_y are also scaled to values near 1.
    """
    Cy, plant = plant.Cy if measured else plant.Cy[:0], plant.differences
    n, (m, r, d, q) = len(plant.A), (plant.B.shape[1], plant.Bw.shape[1], len(plant.C), len(Cy))
    # The rows are the equations of the change of x, of z, and of y. The columns are x, u and w.
    whole = np.block([[plant.A, plant.B, plant.Bw], [plant.C, plant.D, plant.Dw], [Cy, np.zeros((q, m + r))]])
    i, j = np.nonzero(whole)
    columns, unknowns = n + m + r, n + m + r + d + q + 1
    changes = i < n
    # An entry is multiplied by the unit of its column. An entry in a row of x is divided by the unit of this state and by the
    # rate. Every equation thus has three coefficients. The normal equations contain the products of pairs of these
    # coefficients.
    where = np.stack([j, np.where(changes, i, columns + i - n), np.full(len(i), unknowns - 1)], axis=1)
    own = np.where(i == j, 0.0, 1.0)  # the unit of a state does not affect the state's effect on itself; only the rate does
    what = np.stack([np.where(changes, own, 1.0), np.where(changes, -own, 1.0), np.where(changes, -1.0, 0.0)], axis=1)
    pairs, products = where[:, :, None] * unknowns + where[:, None], what[:, :, None] * what[:, None]
    normal = np.bincount(pairs.ravel(), products.ravel(), unknowns**2).reshape(unknowns, unknowns)
    normal = normal.astype(float)  # if all matrices of a plant are zero, bincount has nothing to count and returns integers
    right = -np.bincount(where.ravel(), (what * np.log2(np.abs(whole[i, j]))[:, None]).ravel(), unknowns)
    for first, count in ((n + m, r), (columns, d)):
        alike = slice(first, first + count)
        normal[alike, alike] += TOGETHER * (np.eye(count) - 1 / max(count, 1))
    w = np.arange(n + m, columns)
    logarithms = _with_pivots(normal, right, np.append(w, np.delete(np.arange(unknowns), w)))
    units = _powers(logarithms[: n + m])
    exact = np.exp2(np.round(logarithms[: n + m] / FINEST) * FINEST)
    return OwnUnits(units[:n], units[n:], (exact[:n], exact[n:]), float(np.exp2(logarithms[-1])))


def _powers(exponents: Any) -> Any:
    """Returns powers of two whose exponents are the given numbers, rounded to integers."""
    return np.exp2(np.floor(exponents + UPWARDS))


def _with_pivots(normal: Array, right: Array, first: Array) -> Array:
    """Returns the least-squares solution in which some of the undetermined unknowns are set to 0.

    Among units that are equally undetermined, the first one is set to 0. If the whole plant is connected, all units except the
    rate are equally undetermined. Rounding errors must not decide which of the units is set to 0. Rounding errors differ
    between machines, and an extreme unit might then determine all other units.

    Args:
        normal: matrix of the normal equations, shape (N, N).
        right: right-hand side of the normal equations, shape (N,).
        first: indices of all unknowns, in the order of preference for setting them to 0, shape (N,).
    """
    sizes, directions = np.linalg.eigh(normal)
    fixed = sizes > OPEN * sizes[-1]
    solution = directions[:, fixed] @ ((directions[:, fixed].T @ right) / sizes[fixed])
    left = directions[:, ~fixed]
    rest, pivots = left @ left.T, np.zeros(left.shape[1], dtype=int)
    for k in range(len(pivots)):
        open_alike = np.diagonal(rest)[first]
        pivots[k] = pivot = first[np.argmax(open_alike >= (1 - ALIKE) * open_alike.max())]
        rest = rest - np.outer(rest[:, pivot], rest[pivot]) / rest[pivot, pivot]
    return solution - left @ np.linalg.solve(left[pivots], solution[pivots])


def speed(plant: Plant) -> tuple[float, bool]:
    """Returns the speed of the plant [rad/s], and True if this speed is the speed of the fastest pole.

    If all poles are at 0, the speed is the rate of the plant (see `own_units`), and the second value is False. Poles of
    weighting filters are not considered in the speed. For a discrete plant, the speed of a mode is the change of the mode per
    sample, divided by dt.
    """
    plant = plant.differences.without_weighting
    A = plant.A
    # The sum of the squared poles is compared with the sum of the absolute terms. Both sums are independent of the units.
    if abs(np.sum(A * A.T)) <= CANCELLED_SUM * np.sum(np.abs(A * A.T)):
        own = own_units(plant)
        if are_integrators(own.into(plant).A):
            return own.rate, False
    return float(np.abs(np.linalg.eigvals(A)).max()), True


def are_integrators(A: Array) -> bool:
    """Returns True if all poles are 0 up to rounding errors. The test of the poles requires that the entries of A have similar
    sizes.
    """
    n = len(A)
    return bool(np.linalg.norm(np.linalg.matrix_power(A / size(A), n), 2) <= NILPOTENT)


def _in_units(plant: Plant, states: Array, inputs: Array) -> Plant:
    each = states[:, None]
    A, B, Bw = plant.A * states / each, plant.B * inputs / each, plant.Bw / each
    outputs = {"C": plant.C * states, "D": plant.D * inputs, "Cy": plant.Cy * states, "Dyu": plant.Dyu * inputs}
    return replace(plant, A=A, B=B, Bw=Bw, **outputs, beyond=None, weights=0)


def nearest_power(size: float) -> float:
    """Returns the power of two that is nearest to a size; 1 if the size is 0 or not finite."""
    return float(np.exp2(np.round(np.log2(size)))) if 0 < size < np.inf else 1.0


def size(matrix: Array) -> float:
    """Returns the 2-norm of a matrix, or 1 if the matrix is zero."""
    return float(np.linalg.svd(matrix, compute_uv=False).max(initial=0.0)) or 1.0
