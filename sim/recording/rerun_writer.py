"""Runs as a Rerun file with its layout: the moving car next to its curves.

Rerun takes half a second to import, so this module is imported only when a file is written.
"""

import hashlib
import math
import re
import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
import rerun.chunk

from models.common.arrays import Array
from models.kinds.signals import Signal
from sim.recording.rerun_contents import (
    TIMELINE,
    certificates,
    colours,
    entity,
    line,
    listed,
    log_acting,
    log_difference,
    log_events,
    log_properties,
    log_scene,
    log_signals,
    log_text,
)
from sim.recording.run_log import DAMPERS, LOADS, RunLog, compared, groups, plotted, shown
from sim.recording.run_log import title as page_title
from sim.recording.scene import largest_force
from sim.response.response import Response

# Direction of view: from the left, where the struts are visible, slightly from the front and above; x is forward, z is up.
SIGHT = np.array([-0.45, -1.0, -0.14])
HALF_VIEW = np.tan(np.radians(55.0 / 2))  # Rerun's vertical field of view
SKY = (206, 214, 224)  # background that contrasts with black tyres
PAPER = (178, 183, 192)  # background of plots, for the report's colours and a white time cursor
ROUNDING = 1e-9  # of the other end of a curve: less is 0
UNSEEN = 5e-3  # relative to a peak: about a pixel of a plot
SEEN = 6  # plots on one page; more would be too flat to read
CARS, TITLE = (1090, 326), 28  # space for all cars in a window of 1600 x 900, and height of a view's title [pixels]
# Rerun labels multiples of powers of ten on an axis of values, except those too close together. So many a plot has only the label
# 0. Then the axis is extended to the next label, unless that would make the curve too small.
CLOSEST = 7  # most steps between labels; with more, a plot of 190 pixels has only every tenth label
LABELS = 3  # number of labels needed to read a value
FURTHEST = 1.6  # longest extended axis, over the range
MARGIN = 0.04  # of the range, or of a step, so that no peak or label is on the border
LOW_MARGIN = 0.2  # the same of the plot of differences, which is so low that its highest label would be cut
LARGEST = float(np.finfo(float).max)


def layout(runs: Sequence[RunLog]) -> rrb.Blueprint:
    """Returns the layout: a page for each run and, for several runs, first a comparison."""
    pages = [_page(run) for run in runs]
    root = pages[0] if len(pages) == 1 else rrb.Tabs(_comparison(runs), *pages, active_tab=0)
    return rrb.Blueprint(
        root,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        # Slow and repeated, as a bump takes half a second.
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="playing", loop_mode="All", playback_speed=0.25),
        auto_views=False,
    )


def _page(run: RunLog) -> rrb.Container:
    """Returns the page of a run: on the left the car, its certificate and events, on the right responses and differences."""
    texts = rrb.Tabs(
        rrb.TextDocumentView(origin=entity(run.name, "summary"), name="certificate and verdict"),
        rrb.TextDocumentView(origin=entity("metadata"), name="metadata"),
        active_tab=0,
    )
    left: list[Any] = [_car(run, 1.5), texts]
    if run.events:
        columns = rrb.archetypes.TextLogColumns(timeline_columns=[], text_log_columns=["Body"])
        left.append(rrb.TextLogView(origin=entity(run.name, "events"), name="what happened", columns=columns))
    happened = dict.fromkeys(text for _, text in run.events)
    pages = []
    for name, group in groups(plotted(run)).items():
        for title, part in _parts(page_title(run, name), group):
            plots = []
            for signal in part:
                curves = [response[signal.name] for response in run.responses.values() if signal.name in response.names]
                paths = [entity(run.name, "signals", signal.name, each) for each in (*run.responses, *happened)]
                plots.append(_plot(signal, paths, curves, not plots))
            pages.append(rrb.Vertical(rrb.Grid(*plots, grid_columns=2), _gap(run, name, group), row_shares=[4, 1], name=title))
    pages += _acting(run)
    return rrb.Horizontal(
        rrb.Vertical(*left, row_shares=[5, 4, 2][: len(left)]),
        pages[0] if len(pages) == 1 else rrb.Tabs(*pages, active_tab=0),
        column_shares=[2, 3],
        name=run.name,
    )


def _acting(run: RunLog) -> list[rrb.Container]:
    """Returns the views of loads over time, and of the diagrams of dampers and springs."""
    pages: list[rrb.Container] = []
    if LOADS in run.acting:
        loads = run.acting[LOADS]
        plots = [
            _plot(signal, [entity(run.name, "acting", LOADS, signal.name)], [loads[signal.name]], not i)
            for i, signal in enumerate(loads.signals)
        ]
        pages.append(rrb.Grid(*plots, grid_columns=2 if len(plots) > 3 else 1, name="loads"))
    if DAMPERS in run.acting:
        bounds = rrb.VisualBounds2D(x_range=(-1.1, 1.1), y_range=(-1.1, 1.1))
        views = [
            rrb.Spatial2DView(
                origin=entity(run.name, "acting", "diagrams", one.pull.name),
                name=f"{one.title}: force [{one.pull.unit}] up, over {one.over} to the right",
                visual_bounds=bounds,
                background=rrb.Background(color=PAPER),
            )
            for one in run.diagrams
        ]
        pages.append(rrb.Grid(*views, grid_columns=2 if len(views) > 1 else 1, name="dampers and springs"))
    return pages


def _parts(name: str, group: Sequence[Signal]) -> list[tuple[str, Sequence[Signal]]]:
    """Returns a group's signals, divided evenly among pages of at most `SEEN`, with their titles."""
    count = -(-len(group) // SEEN)
    each = -(-len(group) // count)
    parts = [group[start : start + each] for start in range(0, len(group), each)]
    return [(f"{name} {number}" if count > 1 else name, part) for number, part in enumerate(parts, start=1)]


def _gap(run: RunLog, name: str, group: Sequence[Signal]) -> rrb.View:
    """Returns the plot of the differences of a group's signals, with the largest in its title."""
    title, curves = "difference: MuJoCo - sampled, of each signal's peak", []
    if (gap := run.gap) is not None:
        curves = [gap[signal.name] for signal in group if signal.name in gap.names]
        peaks = {signal.name: float(gap.peak(signal.name)) for signal in group if signal.name in gap.names}
        worst = max(peaks, key=lambda name: peaks[name], default="")
        if worst and np.isfinite(peaks[worst]):
            title += f"; largest {peaks[worst]:.1e}, {worst.replace('_', ' ')}"
    return rrb.TimeSeriesView(
        origin=entity(run.name, "difference", name),
        name=title,
        axis_x=rrb.TimeAxis(link="LinkToGlobal"),
        axis_y=value_axis(curves, LOW_MARGIN),
        plot_legend=rrb.PlotLegend(corner="RightTop"),
        background=rrb.archetypes.PlotBackground(color=PAPER, show_grid=False),
    )


def _comparison(runs: Sequence[RunLog]) -> rrb.Container:
    """Returns the page of all runs: the cars, their certificates, and a plot of each signal with all runs."""
    columns = _columns(runs)
    wide, tall = _room(len(runs), columns)
    cars = rrb.Grid(*(_car(run, wide / tall) for run in runs), grid_columns=columns)
    pages = []
    for name, group in groups(compared(runs)).items():
        for title, part in _parts(name, group):
            plots = [_compared(signal, runs, not i) for i, signal in enumerate(part)]
            pages.append(rrb.Grid(*plots, grid_columns=3 if len(part) > 4 else 2, name=title))
    plots = pages[0] if len(pages) == 1 else rrb.Tabs(*pages, active_tab=0)
    certificates = rrb.TextDocumentView(origin=entity("certificates"), name="certificates")
    return rrb.Vertical(rrb.Horizontal(cars, certificates, column_shares=[3, 1]), plots, row_shares=[4, 5], name="all")


def doubles(runs: Sequence[RunLog]) -> set[str]:
    """Returns the names of runs whose curves all coincide with those of an earlier run, as for a printed gain and its design."""
    doubled: set[str] = set()
    for i, run in enumerate(runs):
        mine = run.responses[shown(run)]
        others = [one.responses[shown(one)] for one in runs[:i] if one.name not in doubled]
        if any(_same_curves(mine, other) for other in others):
            doubled.add(run.name)
    return doubled


@np.errstate(invalid="ignore", over="ignore")  # NaN differs from everything
def _same_curves(one: Response, other: Response) -> bool:
    """Returns True if the curves of two responses cannot be distinguished in a plot."""
    if one.signals != other.signals or not np.array_equal(one.time, other.time):
        return False
    distance = np.abs(one.values - other.values).max(axis=0)
    return bool(np.all(distance <= UNSEEN * np.abs(other.values).max(axis=0)))


def _columns(runs: Sequence[RunLog]) -> int:
    """Returns the number of columns in which the views of the cars are largest."""
    low, high = np.array([run.scene.finite().extent() for run in runs]).swapaxes(0, 1)
    length, _, height = (high - low).max(axis=0)

    def size(columns: int) -> float:
        wide, tall = _room(len(runs), columns)
        return min(wide / length, tall / height)

    return max(range(1, len(runs) + 1), key=size)


def _room(count: int, columns: int) -> tuple[float, float]:
    """Returns width and height of the view of each of several cars [pixels]."""
    return CARS[0] / columns, CARS[1] / -(-count // columns) - TITLE


def _compared(signal: Signal, runs: Sequence[RunLog], legend: bool) -> rrb.View:
    """Returns the plot of a signal of all runs, each in its colour."""
    having = {
        run.name: color for run, color in zip(runs, colours(runs), strict=True) if signal.name in run.responses[shown(run)].names
    }
    paths = {entity(run.name, "signals", signal.name, shown(run)): run.name for run in runs if run.name in having}
    # Thinner in the order in which the viewer draws, so that a curve behind another stays visible.
    lines = {path: line(paths[path], having[paths[path]], min(1.5 + rank, 5.0)) for rank, path in enumerate(sorted(paths)[::-1])}
    hidden = {path: [looks, rrb.EntityBehavior(visible=False)] for path, looks in lines.items() if paths[path] in doubles(runs)}
    happened = [
        entity(run.name, "signals", signal.name, text) for run in runs for text in dict.fromkeys(t for _, t in run.events)
    ]
    # The plot with the legend has no events, whose markers would need as many entries as the controllers.
    curves = [run.responses[shown(run)][signal.name] for run in runs if run.name in having]
    return _plot(signal, [*paths, *([] if legend else happened)], curves, legend, {**lines, **hidden})


def _plot(
    signal: Signal, paths: Sequence[str], curves: Sequence[Array], legend: bool, lines: Mapping[Any, Any] | None = None
) -> rrb.View:
    """Returns the plot of a signal; `lines` has styles of series by path. All plots zoom and pan together in time."""
    return rrb.TimeSeriesView(
        origin="/",
        contents=[f"+ {path}" for path in paths],
        name="   ".join(filter(None, [signal.name.replace("_", " "), f"{signal.symbol} [{signal.unit}]", extremes_text(curves)])),
        axis_x=rrb.TimeAxis(link="LinkToGlobal"),
        axis_y=value_axis(curves),
        plot_legend=rrb.PlotLegend(corner="RightTop", visible=legend),
        background=rrb.archetypes.PlotBackground(color=PAPER, show_grid=False),
        overrides=lines,
    )


def _car(run: RunLog, aspect: float) -> rrb.View:
    """Returns the view of a run's car, for this ratio of width to height."""
    world = entity(run.name, "world")
    low, high = run.scene.finite().extent()
    return _scene_view(world, run.name, (low, high), aspect)


def _scene_view(origin: str, name: str, box: tuple[Array, Array], aspect: float) -> rrb.View:
    """Returns a 3D view whose camera looks along `SIGHT` and shows a whole box [m]."""
    sight = SIGHT / np.linalg.norm(SIGHT)
    right = np.cross(sight, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    upward = np.cross(right, sight)

    low, high = box
    centre = (low + high) / 2
    corners = np.stack(np.meshgrid(*np.stack([low, high], axis=1)), axis=-1).reshape(8, 3) - centre
    wide, tall, deep = np.abs(corners @ right), np.abs(corners @ upward), corners @ sight
    distance = 1.03 * np.max(np.maximum(wide / aspect, tall) / HALF_VIEW - deep)
    return rrb.Spatial3DView(
        origin=origin,
        name=name,
        background=rrb.Background(color=SKY),
        eye_controls=rrb.EyeControls3D(position=centre - distance * sight, look_target=centre, eye_up=[0.0, 0.0, 1.0]),
    )


def value_axis(curves: Iterable[Array], margin: float = MARGIN) -> rrb.ScalarAxis | None:
    """Returns an axis for all finite values of some curves, or None, which leaves it to Rerun, if they have none."""
    ends = extremes(curves)
    if ends is None:
        return None
    low, high = labelled(*ends, margin)
    return rrb.ScalarAxis(range=(low, high)) if math.isfinite(high - low) else None


def extremes(curves: Iterable[Array]) -> tuple[float, float] | None:
    """Returns the smallest and the largest finite value of some curves, or None if they have no finite value."""
    finite = [curve[np.isfinite(curve)] for curve in curves]
    ends = [(float(part.min()), float(part.max())) for part in finite if part.size]
    return (min(low for low, _ in ends), max(high for _, high in ends)) if ends else None


def extremes_text(curves: Iterable[Array]) -> str:
    """Returns the extremes as text; empty without finite values."""
    limits = extremes(curves)
    if limits is None:
        return ""
    least = ROUNDING * max(map(abs, limits))
    return " to ".join(dict.fromkeys(f"{value if abs(value) > least else 0.0:.3g}" for value in limits))


def labelled(low: float, high: float, margin: float = MARGIN) -> tuple[float, float]:
    """Returns the range with a margin, extended to the nearest labels if it has fewer than `LABELS` and they are near.

    Where there is room, no label is nearer to the border than the margin of a step.
    """
    if high - low <= ROUNDING * max(abs(low), abs(high)):  # a constant curve, shown in the middle
        around = abs(low) or 1.0
        low, high = low - around, high + around
    around = margin * (high - low)
    low, high = max(low - around, -LARGEST), min(high + around, LARGEST)
    step, tight = spacing(high - low), (low, high)
    if not 0 < step < math.inf:
        return tight
    while count(low, high, step) < LABELS:
        below, above = step * (math.ceil(low / step) - 1 - margin), step * (math.floor(high / step) + 1 + margin)
        low, high = (below, high) if low - below < above - high else (low, above)
    low, high = (low, high) if high - low <= FURTHEST * (tight[1] - tight[0]) else tight
    below, above = min(low, step * (math.ceil(low / step) - margin)), max(high, step * (math.floor(high / step) + margin))
    fits = count(low, high, step) >= LABELS and spacing(above - below) == step
    return (below, above) if fits and above - below <= FURTHEST * (tight[1] - tight[0]) else (low, high)


def spacing(span: float) -> float:
    """Returns the distance between labels on an axis of this length, in its unit; infinity for one without end."""
    if not math.isfinite(span):
        return math.inf
    return 10.0 ** math.ceil(math.log10(span) - math.log10(CLOSEST))


def count(low: float, high: float, step: float) -> int:
    """Returns the number of multiples of a step in a range."""
    return math.floor(high / step) - math.ceil(low / step) + 1


def write_rrd(path: Path, runs: Sequence[RunLog], metadata: Mapping[str, str]) -> None:
    """Writes runs to a Rerun file with a layout.

    Entities of a run, below its name: `signals/<signal>/<response>`, events at `signals/<signal>/<event>`, `difference/<group>`,
    `world/<body>/<shape>`, `world/springs/<spring>`, `world/forces/<spring>`, `world/profile/<track>`, `acting/loads/<load>`,
    `acting/diagrams/<force>`, `summary` and `events`. All runs share `metadata` and, if they are several, `certificates`. The
    timeline is `time`, from the start of a run. Equal contents get equal recording ids, so a file opened twice is one recording.
    The bytes differ, as Rerun numbers rows by the clock.

    Args:
        path: the file; overwritten if it exists.
        runs: runs with distinct names. Frames after a run broke off, which are not finite, are omitted: the car stops.
        metadata: metadata of all runs.

    Raises:
        OSError: the file cannot be written.
        ValueError: Rerun cannot log something.
    """
    # The viewer keeps one layout per application id, so files share it if their runs have the same names.
    # Rerun warns about other characters.
    application = re.sub(r"[^A-Za-z0-9_-]+", "-", "-".join(["roadproof", *(run.name for run in runs)]))
    recording = rr.RecordingStream(
        application,
        recording_id=_content_id(runs, metadata),
        send_properties=False,  # they hold the time of writing
    )
    strict = rr.strict_mode()
    rr.set_strict_mode(True)  # otherwise Rerun only warns of data that it cannot log
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
        log_text(recording, entity("metadata"), listed(metadata))
        if len(runs) > 1:
            log_text(recording, entity("certificates"), certificates(runs))
        largest = largest_force(run.scene for run in runs)
        for run, color in zip(runs, colours(runs), strict=True):
            log_properties(recording, f"run {run.name}", run.metadata)
            log_text(recording, entity(run.name, "summary"), run.summary + "\n\n---\n\n" + listed(run.metadata))
            log_signals(recording, run, color)
            log_difference(recording, run)
            log_acting(recording, run, color)
            log_events(recording, run)
            log_scene(recording, run, largest)
    finally:
        recording.disconnect()  # flushes and closes the file
        rr.set_strict_mode(strict)
    _check_complete(path)


def _check_complete(path: Path) -> None:
    """Checks a file by its table of contents, which Rerun writes last, in a thread, without an error on a full disk."""
    try:
        with warnings.catch_warnings(action="error"):
            rerun.chunk.RrdReader(path).store()
    except (RuntimeError, ValueError, Warning) as error:
        raise OSError("Rerun did not write the whole file; is the disk full?") from error


def _content_id(runs: Sequence[RunLog], metadata: Mapping[str, str]) -> str:
    """Returns a hash of all texts and all numbers of the responses."""
    digest = hashlib.sha256()
    for part in (metadata, *((run.name, run.metadata, run.events, run.summary) for run in runs)):
        digest.update(repr(part).encode())
    for run in runs:
        for name, response in run.responses.items():
            digest.update(repr((name, response.signals)).encode() + response.time.tobytes() + response.values.tobytes())
    return digest.hexdigest()[:32]
