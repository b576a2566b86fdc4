"""Entities of a run in a Rerun file: scene, curves with marked events, differences, and texts."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import rerun as rr

from models.common.arrays import Array
from models.document.document import Document, Table, notes, statements
from models.document.figure import rgb
from models.document.text import markdown
from sim.drive.regime import REGIME_ENDS
from sim.drive.response import Response
from sim.observers.results import WHEN
from sim.recording.pages import NEUTRAL, Curve, differences, groups, response_curves, signals_of
from sim.recording.run_log import DAMPERS, LOADS, MUJOCO, RunLog
from sim.recording.scene import (
    FORCE,
    LIFTED_COLOUR,
    LINES,
    PROFILE,
    ROAD,
    Scene,
    Shape,
    Track,
    Tyre,
    arrows,
    road_surface,
    strut_lines,
    tyre_surface,
)
from synth.controller.report import NORM

if TYPE_CHECKING:
    from sim.runs.force_diagram import Diagram


TIMELINE = "time"

ROOM = 1.15  # half the width of a diagram, relative to the largest value in the diagram
GROUND = 13  # red, green and blue value of Rerun's background colour, from 0 to 255
READ = 4000  # largest number of characters that a page shows of one metadata value; enough for a gain with 45 states

# Shape and colour of the marker of each event, by the event's text; no curve has one of these colours. A cross marks any other
# event.
MARKERS = {end.event: end.marker for end in REGIME_ENDS} | {"landing": ("Down", (255, 255, 255))}
ANY_MARKER = ("Cross", (225, 225, 225))


def entity(*parts: str) -> str:
    """Returns an entity path with special characters escaped."""
    return "/" + rr.new_entity_path(list(parts))


def time_index(time: Array) -> list[rr.TimeColumn]:
    """Returns times [s], rounded to nanoseconds as in the MCAP file. Rerun would truncate times that are given as floats in
    seconds.
    """
    return [rr.TimeColumn(TIMELINE, duration=np.round(time * 1e9).astype("timedelta64[ns]"))]


# fraction of the run's duration by which the time axis extends beyond its end; otherwise, a plot would cut off the last label
AFTER_END = 0.04


def opaque(color: str) -> list[int]:
    """Returns a colour with opacity, `#rrggbbaa`, blended with Rerun's background, because Rerun's lines overlap themselves."""
    opacity = int(color[7:] or "ff", 16) / 255
    return [round(opacity * part + (1 - opacity) * GROUND) for part in rgb(color)]


def lines(curves: Sequence[Curve]) -> rr.SeriesLines:
    """Returns the line styles of curves. Peaks remain visible, although Rerun averages the samples within a pixel by default."""
    return rr.SeriesLines(
        names=[curve.label for curve in curves],
        colors=[opaque(curve.color) for curve in curves],
        widths=[curve.width for curve in curves],
        aggregation_policy="MinMax",
    )


def curve_path(curve: Curve) -> str:
    """Returns the entity path of a curve over time."""
    parts = ("acting", LOADS, curve.signal) if curve.topic == LOADS else ("signals", curve.signal, curve.topic)
    return entity(curve.run.name, *parts)


def _log_curves(recording: rr.RecordingStream, path: str, curves: Sequence[Curve], ended: bool = True) -> None:
    """Logs the curves of one response at an entity path.

    A NaN shortly after the end of the curves makes their plot extend to the time of this NaN.
    """
    time, values = curves[0].response.time, np.stack([curve.values for curve in curves], axis=-1)
    after = time[-1:] + AFTER_END * time[-1:] if ended else time[:0]
    values = np.concatenate([values, np.full((len(after), len(curves)), np.nan)])
    columns = rr.Scalars.columns(scalars=values.ravel()).partition([len(curves)] * len(values))
    recording.log(path, lines(curves), static=True)
    recording.send_columns(path, time_index(np.concatenate([time, after])), columns)


def log_signals(recording: rr.RecordingStream, run: RunLog, color: str) -> None:
    """Logs all plotted data: responses, differences, loads, and drawings of the diagrams.

    A response is at `signals/<signal>/<response>`, in a shade of the run's colour. The MuJoCo response minus the sampled
    response, relative to the peak of each signal, is at `difference/<group>`. Loads as functions of time are at
    `acting/loads/<load>`, and force diagrams are at `acting/diagrams/<force>`.
    """
    for signal in signals_of([run]):
        for curve in response_curves(run, signal, color):
            _log_curves(recording, curve_path(curve), [curve], curve.topic == MUJOCO)
    for name, group in groups([run]).items():
        if curves := differences(run, group):
            _log_curves(recording, entity(run.name, "difference", name), curves)
    for signal in run.other_signals[LOADS].signals if LOADS in run.other_signals else ():
        curve = Curve(run, LOADS, signal.name, f"{signal.name.replace('_', ' ')} [{signal.unit}]", color)
        _log_curves(recording, curve_path(curve), [curve])
    if DAMPERS in run.other_signals:
        pulled = run.other_signals[DAMPERS]
        for one in run.diagrams:
            path = entity(run.name, "acting", "diagrams", one.pull.name)
            _log_diagram(recording, path, one, pulled.until(pulled.diverged), color)


def _log_diagram(recording: rr.RecordingStream, path: str, one: "Diagram", pulled: Response, color: str) -> None:
    """Logs the plot of a force against its argument (velocity or deflection) as a 2D drawing, because Rerun plots only over
    time.

    The drawing is 2 units wide and 2 units high; its y axis points downwards.
    """
    x, force = pulled[one.argument.name], pulled[one.pull.name]
    far, high = (ROOM * max(float(np.abs(values).max(initial=0.0)), least) for values, least in ((x, 1e-3), (force, 1.0)))

    def place(at: Array, height: Array) -> Array:
        return np.stack([at / far, -height / high], axis=-1)

    grid, ends = np.linspace(-far, far, 401), np.array([-1.0, 1.0])
    axes = [place(far * ends, 0 * ends), place(0 * ends, high * ends)]
    recording.log(f"{path}/axes", rr.LineStrips2D(axes, colors=[(110, 110, 110)], radii=rr.Radius.ui_points(0.7)), static=True)
    texts, points = list[str](), list[tuple[float, float]]()
    for k, (end, unit) in enumerate(((far, one.argument.unit), (high, one.pull.unit))):
        step = 10 ** np.floor(np.log10(end / ROOM))
        step *= np.floor(end / ROOM / step) / 2
        for tick in (step * np.arange(-2, 3)).tolist():
            texts.append(f"{tick:g} {unit}")
            points.append((tick, 0.0) if k == 0 else (0.0, tick))
    for each in one.lines:
        height = each.force(grid)
        seen = np.abs(height) <= high
        drawn = rr.LineStrips2D(
            [place(grid[seen], height[seen])], colors=[rgb(NEUTRAL)], radii=rr.Radius.ui_points(each.width / 2)
        )
        recording.log(f"{path}/{each.signal.name}", drawn, static=True)
        points.append((grid[seen][-1], height[seen][-1]))
        texts.append(each.label)
    named = rr.Points2D(
        place(*np.array(points).T), labels=texts, colors=[(245, 245, 245)], radii=rr.Radius.ui_points(2.5), show_labels=True
    )
    recording.log(f"{path}/names", named, static=True)
    way = place(x, force)
    recording.log(f"{path}/way", rr.LineStrips2D([way], colors=[rgb(color)], radii=rr.Radius.ui_points(0.8)), static=True)
    now = rr.Points2D.from_fields(colors=[rgb(color)], radii=rr.Radius.ui_points(5.0))
    recording.log(f"{path}/now", now, static=True)
    recording.send_columns(f"{path}/now", time_index(pulled.time), rr.Points2D.columns(positions=way))


def log_events(recording: rr.RecordingStream, run: RunLog) -> None:
    """Logs the events as text at `events`, and as markers on every simulated curve at `signals/<signal>/<event>`."""
    if not run.events:
        return
    texts = [text for _, text in run.events]
    index = time_index(np.array([time for time, _ in run.events]))
    # The event's text includes its time, because a narrow view hides the column of times
    lines = [f"{WHEN.text(time)}   {text}" for time, text in run.events]
    recording.send_columns(entity(run.name, "events"), index, rr.TextLog.columns(text=lines, level=["INFO"] * len(lines)))
    response = run.responses[MUJOCO]
    for text in dict.fromkeys(texts):
        shape, colour = MARKERS.get(text, ANY_MARKER)
        looks = rr.SeriesPoints(names=text, colors=colour, markers=rr.components.MarkerShape[shape], marker_sizes=7.0)
        times = np.array([time for time, what in run.events if what == text])
        samples = np.clip(np.searchsorted(response.time, times), 0, len(response.time) - 1)
        for signal in response.signals:
            path = entity(run.name, "signals", signal.name, text)
            recording.log(path, looks, static=True)
            recording.send_columns(path, time_index(times), rr.Scalars.columns(scalars=response[signal.name][samples]))


def log_properties(recording: rr.RecordingStream, name: str, metadata: Mapping[str, str]) -> None:
    """Logs metadata as properties of the recording, which programs can read. Users see the same metadata in text documents."""
    if metadata:
        recording.send_property(name, rr.AnyValues(drop_untyped_nones=True, **metadata))


def log_text(recording: rr.RecordingStream, path: str, text: str) -> None:
    """Logs a text as Markdown."""
    recording.log(path, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)


def list_metadata(metadata: Mapping[str, str]) -> str:
    """Returns metadata as Markdown: a table of short values, then the long values, cut off after `READ` characters."""
    short = {key: value for key, value in metadata.items() if len(value) <= 80 and "\n" not in value}
    table = Table("metadata", "", ("key", "value"), tuple(short.items()))
    long = (f"**{key}**\n```\n{_cut(value)}\n```" for key, value in metadata.items() if key not in short)
    return markdown(Document("", (*[table] * bool(short), *notes(*long))))


def _cut(text: str) -> str:
    if len(text) <= READ:
        return text
    return f"{text[:READ]} ...\n({len(text)} characters; all of them are in the run's properties and in the MCAP file)"


def certificates(runs: Sequence[RunLog]) -> str:
    """Returns a Markdown table of the certificates of all runs, followed by the verdicts, each with the names of the runs that
    have this verdict.
    """
    keys, results = ("bound", "norm", "stable"), list[tuple[str, str]]()
    for run in runs:
        first = f"; first: {run.events[0][1]}, {WHEN.text(run.events[0][0])}" if run.events else ""
        results.append((run.name, f"{run.verdict or '-'}{first}"))
    rows = tuple((run.name, *(_number(run.metadata.get(key, "-")) for key in keys)) for run in runs)
    table = Table("certificates", "", ("controller", *keys), rows)
    return markdown(Document("", (table, *notes("MuJoCo:"), *statements(results))))


def _number(text: str) -> str:
    """Returns a value of the metadata, formatted for a reader."""
    words = {"true": "yes", "false": "NO", "null": "-"}
    try:
        return NORM.digits(float(text))
    except ValueError:
        return words.get(text, text)


def log_scene(recording: rr.RecordingStream, run: RunLog, largest: float) -> None:
    """Logs the moving car and the road on which it drives.

    The car's entity paths are `world/<body>/<shape>`, `world/springs/<spring>` and `world/forces/<spring>`.

    The road is a profile at `world/profile/<track>`. Viewers other than Rerun show pieces of road under the wheels instead of
    the profile.

    Args:
        run: run to log. Frames of the run with values that are not finite are omitted.
        largest: force whose arrow has the full length [N].
    """
    scene = run.scene.finite()
    recording.log(entity(run.name, "world"), rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    profiled = {body for track in scene.tracks for body in track.bodies}
    for shape in scene.shapes:
        if shape.body not in profiled:
            recording.log(entity(run.name, "world", shape.body, shape.name), _solid(shape), static=True)
    for body, motion in scene.bodies.items():
        columns = rr.Transform3D.columns(
            translation=motion.positions,
            quaternion=np.roll(motion.quaternions, -1, axis=1),  # Rerun expects w as the last entry of a quaternion
        )
        recording.send_columns(entity(run.name, "world", body), time_index(scene.time), columns)
    for track in scene.tracks:
        _log_track(recording, entity(run.name, "world", "profile", track.bodies[0]), scene.time, track)
    for tyre in scene.tyres:
        _log_tyre(recording, entity(run.name, "world", tyre.body, tyre.name), scene, tyre)
    for name, ends in scene.springs.items():
        _log_strut(recording, entity(run.name, "world", "springs", name), scene.time, ends)
    for name, (tails, vectors) in arrows(scene, largest).items():
        path = entity(run.name, "world", "forces", name)
        recording.log(path, rr.Arrows3D.from_fields(colors=[FORCE], radii=[0.018]), static=True)
        recording.send_columns(path, time_index(scene.time), rr.Arrows3D.columns(origins=tails, vectors=vectors))


def _log_track(recording: rr.RecordingStream, path: str, time: Array, track: Track) -> None:
    """Logs the surface of the road once; the surface moves as a whole."""
    vertices, colours, triangles = road_surface(track)
    surface = rr.Mesh3D(
        vertex_positions=vertices.astype(np.float32), vertex_colors=colours.astype(np.uint8), triangle_indices=triangles
    )
    recording.log(f"{path}/surface", surface, static=True)
    edge = np.column_stack([track.position, np.full(len(track.position), track.middle + ROAD), track.height])
    recording.log(f"{path}/edge", rr.LineStrips3D([edge.astype(np.float32)], colors=[PROFILE], radii=[0.008]), static=True)
    back = np.column_stack([-track.travelled_distance, np.zeros((len(time), 2))])
    recording.send_columns(path, time_index(time), rr.Transform3D.columns(translation=back))


def _log_tyre(recording: rr.RecordingStream, path: str, scene: Scene, tyre: Tyre) -> None:
    vertices, triangles = tyre_surface(tyre)
    colour = np.where(tyre.lifted[:, None], np.array(LIFTED_COLOUR), 255 * tyre.rgba[:3]).round().astype(np.uint8)
    recording.log(path, rr.Mesh3D.from_fields(triangle_indices=triangles), static=True)
    count = vertices.shape[1]
    columns = rr.Mesh3D.columns(vertex_positions=vertices.reshape(-1, 3).astype(np.float32)).partition([count] * len(vertices))
    recording.send_columns(path, time_index(scene.time), columns)
    recording.send_columns(path, time_index(scene.time), rr.Mesh3D.columns(albedo_factor=colour))


def _log_strut(recording: rr.RecordingStream, path: str, time: Array, ends: Array) -> None:
    looks = rr.LineStrips3D.from_fields(colors=[colour for _, colour in LINES], radii=[radius for radius, _ in LINES])
    recording.log(path, looks, static=True)
    lines = strut_lines(ends)
    # All strips are in a single array, because Rerun would convert separate strips one by one.
    points = rr.encodings.Vec3DBatch(np.concatenate(lines, axis=1).reshape(-1, 3).astype(np.float32)).as_arrow_array()
    ends_at = np.cumsum([0, *[line.shape[1] for line in lines] * len(time)])
    strips = pa.ListArray.from_arrays(ends_at, points, type=rr.components.LineStrip3DBatch([]).as_arrow_array().type)
    columns = rr.LineStrips3D.columns(strips=strips).partition([len(lines)] * len(time))
    recording.send_columns(path, time_index(time), columns)


def _solid(shape: Shape) -> rr.AsComponents:
    """Returns a solid as a Rerun primitive."""
    looks: dict[str, Any] = {
        "quaternions": [np.roll(shape.quaternion, -1)],  # Rerun expects w as the last entry of a quaternion
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
            # A capsule of Rerun extends from its origin along z, but a `Shape` is centred at its origin.
            start = shape.position - half_length * shape.rotation[:, 2]
            return rr.Capsules3D(radii=[radius], lengths=[2 * half_length], translations=[start], **looks)
        case "sphere":
            return rr.Ellipsoids3D(radii=[radius], centers=[shape.position], **looks)
    raise ValueError(f"shape {shape.name!r} has form {shape.form!r}; box, capsule, cylinder and sphere can be drawn")
