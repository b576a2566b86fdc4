"""Figures as data, for picture files and for pages in a browser."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from models.common.arrays import Array

Dash = Literal["solid", "dash", "dot", "dashdot", "longdash", "none"]
Marker = Literal["", "o", "x", "+"]  # circle (hollow), cross, plus

# Colours and line styles of the paper.
STYLES: dict[str, tuple[str, Dash]] = {
    "passive": ("#000000", "dot"),
    "state": ("#1f77b4", "dash"),
    "I": ("#d62728", "dashdot"),
    "II": ("#2ca02c", "solid"),
}
OTHERS = ("#9467bd", "#ff7f0e", "#8c564b", "#17becf", "#e377c2", "#bcbd22", "#393b79", "#00695c")
DASHES: tuple[Dash, ...] = ("longdash", "solid", "dot", "dashdot", "dash")  # the next one when all colours are used


def styles(names: tuple[str, ...]) -> dict[str, tuple[str, Dash]]:
    """Returns colour and line style of every controller: those of the paper, or the next ones that are unused.

    Args:
        names: all controllers, in order, so that a controller's style is the same in every figure.
    """
    rest = [name for name in names if name not in STYLES]
    free: list[tuple[str, Dash]] = [(color, dash) for dash in DASHES for color in OTHERS]
    return {name: STYLES.get(name) or free[rest.index(name) % len(free)] for name in names}


def rgb(color: str) -> tuple[int, int, int]:
    """Returns a colour `#rrggbb` as three numbers from 0 to 255."""
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)


def tint(color: str, share: float) -> str:
    """Returns a colour mixed with a share of white, from 0 to 1."""
    return "#" + "".join(f"{round(part + share * (255 - part)):02x}" for part in rgb(color))


@dataclass(frozen=True, eq=False)
class Curve:
    """A line, points, or both. Without points it is a legend entry only.

    Attributes:
        x, y: shape (N,); NaN interrupts the line.
        label: in the legend, where equal labels have one entry; empty for no entry.
        name: shown at the pointer on a page. Default: the label.
        color: as `#rrggbb`.
        dash: of the line.
        marker: at every point.
        width: of the line [points].
    """

    x: Array
    y: Array
    label: str = ""
    color: str = "#404040"
    dash: Dash = "solid"
    marker: Marker = ""
    width: float = 1.5
    name: str = ""


@dataclass(frozen=True, eq=False)
class Classes:
    """A grid of cells, each of one class.

    Attributes:
        x, y: centres, shapes (N,) and (M,), equidistant.
        kind: index into `colors`, shape (M, N).
        colors: of the classes.
        names: of the classes; those that occur are in the legend.
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


@dataclass(frozen=True, eq=False)
class Shades:
    """A quantity over a plane.

    Attributes:
        x, y: shapes (N,) and (M,).
        z: shape (M, N); NaN for no value.
        label: its name and unit.
    """

    x: Array
    y: Array
    z: Array
    label: str


@dataclass(frozen=True, eq=False)
class Bars:
    """Horizontal bars from zero, the first on top. Bar k is at y = k, where points of a curve may mark it.

    Attributes:
        names: of the bars.
        values: their nonnegative lengths, shape (N,); NaN for no bar.
        words: text at the end of each bar.
        colors: of the bars.
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
        names: of each.
        color: of all.
    """

    ends: tuple[tuple[float, float], ...]
    names: tuple[str, ...]
    color: str = "#dddddd"


@dataclass(frozen=True, eq=False)
class Panel:
    """Pair of axes.

    Attributes:
        title: above the axes; may have two lines.
        xlabel, ylabel: with units; a panel of bars has no ylabel.
        curves: drawn in order.
        ground: below the curves.
        xlog, ylog: True for a logarithmic axis.
        xticks: ticks of the horizontal axis; empty for automatic ones.
        xnames: their labels instead of the numbers.
        xlim, ylim: shown range; None for all.
    """

    title: str
    xlabel: str
    ylabel: str
    curves: tuple[Curve, ...]
    ground: Classes | Shades | Bars | Spans | None = None
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
        name: of its file, without suffix.
        title: caption: what it shows and how to read it.
        panels: in rows.
        columns: of panels.
        size: of one panel [inches].
    """

    name: str
    title: str
    panels: tuple[Panel, ...]
    columns: int = 2
    size: tuple[float, float] = (5.2, 3.5)

    @property
    def rows(self) -> int:
        """Number of rows of panels."""
        return -(-len(self.panels) // self.columns)


def thinned(y: Array, every: int) -> Array:
    """Returns the indices of the points of a line to draw: every `every`-th, and the largest and smallest, which texts quote.

    Args:
        y: shape (N,), finite somewhere.
        every: at least 1.
    """
    return np.union1d(np.arange(0, len(y), every), [np.nanargmax(y), np.nanargmin(y)])


def level(x: Array, y: Array, z: Array, height: float) -> tuple[Array, Array]:
    """Returns the contour z = `height`, z of shape (M, N), over the grid y, x, as x and y of a curve, NaN between its pieces."""
    from contourpy import contour_generator

    pieces = contour_generator(x, y, np.ma.masked_invalid(z)).lines(height)
    gap = np.full((1, 2), np.nan)
    joined = np.concatenate([gap, *(part for piece in pieces for part in (np.asarray(piece), gap))])
    return joined[:, 0], joined[:, 1]


def bands(ground: Shades, levels: Sequence[float]) -> list[list[Array]]:
    """Returns the outlines of the areas between neighbouring levels, shapes (N, 2), holes included."""
    from contourpy import contour_generator

    contours = contour_generator(ground.x, ground.y, np.ma.masked_invalid(ground.z), fill_type="OuterOffset")
    outlines = []
    for low, high in itertools.pairwise(levels):
        pieces: Any = contours.filled(low, high)
        outlines.append([ring for points, cuts in zip(*pieces, strict=True) for ring in np.split(points, cuts[1:-1])])
    return outlines
