"""Runs as an MCAP file, https://mcap.dev/spec: protobuf messages that Rerun and Foxglove plot without any schema installed.

Messages are as in https://protobuf.dev/programming-guides/encoding. The descriptors are built here, at
run time, from the responses' signals: a signal's name is its field's name, and there is no generated code.
"""

import itertools
import json
import operator
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import zstandard
from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from mcap import __version__
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.well_known import MessageEncoding, SchemaEncoding

from models.common.arrays import Array
from models.figures.figure import rgb, styles
from models.kinds.signals import Signal
from sim.recording.run_log import RunLog
from sim.recording.scene import largest_force
from sim.response.response import Response

MAGIC = b"\x89MCAP0\r\n"
CHUNK = 1024 * 1024  # bytes of a chunk before it is compressed; the message that passes it is its last
MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time; the content follows
INDEX = struct.Struct("<BQHI")  # opcode, length, channel, length of the entries; they follow, each a time and a place
BESIDE_CONTENT = MESSAGE.size - 9  # bytes of a message that its length counts

Message = tuple[int, int, bytes]  # log time [ns], channel, content


class McapFile:
    """An MCAP file that is written: metadata and attachments first, then schemas, channels and all messages, then its end."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._at, self._crc = 0, 0
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._before = b""  # the first message: schemas and channels
        self._counts: Counter[int] = Counter()
        self._times: list[int] = []  # of the first and of the last message
        self._chunks: list[ChunkIndex] = []
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._write(MAGIC)
        self._write(_written(Header("", f"mcap-python/{__version__}")))

    def add_metadata(self, name: str, data: Mapping[str, str]) -> None:
        """Adds a metadata record."""
        start, length = self._write(_written(Metadata(name, dict(data))))
        self._metadata.append(MetadataIndex(start, length, name))

    def add_attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Adds an attachment of no date."""
        start, length = self._write(_written(Attachment(0, 0, name, media_type, data)))
        self._attachments.append(AttachmentIndex(start, length, 0, 0, len(data), name, media_type))

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Adds a schema; returns its number."""
        self._schemas.append(Schema(len(self._schemas) + 1, data, encoding, name))
        self._before += _written(self._schemas[-1])
        return len(self._schemas)

    def add_channel(self, topic: str, encoding: str, schema: int, metadata: Mapping[str, str]) -> int:
        """Adds a channel of messages of a schema; returns its number."""
        self._channels.append(Channel(len(self._channels) + 1, topic, encoding, dict(metadata), schema))
        self._before += _written(self._channels[-1])
        return len(self._channels)

    def add_messages(self, messages: Iterable[Message]) -> None:
        """Adds all messages, in the order of time, in chunks."""
        parts, size, first, last = [self._before], len(self._before), 0, 0
        places: dict[int, list[int]] = {}  # by channel: time and place of each of its messages in the chunk, in turn
        for time, channel, content in messages:
            if not places:
                first = time
            places.setdefault(channel, []).extend((time, size))
            parts += (MESSAGE.pack(Opcode.MESSAGE, BESIDE_CONTENT + len(content), channel, 0, time, time), content)
            size += MESSAGE.size + len(content)
            last = time
            if size > CHUNK:
                self._add_chunk(b"".join(parts), first, last, places)
                parts, size, places = [], 0, {}
        if places:
            self._add_chunk(b"".join(parts), first, last, places)

    def finish(self) -> None:
        """Writes what ends a file: checksums, and a summary that says where everything is."""
        self._write(_written(DataEnd(self._crc)))
        first, last = (self._times[0], self._times[-1]) if self._times else (0, 0)
        statistics = Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunks),
            message_count=self._counts.total(),
            message_end_time=last,
            message_start_time=first,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
        groups: list[tuple[Opcode, list]] = [
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.ATTACHMENT_INDEX, self._attachments),
            (Opcode.METADATA_INDEX, self._metadata),
        ]
        start, summary, offsets = self._at, b"", b""
        for opcode, records in groups:
            group = b"".join(map(_written, records))
            offsets += _written(SummaryOffset(opcode, start + len(summary), len(group)))
            summary += group
        footer = _written(Footer(start, start + len(summary), 0))
        self._write(summary + offsets)
        crc = zlib.crc32(summary + offsets + footer[:-4])  # it is the footer's last field, and of all before it
        self._write(footer[:-4] + struct.pack("<I", crc) + MAGIC)

    def _add_chunk(self, content: bytes, first: int, last: int, places: Mapping[int, list[int]]) -> None:
        """Adds messages, compressed, and where each of them is."""
        data = zstandard.compress(content)
        start, length = self._write(_written(Chunk("zstd", data, last, first, zlib.crc32(content), len(content))))
        offsets, indexes, at = {}, [], self._at
        for channel, entries in places.items():
            room = 8 * len(entries)
            offsets[channel] = at
            indexes.append(INDEX.pack(Opcode.MESSAGE_INDEX, INDEX.size - 9 + room, channel, room))
            indexes.append(struct.pack(f"<{len(entries)}Q", *entries))
            at += INDEX.size + room
            self._counts[channel] += len(entries) // 2
        self._write(b"".join(indexes))
        self._times += (first, last)
        self._chunks.append(ChunkIndex(length, start, "zstd", len(data), last, at - start - length, offsets, first, len(content)))

    def _write(self, data: bytes) -> tuple[int, int]:
        """Writes; returns where and how much, in bytes."""
        start = self._at
        self._crc = zlib.crc32(data, self._crc)  # metadata has no checksum of its own
        self._stream.write(data)
        self._at += len(data)
        return start, len(data)


def _written(record: McapRecord) -> bytes:
    """Returns the bytes of a record."""
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


PACKAGE = "roadproof"
SAME = 1e-9  # relative, and absolute in N and N m: what acted is computed again, not read back


@dataclass(frozen=True, eq=False)
class LoggedChannel:
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
        file = McapFile(stream)
        for name, record in records(runs, metadata).items():
            file.add_metadata(name, record)
        for name, (media_type, content) in attachments.items():
            file.add_attachment(name, media_type, content)

        messages: list[Message] = []
        schemas: dict[tuple[str, str, bytes], int] = {}
        for channel in channels(runs):
            if channel.schema not in schemas:
                schemas[channel.schema] = file.add_schema(*channel.schema)
            number = file.add_channel(channel.topic, MessageEncoding.Protobuf, schemas[channel.schema], channel.metadata)
            messages += zip(channel.times, itertools.repeat(number, len(channel.times)), channel.contents(), strict=True)

        # Players stream a file from front to back: all topics together, in the order of time.
        messages.sort(key=operator.itemgetter(0))
        file.add_messages(messages)
        file.finish()


def channels(runs: Sequence[RunLog]) -> Iterator[LoggedChannel]:
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
        if run.gap is not None:
            responses["difference"] = (run.gap, "<f4")
        for name, (response, kind) in responses.items():
            number = numbers.setdefault(response.signals, len(numbers) + 1)
            yield LoggedChannel(
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
            yield LoggedChannel(
                topic(runs, run, name),
                _signals_schema(response.signals, number, "<f8"),
                {signal.name: _described(signal) for signal in response.signals},
                _nanoseconds(response.time),
                partial(_encoded, response, "<f8"),
                _nearly_equal,
            )
    yield from (channel for channel in _published(runs) if channel.times)


def _nearly_equal(message: bytes, other: bytes) -> bool:
    """Returns True if two messages of doubles are equal up to the rounding of another machine."""
    (tags, numbers), (others, numbers_of_other) = _fields(message), _fields(other)
    return tags == others and np.allclose(numbers, numbers_of_other, rtol=SAME, atol=SAME, equal_nan=True)


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
    """Returns the description of a signal for readers, as JSON."""
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


def _published(runs: Sequence[RunLog]) -> Iterator[LoggedChannel]:
    """Yields the channels with published schemas: events and the scene."""
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
            yield LoggedChannel(topic(runs, run, name), _published_schema(kind), {}, when, made, alike)
        low, high = run.scene.extent()
        stand = stand + [1.15 * (high[0] - low[0]), 0.0, 0.0]  # in a row


def _serialized(messages: Callable[[], Iterator[Any]]) -> Iterator[bytes]:
    return (message.SerializeToString() for message in messages())


def _published_schema(kind: type) -> tuple[str, str, bytes]:
    """A message type's schema, with those that it is made of."""
    from mcap_protobuf.schema import build_file_descriptor_set

    data = build_file_descriptor_set(kind).SerializeToString()
    return kind.DESCRIPTOR.full_name, SchemaEncoding.Protobuf, data  # pyright: ignore[reportAttributeAccessIssue] - generated
