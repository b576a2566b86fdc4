"""Runs as an MCAP file, https://mcap.dev/spec: protobuf messages with their schemas, which Rerun and Foxglove can plot.

Encoding: https://protobuf.dev/programming-guides/encoding. The descriptors are built at run time from the signals of the
responses, without generated code; a field has the name of its signal.
"""

import json
import operator
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
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
CHUNK = 1024 * 1024  # uncompressed bytes after which a chunk ends
MESSAGE = np.dtype(  # the content follows
    [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log_time", "<u8"), ("publish_time", "<u8")]
)
INDEX = struct.Struct("<BQHI")  # opcode, length, channel, length of the entries; these follow, each a time and an offset
HEADER = MESSAGE.itemsize - 9  # bytes of a message's length besides its content: without opcode and length


class McapFile:
    """Writer of an MCAP file: first metadata and attachments, then schemas, channels and all messages, then `finish`."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._at, self._crc = 0, 0
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._before = b""  # schemas and channels, which precede the first message
        self._counts: Counter[int] = Counter()
        self._times: list[int] = []  # of the first and the last message of each chunk
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
        """Adds an attachment without a date."""
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

    def add_messages(self, times: Array, channels: Array, contents: Sequence[bytes]) -> None:
        """Adds all messages in chunks, sorted by time: players stream a file from front to back.

        Args:
            times: integer times of the messages [ns], shape (N,); equal ones keep their order.
            channels: their channels, shape (N,).
            contents: N contents.
        """
        order = np.argsort(times, kind="stable")
        times, channels = times[order], channels[order]
        lengths = np.fromiter(map(len, contents), np.int64, len(contents))[order]
        heads = np.zeros(len(times), MESSAGE)
        heads["opcode"], heads["length"], heads["channel"] = Opcode.MESSAGE, HEADER + lengths, channels
        heads["log_time"] = heads["publish_time"] = times
        ends, size, head = np.cumsum(MESSAGE.itemsize + lengths), MESSAGE.itemsize, heads.tobytes()
        start, before = 0, self._before
        while start < len(times):
            sent = int(ends[start - 1]) if start else 0
            end = min(int(np.searchsorted(ends, sent + CHUNK - len(before), side="right")) + 1, len(times))
            parts = [b""] * (2 * (end - start))
            parts[::2] = [head[size * i : size * (i + 1)] for i in range(start, end)]
            parts[1::2] = [contents[i] for i in order[start:end].tolist()]
            offsets = len(before) - sent + np.concatenate([[sent], ends[start : end - 1]])
            self._add_chunk(before + b"".join(parts), times[start:end], channels[start:end], offsets)
            start, before = end, b""

    def finish(self) -> None:
        """Writes the end of the file: checksums, and the summary with the positions of all records."""
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
        crc = zlib.crc32(summary + offsets + footer[:-4])  # the last field of the footer: of all bytes before it
        self._write(footer[:-4] + struct.pack("<I", crc) + MAGIC)

    def _add_chunk(self, content: bytes, times: Array, channels: Array, offsets: Array) -> None:
        """Writes a compressed chunk of messages, and the index of their positions in it."""
        data, first, last = zstandard.compress(content), int(times[0]), int(times[-1])
        start, length = self._write(_written(Chunk("zstd", data, last, first, zlib.crc32(content), len(content))))
        places, indexes, at = {}, [], self._at
        entries = np.stack([times, offsets], axis=-1).astype("<u8")
        for channel in dict.fromkeys(channels.tolist()):
            mine = entries[channels == channel]
            places[channel] = at
            indexes.append(INDEX.pack(Opcode.MESSAGE_INDEX, INDEX.size - 9 + mine.nbytes, channel, mine.nbytes))
            indexes.append(mine.tobytes())
            at += INDEX.size + mine.nbytes
            self._counts[channel] += len(mine)
        self._write(b"".join(indexes))
        self._times += (first, last)
        self._chunks.append(ChunkIndex(length, start, "zstd", len(data), last, at - start - length, places, first, len(content)))

    def _write(self, data: bytes) -> tuple[int, int]:
        """Writes data; returns its position and length in bytes."""
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
SAME = 1e-9  # allowed difference of recomputed forces: relative, and absolute in N and N m


@dataclass(frozen=True, eq=False)
class LoggedChannel:
    """A channel of a log.

    Attributes:
        topic: its name.
        schema: schema of its messages: name, encoding and data.
        metadata: descriptions of its fields.
        times: ascending times of its messages [ns].
        contents: yields its messages, one for each time.
        alike: returns True if two messages are equal to the rounding of another machine.
    """

    topic: str
    schema: tuple[str, str, bytes]
    metadata: Mapping[str, str]
    times: Sequence[int]
    contents: Callable[[], Iterator[bytes]]
    alike: Callable[[bytes, bytes], bool]


def records(runs: Sequence[RunLog], metadata: Mapping[str, str]) -> dict[str, Mapping[str, str]]:
    """Returns the metadata records of a log, by name: one for all runs, and one for each."""
    return {PACKAGE: metadata, **{f"run/{run.name}": run.metadata for run in runs}}


def write_mcap(
    path: Path,
    runs: Sequence[RunLog],
    metadata: Mapping[str, str],
    attachments: Mapping[str, tuple[str, bytes]],
) -> None:
    """Writes runs to an MCAP file.

    Its metadata are `records`, and its channels `channels`.

    Args:
        path: the file; overwritten if it exists.
        runs: runs with distinct names and nonnegative times [s].
        metadata: metadata of all runs.
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

        times, numbers, contents = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)], list[bytes]()
        schemas: dict[tuple[str, str, bytes], int] = {}
        for channel in channels(runs):
            if channel.schema not in schemas:
                schemas[channel.schema] = file.add_schema(*channel.schema)
            number = file.add_channel(channel.topic, MessageEncoding.Protobuf, schemas[channel.schema], channel.metadata)
            times.append(np.array(channel.times, np.int64))
            numbers.append(np.full(len(channel.times), number))
            contents += channel.contents()
        file.add_messages(np.concatenate(times), np.concatenate(numbers), contents)
        file.finish()


def channels(runs: Sequence[RunLog]) -> Iterator[LoggedChannel]:
    """Yields every channel of a log, in order. Logs are written by it, and checked against it.

    Each response has a topic, `/mujoco` for a single run and `/I/mujoco` for one of several: a message per sample, a double per
    signal, log_time = publish_time = t in ns. The channel's metadata has unit, symbol and meaning of every signal as JSON, by its
    name; the schema has them as comments. `/difference` is MuJoCo minus sampled, over each signal's peak, in single precision.
    Other forces are on `/loads` and `/dampers`. Events are `foxglove.Log` on `/events`. The moving car is on `/transforms`,
    `/shapes` and `/scene` in Foxglove's published schemas. A channel without messages is left out.
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
    # A panel of events has its topic even if nothing happened.
    yield from (channel for channel in _published(runs) if channel.times or channel.topic.endswith("/events"))


def _nearly_equal(message: bytes, other: bytes) -> bool:
    """Returns True if two messages of doubles are equal to the rounding of another machine."""
    (tags, numbers), (others, numbers_of_other) = _fields(message), _fields(other)
    return tags == others and np.allclose(numbers, numbers_of_other, rtol=SAME, atol=SAME, equal_nan=True)


def _fields(message: bytes) -> tuple[bytes, Array]:
    """Returns tags and numbers of a message of `_encoded`; any other message has other tags, or fewer."""
    tags, numbers, at = b"", [], 0
    while at < len(message):
        value = at + (2 if message[at] >= 0x80 else 1)
        tags += message[at:value]
        numbers.append(message[value : value + 8])
        at = value + 8
    return tags, np.frombuffer(b"".join(numbers).ljust(8 * len(numbers), b"\0"), "<f8")


def topic(runs: Sequence[RunLog], run: RunLog, name: str) -> str:
    """Returns the name of a topic, which includes the run's name if there are several runs."""
    return f"/{run.name}/{name}" if len(runs) > 1 else f"/{name}"


def _nanoseconds(time: Array) -> list[int]:
    """Returns times [s] in nanoseconds."""
    return np.round(time * 1e9).astype(np.int64).tolist()


def _described(signal: Signal) -> str:
    """Returns the description of a signal as JSON."""
    return json.dumps({"unit": signal.unit, "symbol": signal.symbol, "meaning": signal.meaning})


def _signals_schema(signals: tuple[Signal, ...], number: int, kind: str) -> tuple[str, str, bytes]:
    """Returns the schema of a flat message of doubles or floats, numbered because responses may differ in their signals."""
    message = DescriptorProto(name=f"Signals{number}")
    file = FileDescriptorProto(name=f"{PACKAGE}/signals{number}.proto", package=PACKAGE, syntax="proto3")
    for index, signal in enumerate(signals):
        message.field.add(
            name=signal.name,
            number=index + 1,
            type=FieldDescriptorProto.TYPE_DOUBLE if kind == "<f8" else FieldDescriptorProto.TYPE_FLOAT,
            label=FieldDescriptorProto.LABEL_OPTIONAL,
        )
        # Path of message 0 (field 4 of a file), field `index` (field 2 of a message): a comment above it in the .proto.
        file.source_code_info.location.add(
            path=(4, 0, 2, index),
            span=(index, 0, 0),
            leading_comments=f" {signal.symbol} [{signal.unit}]: {signal.meaning}\n",
        )
    file.message_type.append(message)
    return f"{PACKAGE}.{message.name}", SchemaEncoding.Protobuf, FileDescriptorSet(file=[file]).SerializeToString()


@np.errstate(over="ignore")  # a difference that single precision cannot hold is infinite
def _encoded(response: Response, kind: str) -> Iterator[bytes]:
    """Yields every sample as a protobuf message of doubles, `<f8`, or floats, `<f4`.

    A double is encoded as its tag, (number << 3) | 1 as a varint, and 8 little-endian bytes; a float has 5 and 4. So a flat
    message has the same layout at every sample, and all samples form one array of bytes. Protobuf's own writer leaves out zeros;
    writing them is valid, too, and keeps the layout. -0.0 and NaN are kept as well.
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
    """Returns a varint: seven bits per byte, lowest first; the high bit is set if more follow."""
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
        colour = rgb(colours[run.name].color)
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
            contents, alike = partial(_serialized, messages), partial(scene.alike, kind)
            yield LoggedChannel(topic(runs, run, name), _published_schema(kind), {}, when, contents, alike)
        low, high = run.scene.extent()
        stand = stand + [1.15 * (high[0] - low[0]), 0.0, 0.0]  # in a row


def _serialized(messages: Callable[[], Iterator[Any]]) -> Iterator[bytes]:
    return (message.SerializeToString() for message in messages())


def _published_schema(kind: type) -> tuple[str, str, bytes]:
    """Returns the schema of a message type, including those of its fields."""
    from mcap_protobuf.schema import build_file_descriptor_set

    data = build_file_descriptor_set(kind).SerializeToString()
    return kind.DESCRIPTOR.full_name, SchemaEncoding.Protobuf, data  # pyright: ignore[reportAttributeAccessIssue] - generated
