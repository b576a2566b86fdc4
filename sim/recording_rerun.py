"""Runs as a Rerun file: the moving car beside its curves, with the layout that shows them stored inside.

Rerun is imported where it is used: it takes half a second, and most commands write nothing.
"""

import hashlib
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from models.arrays import Array
from models.signals import Signal
from sim.run_log import RunLog
from sim.scene import Shape

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

Colour = tuple[int, int, int]

_TIMELINE = "time"

# The viewer draws in the order of names, so physics comes last: a thin line within broad ones. Where it leaves them,
# both are seen. By response: (label, colour, width).
_RESPONSES = {
    "continuous": ("continuous", (120, 120, 125), 7.0),
    "linear": ("linear", (70, 130, 230), 4.0),
    "mujoco": ("MuJoCo", (255, 175, 60), 1.5),
}
_ANY_RESPONSE = ((200, 200, 200), 2.0)

# The paper's: passive black, state blue, I red, II green; lightened, as the viewer is dark.
_RUNS = {"passive": (160, 160, 160), "state": (80, 140, 255), "I": (235, 70, 60), "II": (70, 190, 95)}
_OTHER_RUNS = ((240, 150, 40), (190, 110, 220), (60, 195, 200), (225, 110, 160))

_SPRING_TURNS, _SPRING_POINTS, _SPRING_COLOUR = 6, 73, (235, 175, 45)

# Cameras look from the right-hand side, a bit in front and above: x is forward, z is up. A row of cars, more squarely.
_SIGHT, _SIGHT_OF_ROW = np.array([-0.45, 1.0, -0.2]), np.array([-0.12, 1.0, -0.2])
_BACKGROUND = (70, 76, 86)  # black tyres are seen before it
_HALF_VIEW = np.tan(np.radians(55.0 / 2))  # Rerun's vertical field of view


def write_rrd(path: Path, runs: Sequence[RunLog], metadata: Mapping[str, str]) -> None:
    """Writes runs to a Rerun file that opens on a finished layout.

    Entities of a run, under its name: `signals/<signal>/<response>`, `world/<body>/<shape>`, `world/springs/<spring>`,
    `summary` and `events`; once, `metadata`. The timeline is `time`, from the start of a run. The same content gets the
    same recording id, so that a run opened twice is one recording; the bytes differ, as Rerun numbers rows by clock.

    Args:
        path: the file; overwritten if it exists.
        runs: what to write, by distinct names. Frames of a scene that are not finite (the run broke off) are left out:
            the car stays where it was last.
        metadata: what all runs share.

    Raises:
        OSError: the file cannot be written.
        ValueError: Rerun cannot log something.
    """
    import rerun as rr

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
        recording.send_blueprint(_layout(runs))
        recording.send_recording_name(", ".join(run.name for run in runs))
        _log_properties(recording, "roadproof", metadata)
        recording.log("metadata", _document(_listed(metadata)), static=True)
        for run, offset, colour in zip(runs, _offsets(runs), _colours(runs), strict=True):
            _log_run(recording, run, offset, colour)
    finally:
        recording.disconnect()  # flushes and closes the file
        rr.set_strict_mode(strict)
    _check_complete(path)


def _check_complete(path: Path) -> None:
    """Reads the table of contents, which Rerun writes last: it writes in a thread, and raises nothing on a full disk.

    Raises:
        OSError: there is none.
    """
    import rerun.chunk

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


def _path(*parts: str) -> str:
    """An entity path; a name may hold any character."""
    import rerun as rr

    return "/" + rr.new_entity_path(list(parts))


# --- data ------------------------------------------------------------------------------------------------------------


def _log_run(recording: "rr.RecordingStream", run: RunLog, offset: Array, colour: Colour) -> None:
    """All of one run; `offset` [m] and `colour` tell its car from the others' where they are shown together."""
    import rerun as rr

    _log_properties(recording, f"run {run.name}", run.metadata)
    text = run.summary + "\n\n---\n\n" + _listed(run.metadata)
    recording.log(_path(run.name, "summary"), _document(text), static=True)

    for name, response in run.responses.items():
        index = _index(response.time)
        label, line_colour, width = _RESPONSES.get(name, (name, *_ANY_RESPONSE))
        for signal in response.signals:
            path = _path(run.name, "signals", signal.name, name)
            recording.log(path, _line(f"{label} [{signal.unit}]", line_colour, width), static=True)
            recording.send_columns(path, index, rr.Scalars.columns(scalars=response[signal.name]))

    if run.events:
        index = _index(np.array([time for time, _ in run.events]))
        texts = [text for _, text in run.events]
        columns = rr.TextLog.columns(text=texts, level=["INFO"] * len(texts))
        recording.send_columns(_path(run.name, "events"), index, columns)

    recording.log(_path(run.name), rr.Transform3D(translation=offset), static=True)
    low, high = run.scene.extent()
    above = np.array([*(low + high)[:2] / 2, high[2] + 0.2])
    label = rr.Points3D([above], radii=0.001, colors=[colour], labels=[run.name])
    recording.log(_path(run.name, "name"), label, static=True)
    _log_scene(recording, run)


def _log_properties(recording: "rr.RecordingStream", name: str, metadata: Mapping[str, str]) -> None:
    """Metadata where programs look for it; people read it in the documents."""
    import rerun as rr

    if metadata:
        recording.send_property(name, rr.AnyValues(drop_untyped_nones=True, **metadata))


def _index(time: Array) -> "list[rr.TimeColumn]":
    """Times [s] to the nearest nanosecond, as in the MCAP file; of seconds, Rerun would cut off the rest."""
    import rerun as rr

    return [rr.TimeColumn(_TIMELINE, duration=np.round(time * 1e9).astype("timedelta64[ns]"))]


def _log_scene(recording: "rr.RecordingStream", run: RunLog) -> None:
    import rerun as rr

    scene, world = run.scene, _path(run.name, "world")
    recording.log(world, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    for shape in scene.shapes:
        recording.log(_path(run.name, "world", shape.body, shape.name), _solid(shape), static=True)

    for body, motion in scene.bodies.items():
        kept = np.isfinite(motion.positions).all(1) & np.isfinite(motion.quaternions).all(1)
        columns = rr.Transform3D.columns(
            translation=motion.positions[kept],
            quaternion=np.roll(motion.quaternions[kept], -1, axis=1),  # w last
        )
        index = _index(scene.time[kept])
        recording.send_columns(_path(run.name, "world", body), index, columns)

    for name, ends in scene.springs.items():
        kept = np.isfinite(ends).all((1, 2))
        path = _path(run.name, "world", "springs", name)
        recording.log(path, rr.LineStrips3D.from_fields(colors=[_SPRING_COLOUR], radii=[0.01]), static=True)
        index = _index(scene.time[kept])
        recording.send_columns(path, index, rr.LineStrips3D.columns(strips=_coil(ends[kept]).astype(np.float32)))


def _solid(shape: Shape) -> "rr.AsComponents":
    """A shape as Rerun draws it.

    Raises:
        ValueError: the form is not one of those that `Shape` allows.
    """
    import rerun as rr

    looks: dict[str, Any] = {
        "quaternions": [np.roll(shape.quaternion, -1)],  # Rerun writes w last
        "colors": [(255 * shape.rgba).round().astype(np.uint8)],
        "fill_mode": "solid",
    }
    radius, half_length, _ = shape.half_size
    match shape.form:
        case "box":
            return rr.Boxes3D(half_sizes=[shape.half_size], centers=[shape.position], **looks)
        case "cylinder":
            return rr.Cylinders3D(radii=[radius], lengths=[2 * half_length], centers=[shape.position], **looks)
        case "capsule":
            # Rerun's runs from its origin along z, ours is centred.
            start = shape.position - half_length * shape.rotation[:, 2]
            return rr.Capsules3D(radii=[radius], lengths=[2 * half_length], translations=[start], **looks)
        case "sphere":
            return rr.Ellipsoids3D(radii=[radius], centers=[shape.position], **looks)
    raise ValueError(f"shape {shape.name!r} has form {shape.form!r}; box, capsule, cylinder and sphere can be drawn")


def _coil(ends: Array) -> Array:
    """A spring as a line wound around its axis, shape (F, points, 3), from its end points [m], shape (F, 2, 3)."""
    if not len(ends):
        return np.zeros((0, _SPRING_POINTS, 3))
    start, axis = ends[:, 0], ends[:, 1] - ends[:, 0]
    sideways = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis[0]))])
    sideways /= np.linalg.norm(sideways, axis=1, keepdims=True)
    third = np.cross(axis, sideways) / np.linalg.norm(axis, axis=1, keepdims=True)

    along = np.linspace(0.0, 1.0, _SPRING_POINTS)
    radius = 0.12 * np.linalg.norm(axis[0]) * np.clip(10 * np.minimum(along, 1 - along), 0, 1)
    angle = 2 * np.pi * _SPRING_TURNS * along
    across = np.cos(angle)[:, None] * sideways[:, None] + np.sin(angle)[:, None] * third[:, None]
    return start[:, None] + along[:, None] * axis[:, None] + radius[:, None] * across


def _document(text: str) -> "rr.TextDocument":
    import rerun as rr

    return rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)


def _listed(metadata: Mapping[str, str]) -> str:
    """Metadata as Markdown: a table of what fits on a line, then the rest as it is."""
    short = {key: value for key, value in metadata.items() if len(value) <= 80 and "\n" not in value}
    rows = [f"| {key} | {value.replace('|', chr(92) + '|')} |" for key, value in short.items()]
    table = ["| key | value |", "|---|---|", *rows] if rows else []
    blocks = [f"\n**{key}**\n```\n{value}\n```" for key, value in metadata.items() if key not in short]
    return "\n".join(table + blocks)


# --- layout ----------------------------------------------------------------------------------------------------------


def _layout(runs: Sequence[RunLog]) -> "rrb.Blueprint":
    """One run: its page. Several: all of them over each other first, then a page each."""
    import rerun.blueprint as rrb

    pages = [_page(run) for run in runs]
    root = pages[0] if len(pages) == 1 else rrb.Tabs(_comparison(runs), *pages, active_tab=0)
    return rrb.Blueprint(
        root,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        # A bump is over in half a second: slowly, and again.
        rrb.TimePanel(state="collapsed", timeline=_TIMELINE, play_state="playing", loop_mode="All", playback_speed=0.5),
        auto_views=False,
    )


def _page(run: RunLog) -> "rrb.Container":
    """The car and the verdict on the left, every signal's responses on the right."""
    import rerun.blueprint as rrb

    texts: list[rrb.View] = [rrb.TextDocumentView(origin=_path(run.name, "summary"), name="summary")]
    if run.events:
        texts.append(rrb.TextLogView(origin=_path(run.name, "events"), name="events"))
    texts.append(rrb.TextDocumentView(origin="/metadata", name="metadata"))
    car = _scene_view(_path(run.name, "world"), ["$origin/**"], f"{run.name}: MuJoCo", run.scene.extent(), _SIGHT, 1.5)
    plots = {
        signal.name: _plot(signal, [_path(run.name, "signals", signal.name, name) for name in run.responses], {})
        for signal in _signals([run])
    }
    return rrb.Horizontal(
        rrb.Vertical(car, rrb.Tabs(*texts, active_tab=0)),
        _grids(plots, columns=2),
        column_shares=[2, 3],
        name=run.name,
    )


def _comparison(runs: Sequence[RunLog]) -> "rrb.Container":
    """All cars side by side, and every signal of all of them in one plot."""
    import rerun.blueprint as rrb

    extents = [np.array(run.scene.extent()) + offset for run, offset in zip(runs, _offsets(runs), strict=True)]
    low, high = np.min(extents, axis=(0, 1)), np.max(extents, axis=(0, 1))
    contents = [f"+ {_path(run.name, part)}/**" for run in runs for part in ("world", "name")]
    cars = _scene_view("/", contents, "MuJoCo", (low, high + [0.0, 0.0, 0.3]), _SIGHT_OF_ROW, 5.0)

    shown = {run.name: "mujoco" if "mujoco" in run.responses else next(iter(run.responses)) for run in runs}
    plots = {}
    for signal in _signals(runs):
        paths = {_path(run.name, "signals", signal.name, shown[run.name]): run.name for run in runs}
        colours = dict(zip(paths, _colours(runs), strict=True))
        # In the order in which the viewer draws, thinner and thinner, so that one curve behind another is still seen.
        lines = {path: _line(paths[path], colours[path], min(1.5 + rank, 5.0)) for rank, path in enumerate(sorted(paths)[::-1])}
        plots[signal.name] = _plot(signal, list(paths), lines)
    return rrb.Vertical(cars, _grids(plots, columns=4), row_shares=[2, 3], name="all")


def _grids(plots: "Mapping[str, rrb.View]", columns: int) -> "rrb.Container":
    """One grid of plots by signal, or, where they are more than a screen holds, a tab for each kind of signal."""
    import rerun.blueprint as rrb

    if len(plots) <= 8:
        return rrb.Grid(*plots.values(), grid_columns=columns)
    kinds: dict[str, list[rrb.View]] = {}
    for name, plot in plots.items():
        kinds.setdefault(name.split("_")[0], []).append(plot)
    # What comes once or twice, as heave and pitch do, shares a tab, which is seen first.
    tabs = {"car": [plot for kind in kinds.values() if len(kind) <= 2 for plot in kind]}
    tabs |= {name: kind for name, kind in kinds.items() if len(kind) > 2}
    grids = [
        rrb.Grid(*kind, grid_columns=max(columns, 3 if len(kind) > 8 else 2), name=name) for name, kind in tabs.items() if kind
    ]
    return rrb.Tabs(*grids, active_tab=0)


def _plot(signal: Signal, paths: Sequence[str], lines: Mapping[Any, "rr.SeriesLines"]) -> "rrb.View":
    """One signal; `lines` restyles the series by path. All plots zoom and pan together in time."""
    import rerun.blueprint as rrb

    return rrb.TimeSeriesView(
        origin="/",
        contents=[f"+ {path}" for path in paths],
        name=f"{signal.name.replace('_', ' ')}   {signal.symbol} [{signal.unit}]",
        axis_x=rrb.TimeAxis(link="LinkToGlobal"),
        plot_legend=rrb.PlotLegend(corner="RightTop"),
        overrides=lines,
    )


def _line(label: str, colour: Colour, width: float) -> "rr.SeriesLines":
    """A curve that keeps its peaks: Rerun's default averages over the samples of a pixel."""
    import rerun as rr

    return rr.SeriesLines(names=label, colors=colour, widths=width, aggregation_policy="MinMax")


def _colours(runs: Sequence[RunLog]) -> list[Colour]:
    """A colour for each run."""
    return [_RUNS.get(run.name, _OTHER_RUNS[index % len(_OTHER_RUNS)]) for index, run in enumerate(runs)]


def _signals(runs: Sequence[RunLog]) -> tuple[Signal, ...]:
    """Every signal that some response has, once, by name, in order of appearance."""
    found = {signal.name: signal for run in runs for response in run.responses.values() for signal in response.signals}
    return tuple(found.values())


def _scene_view(
    origin: str, contents: Sequence[str], name: str, box: tuple[Array, Array], sight: Array, aspect: float
) -> "rrb.View":
    """A 3D view whose camera looks along `sight` and sees the whole of a box [m]; `aspect` is its width by height."""
    import rerun.blueprint as rrb

    sight = sight / np.linalg.norm(sight)
    right = np.cross(sight, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    upward = np.cross(right, sight)

    low, high = box
    centre = (low + high) / 2
    corners = np.stack(np.meshgrid(*np.stack([low, high], axis=1)), axis=-1).reshape(8, 3) - centre
    wide, tall, deep = np.abs(corners @ right), np.abs(corners @ upward), corners @ sight
    distance = 1.05 * np.max(np.maximum(wide / aspect, tall) / _HALF_VIEW - deep)
    return rrb.Spatial3DView(
        origin=origin,
        contents=contents,
        name=name,
        background=rrb.Background(color=_BACKGROUND),
        eye_controls=rrb.EyeControls3D(position=centre - distance * sight, look_target=centre, eye_up=[0.0, 0.0, 1.0]),
    )


def _offsets(runs: Sequence[RunLog]) -> Iterator[Array]:
    """Where each run's car stands [m] when all are shown: in a row, in the order of the runs."""
    widths = [high[0] - low[0] for low, high in (run.scene.extent() for run in runs)]
    step = 1.15 * max(widths)
    return (np.array([index * step, 0.0, 0.0]) for index in range(len(runs)))
