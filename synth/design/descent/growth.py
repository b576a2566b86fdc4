"""Growth of a gain in stages. A stage at most doubles the gain, and is only kept if it lowers the norm by enough.

Minimising a norm without bounds ruins a controller, because the infimum lies at infinite gain. Starting from the paper's
controller I, the gain would grow to [-72240, -82631] for a decrease of gamma by a thousandth. Each doubling of the gain must
therefore lower the norm by at least 0.1 %. A stage that lowers it by less is undone.
"""

import math
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from models.common.arrays import Array

WORTH = 1e-3  # relative decrease of a norm or a goal that a doubling of the gain must reach
STAGES = 20  # largest number of stages: a growth by 2^20
SAME = 1e-6  # relative; a smaller change counts as no growth, or as no decrease

Value = TypeVar("Value")


def price(growth: float) -> float:
    """Returns the relative decrease of the norm that a growth of the gain must reach."""
    return WORTH * math.log2(growth)


def lower_by_growth(
    x: Array,
    value: Value,
    lower: Callable[[Array, Value, float], tuple[Array, Value]],
    bought: Callable[[Value, Value], float],
    size: float | None = None,
) -> tuple[Array, Value, tuple[float, float] | None]:
    """Lowers a value from a point, first without growth of the largest entry, then in stages that may double it.

    Args:
        x: point of a landscape.
        value: value at this point.
        lower: function of a point, its value and a limit on the entries; returns a point and its value.
        bought: function that returns the relative decrease from one value to another.
        size: largest entry of the point; computed by default.

    Returns:
        Point, its value, and the decrease and the growth of the stage that was undone. The last is None if no stage was undone,
        or if that stage gained nothing.
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
