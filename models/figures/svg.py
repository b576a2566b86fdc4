"""One panel as SVG, to stand in a page: text is text, and colours are classes, which the page's style sheet fills.

A curve is one path in hundredths, lines `M x y l dx dy ...`, markers one `M` each at their middle; with the axes' ends, which its
`svg` says, that is all that `page.js` needs to name what is under the pointer.
"""

import json
from collections.abc import Iterator, Sequence
from html import escape

import numpy as np

from models.figures.area import FINE, ROW, Area, area_of, line_path
from models.figures.axis import Axis
from models.figures.describe import about, quantity
from models.figures.figure import Bars, Classes, Curve, Panel, Shades
from models.figures.ground import ground_parts
from models.figures.names import drawn_text

WIDTH, HEIGHT = 420, 280
WIDE = (600, 360)  # of a figure of one panel
BARS = 320  # width of a panel of bars
DASHES = {"solid": (), "dash": (6, 3), "dot": (1.8, 2.2), "dashdot": (7, 2, 2, 2), "longdash": (10, 3), "none": ()}
MARKERS = {
    "o": "m-300 0a300 300 0 1 0 600 0a300 300 0 1 0-600 0z",
    "x": "m-300-300l600 600m0-600l-600 600",
    "+": "m0-450v900m-450-450h900",
}


def svg(panel: Panel, name: str, wide: bool = False) -> str:
    """A panel as an `svg` element, whose identifier is `plot-` and this name."""
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
    ]
    ends = {
        "area": [round(value, 2) for value in (area.left, area.top, area.width, area.height)],
        "x": _ends(panel.xlabel, area.x, panel.xnames),
        "y": _ends(panel.ylabel, area.y) if panel.ylabel else None,
    }
    identifier = escape(f"plot-{name}")
    title, text = about(panel)
    return (
        f'<svg class="plot {shape} {"paper" if on_paper(panel) else "ink"}" id="{identifier}" role="img" '
        f'aria-labelledby="{identifier}-title {identifier}-text" viewBox="0 0 {width} {height}" '
        f'data-axes="{escape(json.dumps(ends, allow_nan=False))}">'
        f'<title id="{identifier}-title">{drawn_text(title)}</title><desc id="{identifier}-text">{drawn_text(text)}</desc>'
        f"{''.join(parts)}</svg>"
    )


def _ends(label: str, axis: Axis, names: Sequence[str] = ()) -> dict[str, object]:
    """What an axis is of, as `page.js` has it."""
    name, unit = quantity(label)
    return {"name": name, "unit": unit, "low": axis.low, "high": axis.high, "log": axis.log, "names": list(names)}


def on_paper(panel: Panel) -> bool:
    """Whether its colours lie on ground that is as light by night as by day."""
    return isinstance(panel.ground, Classes | Shades)


def _axes(panel: Panel, area: Area, height: float) -> Iterator[str]:
    """Grid, labels and names of the axes."""
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


def _line(curve: Curve, area: Area) -> str:
    path = line_path(area.across(curve.x), np.clip(area.down(curve.y), -1e4, 1e4))
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
    return _drawn(curve, path, ' stroke-width="150"', "point ")


def _drawn(curve: Curve, path: str, look: str, kind: str = "line ") -> str:
    name = curve.name or curve.label
    named = f' data-name="{drawn_text(name)}"' if name else ""
    return f'<path class="{kind}s-{curve.color[1:]}"{named} transform="scale({1 / FINE})"{look} d="{path}"/>' if path else ""
