"""Sections, tables and figures as one HTML file, which needs no network.

Figures are inline SVG, and there is no script. Jinja2 fills `page.html.jinja`.
"""

import base64
import colorsys
import hashlib
import re
from collections import Counter
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

from models.common.errors import InputError
from models.common.files import whole_file
from models.document.document import Block, Document, State, Statement, worst
from models.document.figure import Bars, Figure, legend, rgb
from models.document.picture import check_drawing, key_svg, panel_svg
from models.document.reading import notation, page_text
from models.document.sketch import Sketch, sketch_svg, symbol_html

TEXT, GRAPHICS = 4.5, 3.0  # minimum contrasts, success criteria 1.4.3 and 1.4.11 of WCAG
STEPS = 50
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
        lead: statements on the controllers that are best at something, with their cost.
        verdict: the state in words; empty for those of a report on a vehicle file.
        sketch: sketch of the vehicle at the top, or None.
    """

    title: str
    answer: tuple[Statement, ...]
    summary: Document
    sections: tuple[Document, ...]
    headline: str = ""
    lead: tuple[Statement, ...] = ()
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
        import jinja2  # noqa: F401
    except ImportError as error:
        raise InputError(f"a report needs {error.name}; pip install 'roadproof[report]'") from None
    check_drawing()


def render(page: Page) -> str:
    """Returns the page as one HTML document."""
    import jinja2

    figures = [figure for part in page.parts for figure in part.figures]
    if repeated := [name for name, count in Counter(one.name for one in figures).items() if count > 1]:
        raise ValueError(f"figures of a page have the same name: {', '.join(repeated)}")  # one would show the other's panels
    panels = {one.name: [panel_svg(panel, f"{one.name}-{k}") for k, panel in enumerate(one.panels)] for one in figures}
    entries = {
        one.name: [(key_svg(entry, f"{one.name}-{k}"), entry.label) for k, entry in enumerate(legend(one))] for one in figures
    }
    drawn = "".join([*(one for some in panels.values() for one in some), *(key for some in entries.values() for key, _ in some)])
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
        style=_resource("page.css") + _colors(drawn),
        digest=_digest,
        numbers=_Numbers(),
        panels=panels,
        entries=entries,
        sketch_svg=sketch_svg,
        symbol_html=symbol_html,
        layout=_layout,
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
    """Returns the hash of a style for a Content-Security-Policy."""
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"


class _Numbers:
    """Counters of tables and figures, from 1."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()

    def next(self, kind: str) -> int:
        """Returns the next number of a kind."""
        self._counts[kind] += 1
        return self._counts[kind]


def _colors(drawn: str) -> str:
    """Returns CSS rules for the colours of drawings in dark mode."""
    colors = sorted(set(re.findall(r'(?:stroke|fill)="(#[0-9a-f]{6})"', drawn)))
    rules = [
        f'{where} [{what}="{color}"] {{ {what}: {dark(color)}; }}'
        for where, dark in ((".plot", by_night), (".ground", ground_by_night))
        for color in colors
        for what in ("stroke", "fill")
        if (where, what, color) != (".plot", "fill", "#ffffff")  # of hollow markers
    ]
    return "\n".join(["@media screen and (prefers-color-scheme: dark) {", *rules, "}", ""])


def by_night(color: str) -> str:
    """Returns a colour for dark mode, with as much contrast there as the given one has to white: black becomes white."""
    return readable(color, DARK, max(GRAPHICS, contrast(color, LIGHT)))


def ground_by_night(color: str) -> str:
    """Returns the colour of an area of a map in dark mode, where light lines have contrast: the lighter by day, the darker."""
    hue, light, saturation = colorsys.rgb_to_hls(*(part / 255 for part in rgb(color)))
    turned = colorsys.hls_to_rgb(hue, 0.08 + 0.22 * (1 - light), min(saturation, 0.6))
    return "#" + "".join(f"{round(255 * part):02x}" for part in turned)


def _layout(figure: Figure) -> str:
    """Returns the CSS class of a figure: bars are narrow, one column is wide, others form a grid of two columns or more."""
    if all(isinstance(panel.ground, Bars) for panel in figure.panels):
        return "bars"
    return "wide" if figure.columns == 1 else "many" if figure.columns > 2 else ""
