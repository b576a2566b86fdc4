"""Sections, tables and figures as one HTML file: nothing in it comes from a network, and it opens from disk.

Plotly draws the figures, and its code is in the file; Jinja2 fills `page.html.jinja`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Literal

import numpy as np

from models.common.errors import InputError
from models.common.whole_file import whole_file
from sim.figures.figure import Classes, Curve, Figure, Panel, Shades

PLOTLY_DASHES = {"solid": "solid", "dash": "dash", "dot": "dot", "dashdot": "dashdot", "longdash": "longdash", "none": "solid"}
SVG_DASHES = {"solid": "", "dash": "6 3", "dot": "2 2", "dashdot": "7 2 2 2", "longdash": "10 3", "none": ""}
SYMBOLS = {"": "circle", "o": "circle-open", "x": "x-thin-open", "s": "square", "+": "cross-thin-open"}
FONT = {"family": "system-ui, sans-serif", "size": 12, "color": "#222222"}


State = Literal["holds", "ends", "fails"]


@dataclass(frozen=True)
class Table:
    """A table.

    Attributes:
        name: of its CSV file, without suffix.
        headings: of the columns.
        rows: cells as text.
        words: how many columns on the left are words; the others are numbers, to the right.
    """

    name: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    words: int = 1

    def __post_init__(self) -> None:
        if len(set(self.headings)) < len(self.headings):
            raise ValueError(f"headings of table {self.name!r} are not distinct: {', '.join(self.headings)}")


@dataclass(frozen=True, eq=False)
class Section:
    """What belongs together on the page.

    Attributes:
        title: above it.
        text: sentences, a paragraph each.
        tables, figures: after the text.
    """

    title: str
    text: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    figures: tuple[Figure, ...] = ()


@dataclass(frozen=True, eq=False)
class Page:
    """A whole report.

    Attributes:
        title: above all.
        answer: what the reader came for, a sentence each.
        sections: in order.
        state: what the answer amounts to, and the colour of its box: green where all holds, amber where something ended before
            its time, red where something fails.
    """

    title: str
    answer: tuple[str, ...]
    sections: tuple[Section, ...]
    state: State = "holds"


def check_page() -> None:
    """Whether pages can be made here; raises InputError where not."""
    try:
        import jinja2  # noqa: F401
        import plotly  # noqa: F401
    except ImportError as error:
        raise InputError(f"a report needs {error.name}; pip install 'roadproof[report]'") from None


def render(page: Page) -> str:
    """The page as one HTML document."""
    import jinja2
    from plotly.offline import get_plotlyjs

    environment = jinja2.Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined)
    template = environment.from_string(resources.files("sim.figures").joinpath("page.html.jinja").read_text(encoding="utf-8"))
    return template.render(page=page, plotly=get_plotlyjs(), plots=_plots, legend=_legend, wide=_wide)


def write_page(page: Page, path: Path) -> None:
    """Writes the page whole, or not at all.

    Raises:
        InputError: it cannot be written.
    """
    with whole_file(path, "report") as beside:
        beside.write_text(render(page), encoding="utf-8", newline="\n")


@dataclass(frozen=True)
class _Entry:
    """One entry of a legend; its line is drawn as SVG, so that it is there in print and in black and white."""

    label: str
    color: str
    width: float
    dashes: str
    line: bool
    marker: str


def _legend(figure: Figure) -> list[_Entry]:
    """One entry per label, in the order of their first curves."""
    entries: dict[str, _Entry] = {}
    for curve in (curve for panel in figure.panels for curve in panel.curves):
        if curve.label:
            line = curve.dash != "none"
            entry = _Entry(curve.label, curve.color, curve.width + 0.5, SVG_DASHES[curve.dash], line, curve.marker)
            entries.setdefault(curve.label, entry)
    return list(entries.values())


def _wide(figure: Figure) -> bool:
    """Whether its panels take the whole width."""
    return figure.columns == 1


def _plots(figure: Figure) -> list[str]:
    """Every panel as a piece of HTML."""
    return [_plot(panel, f"{figure.name}-{number}") for number, panel in enumerate(figure.panels)]


def _plot(panel: Panel, name: str) -> str:
    import plotly.graph_objects as go

    ground: list[Any] = []
    if isinstance(panel.ground, Classes):
        kinds, count, scale = panel.ground, len(panel.ground.colors), _steps(panel.ground.colors)
        ground = [
            go.Heatmap(
                x=kinds.x,
                y=kinds.y,
                z=kinds.kind,
                zmin=-0.5,
                zmax=count - 0.5,
                colorscale=scale,
                showscale=False,
                hoverinfo="skip",
            )
        ]
    elif isinstance(panel.ground, Shades):
        shades = panel.ground
        bar = {"title": {"text": shades.label, "side": "right"}, "thickness": 12}
        ground = [
            go.Contour(
                x=shades.x, y=shades.y, z=_listed(shades.z), colorscale="YlOrBr", ncontours=14, colorbar=bar, line={"width": 0}
            )
        ]
    traces = [_trace(curve) for curve in panel.curves if len(curve.x)]
    lines = panel.title.split("\n")
    title = "<br>".join([f"<b>{lines[0]}</b>", *lines[1:]]) if panel.title else ""
    layout = {
        "title": {"text": title, "font": {**FONT, "size": 13}, "x": 0.01, "xanchor": "left"},
        "font": FONT,
        "margin": {"l": 64, "r": 16, "t": 34 + 16 * len(lines) if title else 16, "b": 46},
        "height": 360,
        "showlegend": False,
        "paper_bgcolor": "white",
        "plot_bgcolor": "white",
        "hovermode": "closest",
        "xaxis": _axis(panel.xlabel, panel.xlog, panel.xlim, panel.xticks),
        "yaxis": _axis(panel.ylabel, panel.ylog, panel.ylim, ()),
    }
    figure = go.Figure(data=[*ground, *traces], layout=layout)
    config = {"responsive": True, "displaylogo": False, "modeBarButtonsToRemove": ["lasso2d", "select2d"]}
    return figure.to_html(full_html=False, include_plotlyjs=False, div_id=f"plot-{name}", config=config, default_width="100%")


def _steps(colors: Sequence[str]) -> list[tuple[float, str]]:
    """A colour scale that jumps from one colour to the next."""
    count = len(colors)
    return [(edge / count, color) for k, color in enumerate(colors) for edge in (k, k + 1)]


def _trace(curve: Curve) -> Any:
    import plotly.graph_objects as go

    line, marker = curve.dash != "none", bool(curve.marker)
    mode = "lines+markers" if line and marker else "lines" if line else "markers"
    look = {"color": curve.color, "size": 8, "symbol": SYMBOLS[curve.marker], "line": {"width": 1.6, "color": curve.color}}
    return go.Scatter(
        x=_listed(curve.x),
        y=_listed(curve.y),
        mode=mode,
        name=curve.label or "MuJoCo",
        line={"color": curve.color, "width": curve.width + 0.3, "dash": PLOTLY_DASHES[curve.dash]},
        marker=look if marker else None,
        hovertemplate="%{x:.4g}, %{y:.4g}",
    )


def _listed(values: Any) -> list[Any]:
    """Numbers with 6 digits, as text has them: a page is mailed. What is no number is a gap."""
    array = np.asarray(values, dtype=float)
    if array.ndim > 1:
        return [_listed(row) for row in array]
    return [float(f"{value:.6g}") if np.isfinite(value) else None for value in array.tolist()]


def _axis(label: str, log: bool, limits: tuple[float, float] | None, ticks: Sequence[float]) -> dict[str, Any]:
    axis: dict[str, Any] = {
        "title": {"text": label, "standoff": 8},
        "type": "log" if log else "linear",
        "showline": True,
        "linecolor": "#444444",
        "mirror": True,
        "gridcolor": "#e4e4e4",
        "zeroline": False,
        "ticks": "outside",
    }
    if limits is not None:
        axis["range"] = [float(np.log10(value)) for value in limits] if log else list(limits)
    if ticks:
        axis |= {"tickvals": list(ticks), "ticktext": [f"{tick:g}" for tick in ticks]}
    elif log:
        axis |= {"dtick": 1, "exponentformat": "power"}
    return axis
