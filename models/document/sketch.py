"""Sketches of vehicles as SVG: a body on springs, dampers and actuators above wheels, tyres and a road.

Every sketch has a text alternative for screen readers.

Lines and letters have the colour of the surrounding text, so a sketch is legible on light and dark pages.
"""

import itertools
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from html import escape

from models.document.reading import drawn_text

# Type of a drawn part ("spring", "damper", "adjustable damper", "force" or "box"), and its symbol such as "k_s" (for a box: the
# name of the box)
Part = tuple[str, str]
GREEK = {"phi": "φ", "theta": "θ"}
SYMBOL = re.compile(r"([A-Za-z])(?:_(\w+))?")
# Distance between the parts of a strut, distance between struts, margin of the drawing, and width of the computer's box
ARM, GAP, SIDE, COMPUTER = 44, 30, 46, 112
AHEAD = 120  # the drawing is longer by this length if the road is not flat
# Vertical positions of body, hub and road, and height of the lower margin; positions increase downwards
BODY, HUB, GROUND, BELOW = (34, 78), (148, 174), 228, 60
LETTERS = 9  # largest number of letters that fit into a box between body and wheel
SEAT, ABOVE = (-62, -36), 66  # vertical positions of the mass of a seat, and height that a seat adds to the drawing


@dataclass(frozen=True)
class Strut:
    """Strut of a sketch: a wheel with its suspension and its tyre.

    Attributes:
        place: horizontal position of the wheel in the view [m].
        name: name of the wheel; empty for a single wheel.
        parts: springs, dampers and actuators between body and wheel, or between body and road.
        mass: symbol of the wheel's mass; empty if there is no wheel, and `parts` touch the road.
        tyre: parts between wheel and road.
        stopped: True for a suspension with bump stops.
    """

    place: float
    name: str
    parts: tuple[Part, ...]
    mass: str = ""
    tyre: tuple[Part, ...] = ()
    stopped: bool = False

    @property
    def half(self) -> float:
        """Half of the width of the strut in the drawing."""
        return ARM * max(len(self.parts), 1) / 2 + 8


@dataclass(frozen=True)
class View:
    """One view of a vehicle, such as the view from the side.

    Attributes:
        struts: struts from left to right.
        body: symbols in the body, such as "m_s, I_y".
        spans: distances that are shown below the road, each with the positions of its two ends [m] and a symbol.
        bar: symbol of an anti-roll bar; empty without a bar.
        computer: lines of text in the box of the computer; empty without a computer.
        seat: seat above the body, with the symbol of its mass; None without a seat.
    """

    struts: tuple[Strut, ...]
    body: str
    spans: tuple[tuple[float, float, str], ...] = ()
    bar: str = ""
    computer: tuple[str, ...] = ()
    seat: Strut | None = None

    @property
    def middles(self) -> list[float]:
        """Horizontal positions of the struts in the drawing, proportional to their places, with a scale at which no struts
        overlap.
        """
        pairs = list(itertools.pairwise(self.struts))
        scale = max(((one.half + other.half + GAP) / (other.place - one.place) for one, other in pairs), default=0.0)
        first = self.struts[0]
        return [SIDE + first.half + scale * (strut.place - first.place) for strut in self.struts]

    @property
    def width(self) -> float:
        """Width of the drawing."""
        return self.middles[-1] + self.struts[-1].half + (COMPUTER + 24) * bool(self.computer) + SIDE


@dataclass(frozen=True)
class Sketch:
    """Sketch of a vehicle.

    Attributes:
        title: title of the sketch.
        views: views from top to bottom.
        rows: a row for each part of the vehicle, drawn or not, with its symbol, meaning and value. The symbol of a part may be
            empty.
    """

    title: str
    views: tuple[View, ...]
    rows: tuple[tuple[str, str, str], ...]

    @property
    def single(self) -> "tuple[Sketch, ...]":
        """Every view as a separate sketch, so that a page can place the sketches side by side if there is room."""
        return tuple(replace(self, views=(view,)) for view in self.views)


def symbol_html(symbol: str) -> str:
    """Returns symbols with their subscripts as HTML."""
    return SYMBOL.sub(lambda one: f"<i>{one[1]}</i>{f'<sub>{GREEK.get(one[2], one[2])}</sub>' if one[2] else ''}", escape(symbol))


def sketch_svg(sketch: Sketch, road: Callable[[float], float] | None = None, alone: bool = False) -> str:
    """Returns a sketch as an SVG element. The rows of the sketch are its text alternative.

    Args:
        sketch: sketch to draw.
        road: function from the horizontal position in the view [m] to the height of the road in the drawing, positive upwards;
            None for a flat road.
        alone: True for a sketch in a file of its own, with dark lines on white.
    """
    above = ABOVE * any(view.seat is not None for view in sketch.views)
    width, high = max(view.width for view in sketch.views) + AHEAD * (road is not None), GROUND + BELOW + above
    drawn = (f'translate(0 {k * high + above})">{"".join(_view(view, road))}' for k, view in enumerate(sketch.views))
    parts = [f'<g transform="{one}</g>' for one in drawn]
    text = "; ".join(f"{meaning}{f' {symbol}' if symbol else ''}: {value}" for symbol, meaning, value in sketch.rows)
    own = ' xmlns="http://www.w3.org/2000/svg" color="#1c1c1c" style="background:#ffffff"' if alone else ""
    return (
        f'<svg{own} role="img" viewBox="0 0 {width:g} {high * len(parts)}" width="{width:g}" height="{high * len(parts)}" '
        'fill="none" stroke="currentColor" stroke-width="1.4" font-family="sans-serif" font-size="14">'
        f"<title>{drawn_text(sketch.title)}</title><desc>{drawn_text(text)}</desc>{''.join(parts)}</svg>"
    )


def _view(view: View, road: Callable[[float], float] | None) -> Iterator[str]:
    middles, first, last = view.middles, view.struts[0], view.struts[-1]
    scale = (middles[-1] - middles[0]) / (last.place - first.place) if len(middles) > 1 else 1.0

    def lift(x: float) -> float:
        return road(first.place + (x - middles[0]) / scale) if road is not None else 0.0

    left, right = middles[0] - first.half, middles[-1] + last.half
    ends = range(int(left) - 38, int(right) + 39 + AHEAD * (road is not None), 4)
    yield f'<path d="M{" L".join(f"{x} {GROUND - lift(x):.4g}" for x in ends)}" stroke-width="2.2"/>'
    yield f'<path d="{"".join(f"M{x} {GROUND - lift(x):.4g}l-7 8" for x in ends[2::4])}" opacity=".5"/>'
    yield from _box((left, right), BODY, view.body)
    if view.seat is not None:
        middle = min(max(middles[0] + scale * (view.seat.place - first.place), left + ARM), right - ARM)
        for k, (kind, symbol) in enumerate(view.seat.parts):
            yield from _part(kind, symbol, middle + ARM * (k - (len(view.seat.parts) - 1) / 2) - 6, SEAT[1], BODY[0])
        yield from _box((middle - view.seat.half + 6, middle + view.seat.half - 6), SEAT, view.seat.mass)
    if view.bar:
        middle = (left + right) / 2
        yield f'<path d="M{left + 6:g} {BODY[1]}v9H{right - 6:g}v-9" stroke-width="3"/>{_letters(middle, 104, view.bar)}'
    for strut, x in zip(view.struts, middles, strict=True):
        yield from _strut(strut, x, lift(x))
    for symbol, level in (("z_s", BODY[1]), ("z_u", HUB[1] - lift(middles[0])), ("z_r", GROUND - lift(middles[0]))):
        if first.mass or symbol != "z_u":
            yield f'<path d="M{left - 4:g} {level:.4g}h-18m9 0v-22m-4 7l4-7l4 7"/>{_letters(left - 32, level - 8, symbol)}'
    for ends_of, symbol in ((span[:2], span[2]) for span in view.spans):
        low, high = (middles[0] + scale * (place - first.place) for place in ends_of)
        yield f'<path d="M{low:.4g} 258v12m0 -6H{high:.4g}m0 -6v12"/>{_letters((low + high) / 2, 280, symbol)}'
    if view.computer:
        box, low = (right + 24, right + 24 + COMPUTER), 106 + 17 * len(view.computer)
        yield from _box(box, (92, low), *view.computer)
        middle = sum(box) / 2
        yield f'<path d="M{right:g} 56H{middle:g}V92M{box[0]:g} 113H{right + 2:g}" stroke-dasharray="5 3"/>'
        yield f'<path d="M{middle - 4:g} 84l4 8l4-8M{right + 10:g} 109l-8 4l8 4"/>{_letters(middle - 12, 78, "y")}'


def _strut(strut: Strut, x: float, lift: float) -> Iterator[str]:
    """Yields the SVG elements of a suspension and its wheel, lifted by the road height `lift`."""
    top, low, road = HUB[0] - lift, HUB[1] - lift, GROUND - lift
    for parts, ends, right in ((strut.parts, (BODY[1], top if strut.mass else road), 6), (strut.tyre, (low, road), 0)):
        for k, (kind, symbol) in enumerate(parts):
            yield from _part(kind, symbol, x + ARM * (k - (len(parts) - 1) / 2) - right, *ends)
    if strut.stopped:
        yield f'<path d="M{x - strut.half + 5:g} {BODY[1]}h10l-2 12h-6z" fill="currentColor"/>'
    if strut.mass:
        yield from _box((x - strut.half + 6, x + strut.half - 6), (top, low), strut.mass)
    yield f'<circle cx="{x:.4g}" cy="{road:.4g}" r="3" fill="currentColor"/>{_letters(x, GROUND + 25, strut.name, plain=True)}'


def _part(kind: str, symbol: str, x: float, top: float, low: float) -> Iterator[str]:
    """Yields the SVG elements of a spring, damper, force or named box between two vertical positions."""
    middle, reach = (top + low) / 2, (low - top) / 2 - 6
    if kind == "box":
        name = symbol if len(symbol) <= LETTERS else f"{symbol[: LETTERS - 1]}…"
        yield f'<path d="M{x:g} {top:.4g}v6m0 {2 * reach:.4g}V{low:.4g}"/>'
        yield from _box((x - 8, x + 8), (top + 6, low - 6))
        yield f'<g transform="rotate(-90 {x:g} {middle:.4g})" font-size="11">{_letters(x, middle + 4, name, plain=True)}</g>'
        return
    if kind == "spring":
        path = f"v6{''.join(f'l{d} {reach / 4:.4g}' for d in (-7, *(14, -14) * 3, 7))}V{low:.4g}"
    elif kind == "force":
        path = (
            f"V{middle - 10:.4g}m0 20V{low:.4g}M{x - 10:g} {middle:.4g}a10 10 0 1 0 20 0a10 10 0 1 0 -20 0m10 6v-12m-3 4l3-4l3 4"
        )
    else:
        path = f"V{middle:.4g}m-6 0h12m-14 -9v18h16v-18m-8 18V{low:.4g}"
        path += f"M{x - 13:g} {middle + 12:.4g}l26 -24m-7 1l7 -1l-1 7" * (kind != "damper")
    yield f'<path d="M{x:g} {top:.4g}{path}"/>{_letters(x + 19, middle + 4, symbol)}'


def _box(across: tuple[float, float], down: tuple[float, float], *lines: str) -> Iterator[str]:
    width, height = across[1] - across[0], down[1] - down[0]
    yield f'<rect x="{across[0]:.4g}" y="{down[0]:.4g}" width="{width:.4g}" height="{height:.4g}" rx="3"/>'
    for k, line in enumerate(lines):
        yield _letters(sum(across) / 2, sum(down) / 2 + 5 + 17 * (k - (len(lines) - 1) / 2), line)


def _letters(x: float, y: float, text: str, plain: bool = False) -> str:
    """Returns a text centred at x. In a symbol, the characters after the underscore become a subscript."""
    if not plain and re.fullmatch(rf"{SYMBOL.pattern}(, {SYMBOL.pattern})*", text):
        text = SYMBOL.sub(_subscript, text)
    else:
        text = drawn_text(text)
    return f'<text x="{x:.4g}" y="{y:.4g}" text-anchor="middle" fill="currentColor" stroke="none">{text}</text>' if text else ""


def _subscript(one: re.Match[str]) -> str:
    low = f'<tspan dy="3" font-size="72%">{GREEK.get(one[2], one[2])}</tspan><tspan dy="-3">\u200b</tspan>' if one[2] else ""
    return f'<tspan font-style="italic">{one[1]}</tspan>{low}'
