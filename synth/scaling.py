"""Coordinates and units in which the numbers of a plant have size one."""

import numpy as np
from scipy import linalg

from models.arrays import Array
from synth.plant import GeneralizedPlant

SLOW = 1e-6  # of the size of A; poles that are all slower are those of integrators: 0 but for rounding


def reachable(plant: GeneralizedPlant, free: int) -> Array:
    """Coordinates of (12)'s block structure in which the inputs and the disturbance reach all states alike.

    The square root of a controllability Gramian, block by block. A is shifted until it decays, by rates that do not depend on the
    coordinates, so that the result does not either.
    """
    n = len(plant.A)
    _, (diagonal, _) = linalg.matrix_balance(plant.A, permute=False, separate=True)
    balanced = plant.in_coordinates(np.diag(diagonal))
    poles = np.linalg.eigvals(balanced.A)
    fastest = np.abs(poles).max()
    shift = poles.real.max() + (fastest if fastest > SLOW * size(balanced.A) else size(balanced.A))
    inputs = np.hstack([balanced.B / size(balanced.B), balanced.Bw / size(balanced.Bw)])
    gramian = linalg.solve_continuous_lyapunov(balanced.A - shift * np.eye(n), -inputs @ inputs.T)
    gramian += 1e-5 * np.trace(gramian) * np.eye(n)  # a state that nothing much reaches keeps a scale
    blocks = [np.linalg.cholesky(block) for block in (gramian[:free, :free], gramian[free:, free:])]
    return diagonal[:, None] * np.asarray(linalg.block_diag(*blocks))


def size(matrix: Array) -> float:
    """The 2-norm of a matrix, or 1 where it is zero."""
    return float(np.linalg.norm(matrix, 2)) or 1.0
