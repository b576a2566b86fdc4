"""Where on a panel the axes are, and which; and a line through their points as SVG writes it."""

from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.figures.axis import Axis, axis_of
from models.figures.figure import Bars, Classes, Panel, Shades

LETTER = 9.6  # width of a digit, at the size that narrow screens have
ROW, BAR = 40, 12  # of bars, and their thickness; above each its name
FINE = 100  # parts of a unit that coordinates are written in


@dataclass(frozen=True)
class Area:
    """Where on a panel the axes are, and which [panel's units, from its upper left corner]."""

    left: float
    top: float
    width: float
    height: float
    x: Axis
    y: Axis

    def across(self, values: Array) -> Array:
        """Where numbers lie along the horizontal axis."""
        return self.left + self.width * self.x.place(values)

    def down(self, values: Array) -> Array:
        """Where numbers lie along the vertical axis."""
        return self.top + self.height * (1 - self.y.place(values))


def area_of(panel: Panel, width: float, height: float) -> Area:
    """The axes of a panel of this size, all labels beside them."""
    ground, curves = panel.ground, panel.curves
    across, down = [curve.x for curve in curves], [curve.y for curve in curves]
    xlim, ylim = panel.xlim, panel.ylim
    if isinstance(ground, Bars):
        lengths = np.concatenate([ground.values, *across])
        longest = 1.02 * np.max(lengths[np.isfinite(lengths)], initial=0.0) or 1.0
        count = len(ground.names)
        return Area(4, 4, width - 8, ROW * count, Axis(0.0, float(longest)), Axis(count - 0.5, -0.5))
    if isinstance(ground, Classes):
        half = [(end[-1] - end[0]) / (2 * max(1, len(end) - 1)) for end in (ground.x, ground.y)]
        xlim, ylim = ((end[0] - size, end[-1] + size) for end, size in zip((ground.x, ground.y), half, strict=True))
    elif isinstance(ground, Shades):
        xlim, ylim = (ground.x[0], ground.x[-1]), (ground.y[0], ground.y[-1])
    x, y = axis_of(across, xlim, panel.xlog), axis_of(down, ylim, panel.ylog)
    left, top = 14 + LETTER * max((len(text) for _, text in y.ticks(6)), default=1), 34
    right = 70 if isinstance(ground, Shades) else 8 + LETTER / 2 * max((len(text) for _, text in x.ticks(6)), default=1)
    return Area(left, top, width - left - right, height - top - 48, x, y)


def line_path(x: Array, y: Array) -> str:
    """A line through points [panel's units] in hundredths, each but the first from the one before; NaN interrupts it."""
    known = np.isfinite(x) & np.isfinite(y)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], known, [False]])))
    pieces = []
    for first, last in edges.reshape(-1, 2).tolist():
        points = np.round(FINE * np.stack([x[first:last], y[first:last]], axis=1)).astype(int)
        steps = np.diff(points, axis=0)
        numbers = " ".join(f"{step}" for step in steps[np.any(steps, axis=1)].ravel().tolist())
        pieces.append(f"M{points[0, 0]} {points[0, 1]}{f'l{numbers}' if numbers else ''}".replace(" -", "-"))
    return "".join(pieces)
