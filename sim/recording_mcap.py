"""Runs as an MCAP file: protobuf messages that Rerun and Foxglove plot without any schema installed.

Format: https://mcap.dev/spec and https://protobuf.dev/programming-guides/encoding. The descriptors are built here, at
run time, from the responses' signals: a signal's name is its field's name, and there is no generated code.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import Writer

from models.arrays import Array
from models.signals import Signal
from sim.appearance import largest_force
from sim.difference import difference
from sim.figure import rgb, styles
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
    JSON by the signal's name; the schema has them as comments. `/difference` is MuJoCo minus linear, of each signal's peak, in
    single precision. Events are `foxglove.Log` on `/events`, and the moving car is on `/transforms`, `/shapes` and `/scene` in
    Foxglove's published schemas. `metadata` becomes the metadata record `roadproof`, and each run's own the record `run/<name>`.

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
            responses = {name: (response, "<f8") for name, response in run.responses.items()}
            if {"mujoco", "linear"} <= set(responses):
                responses["difference"] = (difference(run.responses["mujoco"], run.responses["linear"]), "<f4")
            for name, (response, kind) in responses.items():
                if response.signals not in schemas:
                    schemas[response.signals] = _register_signals(writer, response.signals, len(schemas) + 1, kind)
                channel = writer.register_channel(
                    topic=topic(runs, run, name),
                    message_encoding=MessageEncoding.Protobuf,
                    schema_id=schemas[response.signals],
                    metadata={signal.name: _described(signal) for signal in response.signals},
                )
                times = _nanoseconds(response.time)
                messages += ((time, channel, content) for time, content in zip(times, _encoded(response, kind), strict=True))
        messages += _published(writer, runs)

        # Players stream a file from front to back: all topics together, in the order of time.
        messages.sort(key=lambda message: message[0])
        for time, channel, content in messages:
            writer.add_message(channel, log_time=time, data=content, publish_time=time)
        writer.finish()


def topic(runs: Sequence[RunLog], run: RunLog, name: str) -> str:
    """The topic of something of a run: with the run's name where there are several."""
    return f"/{run.name}/{name}" if len(runs) > 1 else f"/{name}"


def _nanoseconds(time: Array) -> list[int]:
    """Times [s] as MCAP counts them."""
    return np.round(time * 1e9).astype(np.int64).tolist()


def _described(signal: Signal) -> str:
    """What a reader needs beside the numbers, as JSON."""
    return json.dumps({"unit": signal.unit, "symbol": signal.symbol, "meaning": signal.meaning})


def _register_signals(writer: Writer, signals: tuple[Signal, ...], number: int, kind: str) -> int:
    """The schema of a flat message of doubles or floats, numbered because responses may differ in their signals."""
    message = DescriptorProto(name=f"Signals{number}")
    file = FileDescriptorProto(name=f"{_PACKAGE}/signals{number}.proto", package=_PACKAGE, syntax="proto3")
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
    return writer.register_schema(
        name=f"{_PACKAGE}.{message.name}",
        encoding=SchemaEncoding.Protobuf,
        data=FileDescriptorSet(file=[file]).SerializeToString(),
    )


@np.errstate(over="ignore")  # a difference that single precision cannot hold is infinite
def _encoded(response: Response, kind: str) -> list[bytes]:
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
    return [content[start : start + width] for start in range(0, len(content), width)]


def _varint(value: int) -> bytes:
    """Seven bits a byte, lowest first; the high bit says that more follow."""
    low, rest = value & 0x7F, value >> 7
    return bytes([low | 0x80]) + _varint(rest) if rest else bytes([low])


def _published(writer: Writer, runs: Sequence[RunLog]) -> Iterator[tuple[int, int, bytes]]:
    """What has a published schema: events and the scene. Registers their channels; yields (time [ns], channel, content)."""
    from mcap_protobuf.schema import register_schema

    from sim import foxglove_scene as scene

    schemas: dict[str, int] = {}

    def written(run: RunLog, name: str, messages: scene.Messages) -> Iterator[tuple[int, int, bytes]]:
        channel = None
        for time, message in messages:
            schema = message.DESCRIPTOR.full_name
            if schema not in schemas:
                schemas[schema] = register_schema(writer, type(message))
            if channel is None:
                channel = writer.register_channel(topic(runs, run, name), MessageEncoding.Protobuf, schemas[schema])
            yield time, channel, message.SerializeToString()

    largest = largest_force(run.scene for run in runs)
    colours = styles(tuple(run.name for run in runs))
    stand = np.zeros(3)
    for run in runs:
        run = replace(run, scene=run.scene.finite())
        times = _nanoseconds(run.scene.time)
        yield from written(run, "events", scene.events(run, _nanoseconds(np.array([time for time, _ in run.events]))))
        yield from written(run, "transforms", scene.transforms(run, times, stand))
        yield from written(run, "shapes", scene.shapes(run, times[0] if times else 0, rgb(colours[run.name][0])))
        yield from written(run, "scene", scene.moving(run, times, largest))
        low, high = run.scene.extent()
        stand = stand + [1.15 * (high[0] - low[0]), 0.0, 0.0]  # in a row
