"""Growth of a gain in stages. Each stage at most doubles the gain. A stage is kept only if it lowers the norm sufficiently.

Minimising a norm without limits on the gain leads to useless controllers, because the infimum may lie at infinite gain.
From the paper's controller I, a descent without limits would increase the gain to [-72240, -82631] to lower gamma by only a
thousandth. Each doubling of the gain must therefore lower the norm by at least 0.1 %. A stage that lowers the norm by less is
undone.
"""

import math
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from models.common.arrays import Array

WORTH = 1e-3  # the gain may double again only if the norm or a goal has decreased by at least this relative amount
STAGES = 20  # largest number of stages, each of which may double the gain, so that the gain may grow by a factor of 2^20
SAME = 1e-6  # a growth or a decrease by less than this relative amount does not count

Value = TypeVar("Value")


def price(growth: float) -> float:
    """Returns the smallest relative decrease of the norm that justifies a given growth of the gain."""
    return WORTH * math.log2(growth)


def lower_by_growth(
    x: Array,
    value: Value,
    lower: Callable[[Array, Value, float], tuple[Array, Value]],
    bought: Callable[[Value, Value], float],
    size: float | None = None,
) -> tuple[Array, Value, tuple[float, float] | None]:
    """Lowers a function, first with a fixed limit on the largest entry of the point x, then in stages that may double this
    limit.

    Args:
        x: point of a landscape.
        value: value of the objective function at the point x.
        lower: function that takes a point, its value and a limit on the entries, and returns a better point and its value.
        bought: function that takes two objective values and returns the relative decrease from the first to the second.
        size: largest absolute value of an entry of the point. Default: computed from the point.

    Returns:
        Final point, value at this point, and a pair for the undone stage: relative decrease of the value, and growth factor of
        the largest entry. The pair is None if no stage was undone, or if the undone stage did not lower the objective function.
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
