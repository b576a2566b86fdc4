"""Sums and products of numbers with twice the digits of floats. A number is the sum of a pair (high, low) of floats.

Knuth's sum and Dekker's product are exact, because the rounding error is also a float, which is stored as `low`. Source: Ogita,
Rump, Oishi 2005, Accurate sum and dot product. All numbers must have magnitudes between about 1e-140 and 1e300, like the
entries of plants.
"""

import numpy as np

from models.common.arrays import Array

SPLIT = 2.0**27 + 1  # this factor splits a float into two halves of 26 bits each, so that products of halves are exact

CONVERGED_CHANGE = 1e-14  # an iteration has converged if the relative change of the result is smaller than this
# Largest number of iterations. Each iteration adds 16 digits, less the digits that are lost because A is ill-conditioned
MOST_TURNS = 12


def exact_sum(a: Array, b: Array) -> tuple[Array, Array]:
    """Returns the sum a + b without rounding error, entry by entry, as a pair (high, low)."""
    high = a + b
    part = high - a
    return high, (a - (high - part)) + (b - part)


def exact_product(a: Array, b: Array) -> tuple[Array, Array]:
    """Returns the product a b without rounding error, entry by entry, as a pair (high, low)."""
    high = a * b
    (a1, a2), (b1, b2) = _halves(a), _halves(b)
    return high, a2 * b2 - (((high - a1 * b1) - a2 * b1) - a1 * b2)


def product(left: Array, right: Array) -> tuple[Array, Array]:
    """Returns the product left @ right with twice the digits, as a pair, for stacks of matrices of shapes (..., k, n) and (...,
    n, c).
    """
    if not left.shape[-1]:
        whole = left @ right
        return whole, np.zeros_like(whole)
    terms, lost = exact_product(left[..., :, :, None], right[..., None, :, :])
    high, low = terms[..., 0, :], lost.sum(axis=-2)
    for i in range(1, terms.shape[-2]):
        high, off = exact_sum(high, terms[..., i, :])
        low = low + off
    return exact_sum(high, low)


def _halves(a: Array) -> tuple[Array, Array]:
    spread = SPLIT * a
    first = spread - (spread - a)
    return first, a - first


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
