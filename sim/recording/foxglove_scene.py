"""Messages that contain a run's scene and events, with Foxglove's published schemas,
https://docs.foxglove.dev/docs/sdk/schemas.

After a jump in time, players show the last message of each topic. Every message of `/scene` and `/transforms` is therefore
complete. The shapes of the bodies do not change, so they are written once, to a separate topic `/shapes`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.ArrowPrimitive_pb2 import ArrowPrimitive
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CubePrimitive_pb2 import CubePrimitive
from foxglove_schemas_protobuf.CylinderPrimitive_pb2 import CylinderPrimitive
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.SpherePrimitive_pb2 import SpherePrimitive
from foxglove_schemas_protobuf.TextPrimitive_pb2 import TextPrimitive
from foxglove_schemas_protobuf.TriangleListPrimitive_pb2 import TriangleListPrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.duration_pb2 import Duration
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.well_known import SchemaEncoding
from mcap_protobuf.schema import build_file_descriptor_set

from models.common.arrays import Array
from models.document.figure import rgb, styles
from sim.recording.mcap_writer import Channel, Schema, nanoseconds, topic
from sim.recording.run_log import RunLog
from sim.recording.scene import FORCE, LIFTED_COLOUR, LINES, Shape, arrows, largest_force, strut_lines, tyre_surface

WORLD = "world"
POINT = np.dtype([("head", "u1", 2), *((f"{kind}{axis}", how) for axis in "xyz" for kind, how in (("tag_", "u1"), ("", "<f8")))])
SHORTEST = 1e-3  # m; a force is not drawn if its arrow would be shorter than this
# m, spacing of the grid to which moving points are rounded, about 0.25 mm; rounding reduces their compressed size to a third
GRID = 2.0**-12

Messages = Iterator[Any]


def channels(runs: Sequence[RunLog]) -> Iterator[Channel]:
    """Yields the channels with published schemas: the events and the scene."""
    largest = largest_force(run.scene for run in runs)
    stand, looks = np.zeros(3), styles(tuple(run.name for run in runs))
    for run in runs:
        run = replace(run, scene=run.scene.finite())
        times = nanoseconds(run.scene.time)
        happened = nanoseconds(np.array([time for time, _ in run.events]))
        colour = rgb(looks[run.name].color)
        first = times[:1] or [0]
        for name, kind, when, messages in (
            ("events", Log, happened, events(run, happened)),
            ("transforms", FrameTransforms, times, transforms(run, times, stand)),
            ("shapes", SceneUpdate, first, shapes(run, first[0], colour)),
            ("scene", SceneUpdate, times, moving_entities(run, times, largest)),
        ):
            contents = (message.SerializeToString() for message in messages)
            if when or name == "events":  # an event panel needs its topic even in a run without events
                yield topic(runs, run, name), _published_schema(kind), {}, when, contents
        low, high = run.scene.extent()
        stand = stand + [1.15 * (high[0] - low[0]), 0.0, 0.0]  # the cars of all runs are placed in a row


def _published_schema(kind: type) -> Schema:
    """Returns the schema of a message type, including the schemas of its fields."""
    data = build_file_descriptor_set(kind).SerializeToString()
    return kind.DESCRIPTOR.full_name, SchemaEncoding.Protobuf, data  # pyright: ignore[reportAttributeAccessIssue] - generated


def frame(run: RunLog, body: str = "") -> str:
    """Returns the name of the coordinate frame of a body in a run, or of the whole car."""
    return f"{run.name}/{body}" if body else run.name


def events(run: RunLog, times: list[int]) -> Messages:
    """Yields the events of a run as messages at the supplied times [ns]."""
    for time, (_, text) in zip(times, run.events, strict=True):
        yield Log(timestamp=_stamp(time), level=Log.INFO, message=text, name=run.name)


def transforms(run: RunLog, times: list[int], stand: Array) -> Messages:
    """Yields the poses of all bodies, and of the car as a whole, as messages.

    Args:
        run: run in whose frames all numbers are finite.
        times: times of the frames [ns].
        stand: position in the world at which the car is shown [m], shape (3,).
    """
    car = FrameTransform(
        parent_frame_id=WORLD,
        child_frame_id=frame(run),
        translation=_vector(stand),
        rotation=_quaternion(IDENTITY_QUATERNION),
    )
    for index, time in enumerate(times):
        stamp = _stamp(time)
        car.timestamp.CopyFrom(stamp)
        whole = FrameTransforms(transforms=[car])
        for body, motion in run.scene.bodies.items():
            whole.transforms.add(
                timestamp=stamp,
                parent_frame_id=frame(run),
                child_frame_id=frame(run, body),
                translation=_vector(motion.positions[index]),
                rotation=_quaternion(motion.quaternions[index]),
            )
        yield whole


def shapes(run: RunLog, time: int, color: tuple[int, int, int]) -> Messages:
    """Yields the message with the solids, fixed to their bodies, and with the name of the run above the car.

    Args:
        run: run in whose frames all numbers are finite.
        time: time of the message [ns].
        color: colour of the run's name (red, green, blue), from 0 to 255.
    """
    update = SceneUpdate()
    for body in run.scene.bodies:
        entity = _add_entity(update, time, frame(run, body), body)
        for shape in run.scene.shapes:
            if shape.body == body:
                _add_solid(entity, shape)
    low, high = run.scene.extent()
    pose = _pose(np.array([*(low + high)[:2] / 2, high[2] + 0.2]))
    label = TextPrimitive(pose=pose, billboard=True, font_size=0.15, color=_color(color), text=run.name)
    _add_entity(update, time, frame(run), "name").texts.append(label)
    yield update


def moving_entities(run: RunLog, times: list[int], largest: float) -> Messages:
    """Yields the messages that draw struts, tyres, and arrows for control forces. A force whose magnitude is `largest` [N] has
    the longest arrow.
    """
    scene = run.scene
    struts = [
        _pack_points(line, LinePrimitive.POINTS_FIELD_NUMBER) for ends in scene.springs.values() for line in strut_lines(ends)
    ]
    looks = [
        LinePrimitive(type=LinePrimitive.LINE_STRIP, pose=_pose(), thickness=2 * radius, color=_color(colour))
        for _ in scene.springs
        for radius, colour in LINES
    ]
    tyres = []
    for tyre in scene.tyres:
        vertices, triangles = tyre_surface(tyre)
        indices, colours = triangles.ravel().tolist(), (255 * tyre.rgba[:3], LIFTED_COLOUR)
        surfaces = [TriangleListPrimitive(pose=_pose(), indices=indices, color=_color(colour)) for colour in colours]
        tyres.append((tyre, surfaces, _pack_points(vertices, TriangleListPrimitive.POINTS_FIELD_NUMBER)))
    pushed = arrows(scene, largest).values()
    for index, time in enumerate(times):
        # each primitive is created inside its message; a finished primitive would be copied into the message point by point
        update = SceneUpdate()
        entity = _add_entity(update, time, frame(run), "struts")
        for look, points in zip(looks, struts, strict=True):
            _fill(entity.lines.add(), look, points[index])
        entity = _add_entity(update, time, frame(run), "forces")
        forces = ((tails[index], vectors[index]) for tails, vectors in pushed)
        entity.arrows.extend(_arrow(*force) for force in forces if np.linalg.norm(force[1]) >= SHORTEST)
        for tyre, surfaces, points in tyres:
            entity = _add_entity(update, time, frame(run, tyre.body), tyre.name)
            _fill(entity.triangles.add(), surfaces[int(tyre.lifted[index])], points[index])
        yield update


def _add_entity(update: Any, time: int, frame_id: str, name: str) -> Any:
    """Adds an entity that moves with its coordinate frame, and returns the entity.

    The entity remains until another entity with the same name replaces it.
    """
    return update.entities.add(timestamp=_stamp(time), frame_id=frame_id, id=name, lifetime=Duration(), frame_locked=True)


def _arrow(tail: Array, vector: Array) -> ArrowPrimitive:
    """Returns the arrow that shows a control force."""
    length = float(np.linalg.norm(vector))
    direction = vector / length
    # Quaternion of the rotation that turns +x into the direction; it is not normalised.
    turn = np.array([1.0 + direction[0], 0.0, -direction[2], direction[1]])
    return ArrowPrimitive(
        pose=_pose(tail, turn / np.linalg.norm(turn)),
        shaft_length=0.7 * length,
        shaft_diameter=0.03,
        head_length=0.3 * length,
        head_diameter=0.07,
        color=_color(FORCE),
    )


def _add_solid(entity: Any, shape: Shape) -> None:
    pose, color = _pose(shape.position, shape.quaternion), _color(255 * shape.rgba[:3], float(shape.rgba[3]))
    if shape.form == "box":
        entity.cubes.append(CubePrimitive(pose=pose, size=_vector(2 * shape.half_size), color=color))
        return
    radius, half_length, _ = shape.half_size
    ball = _vector(np.full(3, 2 * radius))
    if shape.form == "sphere":
        entity.spheres.append(SpherePrimitive(pose=pose, size=ball, color=color))
        return
    size = _vector(2 * np.array([radius, radius, half_length]))
    entity.cylinders.append(CylinderPrimitive(pose=pose, size=size, bottom_scale=1.0, top_scale=1.0, color=color))
    if shape.form == "capsule":
        for end in (-1, 1):
            tip = shape.position + end * half_length * shape.rotation[:, 2]
            entity.spheres.append(SpherePrimitive(pose=_pose(tip), size=ball, color=color))


def _pack_points(points: Array, field: int) -> Array:
    """Returns points, rounded to `GRID`, as entries of a repeated protobuf field: tag, length, three doubles.

    The shape of the array of points changes from (..., P, 3) to (..., P).

    When the message is serialised later, protobuf omits zeros. The number of the protobuf field must be below 16.
    """
    packed = np.empty(points.shape[:-1], POINT)
    packed["head"] = field << 3 | 2, POINT.itemsize - 2
    for i, name in enumerate("xyz"):
        packed[f"tag_{name}"] = (i + 1) << 3 | 1
        packed[name] = np.round(points[..., i] / GRID) * GRID
    return packed


def _fill(primitive: Any, look: Any, packed: Array) -> None:
    """Fills a new primitive with a copy of another primitive, and with points that are already encoded."""
    primitive.CopyFrom(look)
    primitive.MergeFromString(packed.tobytes())


def _stamp(time: int) -> Timestamp:
    seconds, nanos = divmod(time, 10**9)
    return Timestamp(seconds=seconds, nanos=nanos)


def _vector(vector: Array) -> Vector3:
    x, y, z = vector.tolist()
    return Vector3(x=x, y=y, z=z)


def _quaternion(quaternion: Array) -> Quaternion:
    w, x, y, z = quaternion.tolist()
    return Quaternion(x=x, y=y, z=z, w=w)


IDENTITY_QUATERNION = np.array([1.0, 0.0, 0.0, 0.0])
ORIGIN = np.zeros(3)


def _pose(position: Array = ORIGIN, quaternion: Array = IDENTITY_QUATERNION) -> Pose:
    return Pose(position=_vector(position), orientation=_quaternion(quaternion))


def _color(rgb: Array | tuple[int, int, int], alpha: float = 1.0) -> Color:
    """Returns a colour message from numbers between 0 and 255."""
    r, g, b = (float(part) / 255 for part in rgb)
    return Color(r=r, g=g, b=b, a=alpha)
