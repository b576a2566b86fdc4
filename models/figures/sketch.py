"""Sketches of vehicles as SVG: a body on springs, dampers and forces over wheels, tyres and a road, with a text alternative.

Lines and letters have the colour of the text around them, so that a sketch is legible on light and dark pages.
"""

import itertools
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from html import escape

from models.figures.svg import drawn_text

GREEK = {"phi": "φ", "theta": "θ"}
SYMBOL = re.compile(r"([A-Za-z])(?:_(\w+))?")
ARM, GAP, SIDE, COMPUTER = 44, 30, 46, 112  # between parts of a strut, between struts, beside them, and for the computer
BODY, HUB, TYRE, GROUND = (34, 78), (148, 174), 174, 228  # levels, downwards


@dataclass(frozen=True)
class Strut:
    """A wheel with its suspension and its tyre. Symbols are as in "k_s"; a part without one has none drawn.

    Attributes:
        place: along the view [m].
        name: of the wheel; empty if there is one alone.
        spring, damper, force: between body and wheel.
        adjustable: True if an adjustable damper gives the force.
        stopped: True with bump stops.
        mass: of the wheel; empty if the suspension stands on the road.
        tyre, tyre_damper: between wheel and road.
    """

    place: float
    name: str = ""
    spring: str = ""
    damper: str = ""
    force: str = ""
    adjustable: bool = False
    stopped: bool = False
    mass: str = ""
    tyre: str = ""
    tyre_damper: str = ""


@dataclass(frozen=True)
class View:
    """A side of a vehicle.

    Attributes:
        struts: from left to right.
        body: symbols in the body, as in "m_s, I_y".
        heights: symbols of the heights of body, wheel and road; empty ones are left out.
        spans: distances below the road: both ends [m], and a symbol.
        bar: symbol of an anti-roll bar; empty without one.
        computer: lines in the box of the computer; empty without one.
    """

    struts: tuple[Strut, ...]
    body: str
    heights: tuple[str, str, str] = ("z_s", "z_u", "z_r")
    spans: tuple[tuple[float, float, str], ...] = ()
    bar: str = ""
    computer: tuple[str, ...] = ()


@dataclass(frozen=True)
class Sketch:
    """A vehicle as it is drawn.

    Attributes:
        title: what it is.
        views: from above to below.
        rows: symbol, meaning and value of everything that it shows or has; a symbol may be empty.
    """

    title: str
    views: tuple[View, ...]
    rows: tuple[tuple[str, str, str], ...]

    @property
    def single(self) -> "tuple[Sketch, ...]":
        """Every view as a sketch of its own, to stand beside the others where there is room."""
        return tuple(replace(self, views=(view,)) for view in self.views)

    @property
    def text(self) -> str:
        """Description in words."""
        return "; ".join(f"{meaning}{f' {symbol}' if symbol else ''}: {value}" for symbol, meaning, value in self.rows)


def symbol_html(symbol: str) -> str:
    """Returns symbols with their subscripts as HTML."""
    return SYMBOL.sub(lambda one: f"<i>{one[1]}</i>{f'<sub>{GREEK.get(one[2], one[2])}</sub>' if one[2] else ''}", escape(symbol))


def sketch_svg(sketch: Sketch, road: Callable[[float], float] | None = None, alone: bool = False) -> str:
    """Returns a sketch as an SVG element.

    Args:
        road: place along the view [m] -> height of the road in the drawing, upwards; None for a flat one.
        alone: True for a file of its own, in dark ink on white.
    """
    parts, top, width = [], 0.0, max(_width(view) for view in sketch.views)
    for view in sketch.views:
        parts.append(f'<g transform="translate({(width - _width(view)) / 2:g} {top:g})">{"".join(_view(view, road))}</g>')
        top += GROUND + (60 if view.spans else 28)
    own = ' xmlns="http://www.w3.org/2000/svg" color="#1c1c1c" style="background:#ffffff"' if alone else ""
    return (
        f'<svg{own} class="sketch" role="img" viewBox="0 0 {width:g} {top:g}" width="{width:g}" height="{top:g}" '
        'fill="none" stroke="currentColor" stroke-width="1.4" font-family="sans-serif" font-size="14">'
        f"<title>{drawn_text(sketch.title)}</title><desc>{drawn_text(sketch.text)}</desc>{''.join(parts)}</svg>"
    )


def _arms(strut: Strut) -> list[tuple[str, str]]:
    """Returns the parts between body and wheel, from left to right: kind and symbol."""
    kinds = (("spring", strut.spring), ("damper", strut.damper), ("adjustable" if strut.adjustable else "force", strut.force))
    return [(kind, symbol) for kind, symbol in kinds if symbol]


def _half(strut: Strut) -> float:
    return ARM * max(len(_arms(strut)), 1) / 2 + 8


def _middles(view: View) -> list[float]:
    """Returns where the struts are drawn: in proportion to their places, and not into each other."""
    places = [strut.place for strut in view.struts]
    gaps = [one + other + GAP for one, other in itertools.pairwise(map(_half, view.struts))]
    lengths = [b - a for a, b in itertools.pairwise(places)]
    scale = max((gap / length for gap, length in zip(gaps, lengths, strict=True) if length > 0), default=0.0)
    first = SIDE + _half(view.struts[0])
    return [first + scale * (place - places[0]) for place in places]


def _width(view: View) -> float:
    return _middles(view)[-1] + _half(view.struts[-1]) + (COMPUTER + 24 if view.computer else 0) + SIDE


def _view(view: View, road: Callable[[float], float] | None) -> list[str]:
    middles, places = _middles(view), [strut.place for strut in view.struts]
    scale = (middles[-1] - middles[0]) / (places[-1] - places[0]) if len(places) > 1 and places[-1] > places[0] else 60.0

    def at(place: float) -> float:
        return middles[0] + scale * (place - places[0])

    def height(x: float) -> float:
        return road(places[0] + (x - middles[0]) / scale) if road is not None else 0.0

    left, right = middles[0] - _half(view.struts[0]), middles[-1] + _half(view.struts[-1])
    ends = range(int(left) - 38, int(right) + 39, 4)
    parts = [f'<path d="M{" L".join(f"{x} {GROUND - height(x):.4g}" for x in ends)}" stroke-width="2.2"/>']
    parts += [f'<path d="M{x} {GROUND - height(x):.4g}l-7 8" opacity=".5"/>' for x in ends[2::4]]
    parts += [_box(left, right, *BODY), _letters((left + right) / 2, sum(BODY) / 2 + 5, view.body)]
    if view.bar:
        parts += [f'<path d="M{left + 6:g} {BODY[1] + 9}H{right - 6:g}v-9M{left + 6:g} {BODY[1]}v9" stroke-width="3"/>']
        parts.append(_letters((left + right) / 2, BODY[1] + 26, view.bar))
    for strut, x in zip(view.struts, middles, strict=True):
        parts += _strut(strut, x, height(x))
    first = view.struts[0]
    for symbol, level in zip(view.heights, (BODY[1], HUB[1] - height(middles[0]) if first.mass else None, GROUND), strict=True):
        if symbol and level is not None:
            parts.append(f'<path d="M{left - 4:g} {level:.4g}h-18m9 0v-22m-4 7l4-7l4 7"/>')
            parts.append(_letters(left - 32, level - 8, symbol))
    for low, high, symbol in view.spans:
        low, high = at(low), at(high)
        parts.append(f'<path d="M{low:.4g} {GROUND + 30}v12M{high:.4g} {GROUND + 30}v12M{low:.4g} {GROUND + 36}H{high:.4g}"/>')
        parts.append(_letters((low + high) / 2, GROUND + 52, symbol))
    if view.computer:
        x = right + 24
        parts.append(_box(x, x + COMPUTER, 92, 106 + 17 * len(view.computer)))
        parts += [_letters(x + COMPUTER / 2, 110 + 17 * k, line) for k, line in enumerate(view.computer)]
        parts.append(f'<path d="M{right:g} 56H{x + COMPUTER / 2:g}V92M{x:g} 113H{right + 2:g}" stroke-dasharray="5 3"/>')
        parts.append(f'<path d="M{x + COMPUTER / 2 - 4:g} 84l4 8l4-8M{right + 10:g} 109l-8 4l8 4"/>')
        parts.append(_letters(x + COMPUTER / 2 - 12, 78, "y"))
    return parts


def _strut(strut: Strut, x: float, lift: float) -> list[str]:
    """Returns a suspension with its wheel, which the road has lifted."""
    half, parts = _half(strut) - 6, []
    low = (HUB[0] if strut.mass else GROUND) - lift
    arms = _arms(strut)
    for k, (kind, symbol) in enumerate(arms):
        parts += _part(kind, symbol, x + ARM * (k - (len(arms) - 1) / 2) - 6, BODY[1], low)
    if strut.stopped:
        parts.append(f'<path d="M{x - half - 1:g} {BODY[1]}h10l-2 12h-6z" fill="currentColor"/>')
    if strut.mass:
        parts += [_box(x - half, x + half, low, low + HUB[1] - HUB[0]), _letters(x, low + 18, strut.mass)]
        tyre = [one for one in (("spring", strut.tyre), ("damper", strut.tyre_damper)) if one[1]]
        for k, (kind, symbol) in enumerate(tyre):
            parts += _part(kind, symbol, x + ARM * (k - (len(tyre) - 1) / 2), TYRE - lift, GROUND - lift)
    elif not arms and strut.tyre:
        parts += _part("spring", strut.tyre, x, BODY[1], GROUND - lift)
    return [*parts, f'<circle cx="{x:.4g}" cy="{GROUND - lift:.4g}" r="3" fill="currentColor"/>'] + (
        [_letters(x, GROUND + 25, strut.name, plain=True)] if strut.name else []
    )


def _part(kind: str, symbol: str, x: float, top: float, low: float) -> list[str]:
    """Returns a spring, a damper or a force between two levels."""
    middle, free = (top + low) / 2, (low - top) / 2
    if kind == "spring":
        reach = free - 6
        path = f"M{x:g} {top:g}V{middle - reach:.4g}" + "".join(f"l{d:g} {reach / 4:.4g}" for d in (-7, *(14, -14) * 3, 7))
        path += f"V{low:.4g}"
    elif kind == "force":
        path = f"M{x:g} {top:g}V{middle - 10:.4g}m0 20V{low:.4g}m-10 {middle - low:.4g}a10 10 0 1 0 20 0a10 10 0 1 0 -20 0"
        path += "m10 6v-12m-3 4l3-4l3 4"
    else:
        path = f"M{x:g} {top:g}V{middle:.4g}m-6 0h12m-14 -9v18h16v-18M{x:g} {middle + 9:.4g}V{low:.4g}"
        path += f"M{x - 13:g} {middle + 12:.4g}l26 -24m-7 1l7 -1l-1 7" if kind == "adjustable" else ""
    return [f'<path d="{path}"/>', _letters(x + 19, middle + 4, symbol)]


def _box(left: float, right: float, top: float, low: float) -> str:
    return f'<rect x="{left:.4g}" y="{top:.4g}" width="{right - left:.4g}" height="{low - top:.4g}" rx="3"/>'


def _letters(x: float, y: float, text: str, plain: bool = False) -> str:
    """Returns a text around x; of symbols what follows _ is a subscript."""
    if not plain and re.fullmatch(r"[A-Za-z](_\w+)?(, [A-Za-z](_\w+)?)*", text):
        inner = SYMBOL.sub(_subscripted, escape(text))
    else:
        inner = drawn_text(text)
    return f'<text x="{x:.4g}" y="{y:.4g}" text-anchor="middle" fill="currentColor" stroke="none">{inner}</text>'


def _subscripted(one: re.Match[str]) -> str:
    low = f'<tspan dy="3" font-size="10">{GREEK.get(one[2], one[2])}</tspan><tspan dy="-3">\u200b</tspan>' if one[2] else ""
    return f'<tspan font-style="italic">{one[1]}</tspan>{low}'
