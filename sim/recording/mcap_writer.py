"""Runs as an MCAP file: protobuf messages that Rerun and Foxglove plot without any schema installed.

Format: https://mcap.dev/spec and https://protobuf.dev/programming-guides/encoding. The descriptors are built here, at
run time, from the responses' signals: a signal's name is its field's name, and there is no generated code.
"""

import json
import operator
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import Writer

from models.common.arrays import Array
from models.figures.figure import rgb, styles
from models.signals import Signal
from sim.recording.appearance import largest_force
from sim.recording.format import MUJOCO, SAMPLED
from sim.recording.run_log import RunLog
from sim.response.difference import difference
from sim.response.response import Response

PACKAGE = "roadproof"
SAME = 1e-9  # relative, and absolute in N and N m: what acted is computed again, not read back


@dataclass(frozen=True, eq=False)
class Channel:
    """A channel as a log has it.

    Attributes:
        topic: its name.
        schema: of its messages: name, encoding and data.
        metadata: what is said of its fields.
        times: of its messages [ns], ascending.
        contents: makes its messages, one for each time.
        alike: whether two messages say the same, to what another machine may make of it.
    """

    topic: str
    schema: tuple[str, str, bytes]
    metadata: Mapping[str, str]
    times: Sequence[int]
    contents: Callable[[], Iterator[bytes]]
    alike: Callable[[bytes, bytes], bool]


def records(runs: Sequence[RunLog], metadata: Mapping[str, str]) -> dict[str, Mapping[str, str]]:
    """The metadata records of a log, by name: what all runs share, and what is claimed of each."""
    return {PACKAGE: metadata, **{f"run/{run.name}": run.metadata for run in runs}}


def write_mcap(
    path: Path,
    runs: Sequence[RunLog],
    metadata: Mapping[str, str],
    attachments: Mapping[str, tuple[str, bytes]],
) -> None:
    """Writes runs to an MCAP file.

    The records are those of `records`, and the channels those of `channels`.

    Args:
        path: the file; overwritten if it exists.
        runs: what to write, by distinct names; times [s] are not negative.
        metadata: what all runs share.
        attachments: (media type, content) by name.

    Raises:
        OSError: the file cannot be written.
    """
    with path.open("wb") as stream:
        writer = Writer(stream, enable_data_crcs=True)  # metadata has no checksum of its own
        writer.start()

        for name, record in records(runs, metadata).items():
            writer.add_metadata(name, dict(record))
        for name, (media_type, content) in attachments.items():
            writer.add_attachment(create_time=0, log_time=0, name=name, media_type=media_type, data=content)

        messages: list[tuple[int, int, bytes]] = []  # time [ns], channel, content
        schemas: dict[tuple[str, str, bytes], int] = {}
        for channel in channels(runs):
            if channel.schema not in schemas:
                schemas[channel.schema] = writer.register_schema(*channel.schema)
            number = writer.register_channel(
                channel.topic, MessageEncoding.Protobuf, schemas[channel.schema], dict(channel.metadata)
            )
            messages += ((time, number, content) for time, content in zip(channel.times, channel.contents(), strict=True))

        # Players stream a file from front to back: all topics together, in the order of time.
        messages.sort(key=lambda message: message[0])
        for time, number, content in messages:
            writer.add_message(number, log_time=time, data=content, publish_time=time)
        writer.finish()


def channels(runs: Sequence[RunLog]) -> Iterator[Channel]:
    """Every channel of a log, in its order. What is written, and what a log is held to, is this.

    One topic per response, `/mujoco` for a single run and `/I/mujoco` among several: a message per sample, a double per
    signal, log_time = publish_time = t in ns. The channel's metadata holds unit, symbol and meaning of every signal, as
    JSON by the signal's name; the schema has them as comments. `/difference` is MuJoCo minus sampled, of each signal's peak, in
    single precision; what acted beside is on `/loads` and `/dampers`. Events are `foxglove.Log` on `/events`, and the moving car
    is on `/transforms`, `/shapes` and `/scene` in Foxglove's published schemas.
    A channel without messages is left out.
    """
    numbers: dict[tuple[Signal, ...], int] = {}
    for run in runs:
        responses = {name: (response, "<f8") for name, response in run.responses.items()}
        if {MUJOCO, SAMPLED} <= set(responses):
            responses["difference"] = (difference(run.responses[MUJOCO], run.responses[SAMPLED]), "<f4")
        for name, (response, kind) in responses.items():
            number = numbers.setdefault(response.signals, len(numbers) + 1)
            yield Channel(
                topic(runs, run, name),
                _signals_schema(response.signals, number, kind),
                {signal.name: _described(signal) for signal in response.signals},
                _nanoseconds(response.time),
                partial(_encoded, response, kind),
                operator.eq,
            )
    for run in runs:
        for name, response in run.acting.items():
            number = numbers.setdefault(response.signals, len(numbers) + 1)
            yield Channel(
                topic(runs, run, name),
                _signals_schema(response.signals, number, "<f8"),
                {signal.name: _described(signal) for signal in response.signals},
                _nanoseconds(response.time),
                partial(_encoded, response, "<f8"),
                _nearly_equal,
            )
    yield from (channel for channel in _published(runs) if channel.times)


def _nearly_equal(one: bytes, other: bytes) -> bool:
    """Whether two messages of doubles are the same, to what another machine makes of a cosine."""
    (tags, numbers), (others, found) = _fields(one), _fields(other)
    return tags == others and np.allclose(numbers, found, rtol=SAME, atol=SAME, equal_nan=True)


def _fields(message: bytes) -> tuple[bytes, Array]:
    """The tags and the numbers of a message as `_encoded` makes it; what is no such has other tags, or fewer."""
    tags, numbers, at = b"", [], 0
    while at < len(message):
        value = at + (2 if message[at] >= 0x80 else 1)
        tags += message[at:value]
        numbers.append(message[value : value + 8])
        at = value + 8
    return tags, np.frombuffer(b"".join(numbers).ljust(8 * len(numbers), b"\0"), "<f8")


def topic(runs: Sequence[RunLog], run: RunLog, name: str) -> str:
    """The topic of something of a run: with the run's name where there are several."""
    return f"/{run.name}/{name}" if len(runs) > 1 else f"/{name}"


def _nanoseconds(time: Array) -> list[int]:
    """Times [s] as MCAP counts them."""
    return np.round(time * 1e9).astype(np.int64).tolist()


def _described(signal: Signal) -> str:
    """What a reader needs beside the numbers, as JSON."""
    return json.dumps({"unit": signal.unit, "symbol": signal.symbol, "meaning": signal.meaning})


def _signals_schema(signals: tuple[Signal, ...], number: int, kind: str) -> tuple[str, str, bytes]:
    """The schema of a flat message of doubles or floats, numbered because responses may differ in their signals."""
    message = DescriptorProto(name=f"Signals{number}")
    file = FileDescriptorProto(name=f"{PACKAGE}/signals{number}.proto", package=PACKAGE, syntax="proto3")
    for index, signal in enumerate(signals):
        message.field.add(
            name=signal.name,
            number=index + 1,
            type=FieldDescriptorProto.TYPE_DOUBLE if kind == "<f8" else FieldDescriptorProto.TYPE_FLOAT,
            label=FieldDescriptorProto.LABEL_OPTIONAL,
        )
        # The path of message 0 (file field 4), field `index` (message field 2): a comment above it in the .proto.
        file.source_code_info.location.add(
            path=(4, 0, 2, index),
            span=(index, 0, 0),
            leading_comments=f" {signal.symbol} [{signal.unit}]: {signal.meaning}\n",
        )
    file.message_type.append(message)
    return f"{PACKAGE}.{message.name}", SchemaEncoding.Protobuf, FileDescriptorSet(file=[file]).SerializeToString()


@np.errstate(over="ignore")  # a difference that single precision cannot hold is infinite
def _encoded(response: Response, kind: str) -> Iterator[bytes]:
    """Every sample as a protobuf message of doubles, `<f8`, or floats, `<f4`.

    On the wire a double is its tag, (number << 3) | 1 as a varint, and 8 little-endian bytes; a float has 5 and 4. A flat message
    of them thus has the same layout at every sample, and all samples are one array of bytes. Protobuf's own writer
    leaves zeros out; writing them is as valid, reads the same, and keeps the layout. It also keeps -0.0 and NaN.
    """
    count, size = len(response.time), np.dtype(kind).itemsize
    columns = []
    for index in range(len(response.signals)):
        tag = np.frombuffer(_varint((index + 1) << 3 | (1 if size == 8 else 5)), np.uint8)
        value = np.ascontiguousarray(response.values[:, index], dtype=kind).view(np.uint8).reshape(count, size)
        columns += [np.broadcast_to(tag, (count, len(tag))), value]
    rows = np.concatenate(columns, axis=1)
    width, content = rows.shape[1], rows.tobytes()
    return (content[start : start + width] for start in range(0, len(content), width))


def _varint(value: int) -> bytes:
    """Seven bits a byte, lowest first; the high bit says that more follow."""
    low, rest = value & 0x7F, value >> 7
    return bytes([low | 0x80]) + _varint(rest) if rest else bytes([low])


def _published(runs: Sequence[RunLog]) -> Iterator[Channel]:
    """What has a published schema: events and the scene."""
    from sim.recording import foxglove_scene as scene

    largest = largest_force(run.scene for run in runs)
    colours = styles(tuple(run.name for run in runs))
    stand = np.zeros(3)
    for run in runs:
        run = replace(run, scene=run.scene.finite())
        times = _nanoseconds(run.scene.time)
        happened = _nanoseconds(np.array([time for time, _ in run.events]))
        colour = rgb(colours[run.name][0])
        for name, kind, when, messages in (
            ("events", scene.Log, happened, partial(scene.events, run, happened)),
            ("transforms", scene.FrameTransforms, times, partial(scene.transforms, run, times, stand)),
            (
                "shapes",
                scene.SceneUpdate,
                [times[0] if times else 0],
                partial(scene.shapes, run, times[0] if times else 0, colour),
            ),
            ("scene", scene.SceneUpdate, times, partial(scene.moving, run, times, largest)),
        ):
            made, alike = partial(_serialized, messages), partial(scene.alike, kind)
            yield Channel(topic(runs, run, name), _published_schema(kind), {}, when, made, alike)
        low, high = run.scene.extent()
        stand = stand + [1.15 * (high[0] - low[0]), 0.0, 0.0]  # in a row


def _serialized(messages: Callable[[], Iterator[Any]]) -> Iterator[bytes]:
    return (message.SerializeToString() for message in messages())


def _published_schema(kind: type) -> tuple[str, str, bytes]:
    """A message type's schema, with those that it is made of."""
    from mcap_protobuf.schema import build_file_descriptor_set

    data = build_file_descriptor_set(kind).SerializeToString()
    return kind.DESCRIPTOR.full_name, SchemaEncoding.Protobuf, data  # pyright: ignore[reportAttributeAccessIssue] - generated
