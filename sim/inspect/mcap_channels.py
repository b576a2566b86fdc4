"""The channels of an MCAP file while it is read: their schemas, and their messages as they come."""

import struct
from array import array
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from mcap.records import Channel, Schema

from sim.inspect.mcap_contents import Logged

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
        """What is damaged is said to `damaged`, in words."""
        self.messages, self._damaged = 0, damaged
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._series: dict[int, _Series] = {}
        self._topics: dict[str, _Series] = {}

    @property
    def schema_names(self) -> tuple[str, ...]:
        """Of all schemas, in their order."""
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
