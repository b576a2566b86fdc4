"""Writer of runs as a Rerun file with a layout that shows the moving car next to its curves.

Importing Rerun takes half a second, so Rerun is imported only when a file is written.
"""

import math
import re
import warnings
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
import rerun.chunk

from models.common.arrays import Array
from sim.observers.results import DIFFERENCE as GAP
from sim.recording.pages import DIFFERENCE, Page, Plot, colour_of, pages
from sim.recording.rerun_contents import (
    TIMELINE,
    certificates,
    curve_path,
    entity,
    lines,
    list_metadata,
    log_events,
    log_properties,
    log_scene,
    log_signals,
    log_text,
)
from sim.recording.run_log import LOADS, RunLog
from sim.recording.scene import largest_force

# Direction of view: from the left, slightly from the front and above, so that the struts are visible; x points forward, z
# points up.
SIGHT = np.array([-0.45, -1.0, -0.14])
FROM_BEHIND = np.array([1.0, -0.35, -0.14])  # direction of view for a vehicle in the roll plane, slightly from the left
HALF_VIEW = np.tan(np.radians(55.0 / 2))  # tangent of half of Rerun's vertical field of view
SKY = (206, 214, 224)  # background colour, against which black tyres are visible
ROUNDING = 1e-9  # if one end of a curve's range is smaller than this multiple of the other end, the smaller end counts as 0
CARS = 3.6  # ratio of width to height of the area that shows all cars, if the window has 1600 x 900 pixels
# width of a letter relative to the width of a window of 1600 pixels, and number of letters in a row of the certificate table
# without its name
LETTER, LETTERS = 6 / 1600, 34
MARGIN = 0.04  # margin of a plot's axis, relative to the range of its values, so that no peak touches the border


def layout(runs: Sequence[RunLog]) -> rrb.Blueprint:
    """Returns the layout: a page for each run and, if there are several runs, a comparison as the first page."""
    each = [_page(runs, run) for run in runs]
    root = each[0] if len(runs) == 1 else rrb.Tabs(_comparison(runs), *each, active_tab=0)
    return rrb.Blueprint(
        root,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        # The recording is played repeatedly in slow motion, because crossing a bump takes only half a second.
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="playing", loop_mode="All", playback_speed=0.25),
        auto_views=False,
    )


def _page(runs: Sequence[RunLog], run: RunLog) -> rrb.Container:
    """Returns the page of a run: car, certificate and events on the left, responses and differences on the right."""
    texts = rrb.Tabs(
        rrb.TextDocumentView(origin=entity(run.name, "summary"), name="certificate and verdict"),
        rrb.TextDocumentView(origin=entity("metadata"), name="metadata"),
        active_tab=0,
    )
    left: list[Any] = [_car(run, 1.15), texts]
    if run.events:
        columns = rrb.archetypes.TextLogColumns(timeline_columns=[], text_log_columns=["Body"])
        left.append(rrb.TextLogView(origin=entity(run.name, "events"), name="what happened", columns=columns))
    plots = _tab_container([_plots(page, [run]) for page in pages(runs, [run])])
    return rrb.Horizontal(rrb.Vertical(*left, row_shares=[5, 4, 2][: len(left)]), plots, column_shares=[1, 2], name=run.name)


def _comparison(runs: Sequence[RunLog]) -> rrb.Container:
    """Returns the page of all runs: the cars, their certificates, and a plot of each signal for all runs."""
    columns = len(runs) if len(runs) <= 4 else -(-len(runs) // 2)
    aspect = CARS / columns * -(-len(runs) // columns)
    cars = rrb.Grid(*(_car(run, aspect) for run in runs), grid_columns=columns)
    certificates = rrb.TextDocumentView(origin=entity("certificates"), name="certificates")
    plots = _tab_container([_plots(page, runs) for page in pages(runs, runs)])
    table = LETTER * (LETTERS + max(len(name) for name in ("controller", *(run.name for run in runs))))
    return rrb.Vertical(
        rrb.Horizontal(cars, certificates, column_shares=[1 - table, table]), plots, row_shares=[4, 5], name="all"
    )


def _tab_container(pages: Sequence[rrb.Container]) -> rrb.Container:
    return pages[0] if len(pages) == 1 else rrb.Tabs(*pages, active_tab=0)


def _plots(page: Page, runs: Sequence[RunLog]) -> rrb.Container:
    """Returns a page of plots, with the plots of their differences below them."""
    views = [_view(plot, runs, i == 0) for i, plot in enumerate(page.plots)]
    grid = rrb.Grid(*views, grid_columns=page.columns, name=page.title)
    if not page.difference:
        return grid
    peaks = {curve.label: float(curve.response.peak(curve.signal)) for curve in page.difference}
    worst = max(peaks, key=lambda name: peaks[name])
    title = f"{DIFFERENCE}; largest {GAP.digits(peaks[worst])}, {worst}" if np.isfinite(peaks[worst]) else DIFFERENCE
    origin = entity(runs[0].name, "difference", page.group)
    gap = _series(title, [curve.values for curve in page.difference], origin=origin)
    return rrb.Vertical(grid, gap, row_shares=[4, 1], name=page.title)


def _view(plot: Plot, runs: Sequence[RunLog], first: bool) -> rrb.View:
    """Returns a plot over time, with a legend if it is the first plot of its page; for a diagram, returns its view."""
    run = runs[0]
    if plot.diagram is not None:
        return rrb.Spatial2DView(
            origin=entity(run.name, "acting", "diagrams", plot.diagram.pull.name),
            name=f"{plot.title} to the right",
            visual_bounds=rrb.VisualBounds2D(x_range=(-1.1, 1.1), y_range=(-1.1, 1.1)),
        )
    curves = [curve.values for curve in plot.curves]
    title = "   ".join(filter(None, [plot.title, extremes_text(curves)]))
    paths = {curve_path(curve): lines([curve]) for curve in plot.curves}
    signal = plot.curves[0].signal
    happened = [entity(run.name, "signals", signal, text) for run in runs for text in dict.fromkeys(t for _, t in run.events)]
    # With several runs, the plot that contains the legend shows no events, because their markers would add entries to the
    # legend.
    marked = happened if plot.curves[0].topic != LOADS and (len(runs) == 1 or not first) else []
    return _series(title, curves, first, origin="/", contents=[f"+ {path}" for path in (*paths, *marked)], overrides=paths)


def _series(title: str, curves: Sequence[Array], legend: bool = True, **contents: Any) -> rrb.View:
    """Returns a plot of curves over time. All plots over time zoom and pan together."""
    return rrb.TimeSeriesView(
        name=title,
        axis_x=rrb.TimeAxis(link="LinkToGlobal"),
        axis_y=value_axis(curves),
        plot_legend=rrb.PlotLegend(corner="RightTop", visible=legend),
        **contents,
    )


def _car(run: RunLog, aspect: float) -> rrb.View:
    """Returns the view that shows a whole car from the direction `SIGHT`, for a specified ratio of width to height."""
    sight = FROM_BEHIND if run.scene.flat else SIGHT
    sight = sight / np.linalg.norm(sight)
    right = np.cross(sight, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    upward = np.cross(right, sight)

    low, high = run.scene.finite().extent()
    centre = (low + high) / 2
    corners = np.stack(np.meshgrid(*np.stack([low, high], axis=1)), axis=-1).reshape(8, 3) - centre
    wide, tall, deep = np.abs(corners @ right), np.abs(corners @ upward), corners @ sight
    distance = 1.03 * np.max(np.maximum(wide / aspect, tall) / HALF_VIEW - deep)
    return rrb.Spatial3DView(
        origin=entity(run.name, "world"),
        name=run.name,
        background=rrb.Background(color=SKY),
        eye_controls=rrb.EyeControls3D(position=centre - distance * sight, look_target=centre, eye_up=[0.0, 0.0, 1.0]),
    )


def extremes(curves: Sequence[Array]) -> tuple[float, float] | None:
    """Returns the smallest and the largest finite value of curves; None if they have no finite value."""
    finite = np.concatenate([curve[np.isfinite(curve)] for curve in curves] or [np.zeros(0)])
    return (float(finite.min()), float(finite.max())) if finite.size else None


def extremes_text(curves: Sequence[Array]) -> str:
    """Returns the smallest and the largest value of curves as text; empty if no value is finite."""
    limits = extremes(curves)
    if limits is None:
        return ""
    least = ROUNDING * max(map(abs, limits))
    return " to ".join(dict.fromkeys(f"{value if abs(value) > least else 0.0:.3g}" for value in limits))


def value_axis(curves: Sequence[Array]) -> rrb.ScalarAxis | None:
    """Returns a value axis that contains all finite values of curves.

    If the curves have no finite values, the result is None, and Rerun chooses the axis.
    """
    low, high = extremes(curves) or (math.nan, math.nan)
    constant = high - low <= ROUNDING * max(abs(low), abs(high))
    margin = (abs(low) or 1.0) if constant else MARGIN * (high - low)
    return rrb.ScalarAxis(range=(low - margin, high + margin)) if math.isfinite(high - low + 2 * margin) else None


def write_rrd(path: Path, runs: Sequence[RunLog], metadata: Mapping[str, str]) -> None:
    """Writes runs to a Rerun file with its layout.

    The entities of a run are below its name: `signals/<signal>/<response>`, events at `signals/<signal>/<event>`,
    `difference/<group>`, `world/<body>/<shape>`, `world/springs/<spring>`, `world/forces/<spring>`, `world/profile/<track>`,
    `acting/loads/<load>`, `acting/diagrams/<force>`, `summary` and `events`. All runs share the entities `metadata` and, if
    there are several runs, `certificates`. The timeline of the file is `time`, which begins at the start of a run.

    Args:
        path: path of the file; an existing file is overwritten.
        runs: runs with distinct names. Frames with values that are not finite are omitted, so that the car stops at the last
            finite frame.
        metadata: metadata that apply to all runs; keys and values are texts.

    Raises:
        OSError: the file cannot be written.
        ValueError: Rerun cannot log some of the data.
    """
    # The viewer stores one layout for each application id. Each recording has its own id, because the plots of a layout have
    # fixed ranges that fit only one recording.
    digest = zlib.crc32(repr((metadata, [run.metadata for run in runs])).encode())
    application = re.sub(r"[^A-Za-z0-9_-]+", "-", f"roadproof-{'-'.join(run.name for run in runs)}-{digest:08x}")
    # properties are not sent, because they would contain only the time of writing
    recording = rr.RecordingStream(application, send_properties=False)
    strict = rr.strict_mode()
    rr.set_strict_mode(True)  # without strict mode, Rerun only warns about data that it cannot log
    try:
        recording.set_log_time_enabled(False)
        recording.set_log_tick_enabled(False)
        try:
            recording.save(path)
        except RuntimeError as error:
            raise OSError(str(error)) from error
        recording.send_blueprint(layout(runs))
        recording.send_recording_name(", ".join(run.name for run in runs))
        log_properties(recording, "roadproof", metadata)
        log_text(recording, entity("metadata"), list_metadata(metadata))
        if len(runs) > 1:
            log_text(recording, entity("certificates"), certificates(runs))
        largest = largest_force(run.scene for run in runs)
        for run in runs:
            color = colour_of(runs, run)
            log_properties(recording, f"run {run.name}", run.metadata)
            log_text(recording, entity(run.name, "summary"), run.summary + "\n\n---\n\n" + list_metadata(run.metadata))
            log_signals(recording, run, color)
            log_events(recording, run)
            log_scene(recording, run, largest)
    finally:
        recording.disconnect()  # writes the remaining data and closes the file
        rr.set_strict_mode(strict)
    _check_complete(path)


def _check_complete(path: Path) -> None:
    """Checks that a Rerun file is complete by reading its table of contents.

    Rerun writes the table of contents last, in a thread, and reports no error if the disk is full.
    """
    try:
        with warnings.catch_warnings(action="error"):
            rerun.chunk.RrdReader(path).store()
    except (RuntimeError, ValueError, Warning) as error:
        raise OSError("Rerun did not write the whole file") from error
