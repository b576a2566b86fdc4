"""A log taken apart and written again, changed: with right checksums, so that only its contents can give it away."""

import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from mcap.reader import make_reader
from mcap.records import Channel, Message, Schema
from mcap.writer import Writer


@dataclass(frozen=True)
class Contents:
    """The content of an MCAP file of ours, in the order of the file."""

    metadata: list[tuple[str, Mapping[str, str]]]
    attachments: list[tuple[str, str, bytes]]
    schemas: list[Schema]
    channels: list[Channel]
    messages: list[Message]

    def with_claim(self, record: str, key: str, change: Callable[[str], str]) -> "Contents":
        """The same with one entry of a metadata record changed."""
        return replace(
            self,
            metadata=[
                (name, {**one, key: change(one[key])} if name == record and key in one else one) for name, one in self.metadata
            ],
        )

    def without_claim(self, record: str, key: str) -> "Contents":
        """The same without one entry of a metadata record."""
        return replace(
            self, metadata=[(n, {k: v for k, v in one.items() if (n, k) != (record, key)}) for n, one in self.metadata]
        )

    def with_attachment(self, file: str, change: Callable[[bytes], bytes]) -> "Contents":
        """The same with one attachment changed."""
        return replace(
            self, attachments=[(name, kind, change(data) if name == file else data) for name, kind, data in self.attachments]
        )

    def with_messages(self, topic: str, change: Callable[[list[Message]], list[Message]]) -> "Contents":
        """The same with the messages of one topic changed."""
        (number,) = [channel.id for channel in self.channels if channel.topic == topic]
        mine = change([message for message in self.messages if message.channel_id == number])
        others = [message for message in self.messages if message.channel_id != number]
        return replace(self, messages=sorted(others + mine, key=lambda message: message.log_time))


def contents(path: Path) -> Contents:
    """Returns what a log holds, by the format's own reader."""
    with path.open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        assert summary is not None, "the log is whole"
        return Contents(
            [(record.name, record.metadata) for record in reader.iter_metadata()],
            [(one.name, one.media_type, one.data) for one in reader.iter_attachments()],
            list(summary.schemas.values()),
            list(summary.channels.values()),
            [message for _, _, message in reader.iter_messages()],
        )


def written(parts: Contents) -> bytes:
    """The file of these contents."""
    stream = io.BytesIO()
    writer = Writer(stream, chunk_size=16384, enable_data_crcs=True)
    writer.start()
    for name, record in parts.metadata:
        writer.add_metadata(name, dict(record))
    for name, kind, data in parts.attachments:
        writer.add_attachment(0, 0, name, kind, data)
    schemas = {schema.id: writer.register_schema(schema.name, schema.encoding, schema.data) for schema in parts.schemas}
    channels = {
        channel.id: writer.register_channel(
            channel.topic, channel.message_encoding, schemas.get(channel.schema_id, 0), channel.metadata
        )
        for channel in parts.channels
    }
    for message in parts.messages:
        writer.add_message(channels[message.channel_id], message.log_time, message.data, message.publish_time, message.sequence)
    writer.finish()
    return stream.getvalue()
