"""Axes of figures: range, ticks, and place on a panel."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.document.figure import Bars, Classes, Panel, Shades

ROOM = 0.04  # margin at both ends without given limits, as a share of the range
NICE = (1.0, 2.0, 2.5, 5.0, 10.0)  # steps between ticks, times a power of ten
PARTS = ((1.0,), (1.0, 3.0), (1.0, 2.0, 5.0))  # labelled multiples of powers of ten on a logarithmic axis
EXTREME = 300.0  # largest exponent of ten
PLAIN = (1e-3, 1e5)  # range of numbers written without a power of ten
SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class Axis:
    """Range of an axis.

    Attributes:
        low, high: ends of the axis, low < high; both positive on a logarithmic axis.
        log: True for a logarithmic axis.
    """

    low: float
    high: float
    log: bool = False

    def place(self, values: Array) -> Array:
        """Returns positions along the axis, 0 at its low end and 1 at its high end; NaN for numbers without a position."""
        values = np.asarray(values, dtype=float)
        if not self.log:
            return (np.where(np.isfinite(values), values, np.nan) - self.low) / (self.high - self.low)
        known = np.isfinite(values) & (values > 0)
        low, high = math.log(self.low), math.log(self.high)
        return (np.log(np.where(known, values, np.nan)) - low) / (high - low)

    def ticks(self, most: int) -> list[tuple[float, str]]:
        """Returns tick values and labels, about `most` at most."""
        if self.log:
            decades = self._decades(most)
            if len(decades) > 1:
                return decades
        step = nice_step(self.high - self.low, most)
        first, last = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
        digits = len(f"{step:.8f}".rstrip("0").partition(".")[2])
        plain = PLAIN[0] / 10 <= step and max(abs(self.low), abs(self.high)) <= 10 * PLAIN[1]
        ticks = [k * step for k in range(first, last + 1)]
        return [(tick, (f"{tick:.{digits}f}" if plain else f"{tick:.6g}").replace("-", "−")) for tick in ticks]

    def _decades(self, most: int) -> list[tuple[float, str]]:
        low, high = math.log10(self.low), math.log10(self.high)
        labels: list[tuple[float, str]] = []
        for parts in PARTS:
            powers = range(math.floor(low), math.ceil(high) + 1)
            every = max(1, -(-len(powers) // most))
            ticks = [(part, power) for power in powers if power % every == 0 for part in parts]
            inside = [
                (part * 10.0**power, part, power)
                for part, power in ticks
                if low - 1e-9 <= math.log10(part) + power <= high + 1e-9
            ]
            if labels and len(inside) > most:
                break
            labels = [(tick, _power(part, power)) for tick, part, power in inside]
        return labels


def nice_step(span: float, most: int) -> float:
    """Returns a round step that divides a span into at most `most` parts."""
    rough = span / most
    power = 10.0 ** math.floor(math.log10(rough))
    return next(factor * power for factor in NICE if factor * power >= rough * (1 - 1e-9))


def axis_of(values: Sequence[Array], limits: tuple[float, float] | None, log: bool) -> Axis:
    """Returns an axis with these limits; without limits, one that contains all numbers, with a margin."""
    if limits is not None:
        return Axis(float(limits[0]), float(limits[1]), log)
    joined = np.concatenate([np.ravel(np.asarray(array, dtype=float)) for array in values] or [np.zeros(0)])
    joined = joined[np.isfinite(joined) & ((joined > 0) | (not log))]
    if not len(joined):
        return Axis(1.0, 10.0, True) if log else Axis(0.0, 1.0)
    low, high = float(joined.min()), float(joined.max())
    if log:
        low, high = math.log10(low), math.log10(high)
        room = ROOM * (high - low) if high - low > 1e-3 else 0.1
        return Axis(10 ** max(low - room, -EXTREME), 10 ** min(high + room, EXTREME), True)
    room = ROOM * (high - low)
    if room <= 1e-9 * max(abs(low), abs(high)):  # one number, or its rounding
        room = 0.1 * max(abs(low), abs(high)) or 1.0
    return Axis(low - room, high + room)


def _power(part: float, power: int) -> str:
    value = part * 10.0**power
    if PLAIN[0] <= value < PLAIN[1]:
        return f"{value:g}"
    return f"{f'{part:g}·' if part != 1 else ''}10{str(power).translate(SUPERSCRIPT)}"


LETTER = 9.6  # width of a digit, at the letter size of narrow screens
ROW, BAR = 40, 12  # height of a row with a bar and its name above, and of the bar
FINE = 100  # coordinates are written in 1 / FINE of a unit


@dataclass(frozen=True)
class Area:
    """Rectangle of the axes on a panel, from its upper left corner, in the panel's units."""

    left: float
    top: float
    width: float
    height: float
    x: Axis
    y: Axis

    def across(self, values: Array) -> Array:
        """Returns horizontal coordinates of numbers."""
        return self.left + self.width * self.x.place(values)

    def down(self, values: Array) -> Array:
        """Returns vertical coordinates of numbers."""
        return self.top + self.height * (1 - self.y.place(values))


def area_of(panel: Panel, width: float, height: float) -> Area:
    """Returns the axes of a panel of this size, with space for all labels."""
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
    """Returns the SVG path through points [panel's units], in hundredths and relative steps; NaN interrupts the line."""
    known = np.isfinite(x) & np.isfinite(y)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], known, [False]])))
    pieces = []
    for first, last in edges.reshape(-1, 2).tolist():
        points = np.round(FINE * np.stack([x[first:last], y[first:last]], axis=1)).astype(int)
        steps = np.diff(points, axis=0)
        numbers = " ".join(f"{step}" for step in steps[np.any(steps, axis=1)].ravel().tolist())
        pieces.append(f"M{points[0, 0]} {points[0, 1]}{f'l{numbers}' if numbers else ''}".replace(" -", "-"))
    return "".join(pieces)
