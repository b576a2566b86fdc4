"""Figures as picture files, by matplotlib: asked for before the work, drawn without a screen, never half-written."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from models.common.errors import InputError
from models.common.whole_file import check_file, whole_file
from sim.figures.figure import Bars, Classes, Figure, Panel, Shades

SUFFIXES = (".png", ".svg")
LONGEST = 24  # letters of a name beside a bar
DASHES: dict[str, Any] = {
    "solid": "-",
    "dash": "--",
    "dot": ":",
    "dashdot": "-.",
    "longdash": (0, (8, 2)),
    "none": "",
}


def check_picture(path: Path) -> None:
    """Whether a picture can be drawn there, before the work.

    Raises:
        InputError: another kind of file, a folder that is not there, or matplotlib is not installed.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"picture {path}: not a kind of picture that is drawn; give a name that ends in {' or '.join(SUFFIXES)}")
    check_file(path, "picture")
    check_drawing()


def check_drawing() -> None:
    """Whether pictures can be drawn at all.

    Raises:
        InputError: matplotlib is not installed.
    """
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise InputError("pictures need matplotlib; pip install 'roadproof[report]' or leave --picture out") from None


def write_picture(figure: Figure, *paths: Path) -> None:
    """Writes a figure to every path, each whole or not at all; the same figure gives the same bytes.

    Raises:
        InputError: it cannot be written.
    """
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure as Canvas

    width, height = figure.size
    canvas = Canvas(figsize=(width * figure.columns, height * figure.rows + 1.0), dpi=130, layout="constrained")
    FigureCanvasAgg(canvas)
    axes = canvas.subplots(figure.rows, figure.columns, squeeze=False).ravel()
    for axis, panel in zip(axes, figure.panels, strict=False):
        _draw_panel(axis, panel)
    for axis in axes[len(figure.panels) :]:
        axis.set_visible(False)
    entries: dict[str, Any] = {}
    for axis in axes:
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    if entries:
        columns = min(len(entries), 3 * figure.columns - (figure.columns > 1))
        canvas.legend(list(entries.values()), list(entries), loc="outside lower center", ncols=columns, fontsize=9, frameon=False)
    canvas.suptitle(figure.title, fontsize=11)
    # Laid out once, not for every file: that takes longer than drawing.
    layout = canvas.get_layout_engine()
    assert layout is not None
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", r"Glyph \d+ ")  # letters that the font has not are boxes
        layout.execute(canvas)
        canvas.set_layout_engine("none")
        for path in paths:
            dateless = {"Date": None} if path.suffix.lower() == ".svg" else {}
            with whole_file(path, "picture") as beside, matplotlib.rc_context({"svg.hashsalt": "roadproof"}):
                canvas.savefig(beside, metadata=dateless)


def _draw_panel(axis: Any, panel: Panel) -> None:
    ground = panel.ground
    if isinstance(ground, Classes):
        from matplotlib.colors import ListedColormap

        count = len(ground.colors)
        axis.pcolormesh(ground.x, ground.y, ground.kind, cmap=ListedColormap(ground.colors), vmin=-0.5, vmax=count - 0.5)
        for name, color in ground.legend:
            axis.plot([], [], color=color, linestyle="", marker="s", markersize=9, label=name)
    elif isinstance(ground, Shades):
        image = axis.contourf(ground.x, ground.y, np.ma.masked_invalid(ground.z), levels=14, cmap="YlOrBr")
        axis.figure.colorbar(image, ax=axis, label=ground.label)
    elif isinstance(ground, Bars):
        rows = np.arange(len(ground.names))
        drawn = axis.barh(rows, np.nan_to_num(ground.values), 0.6, color=ground.colors)
        axis.bar_label(drawn, ground.words, padding=7, fontsize=9)
        axis.set_yticks(rows, [name if len(name) <= LONGEST else f"{name[: LONGEST - 1]}…" for name in ground.names], fontsize=9)
        axis.invert_yaxis()
        axis.margins(x=0.25)  # for the words
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
            clip_on=not (isinstance(ground, Shades) and len(curve.x)),  # corners are shown whole
            label=curve.label or None,
        )
    if panel.xlog:
        axis.set_xscale("log")
    if panel.ylog:
        axis.set_yscale("log")
    if panel.xticks:
        axis.set_xticks(panel.xticks, panel.xnames or [f"{tick:g}" for tick in panel.xticks])
        axis.tick_params(axis="x", which="minor", labelbottom=False)
    axis.set(xlim=panel.xlim, ylim=panel.ylim)
    axis.set_title(panel.title, fontsize=10)
    axis.set_xlabel(panel.xlabel, fontsize=9)
    axis.set_ylabel(panel.ylabel, fontsize=9)
    if ground is None:
        axis.grid(which="major", color="0.88", linewidth=0.7)
