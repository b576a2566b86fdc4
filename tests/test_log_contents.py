"""Whatever in a log is deleted, doubled, added or changed, the proof is lost, or the thing is named as not checked."""

import json
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from mcap.records import Channel, Message, Schema

from models.common.errors import InputError
from sim.bump import main as bump
from sim.inspect.__main__ import main
from sim.inspect.findings import SINCE
from tests.commands import prose
from tests.rewriting import Contents, contents, written

Change = Callable[[Contents], Contents]


@pytest.fixture(scope="module")
def parts(tmp_path_factory) -> Contents:
    """A short run that leaves the ground."""
    folder = tmp_path_factory.mktemp("logs")
    options = ["--controller", "I", "--height", "0.2", "--speed", "25", "--duration", "0.12", "--logs", str(folder)]
    assert bump(options) == 0
    return contents(next(folder.glob("*.mcap")))


def leaves(value: Any) -> Iterator[tuple[str, Any]]:
    """The JSON value with one thing changed, everywhere in turn, and in words where."""
    if value is not None:
        yield "null", None
    if isinstance(value, dict):
        yield "+", {**value, "proved_best": True}
        for key, one in value.items():
            yield f"-{key}", {k: v for k, v in value.items() if k != key}
            yield from ((f"{key}.{where}", {**value, key: other}) for where, other in leaves(one))
    elif isinstance(value, list):
        yield "+", [*value, *(value[:1] or [0])]
        if value:
            yield "-", value[:-1]
            for i in {0, len(value) - 1}:
                yield from ((f"{i}.{where}", [*value[:i], other, *value[i + 1 :]]) for where, other in leaves(value[i]))
    elif isinstance(value, bool):
        yield "not", not value
    elif value is None:
        yield "1", 1.0
    elif isinstance(value, (int, float)):
        # More than any tolerance, and a peak frequency or a distance is not to be told from itself by less.
        yield "more", value * 1.01 + 1e-3 if isinstance(value, float) else value + 1
    else:
        yield "other", f"{value}x"


def texts(text: str) -> Iterator[tuple[str, str]]:
    """A claim with one thing changed, everywhere in turn."""
    try:
        value = json.loads(text)
    except ValueError:
        yield "other", f"{text}x"
        return
    yield "none", "no JSON"
    yield from ((where, json.dumps(other)) for where, other in leaves(value))


def of_records(parts: Contents) -> Iterator[tuple[str, Contents]]:
    """Every metadata record and every entry of it, and every option of the command line."""
    yield "+metadata", replace(parts, metadata=[*parts.metadata, ("remark", {"proved": "best"})])
    yield "+run", replace(parts, metadata=[*parts.metadata, ("run/II", dict(parts.metadata[-1][1]))])
    for i, (name, record) in enumerate(parts.metadata):
        rest = [*parts.metadata[:i], *parts.metadata[i + 1 :]]
        yield f"-{name}", replace(parts, metadata=rest)
        yield f"2 {name}", replace(parts, metadata=[*parts.metadata, (name, record)])
        yield f"{name}+", replace(parts, metadata=[*rest, (name, {**record, "proved_best": "true"})])
        for key, text in record.items():
            yield f"{name}-{key}", parts.without_claim(name, key)
            for where, other in texts(text):
                yield f"{name} {key}.{where}", parts.with_claim(name, key, lambda _, other=other: other)

    options = {
        "controller I": "controller II",
        "height 0.2": "height 0.21",
        "speed 25": "speed 25.1",
        "duration 0.12": "duration 0.13",
        "--height": "--length",
        "sim.bump": "sim.drive",
        "python -m": "python",
        "--duration": "--vehicle half_car --duration",
        "--controller I": "--controller I --track left",
        "--controller": "--timestep 5e-4 --controller",
        "--logs": "--help --logs",
        "--speed": "--unknown --speed",
    }
    for old, new in options.items():
        yield f"{old} is {new}", parts.with_claim("roadproof", "command_line", lambda text, a=old, b=new: text.replace(a, b, 1))


def of_attachments(parts: Contents) -> Iterator[tuple[str, Contents]]:
    """Every attachment, and everything in the result."""
    yield "+attachment", replace(parts, attachments=[*parts.attachments, ("proof.pdf", "application/pdf", b"best")])
    for i, (name, kind, data) in enumerate(parts.attachments):
        rest = [*parts.attachments[:i], *parts.attachments[i + 1 :]]
        yield f"-{name}", replace(parts, attachments=rest)
        yield f"2 {name}", replace(parts, attachments=[*parts.attachments, (name, kind, data)])
        yield f"{name} kind", replace(parts, attachments=[*rest, (name, "text/html", data)])
        yield f"{name} data", replace(parts, attachments=[*rest, (name, kind, data.replace(b"1", b"2", 1))])
    for where, other in leaves(json.loads(dict((name, data) for name, _, data in parts.attachments)["result.json"])):
        yield f"result.json {where}", parts.with_attachment("result.json", lambda _, other=other: json.dumps(other).encode())
    for runs in (3, "I", {"a": 1}, None, [], [[]]):

        def change(data: bytes, runs: Any = runs) -> bytes:
            return json.dumps({**json.loads(data), "runs": runs}).encode()

        yield f"runs {runs}", parts.with_attachment("result.json", change)


def of_channels(parts: Contents) -> Iterator[tuple[str, Contents]]:
    """Every channel and its messages."""
    free = max(channel.id for channel in parts.channels) + 1
    for channel in parts.channels:
        topic, mine = channel.topic, [message for message in parts.messages if message.channel_id == channel.id]
        others = [one for one in parts.channels if one is not channel]
        number = max(schema.id for schema in parts.schemas) + 1
        (schema,) = [schema for schema in parts.schemas if schema.id == channel.schema_id]

        def like(of: Channel = channel, **changed: Any) -> Channel:
            about = {key: getattr(of, key) for key in ("id", "topic", "message_encoding", "metadata", "schema_id")}
            return Channel(**(about | changed))

        def doubled(one: Channel, mine: list[Message] = mine) -> Contents:
            copies = [replace_message(message, channel_id=free) for message in mine]
            messages = sorted([*parts.messages, *copies], key=lambda message: message.log_time)
            return replace(parts, channels=[*parts.channels, one], messages=messages)

        without = [message for message in parts.messages if message.channel_id != channel.id]
        yield f"-{topic}", replace(parts, channels=others, messages=without)
        yield f"2 {topic}", doubled(like(id=free, topic=f"{topic}_proved"))
        foreign = Schema(id=number, name="evil.Response", encoding="protobuf", data=b"")
        twice = replace(parts, schemas=[*parts.schemas, foreign])
        yield f"2 {topic} foreign", replace(twice, channels=[*parts.channels, like(id=free, schema_id=number)])
        yield f"2 {topic} json", replace(parts, channels=[*parts.channels, like(id=free, message_encoding="json", schema_id=0)])
        yield f"{topic} encoding", replace(parts, channels=[*others, like(message_encoding="json")])
        yield f"{topic} about", replace(parts, channels=[*others, like(metadata={**channel.metadata, "unit": "N"})])
        renamed = Schema(id=number, name=f"{schema.name}2", encoding=schema.encoding, data=schema.data)
        other = [*others, like(schema_id=number)]
        yield f"{topic} schema name", replace(parts, schemas=[*parts.schemas, renamed], channels=other)
        longer = Schema(id=number, name=schema.name, encoding=schema.encoding, data=schema.data + schema.data)
        yield f"{topic} schema", replace(parts, schemas=[*parts.schemas, longer], channels=other)
        yield f"{topic} schema beside", replace(parts, schemas=[*parts.schemas, longer])
        yield f"{topic} empty", parts.with_messages(topic, lambda messages: [])
        middle = len(mine) // 2
        for what, changed in {
            "lost": [],
            "twice": [mine[middle]] * 2,
            "late": [replace_message(mine[middle], log_time=mine[middle].log_time + 1, publish_time=mine[middle].log_time + 1)],
            "published": [replace_message(mine[middle], publish_time=mine[middle].log_time + 1)],
            "numbered": [replace_message(mine[middle], sequence=1)],
            "cut": [replace_message(mine[middle], data=mine[middle].data[:-1])],
            "longer": [replace_message(mine[middle], data=mine[middle].data + mine[middle].data)],
            # The last bytes are the high ones of a number, or of a text.
            "changed": [replace_message(mine[middle], data=mine[middle].data[:-2] + bytes([mine[middle].data[-2] ^ 17, 63]))],
        }.items():
            kept = [*mine[:middle], *changed, *mine[middle + 1 :]]
            yield f"{topic} {what}", parts.with_messages(topic, lambda _, kept=kept: kept)


def replace_message(message: Message, **changed: Any) -> Message:
    """A message with something else in it."""
    about = {key: getattr(message, key) for key in ("channel_id", "log_time", "data", "publish_time", "sequence")}
    return Message(**(about | changed))


def proved(parts: Contents, path: Path, capsys) -> bool:
    """Whether a log of these contents is. What is no log at all is refused; whatever else goes wrong is an error of ours."""
    path.write_bytes(written(parts))
    try:
        return main([str(path)]) == 0
    except InputError as error:
        assert "no log of Roadproof's" in str(error)  # noqa: PT017 - any other is raised
        return False
    finally:
        capsys.readouterr()


def named(what: str) -> bool:
    """Whether the line on what is not checked names it: versions, and the folder of the logs, which ends the command line."""
    return what == "roadproof command_line.other" or (what.startswith("roadproof versions.") and what.endswith(".other"))


def survivors(parts: Contents, path: Path, capsys, some: Callable[[str], bool]) -> list[str]:
    """The changes that leave a log proved, though nothing says that what they change is not checked."""
    changes = [*of_records(parts), *of_attachments(parts), *of_channels(parts)]
    return [what for what, changed in changes if some(what) and not named(what) and proved(changed, path, capsys)]


def test_honest_log_is_proved_and_says_what_is_not_checked(parts, tmp_path, capsys):
    """Written anew with nothing changed it is proved: nothing below fails for another reason. And what no log shows is said."""
    path = tmp_path / "log.mcap"
    path.write_bytes(written(parts))
    assert main([str(path), "-v"]) == 0
    printed = prose(capsys.readouterr().out)
    assert printed.count(" note ") == 1
    assert (
        " note unchecked: who wrote it and when, with which versions and library, in which folders vehicle file and log lay, "
        "what a road file held before it was read, the index behind the data, which players ask, whether a controller keeps "
        "goals of its section "
    ) in printed


def test_change_of_contents_is_found(parts, tmp_path, capsys):
    """Some of the changes of the attack below, one of each sort."""
    some = (
        "+metadata",
        "run/I half_step.difference.more",
        "result.json runs.0.half_step.null",
        "run/I stability.other",
        "run/I designed.not",
        "run/I+",
        "run/I certificate.-norm",
        "run/I certificate.bound.null",
        "run/I samples.none",
        "controller I is controller II",
        "speed 25 is speed 25.1",
        "+attachment",
        "result.json +",
        "runs {'a': 1}",
        "2 /mujoco foreign",
        "/events changed",
        "-/events",
        "-/difference",
        "/scene changed",
    )
    assert set(some) <= {what for what, _ in [*of_records(parts), *of_attachments(parts), *of_channels(parts)]}
    assert survivors(parts, tmp_path / "log.mcap", capsys, lambda what: what in some) == []


@pytest.mark.attack
@pytest.mark.parametrize("share", [1])
def test_every_change_is_found(share, parts, tmp_path, capsys):
    """Of an eighth of all that a log holds, one change of each sort is found: deleted, doubled, added, another number or text."""
    order = [what for what, _ in [*of_records(parts), *of_attachments(parts), *of_channels(parts)]]
    assert len(order) > 400
    sorts = {re.split(r"[. ]|\d+", what)[-1]: what for i, what in enumerate(order) if i % 8 == share}
    mine = {*sorts.values()}
    older = {what for what in order if what.rpartition(".-")[2] in SINCE}  # logs from before these keys lack them, and are logs
    assert set(survivors(parts, tmp_path / "log.mcap", capsys, lambda what: what in mine)) <= older
