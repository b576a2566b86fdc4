"""What lies below a panel's curves, as SVG: bars, cells of a map, shades with their scale."""

import itertools
import unicodedata
from collections.abc import Iterator, Sequence

import numpy as np

from models.common.arrays import Array
from models.figures.area import BAR, FINE, ROW, Area, line_path
from models.figures.axis import Axis, nice_step
from models.figures.figure import Bars, Classes, Panel, Shades, Spans, bands
from models.figures.names import drawn_text

# From light to dark: ColorBrewer's YlOrBr.
SEQUENCE = ("#ffffe5", "#fff7bc", "#fee391", "#fec44f", "#fe9929", "#ec7014", "#cc4c02", "#993404", "#662506")
# Widths of letters at the size that bars are named in: most, wide ones, those of East Asia.
NARROW, BROAD, FULL = 8.0, 12.5, 13.0


def shade_colors(count: int) -> list[str]:
    """So many colours from light to dark."""
    parts = np.array([[int(color[i : i + 2], 16) for i in (1, 3, 5)] for color in SEQUENCE])
    at = np.linspace(0, len(SEQUENCE) - 1, count)
    mixed = np.stack([np.interp(at, np.arange(len(SEQUENCE)), parts[:, i]) for i in range(3)], axis=1)
    return ["#" + "".join(f"{round(part):02x}" for part in color) for color in mixed.tolist()]


def levels(ground: Shades) -> list[float]:
    """Round levels that all of it lies between."""
    low, high = (float(end) for end in (np.nanmin(ground.z), np.nanmax(ground.z)))
    if high - low <= 1e-9 * max(abs(low), abs(high)):
        room = 0.1 * max(abs(low), abs(high)) or 1.0
        low, high = low - room, high + room
    step = nice_step(high - low, 12)
    return [k * step for k in range(int(np.floor(low / step)), int(np.ceil(high / step)) + 1)]


def ground_parts(panel: Panel, area: Area) -> Iterator[str]:
    """The ground of a panel, in pieces of SVG."""
    if isinstance(panel.ground, Bars):
        yield from _bars(panel.ground, area)
    elif isinstance(panel.ground, Classes):
        yield from _classes(panel.ground, area)
    elif isinstance(panel.ground, Spans):
        yield from _spans(panel.ground, area)
    elif isinstance(panel.ground, Shades) and np.isfinite(panel.ground.z).any():
        yield from _shades(panel.ground, area)


def _bars(bars: Bars, area: Area) -> Iterator[str]:
    right = area.left + area.width
    rows = zip(bars.names, bars.values.tolist(), bars.words, bars.colors, strict=True)
    for k, (name, value, words, color) in enumerate(rows):
        top = area.top + ROW * k
        shown = shortened(name, area.width - text_width(words) - 10)
        yield f'<text class="name" x="{area.left:.5g}" y="{top + 11:.5g}">{drawn_text(shown)}</text>'
        yield f'<text class="name" x="{right:.5g}" y="{top + 11:.5g}" text-anchor="end">{drawn_text(words)}</text>'
        if np.isfinite(value):
            width = max(0.5, float(area.across(np.array(value))) - area.left)
            said = drawn_text(f"{name}: {words}")
            yield (
                f'<rect class="f-{color[1:]}" data-name="{said}" x="{area.left:.5g}" y="{top + (ROW - BAR) / 2:.5g}" '
                f'width="{width:.5g}" height="{BAR}"/>'
            )


def text_width(text: str) -> float:
    """About how wide a text is beside a bar, at most [panel's units]."""
    full = sum(unicodedata.east_asian_width(one) in "WF" for one in text)
    broad = sum(one in "mw%@&" or one.isupper() for one in text)
    return FULL * full + BROAD * broad + NARROW * (len(text) - full - broad)


def shortened(name: str, room: float) -> str:
    """A name, or as much of its beginning as there is room for."""
    if text_width(name) <= room:
        return name
    widths = np.cumsum([text_width(one) for one in name])
    return f"{name[: int(np.searchsorted(widths, room - BROAD))]}…"


def _spans(ground: Spans, area: Area) -> Iterator[str]:
    for (low, high), name in zip(ground.ends, ground.names, strict=True):
        left, right = (float(np.clip(area.across(np.array(end)), area.left, area.left + area.width)) for end in (low, high))
        yield (
            f'<rect class="f-{ground.color[1:]}" data-name="{drawn_text(name)}" x="{left:.5g}" y="{area.top:.5g}" '
            f'width="{right - left:.5g}" height="{area.height:.5g}"/>'
        )


def _classes(ground: Classes, area: Area) -> Iterator[str]:
    size = area.width / len(ground.x), area.height / len(ground.y)
    for i, (name, color) in enumerate(zip(ground.names, ground.colors, strict=True)):
        if np.any(ground.kind == i):
            path = "".join(_cells(ground.kind == i, area, *size))
            yield f'<path class="cells f-{color[1:]}" data-name="{drawn_text(name)}" d="{path}"/>'


def _cells(there: Array, area: Area, width: float, height: float) -> Iterator[str]:
    """Every row's runs of cells."""
    for row, cells in enumerate(there):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], cells, [False]])))
        top = area.top + area.height - (row + 1) * height
        for first, last in edges.reshape(-1, 2).tolist():
            left, across = area.left + first * width, (last - first) * width
            yield f"M{left:.6g} {top:.6g}h{across:.6g}v{height:.6g}h{-across:.6g}z"


def _shades(ground: Shades, area: Area) -> Iterator[str]:
    between = levels(ground)
    colors = shade_colors(len(between) - 1)
    for (low, high), color, rings in zip(itertools.pairwise(between), colors, bands(ground, between), strict=True):
        path = "".join(f"{line_path(area.across(ring[:, 0]), area.down(ring[:, 1]))}z" for ring in rings)
        name = drawn_text(f"{ground.label} {low:.6g} to {high:.6g}")
        if path:
            yield f'<path class="f-{color[1:]}" data-name="{name}" transform="scale({1 / FINE})" d="{path}"/>'
    yield from _color_bar(ground.label, between, colors, area)


def _color_bar(label: str, between: Sequence[float], colors: Sequence[str], area: Area) -> Iterator[str]:
    left, step = area.left + area.width + 12, area.height / len(colors)
    scale = Axis(between[0], between[-1])
    for k, color in enumerate(colors):
        top = area.top + area.height - (k + 1) * step
        yield f'<rect class="f-{color[1:]}" x="{left:.5g}" y="{top:.5g}" width="12" height="{step + 0.3:.5g}"/>'
    for tick, text in scale.ticks(6):
        down = area.top + area.height * (1 - float(scale.place(np.array(tick))))
        yield f'<text class="at" x="{left + 16:.5g}" y="{down + 4:.5g}">{drawn_text(text)}</text>'
    yield f'<text class="name" x="{left + 56:.5g}" y="18" text-anchor="end">{drawn_text(label)}</text>'
