"""Panels as SVG for a page, with a text alternative. Text stays text; colours are CSS classes.

Texts of a page are English, so words from right to left, and long ones, are names of controllers or files. A name from right to
left would reverse the order of numbers and commas next to it (Unicode Bidirectional Algorithm, UAX #9); an isolate prevents that.

A curve is one path in hundredths of a unit: lines `M x y l dx dy ...`, markers one `M` each at their centre. From these and the
axes' ranges in the `svg` element, `page.js` names the point under the pointer.
"""

import itertools
import json
import re
import unicodedata
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from html import escape

import numpy as np

from models.common.arrays import Array
from models.document.axis import BAR, FINE, ROW, Area, Axis, area_of, line_path, nice_step
from models.document.direct_labels import direct_labels
from models.document.figure import Bars, Classes, Curve, Dash, Figure, Marker, Panel, Shades, Spans, bands

LONG = 16  # letters; a line may break within longer names
OPEN, CLOSE = "\N{FIRST STRONG ISOLATE}", "\N{POP DIRECTIONAL ISOLATE}"
# A name ends at spaces and punctuation other than - and _.
NAME = re.compile(r"[^\s!-,./:-@\[-^`{-~]+")


def drawn_text(text: str) -> str:
    """Returns a text for SVG and attributes: names are isolated by characters instead of elements, and code is in quotes."""
    return escape(quoted_code(NAME.sub(lambda name: f"{OPEN}{name[0]}{CLOSE}" if _leftward(name[0]) else name[0], text)))


def quoted_code(text: str) -> str:
    """Returns a text with quotes instead of backticks, where no other font can show a name."""
    return text.replace("`", "'")


def page_text(text: str) -> str:
    """Returns a text as HTML. Names from right to left, and long ones, are `bdi` elements, within which lines may break.

    What is in backticks is a `code` element.
    """
    pieces, at = [], 0
    for name in NAME.finditer(text):
        if _leftward(name[0]) or len(name[0]) > LONG:
            pieces += [escape(text[at : name.start()]), f"<bdi>{escape(name[0])}</bdi>"]
            at = name.end()
    return re.sub("`([^`]+)`", r"<code>\1</code>", "".join([*pieces, escape(text[at:])]))


def _leftward(name: str) -> bool:
    return any(unicodedata.bidirectional(letter) in ("R", "AL", "AN") for letter in name)


def quantity(label: str) -> tuple[str, str]:
    """Returns the name and the unit of an axis, from `name [unit]`; either may be empty."""
    name, _, unit = label.partition("[")
    return name.strip(), unit.removesuffix("]").strip()


def about(panel: Panel) -> tuple[str, str]:
    """Returns a panel's title on one line, and a description of its content."""
    across, down = (" ".join(filter(None, quantity(label))) for label in (panel.xlabel, panel.ylabel))
    title = panel.title.replace("\n", "; ") or f"{down} over {across}"
    return title, " ".join([*_ground(panel), *_curves(panel)])


def _ground(panel: Panel) -> list[str]:
    ground = panel.ground
    if isinstance(ground, Bars):
        return [f"{name}: {words}." for name, words in zip(ground.names, ground.words, strict=True)]
    if isinstance(ground, Spans):
        return [f"Shaded: {', '.join(ground.names)}."] if ground.names else []
    if isinstance(ground, Classes):
        shares = [(name, float(np.mean(ground.kind == i))) for i, name in enumerate(ground.names)]
        return ["Shares of the map:", *(f"{name}, {100 * share:.3g} %;" for name, share in shares if share), "and on it:"]
    if isinstance(ground, Shades) and np.isfinite(ground.z).any():
        low, high = np.nanmin(ground.z), np.nanmax(ground.z)
        row, column = np.unravel_index(np.nanargmax(ground.z), ground.z.shape)
        where = f"{panel.xlabel} {ground.x[column]:.3g}, {panel.ylabel} {ground.y[row]:.3g}"
        return [f"{ground.label}, from {low:.4g} to {high:.4g}, largest at {where}."]
    return []


def _curves(panel: Panel) -> list[str]:
    """Returns a description of each curve in words: extremes and end of a line, number of points."""
    (_, unit), (_, per) = quantity(panel.ylabel), quantity(panel.xlabel)
    descriptions = []

    def at(x: float) -> str:
        return panel.xnames[panel.xticks.index(x)] if x in panel.xticks and panel.xnames else f"{x:.3g} {per}".rstrip()

    for curve in panel.curves:
        name, there = curve.name or curve.label, np.isfinite(curve.y) & np.isfinite(curve.x)
        if not name or not there.any():
            continue
        x, y = np.asarray(curve.x)[there], np.asarray(curve.y)[there] + 0.0  # no -0
        if curve.dash == "none":
            descriptions.append(f"{name}: {len(x)} point{'s' if len(x) > 1 else ''}.")
        else:
            top, low = int(y.argmax()), int(y.argmin())
            size = f"{y[top]:.3g} {unit}".rstrip()
            largest, least = f"largest {size} at {at(x[top])}", f"least {y[low]:.3g} at {at(x[low])}"
            descriptions.append(f"{name}: {largest}, {least}, at the end {y[-1]:.3g}.")
    return ["As drawn,", *descriptions] if any(" largest " in words for words in descriptions) else descriptions


# ColorBrewer's YlOrBr, from light to dark.
SEQUENCE = ("#ffffe5", "#fff7bc", "#fee391", "#fec44f", "#fe9929", "#ec7014", "#cc4c02", "#993404", "#662506")
# Widths of letters in names of bars: most, wide ones, East Asian ones.
NARROW, BROAD, FULL = 8.0, 12.5, 13.0


def shade_colors(count: int) -> list[str]:
    """Returns `count` colours from light to dark."""
    parts = np.array([[int(color[i : i + 2], 16) for i in (1, 3, 5)] for color in SEQUENCE])
    at = np.linspace(0, len(SEQUENCE) - 1, count)
    mixed = np.stack([np.interp(at, np.arange(len(SEQUENCE)), parts[:, i]) for i in range(3)], axis=1)
    return ["#" + "".join(f"{round(part):02x}" for part in color) for color in mixed.tolist()]


def levels(ground: Shades) -> list[float]:
    """Returns round levels that enclose all values."""
    low, high = (float(end) for end in (np.nanmin(ground.z), np.nanmax(ground.z)))
    if high - low <= 1e-9 * max(abs(low), abs(high)):
        room = 0.1 * max(abs(low), abs(high)) or 1.0
        low, high = low - room, high + room
    step = nice_step(high - low, 12)
    return [k * step for k in range(int(np.floor(low / step)), int(np.ceil(high / step)) + 1)]


def ground_parts(panel: Panel, area: Area) -> Iterator[str]:
    """Yields the SVG elements of a panel's ground."""
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
        yield f'<text class="name" x="{area.left:.5g}" y="{top + 9:.5g}">{drawn_text(shown)}</text>'
        yield f'<text class="name" x="{right:.5g}" y="{top + 9:.5g}" text-anchor="end">{drawn_text(words)}</text>'
        if np.isfinite(value):
            width = max(0.5, float(area.across(np.array(value))) - area.left)
            shown = drawn_text(f"{name}: {words}")
            yield (
                f'<rect class="f-{color[1:]}" data-name="{shown}" x="{area.left:.5g}" y="{top + (ROW - BAR) / 2:.5g}" '
                f'width="{width:.5g}" height="{BAR}"/>'
            )


def text_width(text: str) -> float:
    """Returns an upper estimate of the width of a text beside a bar [panel's units]."""
    full = sum(unicodedata.east_asian_width(letter) in "WF" for letter in text)
    broad = sum(letter in "mw%@&" or letter.isupper() for letter in text)
    return FULL * full + BROAD * broad + NARROW * (len(text) - full - broad)


def shortened(name: str, room: float) -> str:
    """Returns a name, shortened at its end to fit into `room`."""
    if text_width(name) <= room:
        return name
    widths = np.cumsum([text_width(letter) for letter in name])
    return f"{name[: int(np.searchsorted(widths, room - BROAD))]}…"


def _spans(ground: Spans, area: Area) -> Iterator[str]:
    for (low, high), name in zip(ground.ends, ground.names, strict=True):
        left, right = (float(np.clip(area.across(np.array(end)), area.left, area.left + area.width)) for end in (low, high))
        yield (
            f'<rect class="g-{ground.color[1:]}" data-name="{drawn_text(name)}" x="{left:.5g}" y="{area.top:.5g}" '
            f'width="{right - left:.5g}" height="{area.height:.5g}"/>'
        )


def _classes(ground: Classes, area: Area) -> Iterator[str]:
    size = area.width / len(ground.x), area.height / len(ground.y)
    for i, (name, color) in enumerate(zip(ground.names, ground.colors, strict=True)):
        if np.any(ground.kind == i):
            path = "".join(_cells(ground.kind == i, area, *size))
            yield f'<path class="cells g-{color[1:]}" data-name="{drawn_text(name)}" d="{path}"/>'
    for text, row, column in ground.labels:
        x, y = area.left + (column + 0.5) * size[0], area.top + area.height - (row + 0.5) * size[1]
        yield f'<text class="at" x="{x:.5g}" y="{y + 4:.5g}" text-anchor="middle">{drawn_text(text)}</text>'


def _cells(there: Array, area: Area, width: float, height: float) -> Iterator[str]:
    """Yields one path for each run of cells in a row."""
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
            yield f'<path class="g-{color[1:]}" data-name="{name}" transform="scale({1 / FINE})" d="{path}"/>'
    yield from _color_bar(ground.label, between, colors, area)


def _color_bar(label: str, between: Sequence[float], colors: Sequence[str], area: Area) -> Iterator[str]:
    left, step = area.left + area.width + 12, area.height / len(colors)
    scale = Axis(between[0], between[-1])
    for k, color in enumerate(colors):
        top = area.top + area.height - (k + 1) * step
        yield f'<rect class="g-{color[1:]}" x="{left:.5g}" y="{top:.5g}" width="12" height="{step + 0.3:.5g}"/>'
    for tick, text in scale.ticks(6):
        down = area.top + area.height * (1 - float(scale.place(np.array(tick))))
        yield f'<text class="at" x="{left + 16:.5g}" y="{down + 4:.5g}">{drawn_text(text)}</text>'
    yield f'<text class="name" x="{left + 56:.5g}" y="18" text-anchor="end">{drawn_text(label)}</text>'


WIDTH, HEIGHT = 420, 232
WIDE = (600, 360)  # of a figure of one panel
BARS = 260  # width of a panel of bars
DASHES = {"solid": (), "dash": (6, 3), "dot": (1.8, 2.2), "dashdot": (7, 2, 2, 2), "longdash": (10, 3), "none": ()}
MARKERS = {
    "": "",
    "o": "m-300 0a300 300 0 1 0 600 0a300 300 0 1 0-600 0z",
    "s": "m-265-265h530v530h-530z",
    "^": "m0-380l350 590h-700z",
    "v": "m0 380l350-590h-700z",
    "D": "m0-390l390 390l-390 390l-390-390z",
    "p": "m0-360l342 249l-131 402h-422l-131-402z",
    "x": "m-300-300l600 600m0-600l-600 600",
    "+": "m0-450v900m-450-450h900",
}
SMALL, LETTERS = 0.9, 11.0  # width of the letters of a label beside a line, as a share of a bar's; their height [panel's units]
TOLERANCE = 0.12  # how far a simplified line may be from all its points [panel's units]


@dataclass(frozen=True)
class Entry:
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
            line = before if before.dash != "none" else replace(before, dash=curve.dash, width=curve.width)
            entries[curve.label] = line if line.marker else replace(line, marker=curve.marker, filled=curve.filled)
    return list(entries.values())


def kept_points(x: Array, y: Array) -> Array:
    """Returns the indices of the points that a line needs, after D. H. Douglas and T. K. Peucker (1973).

    Args:
        x, y: shape (N,); NaN interrupts the line, and both its neighbours are kept.
    """
    known = np.isfinite(x) & np.isfinite(y)
    kept = ~known
    edges = np.flatnonzero(np.diff(np.concatenate([[False], known, [False]])))
    first, last = edges[::2], edges[1::2] - 1
    kept[first] = kept[last] = True
    while (wide := last - first > 1).any():  # all spans of a depth at once: a line is split hundreds of times, ten deep
        first, last = first[wide], last[wide]
        counts = last - first + 1
        starts = np.cumsum(counts) - counts
        span = np.repeat(np.arange(len(first)), counts)
        at = np.arange(len(span)) + (first - starts)[span]
        across, down = x[at] - x[first][span], y[at] - y[first][span]
        right, up = x[last] - x[first], y[last] - y[first]
        length = np.hypot(right, up)
        closed = length < 1e-9
        away = np.abs(across * up[span] - down * right[span]) / np.where(closed, 1.0, length)[span]
        away = np.where(closed[span], np.hypot(across, down), away)
        most = np.maximum.reduceat(away, starts)
        reached = np.flatnonzero(away == most[span])
        split = most > TOLERANCE
        middle = at[reached[np.searchsorted(reached, starts)]][split]
        kept[middle] = True
        first, last = np.concatenate([first[split], middle]), np.concatenate([middle, last[split]])
    return np.flatnonzero(kept)


def svg(panel: Panel, name: str, wide: bool = False) -> str:
    """Returns a panel as an `svg` element with the identifier `plot-` and this name."""
    shape = "wide" if wide else ""
    width, height = WIDE if wide else (WIDTH, HEIGHT)
    if isinstance(panel.ground, Bars):
        shape, width, height = "bars", BARS, 40 + ROW * len(panel.ground.names)
    area = area_of(panel, width, height)
    place = f'x="{area.left:.5g}" y="{area.top:.5g}" width="{area.width:.5g}" height="{area.height:.5g}"'
    box = f"{area.left:.5g} {area.top:.5g} {area.width:.5g} {area.height:.5g}"
    parts = [
        "" if isinstance(panel.ground, Bars) else f'<rect class="area" {place}/>',
        *ground_parts(panel, area),
        *_axes(panel, area, height),
        f'<svg {place} viewBox="{box}">',  # cuts off what leaves the axes
        *(_line(curve, area) for curve in panel.curves if curve.dash != "none"),
        "</svg>",
        *(_markers(curve, area) for curve in panel.curves if curve.marker),
        *_labels(panel, area),
    ]
    ends = {
        "area": [round(value, 2) for value in (area.left, area.top, area.width, area.height)],
        "x": _ends(panel.xlabel, area.x, panel.xnames),
        "y": _ends(panel.ylabel, area.y) if panel.ylabel else None,
    }
    identifier = escape(f"plot-{name}")
    title, text = about(panel)
    return (
        f'<svg class="{f"plot {shape}".strip()}" id="{identifier}" role="img" '
        f'aria-labelledby="{identifier}-title {identifier}-text" viewBox="0 0 {width} {height}" '
        f'data-axes="{escape(json.dumps(ends, allow_nan=False))}">'
        f'<title id="{identifier}-title">{drawn_text(title)}</title><desc id="{identifier}-text">{drawn_text(text)}</desc>'
        f"{''.join(parts)}</svg>"
    )


def _ends(label: str, axis: Axis, names: Sequence[str] = ()) -> dict[str, object]:
    """Returns name, unit, range and labels of an axis for `page.js`."""
    name, unit = quantity(label)
    return {"name": name, "unit": unit, "low": axis.low, "high": axis.high, "log": axis.log, "names": list(names)}


def _axes(panel: Panel, area: Area, height: float) -> Iterator[str]:
    """Yields grid, labels and names of the axes."""
    left, top, right, bottom = area.left, area.top, area.left + area.width, area.top + area.height
    if not panel.ylabel:
        yield f'<text class="name" x="{left:.5g}" y="{height - 12:.5g}">{drawn_text(panel.xlabel)}</text>'
        return
    grid = "grid" if panel.ground is None else "tick"
    ticks = [(tick, f"{tick:g}") for tick in panel.xticks] or area.x.ticks(6)
    names = panel.xnames or [text for _, text in ticks]
    for at, text in zip(area.across(np.array([tick for tick, _ in ticks])).tolist(), names, strict=True):
        yield f'<path class="{grid}" d="M{at:.5g} {bottom:.5g}V{top if grid == "grid" else bottom + 4:.5g}"/>'
        yield f'<text class="at" x="{at:.5g}" y="{bottom + 17:.5g}" text-anchor="middle">{drawn_text(text)}</text>'
    ticks = area.y.ticks(6)
    for at, (_, text) in zip(area.down(np.array([tick for tick, _ in ticks])).tolist(), ticks, strict=True):
        yield f'<path class="{grid}" d="M{left:.5g} {at:.5g}H{right if grid == "grid" else left - 4:.5g}"/>'
        yield f'<text class="at" x="{left - 6:.5g}" y="{at + 4:.5g}" text-anchor="end">{drawn_text(text)}</text>'
    middle = left + area.width / 2
    yield f'<text class="name" x="{middle:.5g}" y="{height - 8:.5g}" text-anchor="middle">{drawn_text(panel.xlabel)}</text>'
    yield f'<text class="name" x="2" y="18">{drawn_text(panel.ylabel)}</text>'


def _labels(panel: Panel, area: Area) -> Iterator[str]:
    """Yields the names beside the lines."""
    points = [(area.across(one.x) - area.left, area.down(one.y) - area.top) for one in panel.curves]
    size = area.width, area.height
    for one in direct_labels(panel, points, size, lambda text: SMALL * text_width(text), LETTERS):
        at = f'x="{area.left + one.x:.5g}" y="{area.top + one.y + 0.35 * LETTERS:.5g}"'
        yield f'<text class="beside" {at} text-anchor="middle">{drawn_text(one.text)}</text>'


def _line(curve: Curve, area: Area) -> str:
    x, y = area.across(curve.x), np.clip(area.down(curve.y), -1e4, 1e4)
    kept = kept_points(x, y)
    path = line_path(x[kept], y[kept])
    dashes = " ".join(f"{FINE * part:g}" for part in DASHES[curve.dash])
    dashed = f' stroke-dasharray="{dashes}"' if dashes else ""
    return _drawn(curve, path, f' stroke-width="{FINE * curve.width:g}"{dashed}')


def _markers(curve: Curve, area: Area) -> str:
    x, y = area.across(curve.x), area.down(curve.y)
    inside = (abs(x - area.left - area.width / 2) < area.width / 2 + 0.5) & (
        abs(y - area.top - area.height / 2) < area.height / 2 + 0.5
    )
    at = np.round(FINE * np.stack([x[inside], y[inside]], axis=1)).astype(int).tolist()
    path = "".join(f"M{across} {down}{MARKERS[curve.marker]}" for across, down in at)
    return _drawn(curve, path, ' stroke-width="140"', "point full " if curve.filled else "point ")


def _drawn(curve: Curve, path: str, look: str, kind: str = "line ") -> str:
    name = curve.name or curve.label
    named = f' data-name="{drawn_text(name)}"' if name else ""
    return f'<path class="{kind}s-{curve.color[1:]}"{named} transform="scale({1 / FINE})"{look} d="{path}"/>' if path else ""
