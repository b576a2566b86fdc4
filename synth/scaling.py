"""Coordinates and units in which the numbers of a plant have size one."""

from dataclasses import dataclass

import numpy as np
from scipy import linalg, sparse

from models.common.arrays import Array
from synth.plant import GeneralizedPlant

NILPOTENT = 1e-14  # of |A|^n; an A^n this small is 0 but for rounding, and so are all poles: those of integrators
FREE = 1e-9  # of one equation: holds units that nothing decides near 1


def reachable(plant: GeneralizedPlant, free: int) -> Array:
    """Coordinates of (12)'s block structure in which the inputs and the disturbance reach all states alike.

    The square root of a controllability Gramian, block by block. A is shifted until it decays, by rates that do not depend on the
    coordinates, so that the result does not either.
    """
    n = len(plant.A)
    _, (diagonal, _) = linalg.matrix_balance(plant.A, permute=False, separate=True)
    balanced = plant.in_coordinates(np.diag(diagonal))
    poles = np.linalg.eigvals(balanced.A)
    whole = size(balanced.A)
    integrators = np.linalg.norm(np.linalg.matrix_power(balanced.A / whole, n), 2) <= NILPOTENT
    shift = whole if integrators else poles.real.max() + np.abs(poles).max()
    inputs = np.hstack([balanced.B / size(balanced.B), balanced.Bw / size(balanced.Bw)])
    gramian = linalg.solve_continuous_lyapunov(balanced.A - shift * np.eye(n), -inputs @ inputs.T)
    gramian += 1e-5 * np.trace(gramian) * np.eye(n)  # a state that nothing much reaches keeps a scale
    blocks = [np.linalg.cholesky(block) for block in (gramian[:free, :free], gramian[free:, free:])]
    return diagonal[:, None] * np.asarray(linalg.block_diag(*blocks))


@dataclass(frozen=True, eq=False)
class OwnUnits:
    """Units in which the entries of a plant and of C_y have size one: whatever units it is given in, it is the same in these.

    They are powers of two, so that nothing is rounded on the way there and back.

    Attributes:
        states: what one of each state counts in the given unit, shape (n,).
        inputs: likewise, shape (m,).
        rate: of the plant [rad/s]; time keeps its unit.
    """

    states: Array
    inputs: Array
    rate: float

    def into(self, plant: GeneralizedPlant) -> GeneralizedPlant:
        """A plant of the given units in these."""
        return _in_units(plant, self.states, self.inputs)

    def back(self, plant: GeneralizedPlant) -> GeneralizedPlant:
        """A plant of these units in the given ones."""
        return _in_units(plant, 1 / self.states, 1 / self.inputs)

    def gain_back(self, G: Array) -> Array:
        """A state gain of these units in the given ones, shape (m, n)."""
        return self.inputs[:, None] * G / self.states


def own_units(plant: GeneralizedPlant, Cy: Array | None = None) -> OwnUnits:
    """The plant's own units: of states, of inputs, and its rate.

    Least squares over the logarithms of all entries that are not zero, in which the units of disturbances, outputs and
    measurements are free, too. (`balance` is blind to a state that does not both drive others and is driven by them.)

    Args:
        plant: n states.
        Cy: shape (q, n); of no rows where it is not given.
    """
    Cy = np.zeros((0, len(plant.A))) if Cy is None else Cy
    n, (m, r, d, q) = len(plant.A), (plant.B.shape[1], plant.Bw.shape[1], len(plant.C), len(Cy))
    # From x, u, w to the change of x, z, y.
    whole = np.block([[plant.A, plant.B, plant.Bw], [plant.C, plant.D, plant.Dw], [Cy, np.zeros((q, m + r))]])
    i, j = np.nonzero(whole)
    columns, unknowns = n + m + r, n + m + r + d + q + 1
    changes, every = i < n, np.arange(len(i))
    # An entry is multiplied by the unit of its column; a row of x is divided by its own and by the rate.
    equations = sparse.coo_array(
        (
            np.concatenate([np.ones(len(i)), np.where(changes, -1.0, 1.0), np.where(changes, -1.0, 0.0)]),
            (np.tile(every, 3), np.concatenate([j, np.where(changes, i, columns + i - n), np.full(len(i), unknowns - 1)])),
        ),
        shape=(len(i), unknowns),
    ).tocsr()
    normal = (equations.T @ equations).toarray() + FREE * np.eye(unknowns)
    found = linalg.solve(normal, -equations.T @ np.log(np.abs(whole[i, j])), assume_a="pos")
    units = np.exp2(np.round(found[: n + m] / np.log(2)))
    return OwnUnits(units[:n], units[n:], float(np.exp(found[-1])))


def _in_units(plant: GeneralizedPlant, states: Array, inputs: Array) -> GeneralizedPlant:
    each = states[:, None]
    return GeneralizedPlant(
        plant.A * states / each, plant.B * inputs / each, plant.Bw / each, plant.C * states, plant.D * inputs, plant.Dw
    )


def size(matrix: Array) -> float:
    """The 2-norm of a matrix, or 1 where it is zero."""
    return float(np.linalg.norm(matrix, 2)) or 1.0
