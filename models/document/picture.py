"""Figures drawn by matplotlib without a display: as files, and as SVG in pages and notebooks.

Lengths in figures are in px. In this module, one px is 1/72 inch, so a font size is the same number in px and in points.
"""

import os
import re
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import lru_cache
from io import StringIO
from pathlib import Path
from typing import Any, Literal

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, middle_cut
from models.common.files import whole_file
from models.document.description import about
from models.document.figure import Bars, Classes, Curve, Entry, Figure, Panel, Spans, legend
from models.document.reading import cut, drawn_text, notation, quoted_code, text_width, wrap_at_spaces

FONT, LINE, DPI = 13, 19, 130  # font size, height of a line of text, and resolution of picture files
# Size of a panel; size of a panel that is the only one in a file; width of a panel with bars
SIZE, WIDE, BARS = (400, 250), (600, 360), 260
EDGE, TOP, BOTTOM, RIGHT = 10, 24, 44, 22  # margins of a picture, and margins of a panel
ROW, BAR, KEY = 42, 12, 34  # height of a bar with the name above it; height of the bar alone; length of a line in a legend
BOLD = 1.12  # width of bold letters, relative to the width of normal letters
LONGEST = 24  # largest number of letters of a name in a legend
FAR = 1e6  # this number replaces an infinite end of a span
DASHES: dict[str, Any] = {
    "solid": "-",
    "dash": "--",
    "dot": ":",
    "dashdot": "-.",
    "longdash": (0, (8, 2)),
    "none": "",
}
SETTINGS: dict[Any, Any] = {
    "font.size": FONT,
    "text.parse_math": False,
    "axes.xmargin": 0.04,
    "axes.ymargin": 0.04,
    "lines.markersize": 4.5,
    "path.simplify_threshold": 0.1,
    "svg.fonttype": "none",
    "svg.hashsalt": "roadproof",
}


def check_drawing() -> None:
    """Checks that matplotlib is installed, so that figures can be drawn.

    Raises:
        InputError: matplotlib is not installed.
    """
    try:
        _matplotlib()
    except ImportError:
        raise InputError("pictures need matplotlib; run pip install 'roadproof[report]', or omit --picture") from None


def _matplotlib() -> Any:
    """Imports and returns matplotlib, even if the environment variable MPLBACKEND refers to a backend that is not installed.

    The figures in this module do not need a backend. If MPLBACKEND is valid, its backend still applies to windows in which
    users show their own figures.
    """
    backend = "" if "matplotlib" in sys.modules else os.environ.pop("MPLBACKEND", "")
    try:
        import matplotlib
    finally:
        if backend:
            os.environ["MPLBACKEND"] = backend
    with suppress(ValueError):
        matplotlib.rcParams.update({"backend": backend} if backend else {})
    return matplotlib


@contextmanager
def _settings() -> Iterator[None]:
    matplotlib = _matplotlib()
    with matplotlib.rc_context(SETTINGS), warnings.catch_warnings(), np.errstate(all="ignore"):
        # matplotlib's warnings are ignored: a letter that the font lacks is drawn as a box, and an axis without numbers stays
        # empty.
        warnings.simplefilter("ignore", UserWarning)
        yield


class _Sheet:
    """A matplotlib figure with positions in px, measured from its upper left corner."""

    def __init__(self, width: float, height: float) -> None:
        from matplotlib.figure import Figure as Canvas

        self.width, self.height = width, height
        self.canvas = Canvas(figsize=(width / 72, height / 72), dpi=72)

    def box(self, left: float, top: float, width: float, height: float) -> tuple[float, float, float, float]:
        """Returns a rectangle as fractions of the figure's width and height, measured from the figure's lower left corner."""
        return left / self.width, 1 - (top + height) / self.height, width / self.width, height / self.height

    def write(self, x: float, y: float, text: str, **style: Any) -> None:
        """Writes a line of text with its baseline at y."""
        if text:
            self.canvas.text(x / self.width, 1 - y / self.height, quoted_code(text), va="baseline", **style)

    def write_lines(self, x: float, y: float, lines: Sequence[tuple[str, str]]) -> None:
        """Writes lines of text, each with its font weight. The baseline of the first line is at y."""
        for k, (line, weight) in enumerate(lines):
            self.write(x, y + LINE * k, line, weight=weight)

    def lines(self, lines: Sequence[Sequence[tuple[float, float]]], opacity: float) -> None:
        """Draws lines behind all other elements of the figure."""
        from matplotlib.collections import LineCollection

        places = [np.array([0, 1]) + np.array([1, -1]) * np.array(line) / (self.width, self.height) for line in lines]
        style: dict[str, Any] = {"transform": self.canvas.transFigure, "zorder": -1}
        self.canvas.add_artist(LineCollection(places, colors="black", linewidths=0.8, alpha=opacity, **style))


def write_picture(figure: Figure, *paths: Path) -> None:
    """Writes a figure to every path, each as a complete file. Two files of the same figure have identical bytes.

    Raises:
        InputError: the picture cannot be written.
    """
    with _settings():
        canvas = _whole(figure).canvas
        alternative = " ".join(": ".join(about(panel)) for panel in figure.panels)
        for path in paths:
            metadata = {
                ".svg": {"Date": None, "Title": figure.finding or figure.title, "Description": alternative},
                ".pdf": {"CreationDate": None},
            }
            with whole_file(path, "picture") as beside:
                canvas.savefig(beside, dpi=DPI, metadata=metadata.get(path.suffix.lower(), {}))


def level(x: Array, y: Array, z: Array, height: float) -> tuple[Array, Array]:
    """Returns the contour z = `height` as the x and y values of a curve, with NaN between separate parts of the contour.

    Args:
        x: horizontal grid, shape (N,).
        y: vertical grid, shape (M,).
        z: values on the grid, shape (M, N).
        height: value of z on the contour.
    """
    with _settings():
        pieces = _Sheet(1, 1).canvas.add_subplot().contour(x, y, np.ma.masked_invalid(z), [height]).allsegs[0]
    gap = np.full((1, 2), np.nan)
    joined = np.concatenate([gap, *(part for piece in pieces for part in (piece, gap))])
    return joined[:, 0], joined[:, 1]


def panel_size(panel: Panel, size: tuple[int, int] = SIZE) -> tuple[int, int]:
    """Returns the width and the height of a panel [px]."""
    return (BARS, 30 + ROW * len(panel.ground.names)) if isinstance(panel.ground, Bars) else size


def _whole(figure: Figure) -> _Sheet:
    """Returns a figure with its finding, title, legend and all panels."""
    columns = min(figure.columns, len(figure.panels))
    sizes = [panel_size(panel, WIDE if figure.columns == 1 else SIZE) for panel in figure.panels]
    wide, high = (max(ends) for ends in zip(*sizes, strict=True))
    width = max(wide * columns, WIDE[0])
    words = _paragraphs(figure.finding, figure.title, room=width)
    entries = [(one, one.label if " " in one.label else middle_cut(one.label, LONGEST)) for one in legend(figure)]
    across = max((text_width(name, FONT) + KEY + 32 for _, name in entries), default=1.0)
    keys = max(1, min(len(entries), int(width / across)))
    titles = [_paragraphs(*notation(panel.title).split("\n"), room=wide - 10) for panel in figure.panels]
    heads = [LINE * max(map(len, titles[k : k + columns])) for k in range(0, len(titles), columns)]
    top = 10 + LINE * len(words)
    start = top + LINE * -(-len(entries) // keys) + 12
    sheet = _Sheet(width + 2 * EDGE, start + sum(heads) + (high + 8) * len(heads))
    sheet.write_lines(EDGE, 20, words)
    for k, (entry, name) in enumerate(entries):
        left, down = EDGE + across * (k % keys), top + LINE * (k // keys) + 9
        sheet.canvas.add_artist(_key(entry, (left + np.array([0, 0.5, 1]) * KEY) / sheet.width, 1 - down / sheet.height))
        sheet.write(left + KEY + 8, down + 0.36 * FONT, name)
    for k, (panel, title) in enumerate(zip(figure.panels, titles, strict=True)):
        row, column = divmod(k, columns)
        left, down = EDGE + wide * column, start + sum(heads[: row + 1]) + (high + 8) * row
        sheet.write_lines(left, down + 12 - LINE * len(title), title)
        _draw(sheet, panel, left, down, sizes[k])
    return sheet


def _paragraphs(first: str, *others: str, room: float) -> list[tuple[str, str]]:
    """Returns the lines of several paragraphs, each with its font weight. The first paragraph is bold."""
    bold = [(line, "bold") for line in wrap_at_spaces(notation(first), room / BOLD, FONT)]
    return bold + [(line, "normal") for text in others for line in wrap_at_spaces(notation(text), room, FONT)]


def _key(entry: Entry, x: Array, height: float) -> Any:
    """Returns the artist for an entry of the legend: a line through three points, a marker or a patch."""
    from matplotlib.lines import Line2D

    y = np.full(3, height)
    if entry.ground:
        return Line2D(x, y, color=entry.color, linestyle="", marker="s", markersize=11, markevery=[1])
    look = _look(entry.color, entry.marker, entry.filled)
    return Line2D(x, y, linestyle=DASHES[entry.dash], linewidth=entry.width, markevery=[1], **look)


def _look(color: str, marker: str, filled: bool) -> dict[str, Any]:
    """Returns colour and marker as keyword arguments of matplotlib."""
    return {"color": color, "marker": marker, "markerfacecolor": None if filled or marker in ("x", "+") else "white"}


def _draw(sheet: _Sheet, panel: Panel, left: float, top: float, size: tuple[int, int]) -> None:
    """Draws a panel. The upper left corner of the panel is at (left, top)."""
    if isinstance(panel.ground, Bars):
        _draw_bars(sheet, panel.ground, panel.xlabel, left, top)
        return
    axis = sheet.canvas.add_axes((0, 0, 1, 1), facecolor="none")
    axis.set(xscale="log" if panel.xlog else "linear", yscale="log" if panel.ylog else "linear")
    _draw_ground(axis, panel.ground)
    for curve in panel.curves:
        _draw_curve(axis, curve)
    axis.set(xlim=panel.xlim, ylim=panel.ylim)
    down, names = ticks(axis.get_ylim(), panel.ylog)
    inner = 10 + max((text_width(name, FONT) for name in names), default=0.0)
    width, height = size[0] - inner - RIGHT, size[1] - TOP - BOTTOM
    left, bottom = left + inner, top + TOP + height
    axis.set_position(sheet.box(left, top + TOP, width, height))
    axis.set_axis_off()  # matplotlib's own ticks would double the time for drawing a panel
    sheet.lines([[(left, top + TOP), (left, bottom), (left + width, bottom), (left + width, top + TOP), (left, top + TOP)]], 0.35)
    grid, lines = panel.ground is None, []
    for share, name in zip(_places(axis, down, 1), names, strict=True):
        y = bottom - height * share
        lines.append([(left - 4 * (not grid), y), (left + width * grid, y)])
        sheet.write(left - 7, y + 0.36 * FONT, name, ha="right")
    across, names = ticks(axis.get_xlim(), panel.xlog, panel.xticks, panel.xnames)
    for share, name in zip(_places(axis, across, 0), names, strict=True):
        x = left + width * share
        lines.append([(x, bottom + 4 * (not grid)), (x, bottom - height * grid)])
        sheet.write(x, bottom + 18, name, ha="center")
    sheet.lines(lines, 0.15 if grid else 1)
    sheet.write(left - inner, top + 14, panel.ylabel)
    sheet.write(left + width / 2, bottom + BOTTOM - 8, panel.xlabel, ha="center")
    if isinstance(panel.ground, Spans):
        _name_spans(sheet, axis, panel.ground, left, bottom - 8, width)


def _draw_bars(sheet: _Sheet, bars: Bars, label: str, left: float, top: float) -> None:
    """Draws bars. The name of each bar and its text are written above the bar."""
    from matplotlib.patches import Rectangle

    width = BARS - 16
    longest = np.max(bars.values[np.isfinite(bars.values)], initial=0.0) or 1.0
    rows = zip(bars.names, bars.values.tolist(), bars.words, bars.colors, strict=True)
    for k, (name, value, words, color) in enumerate(rows):
        down = top + ROW * k
        sheet.write(left, down + 14, cut(name, width - text_width(words, FONT) - 10, FONT))
        sheet.write(left + width, down + 14, words, ha="right")
        if np.isfinite(value):
            x, y, wide, high = sheet.box(left, down + 19, width * value / longest, BAR)
            sheet.canvas.add_artist(Rectangle((x, y), wide, high, color=color, linewidth=0))
    sheet.write(left, top + ROW * len(bars.names) + 20, label)


def _draw_ground(axis: Any, ground: Classes | Bars | Spans | None) -> None:
    """Draws the cells, bars or shaded intervals that are below the curves."""
    if isinstance(ground, Classes):
        from matplotlib.patches import PathPatch

        for i, color in enumerate(ground.colors):
            if np.any(ground.kind == i):
                outline = cells(ground.kind == i, ground.x, ground.y)
                axis.add_patch(PathPatch(outline, facecolor=color, linewidth=0, antialiased=False, zorder=0))
        for text, row, column in ground.labels:
            axis.text(ground.x[column], ground.y[row], text, ha="center", va="center")
        axis.set(xlim=_edges(ground.x)[[0, -1]], ylim=_edges(ground.y)[[0, -1]])
    elif isinstance(ground, Spans):
        for low, high in ground.ends:
            axis.axvspan(low, min(high, FAR), color=ground.color, zorder=0)


def _edges(centres: Array) -> Array:
    """Returns the edges of equidistant cells from the centres of the cells."""
    half = (centres[-1] - centres[0]) / (2 * max(1, len(centres) - 1))
    return np.append(centres - half, centres[-1] + half)


def cells(there: Array, x: Array, y: Array) -> Any:
    """Returns the outline of cells, with one rectangle for each run of cells in a row."""
    from matplotlib.path import Path as Outline

    across, down = _edges(x), _edges(y)
    row, first = np.nonzero(np.diff(there, axis=1, prepend=False, append=False))
    (row, first, last) = row[::2], across[first[::2]], across[first[1::2]]
    low, high = down[row], down[row + 1]
    corners = np.stack([first, low, last, low, last, high, first, high, first, low], axis=1).reshape(-1, 2)
    codes = [Outline.MOVETO, *[Outline.LINETO] * 3, Outline.CLOSEPOLY] * len(row)
    return Outline(corners, codes)


def _draw_curve(axis: Any, curve: Curve) -> None:
    axis.plot(
        curve.x,
        curve.y,
        linestyle=DASHES[curve.dash],
        linewidth=curve.width,
        **_look(curve.color, curve.marker, curve.filled),
        zorder=3 if curve.marker else 2,
    )


def ticks(
    limits: tuple[float, float], log: bool, given: Sequence[float] = (), names: Sequence[str] = ()
) -> tuple[Sequence[float], Sequence[str]]:
    """Returns the ticks of an axis and their labels."""
    from matplotlib.ticker import LogLocator, MaxNLocator

    low, high = sorted(limits)
    decades = np.log10(high) - np.log10(low) if log else 0.0
    if not given:
        subs = (1, 2, 5) if decades < 1.6 else (1, 3) if decades < 3.2 else (1,)
        locator = LogLocator(subs=subs, numticks=7) if decades > 0.7 else MaxNLocator(6, steps=[1, 2, 2.5, 5, 10])
        with np.errstate(all="ignore"):
            room = 1e-9 * (high - low)
            given = [float(tick) + 0.0 for tick in locator.tick_values(low, high) if low - room <= tick <= high + room]
    texts = [f"{tick:.6g}" for tick in given]
    if not log and not names and not any("e" in text for text in texts):
        decimals = max((len(text.partition(".")[2]) for text in texts), default=0)
        texts = [f"{tick:.{decimals}f}" for tick in given]
    return given, names or [re.sub(r"(?<![\d.])1·", "", notation(text)).replace("-", "−") for text in texts]


def _places(axis: Any, values: Sequence[float], which: Literal[0, 1]) -> list[float]:
    """Returns the positions of values on an axis, from 0 to 1. The argument `which` is 0 for the horizontal axis and 1 for the
    vertical axis.
    """
    points = np.empty((len(values), 2))
    points[:, which], points[:, 1 - which] = values, (axis.get_ylim, axis.get_xlim)[which]()[0]
    return (axis.transScale + axis.transLimits).transform(points)[:, which].tolist()


def _name_spans(sheet: _Sheet, axis: Any, spans: Spans, left: float, y: float, width: float) -> None:
    """Writes the name of each shaded interval at the middle of the interval."""
    low, high = axis.get_xlim()
    for ends, name in zip(spans.ends, spans.names, strict=True):
        first, last = _places(axis, [min(max(end, low), high) for end in ends], 0)
        sheet.write(left + width * (first + last) / 2, y, cut(name, width, FONT), ha="center")


# In the SVG of a page, text stays text, and numbers have two decimals. The page's security policy forbids inline styles, so
# presentation attributes are used instead. Identifiers that nothing refers to are removed.

MARK = "\0"
STYLE = re.compile(r' style="([^"]*)"')
ELEMENT = re.compile(r"<[^>]*>")
CLEAN = ((r">\s+<", "><"), (r"\s*\n", ""), (r' transform="rotate\(-0 [^"]*"', ""), (r'<g id="[^"]*"', "<g"))


def panel_svg(panel: Panel, name: str) -> str:
    """Returns a panel as an `svg` element with the identifier `plot-NAME` and a text alternative."""
    width, height = size = panel_size(panel)
    with _settings():
        sheet = _Sheet(width, height)
        _draw(sheet, panel, 0, 0, size)
        drawn = _inside(sheet)
    identifier = drawn_text(f"plot-{name}")
    title, text = about(panel)
    kind = "plot bars" if isinstance(panel.ground, Bars) else "plot"
    return (
        f'<svg class="{kind}" id="{identifier}" role="img" aria-labelledby="{identifier}-title {identifier}-text" '
        f'viewBox="0 0 {width} {height}"><title id="{identifier}-title">{drawn_text(title)}</title>'
        f'<desc id="{identifier}-text">{drawn_text(text)}</desc>{drawn.replace(MARK, f"{identifier}-")}</svg>'
    )


def key_svg(entry: Entry, name: str) -> str:
    """Returns the line, marker or patch of a legend entry as an `svg` element that screen readers skip."""
    drawn = _key_inside(Entry("", *entry[1:])).replace(MARK, f"key-{name}-")
    return f'<svg class="plot" viewBox="0 0 {KEY} 14" aria-hidden="true">{drawn}</svg>'


@lru_cache(maxsize=256)
def _key_inside(entry: Entry) -> str:
    with _settings():
        sheet = _Sheet(KEY, 14)
        sheet.canvas.add_artist(_key(entry, np.array([0, 0.5, 1]), 0.5))
        return _inside(sheet)


def _inside(sheet: _Sheet) -> str:
    """Returns the SVG elements of a drawing, with the text `MARK` in front of all identifiers."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    sheet.canvas.patch.set_visible(False)
    file = StringIO()
    FigureCanvasSVG(sheet.canvas).print_svg(file, metadata={"Date": None})
    drawn = file.getvalue()
    drawn = drawn[drawn.index('<g id="figure_1">') : drawn.rindex("</svg>")]
    for pattern, to in CLEAN:
        drawn = re.sub(pattern, to, drawn)
    return ELEMENT.sub(lambda element: _clean(element[0]), drawn)


def _clean(element: str) -> str:
    """Returns the tag of an SVG element with presentation attributes instead of a style, and with `MARK` in front of all
    identifiers.
    """
    element = STYLE.sub(lambda style: _as_attributes(style[1]), element)
    element = re.sub(r"(\.\d\d)\d+", r"\1", element).replace("#000000", "currentColor").replace("xlink:href", "href")
    return re.sub(r'(#| id=")(?=[mpC][0-9a-f_]{9,})', rf"\1{MARK}", element)


@lru_cache(maxsize=1024)
def _as_attributes(style: str) -> str:
    """Returns a CSS style as presentation attributes, but without the font, which the page chooses."""
    pairs = (part.split(": ", 1) for part in style.split("; "))
    return "".join(f' {name}="{value}"' for name, value in pairs if not name.startswith("font"))
