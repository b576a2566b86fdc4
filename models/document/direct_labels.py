"""Direct labels of curves: each name next to its own line, far from other lines, for readers who cannot distinguish hues.

A panel is divided into columns, in each of which a line covers an interval. A label lies above or below its line, at the columns
where the distance to all other lines and labels is largest. Lines on each other share a label. A line without room has none.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from models.common.arrays import Array
from models.document.figure import Panel

Interval = tuple[Array, Array]  # the lowest and the highest y in every column

COLUMNS = 100
GAP = 2.0  # between a line and its label [panel's units]
NOWHERE = 1e6  # an interval from this to minus this is none
CLEAR = 6.0  # least distance from other lines and labels [panel's units]
FAR = 30.0  # distance from which on more of it counts no more [panel's units]
SAME = 1.5  # distance of lines that look like one [panel's units]
STEEP = 4.0  # largest change of a line beside its label, as a share of the height of the label
SLOPED = 0.7  # share of that change by which other lines are farther away
WIDEST = 0.45  # longest label, as a share of the panel


@dataclass(frozen=True)
class Label:
    """The name of a curve on a panel.

    Attributes:
        text: the name.
        x, y: centre, in the coordinates of the points that it was placed by.
    """

    text: str
    x: float
    y: float


def direct_labels(
    panel: Panel,
    points: Sequence[tuple[Array, Array]],
    size: tuple[float, float],
    width: Callable[[str], float],
    height: float,
) -> list[Label]:
    """Returns labels of a panel's lines, if it has several with names, in panel's units, in a rectangle from (0, 0) to `size`.

    Args:
        panel: panel with the curves.
        points: x and y of every curve in that rectangle, shapes (N,); NaN interrupts a line.
        width: returns the width of a text.
        height: height of a line of text.
    """
    curves = panel.curves
    named = [i for i, one in enumerate(curves) if one.label and one.dash != "none" and len(one.x) > 1]
    if len({curves[i].label for i in named}) < 2:
        return []
    taken = [_intervals(x, y, size, one.dash != "none") for one, (x, y) in zip(curves, points, strict=True)]
    found: list[Label] = []
    labels: list[Interval] = []
    while named:
        first = named[0]
        own = [i for i in named if _one_line(taken[first], taken[i])]
        named = [i for i in named if i not in own]
        marks = [i for i, one in enumerate(curves) if one.dash == "none" and one.color in {curves[j].color for j in own}]
        low, high = (end([taken[i][k] for i in (*own, *marks)], axis=0) for k, end in enumerate((np.min, np.max)))
        others = [one for i, one in enumerate(taken) if i not in (*own, *marks)] + labels
        text = ", ".join(dict.fromkeys(curves[i].label for i in own))
        there = _placed((low, high), others, size, width(text), height) if width(text) <= WIDEST * size[0] else None
        if there is not None:
            columns, top = there
            found.append(Label(text, (columns.start + columns.stop) / 2 * size[0] / COLUMNS, top + height / 2))
            covered = np.full(COLUMNS, NOWHERE), np.full(COLUMNS, -NOWHERE)
            covered[0][columns], covered[1][columns] = top, top + height
            labels.append(covered)
    return found


def _one_line(one: Interval, other: Interval) -> bool:
    """Returns True if two lines are drawn on each other."""
    return bool(np.abs(np.stack(one) - np.stack(other)).max() <= SAME)


def _placed(
    own: Interval, others: Sequence[Interval], size: tuple[float, float], width: float, height: float
) -> tuple[slice, float] | None:
    """Returns the columns and the lower end of a label beside its line and far from all others; None if there is no room."""
    count = max(1, int(np.ceil(width * COLUMNS / size[0])))
    low, high = (sliding_window_view(ends, count) for ends in own)
    whole, low, high = low.max(axis=1) < NOWHERE, low.min(axis=1), high.max(axis=1)
    rest = [[sliding_window_view(ends, count) for ends in other] for other in others]
    best: tuple[float, int, float] | None = None
    for first, last in ((low - GAP - height, low - GAP), (high + GAP, high + GAP + height)):
        clear = np.full(len(low), FAR)
        for a, b in rest:
            clear = np.minimum(clear, np.maximum(a - last[:, None], first[:, None] - b).min(axis=1))
        steep = high - low
        fits = whole & (first >= 0) & (last <= size[1]) & (steep <= STEEP * height) & (clear >= CLEAR + SLOPED * steep)
        score = np.where(fits, clear + 0.02 * np.arange(len(low)), -np.inf)
        score[fits] -= 0.5 * steep[fits]
        k = int(score.argmax())
        if fits[k] and (best is None or score[k] > best[0]):
            best = float(score[k]), k, float(first[k])
    return (slice(best[1], best[1] + count), best[2]) if best is not None else None


def _intervals(x: Array, y: Array, size: tuple[float, float], joined: bool) -> Interval:
    """Returns the lowest and the highest y of a curve in every column; `NOWHERE` where it is not."""
    step, known = size[0] / COLUMNS, np.isfinite(x) & np.isfinite(y)
    x, y = np.where(known, x, np.nan), np.clip(np.where(known, y, np.nan), -1e4, 1e4)
    if joined and len(x) > 1:  # as many points on every piece that none of its columns is left out
        pieces = np.nan_to_num(np.ceil(np.abs(np.diff(x)) / (step / 2)), nan=1.0).clip(1, 2 * COLUMNS).astype(int)
        start = np.repeat(np.arange(len(pieces)), pieces)
        along = (np.arange(len(start)) - np.repeat(np.cumsum(pieces) - pieces, pieces)) / pieces[start]
        x, y = (np.append(values[start] + along * np.diff(values)[start], values[-1]) for values in (x, y))
    column = np.floor(np.where(np.isfinite(x), x, -1.0) / step).astype(int)
    inside = (column >= 0) & (column < COLUMNS) & np.isfinite(y)
    low, high = np.full(COLUMNS, NOWHERE), np.full(COLUMNS, -NOWHERE)
    np.minimum.at(low, column[inside], y[inside])
    np.maximum.at(high, column[inside], y[inside])
    return low, high
