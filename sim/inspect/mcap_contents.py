"""What could be read of an MCAP file: its records, attachments and channels, as they stand there."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError


@dataclass(frozen=True, eq=False)
class Logged:
    """A channel and its messages, as bytes.

    Attributes:
        topic: its name; a second channel of the same name is damage, and its messages are not kept.
        encoding: of its messages.
        schema: name, encoding and data; None where it has none.
        metadata: what is said beside it.
        times: log times [ns], shape (N,), uint64, in the order of the file.
        ends: where each message ends in `content`, shape (N,), uint64.
        content: the messages, one behind the other.
        unlike: messages that were not published when they were logged, or are numbered; a run of ours writes none.
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
        """One by one."""
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
class McapFile:
    """What could be read of a file.

    Attributes:
        metadata: records by name.
        attachments: by name.
        channels: by topic.
        schemas: their names, also of those that no channel has.
        chunks: how many were read.
        messages: how many were read, on whatever channel.
        right: checksums that are there, and right.
        absent: checksums that are not there: the format allows zero for one.
        damage: what is missing or broken, in words; empty for a whole file.
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
