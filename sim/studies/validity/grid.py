"""Axes of a map of validity, and the bumps that belong to its cells."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.common.errors import InputError, list_names
from models.common.schema import SI, keys
from models.common.units import setting
from models.roads.road import LOWEST, Bump

NUMBERS = {name: key for name, key in keys(Bump).items() if isinstance(key, SI)}  # keys of a bump whose values are numbers
UNITS = {name: key.unit for name, key in NUMBERS.items()}
MOST_CELLS = 100_000


@dataclass(frozen=True)
class GridAxis:
    """Axis of a map, along which a quantity of the bump takes evenly spaced values.

    Attributes:
        name: quantity of the bump that varies along this axis: height, length or speed.
        values: values of the quantity in SI units, ascending.
    """

    name: str
    values: tuple[float, ...]


def read_axes(texts: Sequence[str]) -> tuple[GridAxis, ...]:
    """Returns the axes defined by one or two values of `--vary`, each in the form `name:low:high:count`.

    Raises:
        InputError: the number of axes is not 1 or 2, the axes are equal, or an axis is invalid: unknown quantity, invalid
            number, fewer than two points.
    """
    example = "as in --vary height:0.02:0.3:20 --vary speed:3:30:20"
    if len(texts) not in (1, 2):
        raise InputError(f"--vary is given {len(texts)} times; give --vary once or twice, for {list_names(UNITS)}, {example}")
    axes = []
    for text in texts:
        name, *parts = text.split(":")
        if name not in UNITS:
            raise InputError(f"--vary {text}: unknown quantity {name!r}; vary one or two of {list_names(UNITS)}, {example}")
        limits = [setting(f"--vary {name}", part, UNITS[name]) for part in parts[:2]]
        try:
            (low, high), count = limits, int(parts[2])
            wrong = len(parts) != 3
        except (ValueError, IndexError):
            wrong, low, high, count = True, 0.0, 0.0, 0
        if wrong:
            raise InputError(f"--vary {text} does not have the form NAME:LOW:HIGH:COUNT, {example}")
        smallest, largest = LOWEST if name == "height" else NUMBERS[name].low, NUMBERS[name].high
        if not smallest <= low < high <= largest:
            raise InputError(
                f"--vary {text}: the range is not allowed; give LOW below HIGH, both from {smallest:g} to {largest:g} "
                f"{UNITS[name]}"
            )
        if count < 2:
            raise InputError(
                f"--vary {text}: {count} points are too few for a map; give 2 or more points, or a single value with --{name}"
            )
        if count > MOST_CELLS // 2:  # half the largest number of cells of a map, because the other axis has at least 2 points
            raise InputError(
                f"--vary {text}: {count} points are too many, because a map may have at most {MOST_CELLS} cells; give "
                "fewer points"
            )
        axes.append(GridAxis(name, tuple(np.linspace(low, high, count).tolist())))
    if axes[0].name == axes[-1].name and len(axes) > 1:
        raise InputError(f"--vary {axes[0].name} is given twice; vary two different quantities of {list_names(UNITS)}")
    count = math.prod(len(axis.values) for axis in axes)
    if count > MOST_CELLS:
        raise InputError(f"the map has {count} cells, but at most {MOST_CELLS} are allowed; give fewer points on the axes")
    return tuple(axes)


def grid(axes: Sequence[GridAxis], fixed: dict[str, float]) -> list[Bump]:
    """Returns the bumps of all cells of the map. In the order of the bumps, the last axis changes fastest.

    Args:
        axes: axes of the map of validity.
        fixed: value of each bump quantity that is not an axis, by name: height [m], length [m] or speed [m/s].
    """
    names = [axis.name for axis in axes]
    cells = [fixed | dict(zip(names, values, strict=True)) for values in itertools.product(*(axis.values for axis in axes))]
    return [Bump(cell["height"], cell["length"], cell["speed"]) for cell in cells]
