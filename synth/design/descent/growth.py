"""Growth of a gain by stages, at most twofold each, as long as each is worth it.

Minimising a norm without bounds ruins a controller: from the paper's controller I it walks to [-72240, -82631] for a thousandth
of gamma, because the infimum lies at infinite gain. So a doubling of the gain has a price, and a stage that buys less is undone.
"""

import math
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from models.common.arrays import Array

WORTH = 1e-3  # relative decrease of a norm or a goal: the price of a doubling of the gain
STAGES = 20  # a growth of 2^20; nothing is worth more
SAME = 1e-6  # relative; less is no growth, and no decrease

Value = TypeVar("Value")


def price(growth: float) -> float:
    """Returns the relative decrease that a growth of the gain has to buy."""
    return WORTH * math.log2(growth)


def lower_by_growth(
    x: Array,
    value: Value,
    lower: Callable[[Array, Value, float], tuple[Array, Value]],
    bought: Callable[[Value, Value], float],
    size: float | None = None,
) -> tuple[Array, Value, tuple[float, float] | None]:
    """Lowers a value from a point, first without growth of the largest entry, then by stages of twofold growth.

    Args:
        x: point of a landscape.
        value: value there.
        lower: returns a point and a value, from a point and its value, with entries up to a limit.
        bought: returns the relative decrease from one value to another.
        size: largest entry that the point counts with; its own if it is not given.

    Returns:
        Point, value, and the decrease and the growth of the stage that was undone; None without one, or if it bought nothing.
    """
    size = float(np.abs(x).max()) if size is None else size
    for stage in range(STAGES):
        moved, there = lower(x, value, 2 * size if stage else size)
        growth, share = float(np.abs(moved).max()) / size if size else 1.0, bought(value, there)
        if growth > 1 + SAME and share < WORTH:
            return x, value, (share, growth) if share > SAME else None
        x, value, size = moved, there, float(np.abs(moved).max())
        if stage and growth <= 1 + SAME:
            break
    return x, value, None
