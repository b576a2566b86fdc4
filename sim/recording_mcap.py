"""Runs as an MCAP file: protobuf messages that Rerun and Foxglove plot without any schema installed.

Format: https://mcap.dev/spec and https://protobuf.dev/programming-guides/encoding. The descriptors are built here, at
run time, from the responses' signals: a signal's name is its field's name, and there is no generated code.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from google.protobuf import timestamp_pb2
from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import Writer

from models.arrays import Array
from models.signals import Signal
from sim.response import Response
from sim.run_log import RunLog

_PACKAGE = "roadproof"


def write_mcap(
    path: Path,
    runs: Sequence[RunLog],
    metadata: Mapping[str, str],
    attachments: Mapping[str, tuple[str, bytes]],
) -> None:
    """Writes runs to an MCAP file.

    One topic per response, `/mujoco` for a single run and `/I/mujoco` among several: a message per sample, a double per
    signal, log_time = publish_time = t in ns. The channel's metadata holds unit, symbol and meaning of every signal, as
    JSON by the signal's name; the schema has them as comments. Events are `foxglove.Log` on `/events`. `metadata`
    becomes the metadata record `roadproof`, and each run's own the record `run/<name>`.

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

        writer.add_metadata(_PACKAGE, dict(metadata))
        for run in runs:
            writer.add_metadata(f"run/{run.name}", dict(run.metadata))
        for name, (media_type, content) in attachments.items():
            writer.add_attachment(create_time=0, log_time=0, name=name, media_type=media_type, data=content)

        messages: list[tuple[int, int, bytes]] = []  # time [ns], channel, content
        schemas: dict[tuple[Signal, ...], int] = {}
        for run in runs:
            prefix = f"/{run.name}" if len(runs) > 1 else ""
            for name, response in run.responses.items():
                if response.signals not in schemas:
                    schemas[response.signals] = _register_signals(writer, response.signals, len(schemas) + 1)
                channel = writer.register_channel(
                    topic=f"{prefix}/{name}",
                    message_encoding=MessageEncoding.Protobuf,
                    schema_id=schemas[response.signals],
                    metadata={signal.name: _described(signal) for signal in response.signals},
                )
                times = _nanoseconds(response.time)
                messages += ((time, channel, content) for time, content in zip(times, _encoded(response), strict=True))

        if any(run.events for run in runs):
            messages += _registered_events(writer, runs)

        # Players stream a file from front to back: all topics together, in the order of time.
        messages.sort(key=lambda message: message[0])
        for time, channel, content in messages:
            writer.add_message(channel, log_time=time, data=content, publish_time=time)
        writer.finish()


def _nanoseconds(time: Array) -> list[int]:
    """Times [s] as MCAP counts them."""
    return np.round(time * 1e9).astype(np.int64).tolist()


def _described(signal: Signal) -> str:
    """What a reader needs beside the numbers, as JSON."""
    return json.dumps({"unit": signal.unit, "symbol": signal.symbol, "meaning": signal.meaning})


def _register_signals(writer: Writer, signals: tuple[Signal, ...], number: int) -> int:
    """The schema of a flat message of doubles, numbered because responses may differ in their signals."""
    message = DescriptorProto(name=f"Signals{number}")
    file = FileDescriptorProto(name=f"{_PACKAGE}/signals{number}.proto", package=_PACKAGE, syntax="proto3")
    for index, signal in enumerate(signals):
        message.field.add(
            name=signal.name,
            number=index + 1,
            type=FieldDescriptorProto.TYPE_DOUBLE,
            label=FieldDescriptorProto.LABEL_OPTIONAL,
        )
        # The path of message 0 (file field 4), field `index` (message field 2): a comment above it in the .proto.
        file.source_code_info.location.add(
            path=(4, 0, 2, index),
            span=(index, 0, 0),
            leading_comments=f" {signal.symbol} [{signal.unit}]: {signal.meaning}\n",
        )
    file.message_type.append(message)
    return writer.register_schema(
        name=f"{_PACKAGE}.{message.name}",
        encoding=SchemaEncoding.Protobuf,
        data=FileDescriptorSet(file=[file]).SerializeToString(),
    )


def _encoded(response: Response) -> list[bytes]:
    """Every sample as a protobuf message.

    On the wire a double is its tag, (number << 3) | 1 as a varint, and 8 little-endian bytes. A flat message of
    doubles thus has the same layout at every sample, and all samples are one array of bytes. Protobuf's own writer
    leaves zeros out; writing them is as valid, reads the same, and keeps the layout. It also keeps -0.0 and NaN.
    """
    count = len(response.time)
    columns = []
    for index in range(len(response.signals)):
        tag = np.frombuffer(_varint((index + 1) << 3 | 1), np.uint8)
        value = np.ascontiguousarray(response.values[:, index], dtype="<f8").view(np.uint8).reshape(count, 8)
        columns += [np.broadcast_to(tag, (count, len(tag))), value]
    rows = np.concatenate(columns, axis=1)
    width, content = rows.shape[1], rows.tobytes()
    return [content[start : start + width] for start in range(0, len(content), width)]


def _varint(value: int) -> bytes:
    """Seven bits a byte, lowest first; the high bit says that more follow."""
    low, rest = value & 0x7F, value >> 7
    return bytes([low | 0x80]) + _varint(rest) if rest else bytes([low])


def _registered_events(writer: Writer, runs: Sequence[RunLog]) -> list[tuple[int, int, bytes]]:
    """Registers the events' channels and makes their messages: (time [ns], channel, content)."""
    file = _log_file()
    dependency = FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(dependency)
    pool = DescriptorPool()
    pool.Add(dependency)
    pool.Add(file)
    log = GetMessageClass(pool.FindMessageTypeByName("foxglove.Log"))

    schema = writer.register_schema(
        name="foxglove.Log",
        encoding=SchemaEncoding.Protobuf,
        data=FileDescriptorSet(file=[dependency, file]).SerializeToString(),
    )
    messages = []
    for run in runs:
        if not run.events:
            continue
        topic = f"/{run.name}/events" if len(runs) > 1 else "/events"
        channel = writer.register_channel(topic, MessageEncoding.Protobuf, schema)
        times = _nanoseconds(np.array([time for time, _ in run.events]))
        for time, (_, text) in zip(times, run.events, strict=True):
            seconds, nanos = divmod(time, 10**9)
            event = log(timestamp={"seconds": seconds, "nanos": nanos}, level="INFO", message=text, name=run.name)
            messages.append((time, channel, event.SerializeToString()))
    return messages


def _log_file() -> FileDescriptorProto:
    """The published schema `foxglove.Log` (https://docs.foxglove.dev/docs/sdk/schemas/log), its first six fields."""
    kind = FieldDescriptorProto
    log = DescriptorProto(name="Log")
    level = log.enum_type.add(name="Level")
    for number, name in enumerate(("UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL")):
        level.value.add(name=name, number=number)
    fields = (
        ("timestamp", kind.TYPE_MESSAGE, ".google.protobuf.Timestamp"),
        ("level", kind.TYPE_ENUM, ".foxglove.Log.Level"),
        ("message", kind.TYPE_STRING, None),
        ("name", kind.TYPE_STRING, None),
        ("file", kind.TYPE_STRING, None),
        ("line", kind.TYPE_FIXED32, None),
    )
    for number, (name, type_, type_name) in enumerate(fields, start=1):
        log.field.add(name=name, number=number, type=type_, type_name=type_name, label=kind.LABEL_OPTIONAL)
    return FileDescriptorProto(
        name="foxglove/Log.proto",
        package="foxglove",
        syntax="proto3",
        dependency=["google/protobuf/timestamp.proto"],
        message_type=[log],
    )
