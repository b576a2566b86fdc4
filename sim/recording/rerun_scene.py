"""A run's scene in Rerun: solids on moving bodies, struts, tyres that give way, and the control forces."""

from typing import Any

import numpy as np
import rerun as rr

from models.common.arrays import Array
from sim.recording.appearance import BESIDE, FORCE, LIFTED, LINES, LONGEST, PROFILE, ROAD, road_surface, strut_lines, tyre_surface
from sim.recording.rerun_signals import entity, time_index
from sim.recording.run_log import RunLog
from sim.recording.scene import Scene, Shape, Track, Tyre


def log_scene(recording: rr.RecordingStream, run: RunLog, largest: float) -> None:
    """The moving car, at `world/<body>/<shape>`, `world/springs/<spring>` and `world/forces/<spring>`, and its road.

    The road is at `world/profile/<track>`, in place of the pieces under the wheels that stand for it in other viewers.

    Args:
        recording: where to.
        run: what to log; frames that are not finite are left out.
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
            quaternion=np.roll(motion.quaternions, -1, axis=1),  # w last
        )
        recording.send_columns(entity(run.name, "world", body), time_index(scene.time), columns)
    for track in scene.tracks:
        _log_track(recording, entity(run.name, "world", "profile", track.name), scene.time, track)
    for tyre in scene.tyres:
        _log_tyre(recording, entity(run.name, "world", tyre.body, tyre.name), scene, tyre)
    for name, ends in scene.springs.items():
        _log_strut(recording, entity(run.name, "world", "springs", name), scene.time, ends)
    for name, force in scene.forces.items():
        _log_force(recording, entity(run.name, "world", "forces", name), scene.time, scene.springs[name], force, largest)


def _log_track(recording: rr.RecordingStream, path: str, time: Array, track: Track) -> None:
    """The road is written once, and moves as a whole: that of a long run takes no more than its points."""
    vertices, colours, triangles = road_surface(track)
    surface = rr.Mesh3D(
        vertex_positions=vertices.astype(np.float32), vertex_colors=colours.astype(np.uint8), triangle_indices=triangles
    )
    recording.log(f"{path}/surface", surface, static=True)
    edge = np.column_stack([track.position, np.full(len(track.position), track.middle + ROAD), track.height])
    recording.log(f"{path}/edge", rr.LineStrips3D([edge.astype(np.float32)], colors=[PROFILE], radii=[0.008]), static=True)
    back = np.column_stack([-track.travelled, np.zeros((len(time), 2))])
    recording.send_columns(path, time_index(time), rr.Transform3D.columns(translation=back))


def _log_tyre(recording: rr.RecordingStream, path: str, scene: Scene, tyre: Tyre) -> None:
    vertices, triangles = tyre_surface(tyre)
    colour = np.where(tyre.lifted[:, None], np.array(LIFTED), 255 * tyre.rgba[:3]).round().astype(np.uint8)
    recording.log(path, rr.Mesh3D.from_fields(triangle_indices=triangles), static=True)
    count = vertices.shape[1]
    columns = rr.Mesh3D.columns(vertex_positions=vertices.reshape(-1, 3).astype(np.float32)).partition([count] * len(vertices))
    recording.send_columns(path, time_index(scene.time), columns)
    recording.send_columns(path, time_index(scene.time), rr.Mesh3D.columns(albedo_factor=colour))


def _log_strut(recording: rr.RecordingStream, path: str, time: Array, ends: Array) -> None:
    looks = rr.LineStrips3D.from_fields(colors=[colour for _, colour in LINES], radii=[radius for radius, _ in LINES])
    recording.log(path, looks, static=True)
    lines = strut_lines(ends)
    strips = [line[frame].astype(np.float32) for frame in range(len(time)) for line in lines]
    columns = rr.LineStrips3D.columns(strips=strips).partition([len(lines)] * len(time))
    recording.send_columns(path, time_index(time), columns)


def _log_force(recording: rr.RecordingStream, path: str, time: Array, ends: Array, force: Array, largest: float) -> None:
    """What pushes on the body, as an arrow beside the strut."""
    axis = ends[:, 1] - ends[:, 0]
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    recording.log(path, rr.Arrows3D.from_fields(colors=[FORCE], radii=[0.018]), static=True)
    columns = rr.Arrows3D.columns(
        origins=ends.mean(axis=1) + BESIDE,
        vectors=axis * (LONGEST / (largest or 1.0) * force)[:, None],
    )
    recording.send_columns(path, time_index(time), columns)


def _solid(shape: Shape) -> rr.AsComponents:
    """A shape as Rerun draws it.

    Raises:
        ValueError: the form is not one of those that `Shape` allows.
    """
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
