"""A gain that makes the loops of many plants stable at once, as far as a descent leads to one."""

from collections.abc import Sequence

import numpy as np

from models.common.arrays import Array
from synth.goals.banded import BandLandscape
from synth.search.descent import quasi_newton

STABLE = -1e-4  # of the fastest pole: far enough left to start from
ROUNDS = 100


def downhill_to_stability(landscapes: Sequence[BandLandscape], x: Array, free: Array) -> Array:
    """A point further down the largest real part of a pole of any of the loops.

    Args:
        landscapes: of the plants, with the same points.
        x: the start.
        free: which entries of a point may move, by index.
    """
    rate = float(np.abs(np.linalg.eigvals(landscapes[0].A)).max()) or 1.0

    def abscissa(t: Array, _: float) -> tuple[float, Array]:
        there = x.copy()
        there[free] = t
        value, slope = max((landscape.abscissa(there) for landscape in landscapes), key=lambda each: each[0])
        return value / rate, slope[free] / rate

    moved = x.copy()
    if np.isfinite(abscissa(x[free], np.inf)[0]):
        moved[free] = quasi_newton(abscissa, x[free], ROUNDS, STABLE)[0]
    return moved
