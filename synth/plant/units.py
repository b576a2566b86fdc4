"""Coordinates and units in which the numbers of a plant, or of several, have size one."""

import functools
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from synth.plant.generalized import Plant

NILPOTENT = 1e-14  # of |A|^n; an A^n this small is 0 but for rounding, and so are all poles: those of integrators
CANCELLED_SUM = 1e-9  # relative to its terms; a smaller sum may be zero
TOGETHER = 1e-4  # weight of the equations that give all of w one unit, and all of z one
OPEN = 1e-11  # of the largest eigenvalue of the normal equations: units that nothing decides; of those decided none is below 1e-8
FINEST = 2.0**-20  # of an exponent of two: what rounding leaves of one is less, so that in powers of two the same is the same
ALIKE = 1e-6  # relative; units with this similar a freedom are equally undetermined
UPWARDS = 0.53  # so that a unit half-way between two powers of two, as are those of entries that are such powers, is no tie
DEPENDENT = 1e-10  # smallest singular value of rows of length one


def reachable(plant: Plant, free: int) -> Array:
    """Returns coordinates of (12)'s block structure in which the inputs and the disturbance reach all states equally.

    They are the square root of a controllability Gramian, block by block. A is shifted until it decays, by rates that do not
    depend on the coordinates, so that the result does not either.
    """
    n = len(plant.A)
    _, (diagonal, _) = linalg.matrix_balance(plant.A, permute=False, separate=True)
    balanced = plant.in_coordinates(np.diag(diagonal))
    A = balanced.A / size(balanced.A)  # so that no root of a unit of time is taken
    poles = np.linalg.eigvals(A)
    shift = 1.0 if are_integrators(A) else poles.real.max() + np.abs(poles).max()
    inputs = np.hstack([balanced.B / size(balanced.B), balanced.Bw / size(balanced.Bw)])
    gramian = linalg.solve_continuous_lyapunov(A - shift * np.eye(n), -inputs @ inputs.T)
    gramian += 1e-5 * np.trace(gramian) * np.eye(n)  # a state that nothing much reaches keeps a scale
    blocks = [np.linalg.cholesky(block) for block in (gramian[:free, :free], gramian[free:, free:])]
    return diagonal[:, None] * np.asarray(linalg.block_diag(*blocks))


@dataclass(frozen=True, eq=False)
class OwnUnits:
    """Units in which the entries of a plant and of C_y have size one, independent of the given units.

    They are powers of two, so that nothing is rounded on the way there and back.

    Attributes:
        states: own units of the states in given ones, shape (n,).
        inputs: own units of the inputs in given ones, shape (m,).
        exact: units before rounding to powers of two, shapes (n,) and (m,): independent of the given units.
        rate: rate of the plant [rad/s]; time keeps its unit.
    """

    states: Array
    inputs: Array
    exact: tuple[Array, Array]
    rate: float

    def into(self, plant: Plant) -> Plant:
        """Returns a plant of the given units in the own units."""
        return _in_units(plant, self.states, self.inputs)

    def back(self, plant: Plant) -> Plant:
        """Returns a plant of the own units in the given units."""
        return _in_units(plant, 1 / self.states, 1 / self.inputs)

    def rows(self, Cy: Array) -> tuple[Array, Array]:
        """Returns C_y of independent rows, in the own units of the states, as S V with orthonormal rows V.

        A design depends only on the span of the rows. Nearly dependent rows lose digits in every product: so a design uses V, and
        S is inverted once, at the end.

        Args:
            Cy: shape (q, n).

        Returns:
            V, shape (q, n), and S, shape (q, q), lower triangular: y = S V x.
        """
        return orthonormal_rows(Cy * self.states)


def orthonormal_rows(rows: Array) -> tuple[Array, Array]:
    """Returns V and S of independent rows S V: V has orthonormal rows that do not depend on units, S is lower triangular."""
    lengths = _powers(np.log2(np.linalg.norm(rows, axis=1)))  # exact, so that no unit is in what is rounded
    basis, triangle = np.linalg.qr((rows / lengths[:, None]).T)
    signs = np.where(np.diagonal(triangle) < 0, -1.0, 1.0)  # alike for rows that are alike
    return (basis * signs).T, lengths[:, None] * (signs[:, None] * triangle).T


def independent(rows: Array) -> list[int]:
    """Returns the indices of rows that do not follow from earlier ones, ascending, independent of units; no row may be zero."""
    rows, _ = unit_rows(rows)
    kept: list[int] = []
    for i in range(len(rows)):
        if np.linalg.svd(rows[[*kept, i]], compute_uv=False)[-1] > DEPENDENT and len(kept) < rows.shape[1]:
            kept.append(i)
    return kept


def unit_rows(Cy: Array) -> tuple[Array, Array]:
    """Returns rows of length one, so that no unit of a measurement makes another vanish, and the lengths, shape (q,)."""
    lengths = np.linalg.norm(Cy, axis=1)
    return Cy / lengths[:, None], lengths


@functools.lru_cache(maxsize=4)  # a design needs them often, and plants do not change
def own_units(plant: Plant, measured: bool = False) -> OwnUnits:
    """Returns the plant's own units of states and inputs, and its rate.

    They result from least squares over the logarithms of all nonzero entries, in which the units of disturbances, outputs and
    measurements are free, too. (`balance` ignores a state that does not both drive others and is driven by them.) A norm has one
    unit of all of w and one of all of z. These decide if nothing else determines the plant's speed: integrators have the rate at
    which the motion and the driving force have the same weight in z.

    The pattern of zeros may leave units undetermined. Some of these are kept as given, those of the disturbance before others. So
    the same plant in other units, each a power of two, is the same in its own bit for bit.

    Args:
        plant: n states; a discrete one has those of its differences.
        measured: True if C_y counts, too.
    """
    Cy, plant = plant.Cy if measured else plant.Cy[:0], plant.differences
    n, (m, r, d, q) = len(plant.A), (plant.B.shape[1], plant.Bw.shape[1], len(plant.C), len(Cy))
    # From x, u, w to the change of x, z, y.
    whole = np.block([[plant.A, plant.B, plant.Bw], [plant.C, plant.D, plant.Dw], [Cy, np.zeros((q, m + r))]])
    i, j = np.nonzero(whole)
    columns, unknowns = n + m + r, n + m + r + d + q + 1
    changes = i < n
    # An entry is multiplied by the unit of its column; a row of x is divided by its own and by the rate. So every equation has
    # three coefficients, which the normal equations take in pairs.
    where = np.stack([j, np.where(changes, i, columns + i - n), np.full(len(i), unknowns - 1)], axis=1)
    own = np.where(i == j, 0.0, 1.0)  # of a state's effect on itself no unit is left but the rate's
    what = np.stack([np.where(changes, own, 1.0), np.where(changes, -own, 1.0), np.where(changes, -1.0, 0.0)], axis=1)
    pairs, products = where[:, :, None] * unknowns + where[:, None], what[:, :, None] * what[:, None]
    normal = np.bincount(pairs.ravel(), products.ravel(), unknowns**2).reshape(unknowns, unknowns)
    normal = normal.astype(float)  # of a plant of zeros alone nothing is counted, in integers
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
    """Returns powers of two with rounded exponents."""
    return np.exp2(np.floor(exponents + UPWARDS))


def _with_pivots(normal: Array, right: Array, first: Array) -> Array:
    """Returns the least-squares solution, with 0 for undetermined unknowns, the first of equally undetermined ones.

    In a connected plant all units but the rate are equally undetermined. Rounding must not choose between them: it differs from
    one machine to the next, and an extreme unit may then decide all others.

    Args:
        normal: the normal equations, shape (N, N).
        right: right-hand side of the equations, shape (N,).
        first: all unknowns, in the order in which they are kept, shape (N,).
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
    """Returns a plant's own speed [rad/s]: its fastest pole, and True; its own rate and False if all poles lie at 0.

    Poles of weights do not count. The speed of a mode of a discrete plant is its change in a sample over dt.
    """
    plant = plant.differences
    n = len(plant.A) - plant.weights
    if plant.weights:
        return _speed(Plant(plant.A[:n, :n], plant.B[:n], plant.Bw[:n], plant.C[:, :n], plant.D, plant.Dw))
    return _speed(plant)


def _speed(plant: Plant) -> tuple[float, bool]:
    A = plant.A
    # The sum of all squared poles, beside what it is a sum of: no unit changes either.
    if abs(np.sum(A * A.T)) <= CANCELLED_SUM * np.sum(np.abs(A * A.T)):
        own = own_units(plant)
        if are_integrators(own.into(plant).A):
            return own.rate, False
    return float(np.abs(np.linalg.eigvals(A)).max()), True


def are_integrators(A: Array) -> bool:
    """Returns True if all poles lie at 0, to rounding; the entries of A must be of similar size."""
    n = len(A)
    return bool(np.linalg.norm(np.linalg.matrix_power(A / size(A), n), 2) <= NILPOTENT)


def _in_units(plant: Plant, states: Array, inputs: Array) -> Plant:
    each = states[:, None]
    A, B, Bw = plant.A * states / each, plant.B * inputs / each, plant.Bw / each
    outputs = {"C": plant.C * states, "D": plant.D * inputs, "Cy": plant.Cy * states, "Dyu": plant.Dyu * inputs}
    return replace(plant, A=A, B=B, Bw=Bw, **outputs, beyond=None, weights=0)


def nearest_power(size: float) -> float:
    """Returns the power of two next to a size."""
    return float(np.exp2(np.round(np.log2(size))))


def size(matrix: Array) -> float:
    """Returns the 2-norm of a matrix, or 1 if the matrix is zero."""
    return float(np.linalg.svd(matrix, compute_uv=False).max(initial=0.0)) or 1.0
