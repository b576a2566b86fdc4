"""From frequencies beside the maxima of a gain to the maxima."""

from collections.abc import Callable

import numpy as np

from models.common.arrays import Array


def climbed(gains: Callable[[Array], Array], left: Array, middle: Array, right: Array, height: Array) -> Array:
    """Nearer to maxima that lie between frequencies: three points to a parabola, its top the next middle.

    Args:
        gains: of frequencies, one for each; even.
        left, middle, right: around each maximum, shape (P,) each.
        height: in the middle, shape (P,).
    """
    for _ in range(3):
        sides = gains(np.abs(np.concatenate([left, right]))).reshape(2, -1)
        a, b = middle - left, right - middle
        rise, drop = (height - sides[0]) / a, (height - sides[1]) / b
        bend = np.maximum(rise + drop, 1e-300)
        vertex = np.clip(middle + 0.5 * (rise * b - drop * a) / bend, left, right)
        there = gains(np.abs(vertex))
        higher = there > height
        middle, height = np.where(higher, vertex, middle), np.where(higher, there, height)
        width = np.maximum(0.2 * np.minimum(a, b), 1e-7 * np.abs(middle))
        left, right = middle - width, middle + width
    return middle
