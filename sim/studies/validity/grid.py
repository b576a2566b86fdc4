"""The axes of a map of validity, and the bumps of its cells."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.common.errors import InputError, listing
from models.roads.road import LIMITS, LOWEST, Bump

UNITS = {"height": "m", "length": "m", "speed": "m/s"}
MOST_CELLS = 100_000


@dataclass(frozen=True)
class GridAxis:
    """Quantity of a bump, varied evenly.

    Attributes:
        name: height, length or speed.
        values: ascending, in SI.
    """

    name: str
    values: tuple[float, ...]


def read_axes(texts: Sequence[str]) -> tuple[GridAxis, GridAxis]:
    """Two axes from `name:low:high:count` each.

    Raises:
        InputError: not two, not different, an unknown quantity, no numbers, a grid of one point.
    """
    example = "as in --vary height:0.02:0.3:20 --vary speed:3:30:20"
    if len(texts) != 2:
        raise InputError(f"a map has two axes, {len(texts)} given; vary two of {listing(UNITS)}, {example}")
    axes = []
    for text in texts:
        name, *numbers = text.split(":")
        if name not in UNITS:
            raise InputError(f"--vary {text}: unknown quantity {name!r}; vary two of {listing(UNITS)}, {example}")
        try:
            low, high, count = float(numbers[0]), float(numbers[1]), int(numbers[2])
            wrong = len(numbers) != 3
        except (ValueError, IndexError):
            wrong, low, high, count = True, 0.0, 0.0, 0
        if wrong:
            raise InputError(f"--vary {text} is not name:low:high:count, {example}")
        smallest, largest = LOWEST if name == "height" else LIMITS[name][0], LIMITS[name][1]
        if not smallest <= low < high <= largest:
            raise InputError(f"--vary {text}: give low < high, from {smallest:g} to {largest:g} {UNITS[name]}")
        if count < 2:
            raise InputError(f"--vary {text}: {count} point(s) make no axis; give 2 or more")
        if count > MOST_CELLS // 2:  # the other axis has 2 or more
            raise InputError(f"--vary {text}: {count} points are too many; a map has at most {MOST_CELLS} cells")
        axes.append(GridAxis(name, tuple(np.linspace(low, high, count).tolist())))
    if axes[0].name == axes[1].name:
        raise InputError(f"--vary {axes[0].name} twice; vary two different ones of {listing(UNITS)}")
    if len(axes[0].values) * len(axes[1].values) > MOST_CELLS:
        raise InputError(
            f"{len(axes[0].values) * len(axes[1].values)} cells are too many; a map has at most {MOST_CELLS}: give fewer points"
        )
    return axes[0], axes[1]


def grid(axes: tuple[GridAxis, GridAxis], fixed: dict[str, float]) -> list[Bump]:
    """The bump of every cell, the second axis running faster."""
    pairs = itertools.product(axes[0].values, axes[1].values)
    cells = [fixed | {axes[0].name: first, axes[1].name: second} for first, second in pairs]
    return [Bump(cell["height"], cell["length"], cell["speed"]) for cell in cells]
