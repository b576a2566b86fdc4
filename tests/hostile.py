"""Logs that no run has written: cut, flipped, and forged on purpose, each from a whole one and a seed."""

import json
import struct
import zlib
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import lz4.frame
import numpy as np
import zstandard
from mcap.opcode import Opcode
from mcap.records import Channel, Message, Schema
from mcap.writer import CompressionType

from tests.rewriting import Contents, written

SIZES = (0, 1, 7, 255, 2**16, 2**24, 2**31 - 1, 2**31, 2**32 - 1, 2**33, 2**40, 2**62, 2**63 - 1, 2**63, 2**64 - 9, 2**64 - 1)
DEEP = "[" * 100_000
TEXTS = (
    "",
    "null",
    "true",
    "{}",
    "[]",
    "[[]]",
    "0",
    "-1",
    "1e9",
    "1e308",
    "1e999",
    "NaN",
    "Infinity",
    "9" * 5000,
    '"x"',
    '"' + "y" * 10**6,
    DEEP,
    '{"a":' * 50_000,
    "[" + "1," * 10**6 + "1]",
    "../../etc/passwd",
    "\x1b[2J\x1b]0;x\x07",
    "\ud7ff\u202e",
    "'; rm -rf /; '",
    '{"type": "bump"}',
    '{"type": "iso8608"}',
    "[1e308, -1e308]",
    "[[1e308, 0], [0, 1e308]]",
    "[null]",
    '"\\ud800"',
    "\x00" * 1000,
)
ROADS = (
    {
        "type": "iso8608",
        "class": "H",
        "seed": 2**62,
        "lowest": 0.01,
        "highest": 10.0,
        "roughness": 16e-6 * 4**7,
        "speed": 200.0,
        "track_width": 10.0,
        "length": 1e6,
        "factor": 1.0,
    },
    {"type": "multisine", "omega": [1e300] * 1000, "amplitudes": [1e300] * 1000, "phases": [1e300] * 1000, "speed": 1.0},
    {"type": "sinusoid", "omega": [1.0] * 10**5, "amplitudes": [1.0], "phases": [0.0], "speed": 1.0},
    {"type": "sinusoid", "omega": [0.0], "amplitudes": [1e12], "phases": [0.0], "speed": 0.0},
    {"type": "bump", "height": 100.0, "length": 1e-3, "speed": 1e3, "track": "both"},
    {"type": "bump", "height": 1e-300, "length": 1e4, "speed": 1e-3, "track": "both"},
    {"type": "watts_hump", "height": 1e-6, "length": 1e4, "speed": 1e-3, "factor": 1e300},
    {"type": "pothole", "depth": 100.0, "length": 1e4, "edge": 1e-3, "speed": 1e3, "track": "../x"},
    {"type": "sweep", "amplitude": 100.0, "lowest": 0.01, "highest": 100.0, "duration": 1e4, "speed": 1e3},
    {"type": "profile", "source": "../../../x", "speed": 20.0},
    {"type": ["bump"]},
    {"type": {}},
    [],
    None,
    "bump",
    1e300,
)
IMPLEMENTATIONS = (
    {"delay": 100_000},
    {"delay": 100_000, "noise": {"sprung_velocity": 1.0}},
    {"delay": 10**30},
    {"delay": -1},
    {"sample_period": 1e9},
    {"sample_period": 1e-9},
    {"sample_period": "x"},
    {"noise": {"../x": 1.0}},
    {"noise": []},
    {"noise": {"sprung_velocity": 1e12}},
    {"quantisation": {"sprung_velocity": 1e-300}},
    {"seed": 2**70},
    {"a": DEEP[:100]},
    [],
    7,
)
TOMLS = (
    ".".join("a" for _ in range(100_000)) + " = 1",
    "[" + ".".join("a" for _ in range(100_000)) + "]",
    "a = " + "[" * 100_000,
    "a = " + "9" * 100_000,
    "a = 0x" + "f" * 100_000,
    "\n".join(f"a{i} = 1" for i in range(50_000)),
    'type = "../../x"',
    'type = "quarter_car"\nparameters = 1\nperformance = 2',
    'type = ["quarter_car"]',
    "\x00",
)
NUMBERS = ("1e-6", "1e12", "1e300", "-1", "0", "nan", "inf", "1e-300", "0x" + "f" * 5000, "true", '"x"', "[]", "9" * 400)


def hostile(whole: bytes, parts: Contents, rng: np.random.Generator) -> bytes:
    """A log that something is wrong with, or several things: a raw one's bytes, or one forged with right checksums."""
    if rng.random() < 0.45:
        return _raw(whole, rng)
    for _ in range(int(rng.integers(1, 4))):
        parts = _choice(rng, FORGERIES)(parts, rng)
    compression = _choice(rng, (CompressionType.ZSTD, CompressionType.ZSTD, CompressionType.LZ4, CompressionType.NONE))
    forged = written(parts, int(_choice(rng, (500, 5000, 10**6))), compression, rng.random() < 0.9)
    return _raw(forged, rng) if rng.random() < 0.2 else forged


def _choice(rng: np.random.Generator, options):
    return options[int(rng.integers(len(options)))]


# --- bytes ----------------------------------------------------------------------------------------------------------------


def _raw(data: bytes, rng: np.random.Generator) -> bytes:
    for _ in range(int(rng.integers(1, 4))):
        data = _choice(rng, RAW)(data, rng)
    return data


def _cut(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: int(rng.integers(0, len(data) + 1))]


def _flip(data: bytes, rng: np.random.Generator) -> bytes:
    changed = bytearray(data)
    for _ in range(int(rng.integers(1, 20))):
        if changed:
            changed[int(rng.integers(len(changed)))] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def _overwrite(data: bytes, rng: np.random.Generator) -> bytes:
    at, width = int(rng.integers(0, len(data) + 1)), _choice(rng, (1, 2, 4, 8))
    return data[:at] + (_choice(rng, SIZES) % 2 ** (8 * width)).to_bytes(width, "little") + data[at + width :]


def _insert(data: bytes, rng: np.random.Generator) -> bytes:
    at = int(rng.integers(0, len(data) + 1))
    return data[:at] + rng.bytes(int(rng.integers(1, 100))) + data[at:]


def _lengthen(data: bytes, rng: np.random.Generator) -> bytes:
    """A record whose length is a lie."""
    records = split(data)
    if not records:
        return data
    at, _ = _choice(rng, records)
    return data[: at + 1] + struct.pack("<Q", _choice(rng, SIZES)) + data[at + 9 :]


def _shuffle(data: bytes, rng: np.random.Generator) -> bytes:
    """Records swapped, doubled or dropped."""
    records = split(data)
    if len(records) < 2:
        return data
    pieces = [data[at : at + size] for at, size in records]
    end = data[records[-1][0] + records[-1][1] :]
    a, b = (int(i) for i in rng.integers(len(pieces), size=2))
    what = int(rng.integers(3))
    if what == 0:
        pieces[a], pieces[b] = pieces[b], pieces[a]
    elif what == 1:
        pieces.insert(a, pieces[b])
    else:
        del pieces[a]
    return data[:8] + b"".join(pieces) + end


def _inner(data: bytes, rng: np.random.Generator) -> bytes:
    """A chunk whose records have been tampered with, with a right checksum: a hostile length, a flip, a cut within."""
    chunks = [(at, size) for at, size in split(data) if data[at] == Opcode.CHUNK]
    if not chunks:
        return data
    at, size = _choice(rng, chunks)
    start, end, _, _, length = struct.unpack_from("<QQQII", data, at + 9)
    body = data[at + 9 + 32 + length + 8 : at + size]
    try:
        inner = zstandard.ZstdDecompressor().stream_reader(body).read(2**24) if length else body
    except zstandard.ZstdError:
        return data
    inner = _choice(rng, (_overwrite, _flip, _cut, _insert))(inner, rng)
    return data[:at] + chunk(start, end, inner, len(inner)) + data[at + size :]


def _bomb(data: bytes, rng: np.random.Generator) -> bytes:
    """A chunk that grows without bound, whatever it says of its size."""
    at, _ = _choice(rng, split(data) or [(min(8, len(data)), 0)])
    says = _choice(rng, (100, 2**20, 2**26, 2**26 + 1, 2**40, 2**64 - 1))
    return data[:at] + _choice(rng, BOMBS)(says) + data[at:]


def chunk(start: int, end: int, records: bytes, says: int, compression: str = "zstd", body: bytes | None = None) -> bytes:
    """A chunk record that says of itself how large it is."""
    if body is None:
        body = zstandard.ZstdCompressor().compress(records)
    name = compression.encode()
    head = struct.pack("<QQQII", start, end, says, zlib.crc32(records), len(name)) + name
    content = head + struct.pack("<Q", len(body)) + body
    return struct.pack("<BQ", Opcode.CHUNK, len(content)) + content


def split(data: bytes) -> list[tuple[int, int]]:
    """Place and size of every record of a file, as far as they can be told."""
    found, at = [], 8
    while at + 9 <= len(data):
        size = 9 + int.from_bytes(data[at + 1 : at + 9], "little")
        if at + size > len(data):
            break
        found.append((at, size))
        at += size
    return found


_ZEROS = zstandard.ZstdCompressor().compress(bytes(2**28))
_UNSAID = zstandard.ZstdCompressor(write_content_size=False).compress(bytes(2**28))
_LIES = _ZEROS[:4] + bytes([0xE0]) + struct.pack("<Q", 2**50) + _ZEROS[9:]  # a frame that announces a petabyte
_LZ4 = lz4.frame.compress(bytes(2**28))
_EMPTY = struct.pack("<BQHIQQ", Opcode.MESSAGE, 22, 1, 0, 0, 0) * 500_000  # messages of nothing, 31 bytes each
_EMPTIES = zstandard.ZstdCompressor().compress(_EMPTY)
BOMBS: tuple[Callable[[int], bytes], ...] = (
    lambda says: chunk(0, 0, b"", says, body=_ZEROS),
    lambda says: chunk(0, 0, b"", says, body=_UNSAID),
    lambda says: chunk(0, 0, b"", says, body=_LIES),
    lambda says: chunk(0, 0, b"", says, "lz4", body=_LZ4),
    lambda says: chunk(0, 0, _EMPTY, len(_EMPTY), body=_EMPTIES),
    lambda says: chunk(0, 0, b"", says, "../../x", body=b""),
)
RAW = (_cut, _flip, _flip, _overwrite, _insert, _lengthen, _lengthen, _shuffle, _inner, _inner, _bomb)


# --- contents -------------------------------------------------------------------------------------------------------------


def _claim(parts: Contents, rng: np.random.Generator) -> Contents:
    """Any entry of any metadata, anything else, nothing, or another's."""
    name, record = _choice(rng, parts.metadata)
    if not record:
        return parts
    key = _choice(rng, list(record))
    if rng.random() < 0.2:
        return parts.without_claim(name, key)
    if rng.random() < 0.3:
        return parts.with_claim(name, key, lambda text: _mutated(text, rng))
    return parts.with_claim(name, key, lambda text: _choice(rng, TEXTS))


def _mutated(text: str, rng: np.random.Generator) -> str:
    """JSON in which one number, somewhere, is another."""
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        return text
    holder: Any = {"": value}
    key: Any = ""
    while isinstance(holder[key], (dict, list)) and holder[key]:
        holder = holder[key]
        key = _choice(rng, list(holder) if isinstance(holder, dict) else range(len(holder)))
    holder[key] = _choice(rng, (0, -1, 1e-300, 1e300, 2**70, None, True, "x", [], {}, 1e9, [1e308] * 100, 10**400))
    try:
        return json.dumps(value)
    except (ValueError, RecursionError):
        return text


def _specific(parts: Contents, rng: np.random.Generator) -> Contents:
    """Returns what a run is made from: absurd, but of the right form."""
    name = _choice(rng, parts.metadata)[0]
    key, options = _choice(
        rng,
        (
            ("road", [json.dumps(road) for road in ROADS]),
            ("implementation", [json.dumps(one) for one in IMPLEMENTATIONS]),
            ("samples", [str(number) for number in (*SIZES, 10**400, -5, 1.5)]),
            ("timestep", ["1e9", "0", "nan", "-1", "1e-300", "inf", "1e-9", "0.02", "9" * 400]),
            ("road_file", ["../../x", "vehicle.toml", "result.json", "/dev/zero"]),
            (
                "gain",
                [json.dumps([[1e12 * rng.standard_normal(), 1e12]]), "[[1e12, 1e12]]", "[[0, 0]]", json.dumps([[1e308] * 1000])],
            ),
            ("name", ["passive", "state", "../../x", "all"]),
            ("certificate", [json.dumps({"X": rng.standard_normal((n, n)).tolist(), "bound": 1e-300}) for n in (1, 4, 300)]),
        ),
    )
    record = dict(parts.metadata)[name]
    return parts.with_claim(name, key, lambda text: _choice(rng, options)) if key in record else parts


def _attachment(parts: Contents, rng: np.random.Generator) -> Contents:
    """An attachment that is another, doubled, gone, or called like a path."""
    if not parts.attachments:
        return parts
    name, kind, data = _choice(rng, parts.attachments)
    what = int(rng.integers(5))
    if what == 0:
        return replace(parts, attachments=[one for one in parts.attachments if one[0] != name])
    if what == 1:
        return replace(parts, attachments=[*parts.attachments, ("../../escaped", kind, data), (name, kind, b"")])
    if what == 2:
        return parts.with_attachment(name, lambda data: _choice(rng, TEXTS).encode("utf-8", "surrogatepass"))
    if what == 3 and data:
        return parts.with_attachment(name, lambda data: _flip(data, rng))
    return parts.with_attachment(name, lambda data: _mutated(data.decode("utf-8", "replace"), rng).encode())


def _vehicle(parts: Contents, rng: np.random.Generator) -> Contents:
    """A vehicle file that is a trap, or has an absurd number."""
    if rng.random() < 0.4:
        return parts.with_attachment("vehicle.toml", lambda data: _choice(rng, TOMLS).encode())

    def absurd(data: bytes) -> bytes:
        lines = data.decode("utf-8", "replace").splitlines()
        numbered = [i for i, line in enumerate(lines) if " = " in line and not line.startswith("type")]
        for _ in range(int(rng.integers(1, 4))):
            if numbered:
                i = _choice(rng, numbered)
                lines[i] = lines[i].split(" = ")[0] + " = " + _choice(rng, NUMBERS)
        return "\n".join(lines).encode()

    return parts.with_attachment("vehicle.toml", absurd)


def _schema(parts: Contents, rng: np.random.Generator) -> Contents:
    """A schema that says other things than its messages hold."""
    i = int(rng.integers(len(parts.schemas)))
    old = parts.schemas[i]
    flipped = _flip(old.data, rng)
    new = _choice(
        rng,
        (
            Schema(old.id, b"", old.encoding, old.name),
            Schema(old.id, rng.bytes(200), old.encoding, old.name),
            Schema(old.id, flipped, old.encoding, old.name),
            Schema(old.id, b"\x0a\x80\x80\x80\x80\x08" + b"x" * 10, old.encoding, old.name),
            Schema(old.id, b"\x22" * 10_000, old.encoding, old.name),
            Schema(old.id, old.data * 3, old.encoding, old.name),
            Schema(old.id, old.data, "jsonschema", old.name),
            Schema(old.id, old.data, old.encoding, "../../x"),
        ),
    )
    return replace(parts, schemas=[*parts.schemas[:i], new, *parts.schemas[i + 1 :]])


def _channel(parts: Contents, rng: np.random.Generator) -> Contents:
    """A channel of another name, schema, encoding or unit."""
    i = int(rng.integers(len(parts.channels)))
    old, other, text = parts.channels[i], _choice(rng, parts.channels), _choice(rng, TEXTS[:25])
    new = _choice(
        rng,
        (
            Channel(old.id, other.topic, old.message_encoding, old.metadata, old.schema_id),
            Channel(old.id, "/../../x", old.message_encoding, old.metadata, old.schema_id),
            Channel(old.id, old.topic, "json", old.metadata, old.schema_id),
            Channel(old.id, old.topic, old.message_encoding, dict.fromkeys(old.metadata, text), old.schema_id),
            Channel(old.id, old.topic, old.message_encoding, {}, 0),
        ),
    )
    return replace(parts, channels=[*parts.channels[:i], new, *parts.channels[i + 1 :]])


def _messages(parts: Contents, rng: np.random.Generator) -> Contents:
    """Messages whose times or numbers are absurd, that are longer, shorter, gone or doubled."""
    if not parts.messages:
        return parts
    messages = list(parts.messages)
    what = int(rng.integers(6))
    for i in rng.integers(len(messages), size=int(rng.integers(1, 30))).tolist():
        old = messages[i]
        time, data = old.log_time, old.data
        if what == 0:
            time = _choice(rng, SIZES)
        elif what == 1:
            number = _choice(rng, (np.nan, np.inf, -np.inf, 1e308, 5e-324, 1e9, 0.0))
            at = int(rng.integers(0, max(len(data) // 9, 1))) * 9 + 1
            data = data[:at] + struct.pack("<d", number) + data[at + 8 :]
        elif what == 2:
            data = _choice(rng, (b"", data[:-1], data + b"\x00", rng.bytes(len(data)), data * 100))
        elif what == 3:
            data = _flip(data, rng)
        messages[i] = Message(old.channel_id, time, data, old.publish_time, old.sequence)
    if what == 4:
        messages = messages[: int(rng.integers(len(messages) + 1))]
    if what == 5:
        messages = [messages[i] for i in rng.integers(len(messages), size=len(messages))]
    return replace(parts, messages=messages)


def _records(parts: Contents, rng: np.random.Generator) -> Contents:
    """Metadata that are gone, doubled, or too many, and runs of absurd names."""
    name, record = _choice(rng, parts.metadata)
    more = _choice(
        rng,
        (
            [(name, record)],
            [("run/../../x", record)],
            [("run/" + "x" * 10**5, record)],
            [(f"run/{i}", {}) for i in range(2000)],
            [(f"run/{i}", record) for i in range(5)],
            [("x" * 10**6, {})],
        ),
    )
    kept = [one for one in parts.metadata if one[0] != name] if rng.random() < 0.3 else parts.metadata
    return replace(parts, metadata=[*kept, *more])


FORGERIES = (
    _claim,
    _claim,
    _claim,
    _specific,
    _specific,
    _attachment,
    _vehicle,
    _vehicle,
    _schema,
    _channel,
    _messages,
    _messages,
    _records,
)
