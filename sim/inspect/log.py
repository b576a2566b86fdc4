"""Reads a log: the claims about each run, which are its logged properties and results, and the responses of each run.

`sim.recording.mcap_writer` and `sim.recording.run_records` write the log and define its topics and claims.
"""

import json
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from google.protobuf.descriptor_pb2 import FileDescriptorSet

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.files import reading
from sim.recording.mcap_writer import PACKAGE
from sim.recording.run_log import CONTINUOUS, FORMAT, MEASURED_TOPIC, MUJOCO, SAMPLED

RESPONSES = (MUJOCO, SAMPLED, CONTINUOUS, MEASURED_TOPIC)
GIVE = "give an .mcap file that a Roadproof command wrote"


class Part(dict[str, Any]):
    """Dictionary that contains a part of a log. Access to a missing key raises an InputError, whose text contains the name of
    the key.
    """

    def __missing__(self, key: str) -> NoReturn:
        raise InputError(f"the log has no {key!r}")


@dataclass(frozen=True, eq=False)
class Samples:
    """A logged response.

    Attributes:
        names: names of the S signals.
        times: times of the samples [ns], shape (T,).
        values: signals in SI units, with a row for each sample and a column for each signal, shape (T, S).
    """

    names: tuple[str, ...]
    times: Array
    values: Array


@dataclass(frozen=True, eq=False)
class RecordedRun:
    """A logged run.

    Attributes:
        name: name of the run.
        claims: logged properties and results of the run as text, by key; see `sim.recording.run_records.run_log`.
        responses: logged responses by name; see `RESPONSES`.
    """

    name: str
    claims: Mapping[str, str]
    responses: Mapping[str, Samples]

    def claim(self, key: str) -> Any:
        """Returns the value of a claim whose text is in JSON."""
        return json.loads(self.claims[key])


@dataclass(frozen=True, eq=False)
class Log:
    """Content of a log file.

    Attributes:
        path: path of the file.
        metadata: metadata of the whole log as text, by key.
        attachments: contents of the attachments, by name.
        runs: logged runs in the order of the file.
        messages: total number of messages in all channels.
    """

    path: Path
    metadata: Mapping[str, str]
    attachments: Mapping[str, bytes]
    runs: tuple[RecordedRun, ...]
    messages: int

    @property
    def timestep(self) -> float:
        """Timestep of the logged runs [s]."""
        return float(self.metadata["timestep"])

    @property
    def versions(self) -> dict[str, str]:
        """Versions of the packages that wrote the log, by name of the package."""
        return json.loads(self.metadata.get("versions", "{}"))


def read_log(path: Path) -> Log:
    """Reads a log. The MCAP library checks the checksums of the chunks, attachments and data of the file.

    Raises:
        InputError: the file cannot be read, is not an MCAP file, is damaged, has another format version, or was not written by
            Roadproof.
    """
    from mcap.records import Attachment, Channel, Message, Metadata, Schema
    from mcap.stream_reader import StreamReader

    records, messages = defaultdict[type, list[Any]](list), defaultdict[int, list[Any]](list)
    with reading(path, "log", GIVE), path.open("rb") as stream:
        for record in StreamReader(stream, validate_crcs=True).records:
            records[type(record)].append(record)
        metadata = {one.name: one.metadata for one in records[Metadata]}
        if PACKAGE not in metadata:
            raise InputError(f"Roadproof did not write this file; {GIVE}")
        for one in records[Message]:
            messages[one.channel_id].append(one)
        schemas = {one.id: one for one in records[Schema]}
        topics = {one.topic: (schemas[one.schema_id], messages[one.id]) for one in records[Channel]}
        names = [name.removeprefix("run/") for name in metadata if name.startswith("run/")]
        runs = []
        for name in names:
            prefix = f"/{name}/" if len(names) > 1 else "/"
            responses = Part({one: _samples(*topics[prefix + one]) for one in RESPONSES if prefix + one in topics})
            runs.append(RecordedRun(name, Part(metadata[f"run/{name}"]), responses))
        attachments = Part({one.name: one.data for one in records[Attachment]})
        log = Log(path, metadata[PACKAGE], attachments, tuple(runs), len(records[Message]))
        if (written := log.metadata.get("format")) != str(FORMAT):
            raise InputError(
                f"the log has format {written} of Roadproof {log.versions.get('roadproof', 'in an early version')}, "
                f"but this version reads format {FORMAT}; use the version of Roadproof that wrote the log"
            )
    return log


def _samples(schema: Any, messages: list[Any]) -> Samples:
    """Returns the numbers in all messages of an MCAP topic. All messages have the same fields in the same order, because
    `mcap_writer` always writes all fields.
    """
    fields = FileDescriptorSet.FromString(schema.data).file[0].message_type[0].field
    times = np.array([message.log_time for message in messages], dtype=np.int64)
    tags = [1 if field.number < 16 else 2 for field in fields]  # number of bytes of the tag before each number
    starts = np.cumsum(tags) + 8 * np.arange(len(fields))
    rows = np.frombuffer(b"".join(message.data for message in messages), np.uint8).reshape(-1, starts[-1] + 8)
    values = [np.ascontiguousarray(rows[:, start : start + 8]).view("<f8") for start in starts]
    return Samples(tuple(field.name for field in fields), times, np.hstack(values).astype(float))
