"""Writer of runs as an MCAP file, https://mcap.dev/spec: protobuf messages with schemas that Rerun and Foxglove can plot.

Encoding: https://protobuf.dev/programming-guides/encoding. The protobuf descriptors are created at run time from the signals of
the responses, without generated code. Each field of a message has the same name as its signal.
"""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from operator import itemgetter
from pathlib import Path

import numpy as np
from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import Writer

from models.common.arrays import Array
from models.common.extensions import FEATURES
from models.kinds.signals import Signal
from sim.drive.response import Response
from sim.recording.run_log import RunLog

PACKAGE = "roadproof"


Schema = tuple[str, str, bytes]  # name, encoding and data of a message schema
# A channel consists of topic, schema, metadata, times [ns] and messages
Channel = tuple[str, Schema, dict[str, str], Sequence[int], Iterable[bytes]]


def write_mcap(
    path: Path,
    runs: Sequence[RunLog],
    metadata: Mapping[str, str],
    attachments: Mapping[str, tuple[str, bytes]],
) -> None:
    """Writes runs to an MCAP file.

    The file contains one metadata record for all runs and one for each run, the attachments, and the channels that `channels`
    yields.


    Args:
        path: path of the file; an existing file is overwritten.
        runs: runs with distinct names, and times [s] that are not negative.
        metadata: metadata that apply to all runs; keys and values are texts.
        attachments: media type and content of each attached file, by name.

    Raises:
        OSError: the file cannot be written.
    """
    with path.open("wb") as stream:
        writer = Writer(stream, enable_data_crcs=True)
        writer.start()
        for name, record in {PACKAGE: metadata, **{f"run/{run.name}": run.metadata for run in runs}}.items():
            writer.add_metadata(name, dict(record))
        for name, (media_type, content) in attachments.items():
            writer.add_attachment(0, 0, name, media_type, content)
        schemas: dict[Schema, int] = {}
        messages: list[tuple[int, int, bytes]] = []
        for name, schema, described, times, contents in channels(runs):
            if schema not in schemas:
                schemas[schema] = writer.register_schema(*schema)
            number = writer.register_channel(name, MessageEncoding.Protobuf, schemas[schema], described)
            messages += [(time, number, content) for time, content in zip(times, contents, strict=True)]
        # Messages are sorted by time, because players read a file from beginning to end
        for time, number, content in sorted(messages, key=itemgetter(0)):
            writer.add_message(number, time, content, time)
        writer.finish()


def channels(runs: Sequence[RunLog]) -> Iterator[Channel]:
    """Yields all channels of a log in the order in which they are written.

    Each response has its own topic: `/mujoco` for a single run, or `/I/mujoco` for the run I of several runs. The topic has one
    message for each sample, with one double for each signal; log_time and publish_time are the time of the sample in ns. The
    metadata of the channel contain the unit, symbol and meaning of every signal as JSON by name; the schema contains them as
    comments. The topic `/difference` contains the MuJoCo response minus the sampled response, relative to the peak of each
    signal, in single precision. Forces that are not part of the responses are in the topics `/loads` and `/dampers`. The
    extension "scene of a log" adds events as `foxglove.Log` messages in the topic `/events`. The moving car is in the
    topics `/transforms`, `/shapes` and `/scene`, with Foxglove's published schemas. Channels without messages are omitted.
    """
    numbers: dict[tuple[Signal, ...], int] = {}
    for run in runs:
        responses = {**run.responses, **({} if run.gap is None else {"difference": run.gap}), **run.other_signals}
        for name, response in responses.items():
            kind = "<f4" if name == "difference" else "<f8"
            number = numbers.setdefault(response.signals, len(numbers) + 1)
            yield (
                topic(runs, run, name),
                _signals_schema(response.signals, number, kind),
                {signal.name: _describe_signal(signal) for signal in response.signals},
                nanoseconds(response.time),
                _encode_samples(response, kind),
            )
    if (scene := FEATURES.load_if_known("scene of a log")) is not None:
        yield from scene.channels(runs)


def topic(runs: Sequence[RunLog], run: RunLog, name: str) -> str:
    """Returns the name of a topic. If the log contains several runs, the topic includes the name of the run."""
    return f"/{run.name}/{name}" if len(runs) > 1 else f"/{name}"


def nanoseconds(time: Array) -> list[int]:
    """Returns times [s] converted to nanoseconds."""
    return np.round(time * 1e9).astype(np.int64).tolist()


def _describe_signal(signal: Signal) -> str:
    """Returns the description of a signal as JSON."""
    return json.dumps({"unit": signal.unit, "symbol": signal.symbol, "meaning": signal.meaning})


def _signals_schema(signals: tuple[Signal, ...], number: int, kind: str) -> Schema:
    """Returns the schema of a flat message of doubles or floats.

    The name of the schema contains a number, because different responses may have different signals.
    """
    message = DescriptorProto(name=f"Signals{number}")
    file = FileDescriptorProto(name=f"{PACKAGE}/signals{number}.proto", package=PACKAGE, syntax="proto3")
    for index, signal in enumerate(signals):
        message.field.add(
            name=signal.name,
            number=index + 1,
            type=FieldDescriptorProto.TYPE_DOUBLE if kind == "<f8" else FieldDescriptorProto.TYPE_FLOAT,
            label=FieldDescriptorProto.LABEL_OPTIONAL,
        )
        # Path to field number `index` of the first message of the file, with Protobuf's tags 4 (a message in a file) and 2 (a
        # field in a message). The text becomes a comment above this field in the .proto file.
        file.source_code_info.location.add(
            path=(4, 0, 2, index),
            span=(index, 0, 0),
            leading_comments=f" {signal.symbol} [{signal.unit}]: {signal.meaning}\n",
        )
    file.message_type.append(message)
    return f"{PACKAGE}.{message.name}", SchemaEncoding.Protobuf, FileDescriptorSet(file=[file]).SerializeToString()


@np.errstate(over="ignore")  # a number too large for single precision becomes infinite
def _encode_samples(response: Response, kind: str) -> Iterator[bytes]:
    """Yields every sample as a protobuf message of doubles, `<f8`, or of floats, `<f4`.

    A double is encoded as its tag, (number << 3) | 1 as a varint, and 8 little-endian bytes; a float has wire type 5 and 4
    bytes. A flat message therefore has the same layout at every sample, and all samples form a single array of bytes.
    Protobuf's own writer would omit zeros. Messages that contain zeros are also valid, and preserve the layout, NaN and the
    value -0.0.
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
    """Returns a number as a varint: seven bits per byte, lowest bits first. The high bit of a byte is set if another byte
    follows.
    """
    low, rest = value & 0x7F, value >> 7
    return bytes([low | 0x80]) + _varint(rest) if rest else bytes([low])
