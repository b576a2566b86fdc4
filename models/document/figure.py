"""Figures as data, from which picture files and pages for a browser are drawn."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from models.common.arrays import Array

Dash = Literal["solid", "dash", "dot", "dashdot", "longdash", "none"]
# Markers of curves: hollow circle, square, triangle, diamond, triangle and pentagon; then two crosses
Marker = Literal["", "o", "s", "^", "D", "v", "p", "x", "+"]


class Style(NamedTuple):
    """Line style of a controller. Any two styles differ in more than colour, so readers can distinguish them without colours.

    Attributes:
        color: colour as `#rrggbb`.
        dash: dash pattern of lines.
        marker: marker of points.
    """

    color: str
    dash: Dash
    marker: Marker


# Colours that colour-blind readers can distinguish, from M. Okabe and K. Ito (2008), Color Universal Design. The light colours
# are darker here, so that their contrast on white is 3. The dash patterns are the same as in that publication.
BLACK, BLUE, VERMILLION, GREEN = "#000000", "#0072b2", "#d55e00", "#009e73"
PURPLE, ORANGE, SKY, GREY = "#c471a0", "#bd8200", "#3d97cc", "#6e6e6e"
STYLES: dict[str, Style] = {
    "passive": Style(BLACK, "dot", "o"),
    "state": Style(BLUE, "dash", "s"),
    "I": Style(VERMILLION, "dashdot", "^"),
    "II": Style(GREEN, "solid", "D"),
}
OTHERS = (PURPLE, ORANGE, SKY, GREY, BLUE, VERMILLION, GREEN)
# Dash patterns of curves; a figure with more curves than colours uses the next pattern
DASHES: tuple[Dash, ...] = ("longdash", "solid", "dot", "dashdot", "dash")
POINTS: tuple[Marker, ...] = ("v", "p", "D", "s", "^", "o")


def styles(names: tuple[str, ...]) -> dict[str, Style]:
    """Returns colour, line style and marker of every controller: the style in the paper, or the next unused style.

    Args:
        names: names of all controllers in a fixed order, so that a controller has the same style in every figure.
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
    """Curve in a panel: a line, points, or both. A curve without points is only an entry of the legend.

    Attributes:
        x: horizontal values, shape (N,).
        y: vertical values, shape (N,). A coordinate NaN interrupts the line.
        label: name in the legend; curves with equal labels share an entry. A curve with an empty label has no entry in the
            legend.
        name: name in the text alternative; by default, the label.
        color: colour as `#rrggbb`.
        dash: dash pattern of the line.
        marker: marker of every point; empty for points without a marker.
        width: width of the line [points].
        filled: True for filled markers, False for hollow markers.
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
    """Map: a grid of cells, each of which belongs to a class.

    Attributes:
        x: horizontal centres of the cells, equidistant, shape (N,).
        y: vertical centres of the cells, equidistant, shape (M,).
        kind: index of each cell's class, shape (M, N).
        colors: colours of the classes.
        names: names of the classes; the legend contains only the classes that occur in the grid.
    """

    x: Array
    y: Array
    kind: Array
    colors: tuple[str, ...]
    names: tuple[str, ...]

    @property
    def legend(self) -> list[tuple[str, str]]:
        """Name and colour of each class that occurs in the map and has a name."""
        pairs = zip(self.names, self.colors, strict=True)
        return [pair for i, pair in enumerate(pairs) if pair[0] and np.any(self.kind == i)]

    @property
    def labels(self) -> list[tuple[str, int, int]]:
        """Name of every class whose area has room for the name, with the row and column of the innermost cell of the class."""
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


ROOM = 0.04  # margin at both ends of an axis, relative to the range of the axis
# A map shows the name of a class if the innermost cell of the class is more than 1/WIDE of the map's width from its edge
WIDE = 8


@dataclass(frozen=True, eq=False)
class Bars:
    """Horizontal bars from zero, the first bar on top.

    Attributes:
        names: names of the bars.
        values: lengths of the bars, at least 0, shape (N,); NaN for no bar.
        words: text that is written next to each bar.
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
        ends: start and end of each interval; an infinite end is the border of the panel.
        names: name of each interval.
        color: colour of all intervals.
    """

    ends: tuple[tuple[float, float], ...]
    names: tuple[str, ...]
    color: str = "#dddddd"


@dataclass(frozen=True, eq=False)
class Panel:
    """Panel of a figure: a pair of axes with curves.

    Attributes:
        title: title above the axes; may have two lines.
        xlabel: label of the horizontal axis with its unit.
        ylabel: label of the vertical axis with its unit; empty for a panel of bars.
        curves: curves, in the order in which they are drawn.
        ground: cells, bars or shaded intervals that are drawn below the curves; None for a panel that contains only curves.
        xlog: True for a logarithmic horizontal axis.
        ylog: True for a logarithmic vertical axis.
        xticks: ticks of the horizontal axis; empty for automatic ticks.
        xnames: labels of the ticks, instead of numbers.
        xlim: shown range of the horizontal axis; None for the range of the data.
        ylim: shown range of the vertical axis; None for the range of the data.
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
    """Figure: several panels that belong together.

    Attributes:
        name: name of the figure's file, without suffix.
        title: caption that explains how to read the figure.
        panels: panels of the figure, row by row from left to right.
        columns: number of columns of panels.
        finding: result in one sentence; may be empty.
    """

    name: str
    title: str
    panels: tuple[Panel, ...]
    columns: int = 2
    finding: str = ""


class Entry(NamedTuple):
    """Entry of a legend: a line, a marker, both, or a patch of colour.

    Attributes:
        label: text of the entry.
        color: colour as `#rrggbb`.
        dash: dash pattern of the line; "none" for no line.
        width: width of the line [points].
        marker: marker of the points; may be empty.
        filled: True for filled markers.
        ground: True if the entry explains the colour of an area in a map.
    """

    label: str
    color: str
    dash: Dash = "none"
    width: float = 0.0
    marker: Marker = ""
    filled: bool = False
    ground: bool = False


def legend(figure: Figure) -> list[Entry]:
    """Returns one legend entry per label.

    In the legend, the classes of a panel come before its curves. A line and points with the same label share an entry.
    """
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
    """Returns the limits of an axis that shows all values with a margin."""
    joined = np.concatenate([*values, np.zeros(0)])
    joined = joined[np.isfinite(joined)]
    if not len(joined):
        return 0.0, 1.0
    low, high = float(joined.min()), float(joined.max())
    room = ROOM * (high - low)
    if room <= 1e-9 * max(abs(low), abs(high)):  # all values are equal, except for rounding errors
        room = 0.1 * max(abs(low), abs(high)) or 1.0
    return low - room, high + room


def drawn_indices(y: Array, every: int) -> Array:
    """Returns the indices of the points to draw for a line, so that even the shortest peak remains visible.

    In each group of 2 * `every` consecutive points, only the points with the largest and the smallest value are drawn. Both
    ends of the line are also drawn.

    Args:
        y: values of the line, shape (N,), N at least 1.
        every: factor by which the number of points is reduced, at least 1; with 1, all points are drawn.
    """
    if every == 1:
        return np.arange(len(y))
    blocks = np.pad(y, (0, -len(y) % (2 * every)), mode="edge").reshape(-1, 2 * every)
    starts = np.arange(0, len(y), 2 * every)
    missing = np.isnan(blocks)
    largest, least = np.where(missing, -np.inf, blocks).argmax(axis=1), np.where(missing, np.inf, blocks).argmin(axis=1)
    return np.unique(np.concatenate([[0, len(y) - 1], starts + largest, starts + least]))
