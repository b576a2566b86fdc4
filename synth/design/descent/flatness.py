"""Flatness of an optimum: the change of each entry of a gain, by itself, that raises the norm by a given share.

The paper's optimum is attained on a whole face of gains; near it the norm says next to nothing about which gain to take.
"""

import numpy as np

from models.common.arrays import Array
from synth.design.descent.landscape import Landscape
from synth.plant.generalized import Plant

SMALLEST = 1e-4  # of an entry's scale: the first step
STEPS, HALVINGS = 16, 8  # fourfold steps, beyond which a move is of any size; then to a hundredth of itself


def free_moves(plant: Plant, K: Array, share: float) -> tuple[Array, Array, Array]:
    """For each measurement the largest gain on it, and how far that entry may fall and rise.

    Args:
        K: a stabilising gain, shape (m, q).
        share: relative increase of the norm that is allowed.

    Returns:
        Gain, fall and rise, each of shape (q,); the last two >= 0, and infinite where no move matters.
    """
    landscape = Landscape(plant)
    x = landscape.point(K)
    allowed = landscape.norm(x)[0] * (1 + share)
    q = K.shape[1]
    largest = np.abs(K).argmax(axis=0) * q + np.arange(q)  # as an index of x

    def stays(i: int, move: float) -> bool:
        there = x.copy()
        there[i] += move
        return landscape.norm(there, allowed)[0] <= allowed

    fall, rise = (np.array([_furthest(lambda t, i=i, sign=sign: stays(i, sign * t)) for i in largest]) for sign in (-1, 1))
    scale = landscape.scale.ravel()[largest]
    return K.ravel()[largest], fall * scale, rise * scale


def _furthest(stays) -> float:
    """The largest move that stays, found by growing and halving."""
    inside, outside = 0.0, SMALLEST
    for _ in range(STEPS):
        if not stays(outside):
            break
        inside, outside = outside, 4 * outside
    else:
        return np.inf
    for _ in range(HALVINGS):
        middle = (inside + outside) / 2
        if stays(middle):
            inside = middle
        else:
            outside = middle
    return inside
