"""Coordinates and units in which the numbers of a plant have size one."""

import numpy as np
from scipy import linalg, sparse

from models.arrays import Array
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


def own_units(plant: GeneralizedPlant, Cy: Array) -> tuple[Array, float]:
    """Units of the states, powers of two, shape (n,), and a rate [rad/s] in which the entries of a plant and C_y have size one.

    Least squares over the logarithms of all entries that are not zero, in which the units of inputs, disturbances, outputs and
    measurements are free, too: whatever units the plant is given in, it is the same plant in these. (`balance` is blind to a
    state that does not both drive others and is driven by them.)

    Args:
        plant: n states.
        Cy: shape (q, n).
    """
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
    return np.exp2(np.round(found[:n] / np.log(2))), float(np.exp(found[-1]))


def size(matrix: Array) -> float:
    """The 2-norm of a matrix, or 1 where it is zero."""
    return float(np.linalg.norm(matrix, 2)) or 1.0
