"""Runs as a Rerun file: the moving car beside its curves, with the layout that it opens on stored inside.

Rerun takes half a second to import, so this is imported where a file is written; most commands write nothing.
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

# Cameras look from the left-hand side, where the struts are seen, a bit in front and above: x is forward, z is up.
SIGHT = np.array([-0.45, -1.0, -0.14])
HALF_VIEW = np.tan(np.radians(55.0 / 2))  # Rerun's vertical field of view
SKY = (206, 214, 224)  # black tyres are seen before it
PAPER = (178, 183, 192)  # the report's colours are made for light paper; the time cursor is white
UNSEEN = 5e-3  # of a peak: about a pixel of a plot
SEEN = 6  # plots of one page: more of them are too flat to be read
CARS, TITLE = (1090, 326), 28  # room for cars side by side in a window of 1600 x 900, and height of a view's title [pixels]
# An axis of values: Rerun labels powers of ten and their multiples, and leaves out those that come too close. So many a plot has
# one label, 0, and an axis goes on to the next one where that is near; far, it would take the room that the curve is seen in.
CLOSEST = 7  # steps between labels, from bottom to top; of more, Rerun labels only every tenth on a plot of 190 pixels
LABELS = 2  # are needed to read a value
FURTHEST = 1.3  # times the range: further an axis does not go on to a label
MARGIN = 0.04  # of the range, or of a step, so that neither a peak nor a label is on the border


def layout(runs: Sequence[RunLog]) -> rrb.Blueprint:
    """Returns the page of a single run. For several runs a page that compares all comes first."""
    pages = [_page(run) for run in runs]
    root = pages[0] if len(pages) == 1 else rrb.Tabs(_comparison(runs), *pages, active_tab=0)
    return rrb.Blueprint(
        root,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        # A bump is over in half a second: slowly, and again.
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="playing", loop_mode="All", playback_speed=0.25),
        auto_views=False,
    )


def _page(run: RunLog) -> rrb.Container:
    """The car, what is proved of it and what happened on the left; every signal's responses and differences on the right."""
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
    """A group's signals by page, each with its title: as many on one as on another, and never too many."""
    count = -(-len(group) // SEEN)
    each = -(-len(group) // count)
    parts = [group[start : start + each] for start in range(0, len(group), each)]
    return [(f"{name} {number}" if count > 1 else name, part) for number, part in enumerate(parts, start=1)]


def _gap(run: RunLog, name: str, group: Sequence[Signal]) -> rrb.View:
    """The differences of a group's signals, which the verdict is about; the largest in the title."""
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
        axis_y=value_axis(curves),
        plot_legend=rrb.PlotLegend(corner="RightTop"),
        background=rrb.archetypes.PlotBackground(color=PAPER, show_grid=False),
    )


def _comparison(runs: Sequence[RunLog]) -> rrb.Container:
    """All cars side by side, what is proved of each, and every signal of all of them in one plot, a few plots to a page."""
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
    """Names of runs whose curves all lie on those of one before, as a printed gain's do on its design's: shown when asked."""
    found: set[str] = set()
    for i, run in enumerate(runs):
        mine = run.responses[shown(run)]
        others = [one.responses[shown(one)] for one in runs[:i] if one.name not in found]
        if any(_same_curves(mine, other) for other in others):
            found.add(run.name)
    return found


@np.errstate(invalid="ignore", over="ignore")  # what is no number is like nothing
def _same_curves(one: Response, other: Response) -> bool:
    """Returns True if no curve of one response can be told from that of the other."""
    if one.signals != other.signals or not np.array_equal(one.time, other.time):
        return False
    apart = np.abs(one.values - other.values).max(axis=0)
    return bool(np.all(apart <= UNSEEN * np.abs(other.values).max(axis=0)))


def _columns(runs: Sequence[RunLog]) -> int:
    """In how many columns cars side by side are seen largest."""
    low, high = np.array([run.scene.finite().extent() for run in runs]).swapaxes(0, 1)
    length, _, height = (high - low).max(axis=0)

    def size(columns: int) -> float:
        wide, tall = _room(len(runs), columns)
        return min(wide / length, tall / height)

    return max(range(1, len(runs) + 1), key=size)


def _room(count: int, columns: int) -> tuple[float, float]:
    """Width and height of the view of each of several cars [pixels]."""
    return CARS[0] / columns, CARS[1] / -(-count // columns) - TITLE


def _compared(signal: Signal, runs: Sequence[RunLog], legend: bool) -> rrb.View:
    """Returns the plot of a signal of all runs, each in its colour."""
    having = {
        run.name: color for run, color in zip(runs, colours(runs), strict=True) if signal.name in run.responses[shown(run)].names
    }
    paths = {entity(run.name, "signals", signal.name, shown(run)): run.name for run in runs if run.name in having}
    # In the order in which the viewer draws, thinner and thinner, so that one curve behind another is still seen.
    lines = {path: line(paths[path], having[paths[path]], min(1.5 + rank, 5.0)) for rank, path in enumerate(sorted(paths)[::-1])}
    hidden = {path: [looks, rrb.EntityBehavior(visible=False)] for path, looks in lines.items() if paths[path] in doubles(runs)}
    happened = [
        entity(run.name, "signals", signal.name, text) for run in runs for text in dict.fromkeys(t for _, t in run.events)
    ]
    # The plot with the legend goes without: there are as many markers as controllers.
    curves = [run.responses[shown(run)][signal.name] for run in runs if run.name in having]
    return _plot(signal, [*paths, *([] if legend else happened)], curves, legend, {**lines, **hidden})


def _plot(
    signal: Signal, paths: Sequence[str], curves: Sequence[Array], legend: bool, lines: Mapping[Any, Any] | None = None
) -> rrb.View:
    """Returns the plot of a signal; `lines` restyles the series by path. All plots zoom and pan together in time, with one
    legend.
    """
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
    """A run's car, seen whole by a view of this width by height."""
    world = entity(run.name, "world")
    low, high = run.scene.finite().extent()
    return _scene_view(world, run.name, (low, high), aspect)


def _scene_view(origin: str, name: str, box: tuple[Array, Array], aspect: float) -> rrb.View:
    """A 3D view whose camera looks along `SIGHT` and sees the whole of a box [m]."""
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


def value_axis(curves: Iterable[Array]) -> rrb.ScalarAxis | None:
    """An axis that shows the whole of every curve, each of any shape.

    Values that are not finite are left out; where none is, there is no axis to give, and Rerun chooses.
    """
    found = extremes(curves)
    if found is None:
        return None
    low, high = labelled(*found)
    return rrb.ScalarAxis(range=(low, high)) if math.isfinite(high - low) else None


def extremes(curves: Iterable[Array]) -> tuple[float, float] | None:
    """Returns the least and the greatest finite value of some curves, or None if there is no finite value."""
    finite = [curve[np.isfinite(curve)] for curve in curves]
    ends = [(float(part.min()), float(part.max())) for part in finite if part.size]
    return (min(low for low, _ in ends), max(high for _, high in ends)) if ends else None


def extremes_text(curves: Iterable[Array]) -> str:
    """Describes the extremes in words; empty without any."""
    limits = extremes(curves)
    return "" if limits is None else " to ".join(dict.fromkeys(f"{value + 0.0:.3g}" for value in limits))


def labelled(low: float, high: float) -> tuple[float, float]:
    """The range and a margin; and more where fewer than two labels lie in it, and the next one on the nearer side is near."""
    if high <= low:  # nothing happens: the curve in the middle
        around = abs(low) or 1.0
        low, high = low - around, high + around
    margin = MARGIN * (high - low)
    low, high = low - margin, high + margin
    step, tight = spacing(high - low), (low, high)
    if not 0 < step < math.inf:
        return tight
    while count(low, high, step) < LABELS:
        below, above = step * (math.ceil(low / step) - 1 - MARGIN), step * (math.floor(high / step) + 1 + MARGIN)
        low, high = (below, high) if low - below < above - high else (low, above)
    return (low, high) if high - low <= FURTHEST * (tight[1] - tight[0]) else tight


def spacing(span: float) -> float:
    """Returns the distance of labels on an axis of this length, in the axis's own unit."""
    return 10.0 ** math.ceil(math.log10(span) - math.log10(CLOSEST))


def count(low: float, high: float, step: float) -> int:
    """Returns the number of multiples of a step in a range."""
    return math.floor(high / step) - math.ceil(low / step) + 1


def write_rrd(path: Path, runs: Sequence[RunLog], metadata: Mapping[str, str]) -> None:
    """Writes runs to a Rerun file that opens on a finished layout.

    Entities of a run, under its name: `signals/<signal>/<response>`, what happened on it at `signals/<signal>/<event>`,
    `difference/<group>`, `world/<body>/<shape>`, `world/springs/<spring>`, `world/forces/<spring>`, `world/profile/<track>`,
    `acting/loads/<load>`, `acting/diagrams/<force>`, `summary` and `events`; once, `metadata` and, of several runs,
    `certificates`. The timeline is `time`, from the start of a run. The same content gets the same recording id, so that a run
    opened twice is one recording; the bytes differ, as Rerun numbers rows by clock.

    Args:
        path: the file; overwritten if it exists.
        runs: what to write, by distinct names. Frames of a scene that are not finite (the run broke off) are left out:
            the car stays where it was last.
        metadata: what all runs share.

    Raises:
        OSError: the file cannot be written.
        ValueError: Rerun cannot log something.
    """
    # The viewer keeps one layout per application id: files with runs of the same names share it, others do not.
    # Of characters outside this set it complains.
    application = re.sub(r"[^A-Za-z0-9_-]+", "-", "-".join(["roadproof", *(run.name for run in runs)]))
    recording = rr.RecordingStream(
        application,
        recording_id=_content_id(runs, metadata),
        send_properties=False,  # they hold the time of writing
    )
    strict = rr.strict_mode()
    rr.set_strict_mode(True)  # or Rerun only warns of what it cannot log, and the file lacks it
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
    """Reads the table of contents, which Rerun writes last: it writes in a thread, and raises nothing on a full disk."""
    try:
        with warnings.catch_warnings(action="error"):
            rerun.chunk.RrdReader(path).store()
    except (RuntimeError, ValueError, Warning) as error:
        raise OSError("Rerun did not write the whole file; is the disk full?") from error


def _content_id(runs: Sequence[RunLog], metadata: Mapping[str, str]) -> str:
    """A name for the content: of text and of every number in the responses."""
    digest = hashlib.sha256()
    for part in (metadata, *((run.name, run.metadata, run.events, run.summary) for run in runs)):
        digest.update(repr(part).encode())
    for run in runs:
        for name, response in run.responses.items():
            digest.update(repr((name, response.signals)).encode() + response.time.tobytes() + response.values.tobytes())
    return digest.hexdigest()[:32]
