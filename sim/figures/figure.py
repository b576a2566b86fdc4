"""Figures as data: what is drawn, said once, for a picture file and for a page in a browser alike."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from models.common.arrays import Array

Dash = Literal["solid", "dash", "dot", "dashdot", "longdash", "none"]
Marker = Literal["", "o", "x", "s", "+"]  # circle (hollow), cross, square, plus

# The paper's colours and line styles; whatever else there is comes after.
STYLES: dict[str, tuple[str, Dash]] = {
    "passive": ("#000000", "dot"),
    "state": ("#1f77b4", "dash"),
    "I": ("#d62728", "dashdot"),
    "II": ("#2ca02c", "solid"),
}
OTHERS = ("#9467bd", "#ff7f0e", "#8c564b", "#17becf", "#e377c2", "#bcbd22")


def styles(names: tuple[str, ...]) -> dict[str, tuple[str, Dash]]:
    """Colour and line style of every controller: the paper's for the paper's."""
    rest = [name for name in names if name not in STYLES]
    return {name: STYLES.get(name) or (OTHERS[rest.index(name) % len(OTHERS)], "longdash") for name in names}


def rgb(color: str) -> tuple[int, int, int]:
    """A colour `#rrggbb` as three numbers from 0 to 255."""
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)


def tint(color: str, share: float) -> str:
    """A colour mixed with a share of white, from 0 to 1."""
    return "#" + "".join(f"{round(part + share * (255 - part)):02x}" for part in rgb(color))


@dataclass(frozen=True, eq=False)
class Curve:
    """A line, points, or both. Without points it is a legend entry only.

    Attributes:
        x, y: shape (N,); NaN interrupts the line.
        label: in the legend, where curves of one label have one entry; empty for none.
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


@dataclass(frozen=True, eq=False)
class Classes:
    """A grid of cells that are each of one kind.

    Attributes:
        x, y: centres, shapes (N,) and (M,), equidistant.
        kind: index into `colors`, shape (M, N).
        colors: of the kinds.
    """

    x: Array
    y: Array
    kind: Array
    colors: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Shades:
    """A quantity over a plane.

    Attributes:
        x, y: shapes (N,) and (M,).
        z: shape (M, N); NaN where it does not exist.
        label: what it is, with its unit.
    """

    x: Array
    y: Array
    z: Array
    label: str


@dataclass(frozen=True, eq=False)
class Panel:
    """One pair of axes.

    Attributes:
        title: above it; may have two lines.
        xlabel, ylabel: with units.
        curves: drawn in order.
        ground: below the curves.
        xlog, ylog: whether an axis is logarithmic.
        xticks: where the horizontal axis is labelled; empty for as usual.
        xlim, ylim: shown range; None for all.
    """

    title: str
    xlabel: str
    ylabel: str
    curves: tuple[Curve, ...]
    ground: Classes | Shades | None = None
    xlog: bool = False
    ylog: bool = False
    xticks: tuple[float, ...] = ()
    xlim: tuple[float, float] | None = None
    ylim: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False)
class Figure:
    """Panels that belong together.

    Attributes:
        name: of its file, without suffix.
        title: above all panels.
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
        """Of panels."""
        return -(-len(self.panels) // self.columns)


def level(x: Array, y: Array, z: Array, height: float) -> tuple[Array, Array]:
    """Where z, shape (M, N), over the grid y, x has a height, as x and y of a curve. NaN is no ground."""
    from contourpy import contour_generator

    pieces = contour_generator(x, y, np.ma.masked_invalid(z)).lines(height)
    gap = np.full((1, 2), np.nan)
    joined = np.concatenate([gap, *(part for piece in pieces for part in (np.asarray(piece), gap))])
    return joined[:, 0], joined[:, 1]
