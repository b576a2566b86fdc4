"""Figures as data, for picture files and for pages in a browser."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from models.common.arrays import Array

Dash = Literal["solid", "dash", "dot", "dashdot", "longdash", "none"]
Marker = Literal["", "o", "s", "^", "D", "v", "p", "x", "+"]  # hollow circle, square, triangles, diamond, pentagon; crosses


class Style(NamedTuple):
    """Look of a controller: no two differ by colour alone.

    Attributes:
        color: colour as `#rrggbb`.
        dash: dash of its lines.
        marker: marker of its points.
    """

    color: str
    dash: Dash
    marker: Marker


# Colours of M. Okabe and K. Ito (2008), Color Universal Design, which colour-blind readers can tell apart. The light ones are
# darkened to a contrast of 3 on white. Dashes are the paper's.
BLACK, BLUE, VERMILLION, GREEN = "#000000", "#0072b2", "#d55e00", "#009e73"
PURPLE, ORANGE, SKY, GREY = "#c471a0", "#bd8200", "#3d97cc", "#6e6e6e"
STYLES: dict[str, Style] = {
    "passive": Style(BLACK, "dot", "o"),
    "state": Style(BLUE, "dash", "s"),
    "I": Style(VERMILLION, "dashdot", "^"),
    "II": Style(GREEN, "solid", "D"),
}
OTHERS = (PURPLE, ORANGE, SKY, GREY, BLUE, VERMILLION, GREEN)
DASHES: tuple[Dash, ...] = ("longdash", "solid", "dot", "dashdot", "dash")  # the next one when all colours are used
POINTS: tuple[Marker, ...] = ("v", "p", "D", "s", "^", "o")


def styles(names: tuple[str, ...]) -> dict[str, Style]:
    """Returns colour, line style and marker of every controller: those of the paper, or the next ones that are unused.

    Args:
        names: all controllers, in order, so that a controller's style is the same in every figure.
    """
    rest = [name for name in names if name not in STYLES]
    taken = {(style.color, style.dash) for style in STYLES.values()}
    every = (
        Style(OTHERS[k % len(OTHERS)], DASHES[k % len(DASHES)], POINTS[k % len(POINTS)]) for k in range(len(OTHERS) * len(DASHES))
    )
    free = [style for style in every if (style.color, style.dash) not in taken]
    return {name: STYLES.get(name) or free[rest.index(name) % len(free)] for name in names}


def rgb(color: str) -> tuple[int, int, int]:
    """Returns a colour `#rrggbb` as three numbers from 0 to 255."""
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)


@dataclass(frozen=True, eq=False)
class Curve:
    """A line, points, or both. Without points it is a legend entry only.

    Attributes:
        x, y: shape (N,); NaN interrupts the line.
        label: name in the legend, where equal labels have one entry; empty for no entry.
        name: name in the text alternative. Default: the label.
        color: colour as `#rrggbb`.
        dash: dash of the line.
        marker: marker of every point; empty for none.
        width: width of the line [points].
        filled: True for full markers instead of hollow ones.
    """

    x: Array
    y: Array
    label: str = ""
    color: str = "#404040"
    dash: Dash = "solid"
    marker: Marker = ""
    width: float = 1.5
    name: str = ""
    filled: bool = False


@dataclass(frozen=True, eq=False)
class Classes:
    """A grid of cells, each of one class.

    Attributes:
        x, y: centres, shapes (N,) and (M,), equidistant.
        kind: index into `colors`, shape (M, N).
        colors: colours of the classes.
        names: names of the classes; those that occur are in the legend.
    """

    x: Array
    y: Array
    kind: Array
    colors: tuple[str, ...]
    names: tuple[str, ...]

    @property
    def legend(self) -> list[tuple[str, str]]:
        """Name and colour of the classes that occur and have a name."""
        pairs = zip(self.names, self.colors, strict=True)
        return [pair for i, pair in enumerate(pairs) if pair[0] and np.any(self.kind == i)]

    @property
    def labels(self) -> list[tuple[str, int, int]]:
        """Short name, row and column of the innermost cell of every class that has room for words."""
        entries = []
        for i, name in enumerate(self.names):
            inside, depth, at = self.kind == i, 0, (0, 0)
            while name and inside.any():
                depth, at = depth + 1, tuple(np.argwhere(inside)[inside.sum() // 2].tolist())
                padded = np.pad(inside, 1)
                inside = inside & padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
            if depth * WIDE > len(self.x):
                entries.append((name.partition(" first")[0].partition(";")[0], *at))
        return entries


ROOM = 0.04  # margin at both ends of an axis, as a share of its range
WIDE = 8  # a class has room for words if it is as deep as this part of a map


@dataclass(frozen=True, eq=False)
class Bars:
    """Horizontal bars from zero, the first on top.

    Attributes:
        names: names of the bars.
        values: nonnegative lengths of the bars, shape (N,); NaN for no bar.
        words: text at the end of each bar.
        colors: colours of the bars.
    """

    names: tuple[str, ...]
    values: Array
    words: tuple[str, ...]
    colors: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Spans:
    """Shaded intervals of the horizontal axis.

    Attributes:
        ends: start and end of each; an infinite end is the border.
        names: name of each interval.
        color: colour of all intervals.
    """

    ends: tuple[tuple[float, float], ...]
    names: tuple[str, ...]
    color: str = "#dddddd"


@dataclass(frozen=True, eq=False)
class Panel:
    """Pair of axes.

    Attributes:
        title: title above the axes; may have two lines.
        xlabel, ylabel: labels with units; a panel of bars has no ylabel.
        curves: curves in the order of drawing.
        ground: layer below the curves.
        xlog, ylog: True for a logarithmic axis.
        xticks: ticks of the horizontal axis; empty for automatic ones.
        xnames: labels of the ticks instead of numbers.
        xlim, ylim: shown range; None for all.
    """

    title: str
    xlabel: str
    ylabel: str
    curves: tuple[Curve, ...]
    ground: Classes | Bars | Spans | None = None
    xlog: bool = False
    ylog: bool = False
    xticks: tuple[float, ...] = ()
    xnames: tuple[str, ...] = ()
    xlim: tuple[float, float] | None = None
    ylim: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False)
class Figure:
    """Panels that belong together.

    Attributes:
        name: name of its file, without suffix.
        title: caption that explains how to read it.
        panels: panels in rows.
        columns: number of columns of panels.
        finding: result in one sentence, or empty.
    """

    name: str
    title: str
    panels: tuple[Panel, ...]
    columns: int = 2
    finding: str = ""


class Entry(NamedTuple):
    """Entry of a legend: a line, a marker, both, or a patch of colour.

    Attributes:
        label: text.
        color: colour as `#rrggbb`.
        dash, width: style of the line; no line with `none`.
        marker: marker of the points, or empty.
        filled: True for full markers.
        ground: True for an area of a map.
    """

    label: str
    color: str
    dash: Dash = "none"
    width: float = 0.0
    marker: Marker = ""
    filled: bool = False
    ground: bool = False


def legend(figure: Figure) -> list[Entry]:
    """Returns one legend entry per label, classes of a panel before its curves; line and points of one label are together."""
    entries: dict[str, Entry] = {}
    for panel in figure.panels:
        if isinstance(panel.ground, Classes):
            for name, color in panel.ground.legend:
                entries.setdefault(name, Entry(name, color, ground=True))
        for curve in panel.curves:
            if not curve.label:
                continue
            before = entries.get(curve.label, Entry(curve.label, curve.color))
            line = before if before.dash != "none" else before._replace(dash=curve.dash, width=curve.width)
            entries[curve.label] = line if line.marker else line._replace(marker=curve.marker, filled=curve.filled)
    return list(entries.values())


def axis_ends(values: Sequence[Array]) -> tuple[float, float]:
    """Returns the ends of an axis that contains all numbers, with a margin."""
    joined = np.concatenate([*values, np.zeros(0)])
    joined = joined[np.isfinite(joined)]
    if not len(joined):
        return 0.0, 1.0
    low, high = float(joined.min()), float(joined.max())
    room = ROOM * (high - low)
    if room <= 1e-9 * max(abs(low), abs(high)):  # one number, or its rounding
        room = 0.1 * max(abs(low), abs(high)) or 1.0
    return low - room, high + room


def drawn_indices(y: Array, every: int) -> Array:
    """Returns the indices of the points of a line to draw: of every 2 `every` points the largest and the smallest, and both ends.

    So no peak is cut, however short it is.

    Args:
        y: shape (N,), N at least 1.
        every: step of the thinning, at least 1; with 1 all points are drawn.
    """
    if every == 1:
        return np.arange(len(y))
    blocks = np.pad(y, (0, -len(y) % (2 * every)), mode="edge").reshape(-1, 2 * every)
    starts = np.arange(0, len(y), 2 * every)
    missing = np.isnan(blocks)
    largest, least = np.where(missing, -np.inf, blocks).argmax(axis=1), np.where(missing, np.inf, blocks).argmin(axis=1)
    return np.unique(np.concatenate([[0, len(y) - 1], starts + largest, starts + least]))
