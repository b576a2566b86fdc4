"""Sums and products with twice the digits of floats: pairs (high, low), whose sum is the number.

Knuth's sum and Dekker's product are exact: the rounding error is a float itself, and is kept (Ogita, Rump, Oishi 2005, Accurate
sum and dot product). Numbers must stay away from 1e300 and 1e-140; entries of a plant do.
"""

import numpy as np

from models.common.arrays import Array

SPLIT = 2.0**27 + 1  # halves a float: each half has 26 bits, so that products of halves are exact

CONVERGED_CHANGE = 1e-14  # relative; an iteration that moves by less has converged
MOST_TURNS = 12  # iterations; each gains the digits that the condition of A leaves, of sixteen


def exact_sum(a: Array, b: Array) -> tuple[Array, Array]:
    """Returns a + b without error, entry by entry."""
    high = a + b
    part = high - a
    return high, (a - (high - part)) + (b - part)


def exact_product(a: Array, b: Array) -> tuple[Array, Array]:
    """Returns a b without error, entry by entry."""
    high = a * b
    (a1, a2), (b1, b2) = _halves(a), _halves(b)
    return high, a2 * b2 - (((high - a1 * b1) - a2 * b1) - a1 * b2)


def product(left: Array, right: Array) -> tuple[Array, Array]:
    """Returns left @ right with twice the digits, for stacks of matrices of shapes (..., k, n) and (..., n, c)."""
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
