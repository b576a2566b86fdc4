"""Sums and products of numbers with twice the digits of floats. A number is the sum of a pair (high, low) of floats.

Knuth's sum and Dekker's product are exact, because the rounding error is also a float, which is stored as `low`. Source: Ogita,
Rump, Oishi 2005, Accurate sum and dot product. All numbers must have magnitudes between about 1e-140 and 1e300, like the
entries of plants.
"""

import numpy as np

from models.common.arrays import Array

SPLIT = 2.0**27 + 1  # this factor splits a float into two halves of 26 bits each, so that products of halves are exact


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
