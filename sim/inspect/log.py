"""A log of ours, read back: what is claimed of each of its runs, and its responses. Nothing of it is believed here, only read.

The reverse of `sim.recording.mcap_writer` and `sim.recording.run_records`: names of topics and claims are theirs.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorSet
from google.protobuf.message import DecodeError

from models.common.arrays import Array
from models.common.errors import InputError
from sim.inspect.mcap_contents import Logged, McapContents
from sim.inspect.mcap_reader import read_mcap
from sim.recording.mcap_writer import PACKAGE
from sim.recording.run_log import CONTINUOUS, FORMAT, MUJOCO, NAME, SAMPLED, SINCE

RESPONSES = (MUJOCO, SAMPLED, CONTINUOUS)
MOST_JSON = 8 * 2**20  # bytes; parsed, it may take twenty times as much
MOST_ABOUT = 4096  # characters that say unit, symbol and meaning of a signal
MOST_RUNS = 1000


@dataclass(frozen=True, eq=False)
class Samples:
    """A response as it was logged.

    Attributes:
        names: of its signals, S of them.
        units: what their channel says of their units, by name.
        times: [ns], shape (T,), uint64.
        values: shape (T, S).
    """

    names: tuple[str, ...]
    units: Mapping[str, Any]
    times: Array
    values: Array


@dataclass(frozen=True, eq=False)
class RecordedRun:
    """Logged run.

    Attributes:
        name: its name.
        claims: its metadata as text, by key, see `sim.recording.run_records.run_log`.
        responses: readable ones of `RESPONSES`.
        damage: of the unreadable ones, in words.
    """

    name: str
    claims: Mapping[str, str]
    responses: Mapping[str, Samples]
    damage: tuple[str, ...]

    def claim(self, key: str) -> Any:
        """Returns the claim of a key that holds JSON.

        Raises:
            InputError: there is no such claim, or it is no JSON.
        """
        if key not in self.claims:
            raise InputError(f"the log claims no {key}")
        return read_json(self.claims[key], key)


@dataclass(frozen=True, eq=False)
class Recorded:
    """A log.

    Attributes:
        path: its file.
        file: what could be read of it.
        runs: in the order of the file.
    """

    path: Path
    file: McapContents
    runs: tuple[RecordedRun, ...]

    @property
    def metadata(self) -> Mapping[str, str]:
        """Returns the metadata of the whole log, as text by key."""
        return self.file.metadata[PACKAGE]

    @property
    def attachments(self) -> Mapping[str, bytes]:
        """Content by name."""
        return {name: attached.data for name, attached in self.file.attachments.items()}

    @property
    def result(self) -> dict[str, Any]:
        """Returns the attached result of the command.

        Raises:
            InputError: it is not attached, is no object, or is empty.
        """
        if "result.json" not in self.file.attachments:
            raise InputError("result.json is not attached")
        result = read_json(self.file.attachments["result.json"].data, "result.json")
        if not isinstance(result, dict) or not result:
            raise InputError("result.json is empty, or no object")
        return result


def read_log(path: Path) -> Recorded:
    """Reads a log as far as it can be read.

    Raises:
        InputError: it cannot be opened, is no MCAP file, or none that a run of ours has written.
    """
    file = read_mcap(path)
    names = [name.removeprefix("run/") for name in file.metadata if name.startswith("run/")]
    if PACKAGE not in file.metadata:
        cut = f" (it is {file.damage[0]})" if file.damage else ""
        raise InputError(f"log {path}: no log of Roadproof's{cut}; give an .mcap file that a run has written")
    if len(names) > MOST_RUNS or not all(NAME.fullmatch(name) for name in names):
        raise InputError(f"log {path}: no log of Roadproof's: its runs have no names that ours could have")
    runs = tuple(_run(file, name, f"/{name}/" if len(names) > 1 else "/") for name in names)
    return Recorded(path, file, runs)


def read_json(text: str | bytes, what: str) -> Any:
    """JSON, with finite numbers, from a log.

    Raises:
        InputError: it is not, or absurdly large or deep.
    """
    if len(text) > MOST_JSON:
        raise InputError(f"{what} is {len(text)} bytes of JSON; {MOST_JSON} are allowed")
    try:
        return json.loads(text, object_pairs_hook=_once, parse_constant=_no_number, parse_float=_finite, parse_int=_whole)
    except (ValueError, RecursionError) as error:  # no JSON, no UTF-8, a number of 5000 digits; brackets in brackets in ...
        raise InputError(f"{what} is no JSON") from error


def timestep(metadata: Mapping[str, str]) -> float:
    """The timestep of a log [s].

    Raises:
        InputError: it has none.
    """
    try:
        value = float(metadata.get("timestep", ""))
    except ValueError:
        value = math.nan
    if not 1e-9 <= value <= 1e3:  # NaN is in no range
        raise InputError("the log has no timestep that it could have been run with")
    return value


def _run(file: McapContents, name: str, prefix: str) -> RecordedRun:
    responses, damage = {}, []
    for response in RESPONSES:
        topic = file.channels.get(prefix + response)
        if topic is None:
            damage.append(f"the {response} response is missing")
            continue
        try:
            responses[response] = _samples(topic)
        except InputError as error:
            damage.append(f"the {response} response cannot be read: {error}")
    return RecordedRun(name, file.metadata[f"run/{name}"], responses, tuple(damage))


def _samples(topic: Logged) -> Samples:
    """A topic's messages as numbers. A row is laid out as `sim.recording.mcap_writer` writes it: all fields, in their order."""
    if topic.schema is None or (topic.encoding, topic.schema[1]) != ("protobuf", "protobuf"):
        raise InputError("it is not encoded as protobuf")
    names = _fields(topic.schema[2])
    rows, values, column = topic.rows(), [], 0
    for number in range(1, len(names) + 1):
        tag = number << 3 | 1
        head = [tag] if tag < 128 else [tag & 0x7F | 0x80, tag >> 7]
        value = rows[:, column + len(head) : column + len(head) + 8]
        if value.shape[1] != 8 or np.any(rows[:, column : column + len(head)] != head):
            raise InputError("its messages do not hold the fields of its schema")
        values.append(np.ascontiguousarray(value).view("<f8"))
        column += len(head) + 8
    if column != rows.shape[1]:
        raise InputError("its messages hold more than the fields of its schema")
    units = {name: _unit(topic.metadata.get(name, "null")) for name in names}
    return Samples(names, units, topic.times, np.hstack(values).astype(float) if len(rows) else np.zeros((0, len(names))))


def _unit(text: str) -> Any:
    """Returns the unit in a channel's description of a signal, or None if it has none."""
    about = read_json(text, "what is said of a signal") if len(text) <= MOST_ABOUT else None
    return about.get("unit") if isinstance(about, dict) else None


def _fields(schema: bytes) -> tuple[str, ...]:
    """Names of the fields of a flat message of doubles, numbered from 1."""
    try:
        files = FileDescriptorSet.FromString(schema).file
    except DecodeError as error:
        raise InputError("its schema is no protobuf") from error
    messages = files[0].message_type if len(files) == 1 else []
    fields = messages[0].field if len(messages) == 1 else []
    names = tuple(field.name for field in fields)
    doubles = all(field.type == FieldDescriptorProto.TYPE_DOUBLE for field in fields)
    if not names or len(names) > 1000 or len(set(names)) < len(names) or not doubles:
        raise InputError("its schema is no flat message of doubles")
    if [field.number for field in fields] != list(range(1, len(names) + 1)):
        raise InputError("its schema does not number its fields as ours do")
    return names


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    entries = dict(pairs)
    if len(entries) < len(pairs):
        raise ValueError("a key is given twice")
    return entries


def _no_number(text: str) -> None:
    raise ValueError(f"{text} is no JSON")


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError("not finite")
    return value


def _whole(text: str) -> int:
    value = int(text)
    if abs(value) >= 2**64:
        raise ValueError("beyond every whole number of ours")
    return value


def is_current(log: Recorded) -> bool:
    """Returns True if a log has this format, False if it is older than numbered formats.

    Raises:
        InputError: the log has another format, or no format number in spite of younger claims.
    """
    number = log.metadata.get("format")
    if number is not None and number != str(FORMAT):
        raise InputError(
            f"the log is of format {number[:20]!r}, and this version reads {FORMAT} and older; take the one that wrote it"
        )
    younger = [key for run in log.runs for key in SINCE if key in run.claims]
    if number is None and younger:
        raise InputError(f"the log is of no format, and claims {younger[0]}, which no log before formats does")
    return number is not None
