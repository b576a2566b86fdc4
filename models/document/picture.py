"""Figures as picture files, drawn by matplotlib without a display."""

import os
import sys
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from models.common.errors import InputError
from models.common.files import whole_file
from models.document.axis import Axis
from models.document.direct_labels import direct_labels
from models.document.figure import Bars, Classes, Figure, Panel, Shades, Spans
from models.document.reading import notation
from models.document.svg import Entry, legend, quoted_code

LONGEST = 24  # letters of a name in a legend
FAR = 1e6  # end of a span with an infinite end
MARGIN = 60  # about what labels of axes and titles take of a panel [points]
ROW = 0.4  # height of a bar and its name [inches]
TITLE, HEAD, WORDS, NOTE = 11, 10, 9, 8  # font sizes [points]
DASHES: dict[str, Any] = {
    "solid": "-",
    "dash": "--",
    "dot": ":",
    "dashdot": "-.",
    "longdash": (0, (8, 2)),
    "none": "",
}


def check_drawing() -> None:
    """Checks that pictures can be drawn.

    Raises:
        InputError: matplotlib is not installed.
    """
    try:
        _matplotlib()
    except ImportError:
        raise InputError("pictures need matplotlib; pip install 'roadproof[report]' or omit --picture") from None


def _matplotlib() -> Any:
    """Imports matplotlib. The environment's MPLBACKEND may name a backend that is not installed; nothing here needs one."""
    given = None if "matplotlib" in sys.modules else os.environ.pop("MPLBACKEND", None)
    try:
        import matplotlib
    finally:
        if given is not None:
            os.environ["MPLBACKEND"] = given
    if given:
        with suppress(ValueError):
            matplotlib.rcParams["backend"] = given  # as matplotlib does, for the other code of this process
    return matplotlib


def write_picture(figure: Figure, *paths: Path) -> None:
    """Writes a figure to every path, each whole or not at all. Equal figures give equal bytes.

    Raises:
        InputError: the picture cannot be written.
    """
    matplotlib = _matplotlib()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", r"Glyph \d+ ")  # letters that the font lacks are drawn as boxes
        canvas = _drawn(figure)
        # The layout, which takes longer than drawing, is computed once for all files.
        layout = canvas.get_layout_engine()
        layout.execute(canvas)
        canvas.set_layout_engine(None)  # not "none", with which saving draws a second time, for a layout
        for path in paths:
            dateless = {"Date": None} if path.suffix.lower() == ".svg" else {}
            with whole_file(path, "picture") as beside, matplotlib.rc_context({"svg.hashsalt": "roadproof"}):
                canvas.savefig(beside, metadata=dateless)


def _drawn(figure: Figure) -> Any:
    """Returns a matplotlib figure, high enough for its bars and its legend."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure as Canvas

    width, height = figure.size
    bars = max((len(panel.ground.names) for panel in figure.panels if isinstance(panel.ground, Bars)), default=0)
    height = max(height, ROW * bars + 1.0)
    canvas = Canvas(figsize=(width * figure.columns, height * figure.rows + 1.0), dpi=130, layout="constrained")
    FigureCanvasAgg(canvas)
    axes = canvas.subplots(figure.rows, figure.columns, squeeze=False).ravel()
    for axis, panel in zip(axes, figure.panels, strict=False):
        _draw_panel(axis, panel, width - 0.5)
    for axis in axes[len(figure.panels) :]:
        axis.set_visible(False)
    entries = legend(figure)
    columns = min(len(entries), 3 * figure.columns - (figure.columns > 1))
    names = [one.label if " " in one.label else middle_cut(one.label) for one in entries]
    room = width * figure.columns - 0.2
    note = _broken(notation(figure.title), room, NOTE) if figure.finding else ""
    canvas.set_figheight(canvas.get_figheight() + 0.15 * len(note.splitlines()))
    columns = max(columns, 1) if note else columns
    while columns:  # as many as fit
        drawn = canvas.legend(
            [_key(one) for one in entries],
            names,
            loc="outside lower center",
            ncols=columns,
            fontsize=WORDS,
            frameon=False,
            title=note or None,
            title_fontproperties={"size": NOTE},
        )
        if columns == 1 or drawn.get_window_extent().width <= room * canvas.dpi:
            canvas.set_figheight(canvas.get_figheight() + 0.18 * (-(-len(names) // columns) - 1))
            break
        drawn.remove()
        columns -= 1
    canvas.suptitle(_broken(notation(figure.finding or figure.title), room, TITLE), fontsize=TITLE)
    return canvas


def _key(entry: Entry) -> Any:
    """Returns the line, the marker or the patch of a legend's entry."""
    from matplotlib.lines import Line2D

    if entry.ground:
        return Line2D([], [], color=entry.color, linestyle="", marker="s", markersize=9)
    return Line2D([], [], linestyle=DASHES[entry.dash], linewidth=entry.width, **_look(entry.color, entry.marker, entry.filled))


def _look(color: str, marker: str, filled: bool) -> dict[str, Any]:
    """Returns colour and marker as keywords of matplotlib."""
    inner = None if filled or marker in ("x", "+") else "white"
    return {"color": color, "marker": marker, "markersize": 4.5, "markerfacecolor": inner}


def _width(text: str, size: float) -> float:
    """Returns the width of a line of text [inches] at a font size [points]."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import TextToPath

    return TextToPath().get_text_width_height_descent(text, FontProperties(size=size), ismath=False)[0] / 72


def _broken(text: str, room: float, size: float) -> str:
    """Returns a text broken at spaces into lines of at most this width [inches]."""
    lines: list[str] = []
    for line in quoted_code(text).split("\n"):
        lines.append("")
        for word in line.split(" "):
            longer = f"{lines[-1]} {word}".lstrip()
            if lines[-1] and _width(longer, size) > room:
                lines.append(_cut(word, room, size))
            else:
                lines[-1] = _cut(longer, room, size)
    return "\n".join(lines)


def middle_cut(name: str) -> str:
    """Returns a name of at most `LONGEST` letters, without its middle if it is longer: names often differ at their ends."""
    return name if len(name) <= LONGEST else f"{name[: LONGEST // 2]}…{name[len(name) - (LONGEST - 1) // 2 :]}"


def _cut(name: str, room: float, size: float) -> str:
    """Returns a name, shortened at its end to fit into `room` [inches]."""
    if _width(name, size) <= room:
        return name
    while name and _width(f"{name}…", size) > room:
        name = name[:-1]
    return f"{name}…"


def _draw_panel(axis: Any, panel: Panel, width: float) -> None:
    """Draws a panel on axes of about this width [inches]."""
    ground = panel.ground
    if isinstance(ground, Classes):
        from matplotlib.colors import ListedColormap

        count = len(ground.colors)
        for text, row, column in ground.labels:
            axis.text(ground.x[column], ground.y[row], text, fontsize=WORDS, ha="center", va="center")
        axis.pcolormesh(ground.x, ground.y, ground.kind, cmap=ListedColormap(ground.colors), vmin=-0.5, vmax=count - 0.5)
    elif isinstance(ground, Shades):
        image = axis.contourf(ground.x, ground.y, np.ma.masked_invalid(ground.z), levels=14, cmap="YlOrBr")
        axis.figure.colorbar(image, ax=axis, label=ground.label)
    elif isinstance(ground, Bars):
        count = len(ground.names)
        axis.barh(np.arange(count), np.nan_to_num(ground.values), 0.3, color=ground.colors)
        for k, (name, words) in enumerate(zip(ground.names, ground.words, strict=True)):  # text above each bar, as on the page
            style: dict[str, Any] = {"fontsize": WORDS, "va": "bottom", "transform": axis.get_yaxis_transform()}
            shown = _cut(name, width - _width(words, WORDS) - 0.3, WORDS)
            axis.text(0.01, k - 0.2, shown, **style)
            axis.text(0.99, k - 0.2, words, ha="right", **style)
        axis.set_yticks([])
        axis.set_ylim(count - 0.5, -0.7)
    elif isinstance(ground, Spans):
        for low, high in ground.ends:
            axis.axvspan(low, min(high, FAR), color=ground.color, zorder=0)
    for curve in panel.curves:
        axis.plot(
            curve.x,
            curve.y,
            linestyle=DASHES[curve.dash],
            linewidth=curve.width,
            **_look(curve.color, curve.marker, curve.filled),
            zorder=3 if curve.marker else 2,
            clip_on=not (isinstance(ground, Shades) and len(curve.x)),  # markers at corners are not cut
        )
    if panel.xlog:
        axis.set_xscale("log")
    if panel.ylog:
        axis.set_yscale("log")
    if panel.xticks:
        axis.set_xticks(panel.xticks, panel.xnames or [f"{tick:g}" for tick in panel.xticks])
        axis.tick_params(axis="x", which="minor", labelbottom=False)
    if not isinstance(ground, Bars):
        axis.set(xlim=panel.xlim, ylim=panel.ylim)
        _label_decades(axis, panel)
    if isinstance(ground, Spans):
        for (low, high), name in zip(ground.ends, ground.names, strict=True):
            left, right = (min(max(end, axis.get_xlim()[0]), axis.get_xlim()[1]) for end in (low, high))
            middle = (left * right) ** 0.5 if panel.xlog else (left + right) / 2
            at = {"transform": axis.get_xaxis_transform(), "fontsize": NOTE, "ha": "center", "va": "bottom", "color": "0.35"}
            axis.text(middle, 0.02, _cut(name, width, NOTE), **at)
    _write_labels(axis, panel)
    axis.set_title(_broken(panel.title, width, HEAD), fontsize=HEAD)
    axis.set_xlabel(panel.xlabel, fontsize=WORDS)
    axis.set_ylabel(panel.ylabel, fontsize=WORDS)
    if ground is None:
        axis.grid(which="major", color="0.88", linewidth=0.7)


def _write_labels(axis: Any, panel: Panel) -> None:
    """Writes the names of lines beside them."""
    from matplotlib.patheffects import withStroke

    width, height = (72 * inches - MARGIN for inches in axis.figure.get_size_inches() / _grid(axis))  # points, before the layout
    inside, points = axis.transData + axis.transAxes.inverted(), []
    for curve in panel.curves:
        with np.errstate(all="ignore"):
            at = inside.transform(np.column_stack([curve.x, curve.y]).astype(float))
        points.append((width * at[:, 0], height * at[:, 1]))
    halo = [withStroke(linewidth=2.5, foreground="white")]
    for one in direct_labels(panel, points, (width, height), lambda text: 72 * _width(text, NOTE) + 2, NOTE + 1):
        place: dict[str, Any] = {"transform": axis.transAxes, "fontsize": NOTE, "ha": "center", "va": "center"}
        axis.text(one.x / width, one.y / height, one.text, path_effects=halo, zorder=4, **place)


def _grid(axis: Any) -> tuple[int, int]:
    """Returns the columns and rows of the figure of some axes."""
    rows, columns = axis.get_subplotspec().get_gridspec().get_geometry()
    return columns, rows


def _label_decades(axis: Any, panel: Panel) -> None:
    """Labels logarithmic axes as a page does: 0.1, 1, 10 rather than powers beside plain numbers."""
    for log, of, limits, given in (
        (panel.xlog, axis.xaxis, axis.get_xlim(), panel.xticks),
        (panel.ylog, axis.yaxis, axis.get_ylim(), ()),
    ):
        if log and not given and limits[0] > 0:
            ticks = Axis(*limits, log=True).ticks(6)
            of.set_ticks([tick for tick, _ in ticks], [text for _, text in ticks])
            of.set_tick_params(which="minor", labelleft=False, labelbottom=False)
