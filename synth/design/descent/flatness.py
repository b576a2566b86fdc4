"""Flatness of an optimum: how far a single gain entry can change until the norm rises by a given percentage.

In the paper's problem, a whole set of gains is optimal. Close to the set of optimal gains, the norm hardly depends on the gain.
"""

import numpy as np

from models.common.arrays import Array
from synth.design.descent.landscape import Landscape
from synth.plant.generalized import Plant

SMALLEST = 1e-4  # size of the first step, relative to the scale of the gain entry
# (steps, bisections): number of steps, each four times as long as the previous one, and number of bisections. If all steps are
# allowed, the change counts as unlimited. Otherwise, the bisections determine the allowed change to within 1 %
STEPS, HALVINGS = 16, 8


def free_moves(plant: Plant, K: Array, share: float) -> tuple[Array, Array, Array]:
    """Returns the largest gain entry for each measurement, and by how much this entry may decrease and increase.

    Args:
        K: stabilising gain, shape (m, q).
        share: allowed relative increase of the norm.

    Returns:
        Gain entry, allowed decrease and allowed increase, each of shape (q,). The allowed changes are not negative; they are
        infinite if the entry has no effect.
    """
    landscape = Landscape(plant)
    x = landscape.point(K)
    allowed = landscape.norm(x)[0] * (1 + share)
    q = K.shape[1]
    largest = np.abs(K).argmax(axis=0) * q + np.arange(q)  # position of each gain entry in x

    def stays(i: int, move: float) -> bool:
        there = x.copy()
        there[i] += move
        return landscape.norm(there, allowed)[0] <= allowed

    fall, rise = (np.array([_furthest(lambda t, i=i, sign=sign: stays(i, sign * t)) for i in largest]) for sign in (-1, 1))
    scale = landscape.scale.ravel()[largest]
    return K.ravel()[largest], fall * scale, rise * scale


def _furthest(stays) -> float:
    """Returns the largest change of a gain entry that keeps the norm within its limit, found by increasing steps and then
    bisection.
    """
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
