"""Linear equations whose solution has twice the digits of floats, by iterative refinement."""

import numpy as np

from models.common.arrays import Array
from synth.plant.double_double import exact_sum, product

CONVERGED_CHANGE = 1e-14  # an iteration has converged if the relative change of the result is smaller than this
# Largest number of iterations. Each iteration adds 16 digits, less the digits that are lost because A is ill-conditioned
MOST_TURNS = 12


def solve_closely(high: Array, low: Array, right: Array, C: Array, C_low: Array) -> tuple[Array, Array]:
    """Returns (C + C_low) (x + j y) with twice the digits, where (high + low) [x; y] = right, and an estimate of the error.

    The residual of the equations is computed with twice the digits, and the solution is corrected until it converges. Source:
    Higham 2002, Accuracy and Stability of Numerical Algorithms, chapter 12. The method fails if the equations are so
    ill-conditioned that no digit of a solution in floats is correct.

    Args:
        high, low: matrix of the equations, shape (..., 2 n, 2 n), and its low-order digits.
        right: right side of the equations, shape (2 n, r).
        C, C_low: matrix by which the solution is multiplied, shape (d, n), and its low-order digits.

    Returns:
        The result, complex, shape (..., d, r), and the largest change of its entries in the last iteration, shape (...).
    """
    solution, rest = np.zeros((2, *high.shape[:-1], right.shape[-1]))
    T, moved = np.zeros((*high.shape[:-2], len(C), right.shape[-1]), complex), np.full(high.shape[:-2], np.inf)
    for _ in range(MOST_TURNS):
        into, lost = product(high, solution)
        change, off = exact_sum(right, -into)
        step = np.linalg.solve(high, change + (off - lost - high @ rest - low @ solution))
        solution, off = exact_sum(solution, step)
        solution, rest = exact_sum(solution, rest + off)
        parts = []
        for x, least in zip(np.split(solution, 2, axis=-2), np.split(rest, 2, axis=-2), strict=True):
            out, lost = product(C, x)
            parts.append(out + (lost + C @ least + C_low @ x))
        before, T = T, parts[0] + 1j * parts[1]
        moved = np.abs(T - before).max(axis=(-2, -1), initial=0.0)
        if np.all(moved <= CONVERGED_CHANGE * np.abs(T).max(axis=(-2, -1), initial=0.0)):
            break
    return T, moved


def with_imaginary(real: Array, imaginary: Array) -> Array:
    """Returns complex matrices, shape (..., n, n), as real matrices that act on [x; y], shape (..., 2 n, 2 n)."""
    return np.block([[real, -imaginary], [imaginary, real]])
