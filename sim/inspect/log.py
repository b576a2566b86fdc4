"""A log of ours, read back: the claims about each of its runs, and its responses.

The reverse of `sim.recording.mcap_writer` and `sim.recording.run_records`, which name the topics and the claims.
"""

import json
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from google.protobuf.descriptor_pb2 import FileDescriptorSet

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.files import reading
from sim.recording.mcap_writer import PACKAGE
from sim.recording.run_log import CONTINUOUS, FORMAT, MUJOCO, SAMPLED

RESPONSES = (MUJOCO, SAMPLED, CONTINUOUS)
GIVE = "give an .mcap file that a run has written"


@dataclass(frozen=True, eq=False)
class Samples:
    """A response in a log.

    Attributes:
        names: names of the S signals.
        times: times of the samples [ns], shape (T,).
        values: shape (T, S).
    """

    names: tuple[str, ...]
    times: Array
    values: Array


@dataclass(frozen=True, eq=False)
class RecordedRun:
    """A run in a log.

    Attributes:
        name: name of the run.
        claims: metadata as text, by key, see `sim.recording.run_records.run_log`.
        responses: responses that the log contains, by their names in `RESPONSES`.
    """

    name: str
    claims: Mapping[str, str]
    responses: Mapping[str, Samples]

    def claim(self, key: str) -> Any:
        """Returns the claim of a key that holds JSON.

        Raises:
            InputError: the log has no such claim, or it is not JSON.
        """
        if key not in self.claims:
            raise InputError(f"the log claims no {key}")
        return read_json(self.claims[key], key)


@dataclass(frozen=True, eq=False)
class Log:
    """A log.

    Attributes:
        path: path of the file.
        metadata: metadata of the whole log, as text by key.
        attachments: contents of the attachments, by name.
        runs: runs in the order of the file.
        messages: number of messages, in all channels.
    """

    path: Path
    metadata: Mapping[str, str]
    attachments: Mapping[str, bytes]
    runs: tuple[RecordedRun, ...]
    messages: int

    @property
    def timestep(self) -> float:
        """Returns the timestep of its runs [s]."""
        return float(self.metadata["timestep"])

    @property
    def result(self) -> dict[str, Any]:
        """Returns the attached result of the command, a JSON object.

        Raises:
            InputError: the result is not attached, or is not JSON.
        """
        if "result.json" not in self.attachments:
            raise InputError("result.json is not attached")
        return read_json(self.attachments["result.json"], "result.json")

    def attached(self, run: RecordedRun, claim: str) -> bytes:
        """Returns the attachment that a run's claim names.

        Raises:
            InputError: the file is not attached.
        """
        name = run.claims.get(claim, "")
        if name not in self.attachments:
            raise InputError(f"its {claim.replace('_', ' ')} is not attached")
        return self.attachments[name]


def read_log(path: Path) -> Log:
    """Reads a log; the MCAP library compares the checksums of its chunks, attachments and data.

    Raises:
        InputError: the file cannot be read, is not MCAP, is damaged, has another version, or was not written by Roadproof.
    """
    from mcap.records import Attachment, Channel, Message, Metadata, Schema
    from mcap.stream_reader import StreamReader

    metadata: dict[str, Mapping[str, str]] = {}
    attachments: dict[str, bytes] = {}
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    messages: dict[int, list[Message]] = defaultdict(list)
    with reading(path, "log", GIVE), path.open("rb") as stream:
        for record in StreamReader(stream, validate_crcs=True).records:
            match record:
                case Metadata():
                    metadata[record.name] = record.metadata
                case Attachment():
                    attachments[record.name] = record.data
                case Schema():
                    schemas[record.id] = record
                case Channel():
                    channels[record.id] = record
                case Message():
                    messages[record.channel_id].append(record)
        if PACKAGE not in metadata:
            raise InputError(f"Roadproof has not written it; {GIVE}")
        common = metadata[PACKAGE]
        if common.get("format") != str(FORMAT):
            versions = read_json(common.get("versions", "{}"), "versions")
            raise InputError(
                f"is of format {common.get('format')}, written by Roadproof {versions.get('roadproof', 'of an early version')}; "
                f"this version reads format {FORMAT}: take the version that wrote it"
            )
        topics = {channel.topic: (schemas[channel.schema_id], messages[channel.id]) for channel in channels.values()}
        names = [name.removeprefix("run/") for name in metadata if name.startswith("run/")]
        runs = []
        for name in names:
            prefix = f"/{name}/" if len(names) > 1 else "/"
            responses = {one: _samples(*topics[prefix + one]) for one in RESPONSES if prefix + one in topics}
            runs.append(RecordedRun(name, metadata[f"run/{name}"], responses))
    return Log(path, common, attachments, tuple(runs), sum(map(len, messages.values())))


def read_json(text: str | bytes, what: str) -> Any:
    """Returns JSON from a log.

    Raises:
        InputError: the text is not JSON.
    """
    try:
        return json.loads(text)
    except ValueError as error:
        raise InputError(f"{what} is not JSON") from error


def _samples(schema: Any, messages: list[Any]) -> Samples:
    """Returns the messages of a topic as numbers. `mcap_writer` writes every field of every message, in order."""
    fields = FileDescriptorSet.FromString(schema.data).file[0].message_type[0].field
    times = np.array([message.log_time for message in messages], dtype=np.int64)
    if not messages:
        return Samples(tuple(field.name for field in fields), times, np.zeros((0, len(fields))))
    rows = np.frombuffer(b"".join(message.data for message in messages), np.uint8).reshape(len(messages), -1)
    tags = [1 if field.number < 16 else 2 for field in fields]  # bytes before each number
    starts = np.cumsum(tags) + 8 * np.arange(len(fields))
    values = [np.ascontiguousarray(rows[:, start : start + 8]).view("<f8") for start in starts]
    return Samples(tuple(field.name for field in fields), times, np.hstack(values).astype(float))
