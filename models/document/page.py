"""Pages: documents as one HTML file that needs no network.

Figures are inline SVG, and the page contains no script. Jinja2 fills the template `page.html.jinja`.
"""

import base64
import hashlib
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Any

from models.common.errors import InputError
from models.common.files import whole_file
from models.document.document import Block, Document, State, Statement, Table, worst
from models.document.figure import Bars, Figure, legend
from models.document.picture import check_drawing, key_svg, panel_svg
from models.document.reading import notation, page_text, short_form, whole_form
from models.document.sketch import Sketch, sketch_svg, symbol_html

STYLE = """<style>
.roadproof {max-width: 480px}
.roadproof p {margin: 0}
.roadproof .plot {font-size: 13px}
.roadproof .plot text {fill: currentColor}
.roadproof .legend {list-style: none; padding: 0}
.roadproof .legend .plot {width: 34px; height: 14px; vertical-align: middle; margin-right: 6px}
</style>"""
IN_NOTEBOOK = "\1"  # placeholder in front of each identifier of an HTML fragment
# A page shows this number of statements before the first figure or table; further statements without a claim are collapsed
BRIEF = 2


VERDICTS: dict[State, str] = {
    "holds": "MuJoCo agrees, and every claim holds throughout",
    "ends": "no check fails, but not every claim holds throughout",
    "fails": "something FAILS",
}
# These marks show a state to readers who cannot distinguish colours
MARKS: dict[State, str] = {"holds": "✓", "ends": "!", "fails": "✗"}


@dataclass(frozen=True, eq=False)
class Page:
    """Report as one HTML page.

    Attributes:
        title: title of the page.
        summary: first part of the page: figures and tables, without a title.
        sections: parts of the page after the summary, in order.
        headline: main result of the report in one line.
        verdicts: text of the verdict for each state.
        sketch: sketch of the vehicle at the top; None for a page without a sketch.
    """

    title: str
    summary: Document
    sections: tuple[Document, ...]
    headline: str = ""
    verdicts: Mapping[State, str] = field(default_factory=lambda: VERDICTS)
    sketch: Sketch | None = None

    @property
    def whole(self) -> Document:
        """The summary and all sections as one document."""
        return Document(self.title, (self.summary, *self.sections))

    @property
    def answer(self) -> list[Statement]:
        """The statements of the report that make a claim about the result."""
        return [one for one in self.whole.statements if one.state != "note"]

    @property
    def state(self) -> State:
        """The verdict on the agreement of simulation and analysis: all claims hold, some claims hold only up to some point, or
        some claims fail.
        """
        return worst([*self.answer, Statement("", "holds")])

    @property
    def verdict(self) -> str:
        """The text of the verdict on the report."""
        return self.verdicts[self.state]

    @property
    def warnings(self) -> list[str]:
        """The statements that fail, or that hold only up to some point."""
        return [one.text for one in self.answer if one.state in ("ends", "fails")]


def check_page() -> None:
    """Checks that all packages for creating pages are installed. Raises an InputError if one of the packages is missing."""
    try:
        import jinja2  # noqa: F401
    except ImportError as error:
        raise InputError(f"a report needs the package {error.name}; run pip install 'roadproof[report]'") from None
    check_drawing()


def render(page: Page) -> str:
    """Returns the page as one HTML document."""
    names = [one.name for one in page.whole.figures]
    if repeated := [name for name, count in Counter(names).items() if count > 1]:
        # If two figures had the same name, the second figure would show the panels of the first figure
        raise ValueError(f"figures of a page have the same name: {', '.join(repeated)}")
    counts = Counter[str]()

    def number(kind: str) -> str:
        counts[kind] += 1
        return f"{kind} {counts[kind]}."

    return (
        _environment(number)
        .get_template("page.html.jinja")
        .render(
            page=page,
            mark=MARKS[page.state],
            style=_resource("page.css"),
            digest=_digest,
            sketch_svg=sketch_svg,
            symbol_html=symbol_html,
        )
    )


def fragment(document: Document) -> str:
    """Returns the blocks of a document as HTML for a notebook.

    A notebook contains many fragments, so all identifiers begin with a checksum of the fragment.
    """

    def named(block: Block) -> Block:
        if isinstance(block, Document):
            return replace(block, blocks=tuple(map(named, block.blocks)))
        return replace(block, name=f"{IN_NOTEBOOK}{block.name}") if isinstance(block, Table | Figure) else block

    whole = Document("", (named(document),))
    text = str(_environment(lambda kind: "").get_template("blocks.html.jinja").module.blocks(whole))  # pyright: ignore
    text = text.replace(IN_NOTEBOOK, f"n{hashlib.sha256(text.encode()).hexdigest()[:12]}-")
    return f'{STYLE}<div class="roadproof">{text}</div>'


def _environment(number: Callable[[str], str]) -> Any:
    """Returns the Jinja2 templates of the page, together with the functions that these templates call.

    Args:
        number: function that returns the label of the next "Table" or "Figure".
    """
    import jinja2

    loader = jinja2.FunctionLoader(_resource)
    options = {"trim_blocks": True, "lstrip_blocks": True, "undefined": jinja2.StrictUndefined, "finalize": _escaped_value}
    environment = jinja2.Environment(autoescape=True, loader=loader, **options)
    functions = {"kind": _kind, "leading": _split_statements, "layout": _layout, "notation": notation, "legend": legend}
    functions |= {"short_form": short_form, "whole_form": whole_form}
    environment.globals.update(functions, number=number, key_svg=key_svg, panel_svg=panel_svg)
    return environment


def _escaped_value(value: Any) -> Any:
    """Returns a value in the form in which the page shows it: text is escaped, markup is unchanged."""
    from markupsafe import Markup

    return Markup(page_text(value)) if isinstance(value, str) and not isinstance(value, Markup) else value


def _kind(block: Block) -> str:
    """Returns the name of a block's class in lower case."""
    return type(block).__name__.lower()


def _split_statements(section: Document) -> tuple[list[Statement], list[Statement]]:
    """Returns the statements of a section that are always visible, and the statements that the page collapses."""
    texts = [block for block in section.blocks if isinstance(block, Statement)]
    shown = [
        one for i, one in enumerate(texts) if one.state != "note" or one.detail == "brief" or (i < BRIEF and one.detail != "full")
    ]
    return shown, [one for one in texts if one not in shown]


def write_page(page: Page, path: Path) -> None:
    """Writes the page as one complete file.

    Raises:
        InputError: the page cannot be written.
    """
    with whole_file(path, "report") as beside:
        beside.write_text(render(page), encoding="utf-8", newline="\n")


def _resource(name: str) -> str:
    return resources.files("models.document").joinpath(name).read_text(encoding="utf-8")


def _digest(text: str) -> str:
    """Returns the hash of a CSS style, for the Content-Security-Policy of the page."""
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"


def _layout(figure: Figure) -> str:
    """Returns the CSS class of a figure: bars are narrow, figures with one column are wide, other figures form a grid."""
    if all(isinstance(panel.ground, Bars) for panel in figure.panels):
        return "bars"
    return "wide" if figure.columns == 1 else ""
