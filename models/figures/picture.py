"""Figures as picture files, drawn by matplotlib without a display."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from models.common.errors import InputError
from models.common.files import whole_file
from models.figures.figure import Bars, Classes, Figure, Panel, Shades, Spans

LONGEST = 24  # letters of a name in a legend
FAR = 1e6  # end of a span with an infinite end
SHOWN = " "  # prefix of a legend label: matplotlib leaves out labels that begin with _
ROW = 0.4  # height of a bar and its name [inches]
TITLE, HEAD, WORDS = 11, 10, 9  # font sizes [points]
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
        import matplotlib  # noqa: F401
    except ImportError:
        raise InputError("pictures need matplotlib; pip install 'roadproof[report]' or leave --picture out") from None


def write_picture(figure: Figure, *paths: Path) -> None:
    """Writes a figure to every path, each whole or not at all. Equal figures give equal bytes.

    Raises:
        InputError: it cannot be written.
    """
    import matplotlib

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", r"Glyph \d+ ")  # letters that the font lacks are drawn as boxes
        canvas = _drawn(figure)
        # The layout, which takes longer than drawing, is computed once for all files.
        layout = canvas.get_layout_engine()
        layout.execute(canvas)
        canvas.set_layout_engine("none")
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
    entries: dict[str, Any] = {}
    for axis in axes:
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            entries.setdefault(label.removeprefix(SHOWN), handle)
    columns = min(len(entries), 3 * figure.columns - (figure.columns > 1))
    names = [label if len(label) <= LONGEST or " " in label else f"{label[: LONGEST - 1]}…" for label in entries]
    room = width * figure.columns - 0.2
    while columns:  # as many as fit
        legend = canvas.legend(
            list(entries.values()), names, loc="outside lower center", ncols=columns, fontsize=WORDS, frameon=False
        )
        if columns == 1 or legend.get_window_extent().width <= room * canvas.dpi:
            canvas.set_figheight(canvas.get_figheight() + 0.18 * (-(-len(names) // columns) - 1))
            break
        legend.remove()
        columns -= 1
    canvas.suptitle(_broken(figure.title, room, TITLE), fontsize=TITLE)
    return canvas


def _width(text: str, size: float) -> float:
    """Returns the width of a line of text [inches] at a font size [points]."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import TextToPath

    return TextToPath().get_text_width_height_descent(text, FontProperties(size=size), ismath=False)[0] / 72


def _broken(text: str, room: float, size: float) -> str:
    """Returns a text broken at spaces into lines of at most this width [inches]."""
    lines: list[str] = []
    for line in text.split("\n"):
        lines.append("")
        for word in line.split(" "):
            longer = f"{lines[-1]} {word}".lstrip()
            if lines[-1] and _width(longer, size) > room:
                lines.append(_cut(word, room, size))
            else:
                lines[-1] = _cut(longer, room, size)
    return "\n".join(lines)


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
        axis.pcolormesh(ground.x, ground.y, ground.kind, cmap=ListedColormap(ground.colors), vmin=-0.5, vmax=count - 0.5)
        for name, color in ground.legend:
            axis.plot([], [], color=color, linestyle="", marker="s", markersize=9, label=SHOWN + name)
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
        for (low, high), name in zip(ground.ends, ground.names, strict=True):
            shown = axis.axvspan(low, min(high, FAR), color=ground.color, zorder=0)
            shown.set_label(SHOWN + name)
    for curve in panel.curves:
        axis.plot(
            curve.x,
            curve.y,
            color=curve.color,
            linestyle=DASHES[curve.dash],
            linewidth=curve.width,
            marker=curve.marker,
            markersize=4.5,
            markerfacecolor="white" if curve.marker == "o" else None,
            zorder=3 if curve.marker else 2,
            clip_on=not (isinstance(ground, Shades) and len(curve.x)),  # markers at corners are not cut
            label=SHOWN + curve.label if curve.label else None,
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
    axis.set_title(_broken(panel.title, width, HEAD), fontsize=HEAD)
    axis.set_xlabel(panel.xlabel, fontsize=WORDS)
    axis.set_ylabel(panel.ylabel, fontsize=WORDS)
    if ground is None:
        axis.grid(which="major", color="0.88", linewidth=0.7)
