"""Sections, tables and figures as one HTML file, which needs no network.

Figures are inline SVG, so they appear in print, in a mail and without JavaScript; `page.js` only names the point under the
pointer. Jinja2 fills `page.html.jinja`.
"""

import base64
import colorsys
import hashlib
from collections import Counter
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

from models.common.errors import InputError
from models.common.files import whole_file
from models.document.document import Block, Document, State, Statement, worst
from models.document.downloads import csv_link, downloads
from models.document.figure import Bars, Classes, Figure, Shades, Spans, rgb
from models.document.reading import notation
from models.document.sketch import Sketch, sketch_svg, symbol_html
from models.document.svg import DASHES, MARKERS, legend, levels, page_text, shade_colors, svg

TEXT, GRAPHICS = 4.5, 3.0  # minimum contrasts, success criteria 1.4.3 and 1.4.11 of WCAG
STEPS = 50
MANY = 4  # panels that are shown in two columns
BRIEF = 2  # statements before the first figure or table that are shown; others that claim nothing are folded


def luminance(color: str) -> float:
    """Returns the relative luminance of `#rrggbb`, from 0 for black to 1 for white."""
    parts = [part / 255 for part in rgb(color)]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(color: str, other: str) -> float:
    """Returns the contrast ratio of two colours, from 1 for equal ones to 21 for black and white."""
    low, high = sorted((luminance(color), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def readable(color: str, background: str, least: float = GRAPHICS) -> str:
    """Returns the colour, mixed with as little black or white as the minimum contrast needs."""
    end = max(("#000000", "#ffffff"), key=lambda one: contrast(one, background))
    mixed = (_mixed(color, end, step / STEPS) for step in range(STEPS + 1))
    return next((shade for shade in mixed if contrast(shade, background) >= least), end)


def _mixed(color: str, other: str, share: float) -> str:
    pairs = zip(rgb(color), rgb(other), strict=True)
    return "#" + "".join(f"{round((1 - share) * a + share * b):02x}" for a, b in pairs)


LIGHT, DARK = "#ffffff", "#16181b"  # backgrounds of figures, as in page.css
VERDICTS: dict[State, str] = {
    "holds": "MuJoCo agrees, and every claim holds throughout",
    "ends": "no check fails, but not every claim holds throughout",
    "fails": "something FAILS",
}
MARKS: dict[State, str] = {"holds": "✓", "ends": "!", "fails": "✗"}  # so that a state is not told by its colour alone


@dataclass(frozen=True, eq=False)
class Page:
    """Whole report.

    Attributes:
        title: title of the page.
        answer: statements on what is claimed, and how it was checked; those that do not hold throughout are shown first.
        summary: the first part: figures and tables, without a title.
        sections: the others, in order.
        headline: the answer in a line.
        lead: a sentence for each controller that is best at something, with its cost.
        verdict: the state in words; empty for those of a report on a vehicle file.
        sketch: sketch of the vehicle at the top, or None.
    """

    title: str
    answer: tuple[Statement, ...]
    summary: Document
    sections: tuple[Document, ...]
    headline: str = ""
    lead: tuple[str, ...] = ()
    verdict: str = ""
    sketch: Sketch | None = None

    @property
    def state(self) -> State:
        """Returns the verdict on physics against analysis: whether all holds, something ends early, or something fails."""
        state = worst(self.answer)
        return "holds" if state == "note" else state

    @property
    def warnings(self) -> tuple[str, ...]:
        """Returns the statements that do not hold throughout."""
        return tuple(one.text for one in self.answer if one.state in ("ends", "fails"))

    @property
    def parts(self) -> tuple[Document, ...]:
        """The summary and all sections."""
        return (self.summary, *self.sections)


def check_page() -> None:
    """Checks that pages can be made; raises an InputError if a package is missing."""
    try:
        import contourpy  # noqa: F401
        import jinja2  # noqa: F401
    except ImportError as error:
        raise InputError(f"a report needs {error.name}; pip install 'roadproof[report]'") from None


def render(page: Page) -> str:
    """Returns the page as one HTML document."""
    import jinja2

    environment = jinja2.Environment(
        autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined, finalize=_said
    )
    return environment.from_string(_resource("page.html.jinja")).render(
        notation=notation,
        page=page,
        kind=_kind,
        leading=_leading,
        verdict=page.verdict or VERDICTS[page.state],
        mark=MARKS[page.state],
        style=_resource("page.css") + _colors(page),
        script=_resource("page.js"),
        digest=_digest,
        numbers=_Numbers(),
        svg=svg,
        legend=legend,
        sketch_svg=sketch_svg,
        symbol_html=symbol_html,
        dashes=DASHES,
        markers=MARKERS,
        downloads=downloads,
        layout=_layout,
        csv_link=csv_link,
    )


def _said(value: Any) -> Any:
    """Returns a value as the page shows it: text escaped and its names isolated, markup unchanged."""
    from markupsafe import Markup

    return Markup(page_text(value)) if isinstance(value, str) and not isinstance(value, Markup) else value


def _kind(block: Block) -> str:
    """Returns the name of a block's class, in small letters."""
    return type(block).__name__.lower()


def _leading(section: Document) -> tuple[list[Statement], list[Statement]]:
    """Returns the statements of a section that are shown, and those that are folded."""
    texts = [block for block in section.blocks if isinstance(block, Statement)]
    shown = [one for i, one in enumerate(texts) if one.state != "note" or (i < BRIEF and one.detail != "full")]
    return shown, [one for one in texts if one not in shown]


def write_page(page: Page, path: Path) -> None:
    """Writes the page whole, or not at all.

    Raises:
        InputError: the page cannot be written.
    """
    with whole_file(path, "report") as beside:
        beside.write_text(render(page), encoding="utf-8", newline="\n")


def _resource(name: str) -> str:
    return resources.files("models.document").joinpath(name).read_text(encoding="utf-8")


def _digest(text: str) -> str:
    """Returns the hash of a script or a style for a Content-Security-Policy."""
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"


class _Numbers:
    """Counters of tables and figures, from 1."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()

    def next(self, kind: str) -> int:
        """Returns the next number of a kind."""
        self._counts[kind] += 1
        return self._counts[kind]


def _colors(page: Page) -> str:
    """Returns CSS rules for the colours of figures: lines, points and bars have enough contrast, in light and dark mode."""
    strokes, fills, grounds = set[str](), set[str](), set[str]()
    for panel in (panel for part in page.parts for figure in part.figures for panel in figure.panels):
        strokes |= {curve.color for curve in panel.curves}
        ground = panel.ground
        if isinstance(ground, Bars):
            fills |= set(ground.colors)
        elif isinstance(ground, Classes):
            grounds |= set(ground.colors)
        elif isinstance(ground, Spans):
            grounds.add(ground.color)
        elif isinstance(ground, Shades):
            grounds |= set(shade_colors(len(levels(ground)) - 1))
    ink = [(f".s-{color[1:]}", "stroke", color) for color in sorted(strokes)]
    ink += [
        (f".plot .full.s-{color[1:]}, .legend .full.s-{color[1:]}, .bars .f-{color[1:]}", "fill", color)
        for color in sorted(strokes | fills)
    ]
    day = [f"{where} {{ {what}: {readable(color, LIGHT)}; }}" for where, what, color in ink]
    areas = [(f".plot .g-{color[1:]}, .legend .g-{color[1:]}", color) for color in sorted(grounds)]
    day += [f"{where} {{ fill: {color}; }}" for where, color in areas]
    night = [f"{where} {{ {what}: {by_night(color)}; }}" for where, what, color in ink]
    night += [f"{where} {{ fill: {ground_by_night(color)}; }}" for where, color in areas]
    return "\n".join([*day, "@media screen and (prefers-color-scheme: dark) {", *night, "}", ""])


def by_night(color: str) -> str:
    """Returns a colour for dark mode, with as much contrast there as the given one has to white: black becomes white."""
    return readable(color, DARK, max(GRAPHICS, contrast(color, LIGHT)))


def ground_by_night(color: str) -> str:
    """Returns the colour of an area of a map in dark mode, where light lines have contrast: the lighter by day, the darker."""
    hue, light, saturation = colorsys.rgb_to_hls(*(part / 255 for part in rgb(color)))
    turned = colorsys.hls_to_rgb(hue, 0.08 + 0.22 * (1 - light), min(saturation, 0.6))
    return "#" + "".join(f"{round(255 * part):02x}" for part in turned)


def _layout(figure: Figure) -> str:
    """Returns the CSS class of a figure: one column is wide, bars are narrow, others form a grid, of two or three columns."""
    if all(isinstance(panel.ground, Bars) for panel in figure.panels):
        return "bars"
    wide, high = figure.size
    many = "" if len(figure.panels) <= MANY else "pairs" if wide > 2 * high else "three"
    return "wide" if figure.columns == 1 else many
