"""Readable contents of an MCAP file: its bytes, records, attachments and channels."""

import io
import struct
from array import array
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.records import Channel, Chunk, Schema

from models.common.arrays import Array
from models.common.errors import InputError

MIB = 1 << 20
MOST_RECORD = 64 * MIB  # of the file, and of a decompressed chunk; writers end a chunk at 1 to 8 MiB


class ExactStream(ReadDataStream):
    """The bytes of one record. A length beyond its end is an error, where the library takes what there is."""

    def __init__(self, content: bytes) -> None:
        super().__init__(io.BytesIO(content))
        self._end = len(content)

    def read(self, length: int) -> bytes:
        """The next bytes, all of them.

        Raises:
            EndOfFile: there are fewer.
        """
        if length > self._end - self.count:
            raise EndOfFile
        return super().read(length)


def decompressed(chunk: Chunk) -> bytes | None:
    """Returns a chunk's records, at most one byte more than its size, or None if its data do not decompress."""
    most = chunk.uncompressed_size + 1
    try:
        if chunk.compression == "":
            return chunk.data
        if chunk.compression == "zstd":
            # Streaming: in one go it would allocate what the frame's own header says.
            return zstandard.ZstdDecompressor(max_window_size=MOST_RECORD).stream_reader(chunk.data).read(most)
        if chunk.compression == "lz4":
            return lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, most)
    except (zstandard.ZstdError, RuntimeError, EOFError):
        pass
    return None


@dataclass(frozen=True, eq=False)
class Logged:
    """Channel and its messages, as bytes.

    Attributes:
        topic: its name; a second channel of the same name is damage, and its messages are not kept.
        encoding: of its messages.
        schema: name, encoding and data, or None without a schema.
        metadata: of the channel.
        times: log times [ns], shape (N,), uint64, in the order of the file.
        ends: end of each message in `content`, shape (N,), uint64.
        content: the messages, concatenated.
        unlike: number of messages with a sequence number, or published at another time than logged; Roadproof writes none.
    """

    topic: str
    encoding: str
    schema: tuple[str, str, bytes] | None
    metadata: Mapping[str, str]
    times: Array
    ends: Array
    content: memoryview
    unlike: int

    def messages(self) -> Iterator[memoryview]:
        """Yields the messages one by one."""
        start = 0
        for end in self.ends.tolist():
            yield self.content[start:end]
            start = end

    def rows(self) -> Array:
        """Messages of one length, shape (N, length), uint8.

        Raises:
            InputError: they are not.
        """
        width = int(self.ends[0]) if len(self.ends) else 0
        if np.any(self.ends != width * np.arange(1, len(self.ends) + 1, dtype=np.uint64)):
            raise InputError("its messages are not as long as its first")
        return np.frombuffer(self.content, np.uint8).reshape(len(self.ends), width)


@dataclass(frozen=True)
class Attached:
    """An attachment: its media type, its times [ns] and its content."""

    media_type: str
    times: tuple[int, int]
    data: bytes


@dataclass(frozen=True, eq=False)
class McapContents:
    """Readable contents of a file.

    Attributes:
        metadata: records by name.
        attachments: by name.
        channels: by topic.
        schemas: names of all schemas, used or not.
        chunks: number of chunks read.
        messages: number of messages read, on any channel.
        right: number of correct checksums.
        absent: number of absent checksums: the format allows zero for one.
        damage: missing or broken parts, in words; empty for a whole file.
    """

    metadata: Mapping[str, Mapping[str, str]]
    attachments: Mapping[str, Attached]
    channels: Mapping[str, Logged]
    schemas: tuple[str, ...]
    chunks: int
    messages: int
    right: int
    absent: int
    damage: tuple[str, ...]


MOST_CHANNELS = 10_000  # a thousand runs have eight each
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time


@dataclass
class _Series:
    """A channel that is being read."""

    channel: Channel
    schema: tuple[str, str, bytes] | None
    times: array = field(default_factory=lambda: array("Q"))
    ends: array = field(default_factory=lambda: array("Q"))
    content: bytearray = field(default_factory=bytearray)
    unlike: int = 0


class Channels:
    """Collects what stands in chunks: schemas, channels and their messages.

    Attributes:
        messages: how many came, kept or not.
    """

    def __init__(self, damaged: Callable[[str], None]) -> None:
        """Prepares to collect channels; `damaged` receives descriptions of damage."""
        self.messages, self._damaged = 0, damaged
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._series: dict[int, _Series] = {}
        self._topics: dict[str, _Series] = {}

    @property
    def schema_names(self) -> tuple[str, ...]:
        """Returns the names of all schemas, in their order."""
        return tuple(schema.name for schema in self._schemas.values())

    def logged(self) -> dict[str, Logged]:
        """Every channel with its messages, by topic."""
        return {
            topic: Logged(
                topic,
                series.channel.message_encoding,
                series.schema,
                series.channel.metadata,
                np.array(series.times, dtype=np.uint64),
                np.array(series.ends, dtype=np.uint64),
                memoryview(series.content),
                series.unlike,
            )
            for topic, series in self._topics.items()
        }

    def add_schema(self, where: str, schema: Schema) -> None:
        """Takes a schema."""
        if self._schemas.setdefault(schema.id, schema) != schema:
            self._damaged(f"the schema {where} has the number of another")

    def open(self, where: str, channel: Channel) -> None:
        """Begins a channel."""
        if channel.id in self._channels:
            if self._channels[channel.id] != channel:
                self._damaged(f"the channel {where} has the number of another")
            return
        if len(self._channels) >= MOST_CHANNELS:
            self._damaged(f"more than {MOST_CHANNELS} channels; the others are not read")
            return
        self._channels[channel.id] = channel
        schema = self._schemas.get(channel.schema_id)
        if channel.topic in self._topics:
            self._damaged(f"the channel {where} has the topic of another")
            return
        about = (schema.name, schema.encoding, schema.data) if schema is not None else None
        self._topics[channel.topic] = self._series[channel.id] = _Series(channel, about)

    def add_message(self, where: str, content: memoryview) -> None:
        """Takes a message's bytes."""
        # Not as a record of the library's: a chunk may hold two million of them, and objects take 15 times as much memory.
        if len(content) < _MESSAGE.size:
            self._damaged(f"a message {where} has {len(content)} bytes; the least is {_MESSAGE.size}")
            return
        self.messages += 1
        number, order, time, published = _MESSAGE.unpack_from(content)
        series = self._series.get(number)
        if series is None:
            if number not in self._channels:
                self._damaged(f"messages {where} have no channel")
            return
        series.times.append(time)
        series.content += content[_MESSAGE.size :]
        series.ends.append(len(series.content))
        series.unlike += order != 0 or published != time
