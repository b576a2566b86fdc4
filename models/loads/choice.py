"""Loads by name: the text `KIND[:NAME=VALUE...]`, as on a command line, in a campaign file or a log, becomes a load."""

import math
import re
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

from models.common.errors import InputError
from models.common.numbers import settings
from models.loads.load import LOADS, Load
from models.loads.table import parse_history, read_history

SYNTAX = (
    f"give {', '.join(LOADS)}, each with :NAME=VALUE for its numbers, as in brake:g=0.5:start=1:rise=0.2:hold=2 or "
    "payload:mass=100:x=-1.2, or a .csv file"
)
NAMED = rf"\s*\+\s*(?=(?:{'|'.join(LOADS)})(?:[:+]|\s*$))"
FILED = r"\s+\+\s+(?=\S[^+]*\.csv\s*(?:$|\+))"
JOINED = re.compile(rf"{NAMED}|{FILED}", re.IGNORECASE)  # between a road and its loads, and between these


def split_off(text: str) -> tuple[str, list[str]]:
    """A road's text without the loads that are added to it, and these: `bump + brake:g=0.5 + push.csv`."""
    road, *loads = JOINED.split(text)
    return road, loads


def is_file(text: str) -> bool:
    """Whether a load's text names a file."""
    return text.strip().lower().endswith(".csv")


def choose_load(text: str, folder: Path = Path()) -> Load:
    """A load from its text.

    Args:
        text: the text.
        folder: where a relative file name begins.

    Raises:
        InputError: an unknown kind or name, a value that is not allowed, a file that is no load.
    """
    if is_file(text):
        return read_history(folder / text.strip())
    kind, colon, rest = text.strip().partition(":")
    if kind not in LOADS:
        raise InputError(f"unknown load {text!r}; {SYNTAX}")
    of = LOADS[kind]
    try:
        given = settings(colon + rest, [field.name for field in fields(of)])
        return of(**{name: _number(name, value) for name, value in given.items()})
    except InputError as error:
        raise InputError(f"load {text!r}: {error}") from error


def described_loads(texts: Sequence[str]) -> tuple[Load, ...]:
    """Loads from their texts, as a log has them; no file is read.

    Raises:
        InputError: one is none.
    """
    found = []
    for text in texts:
        source, semicolon, rows = text.partition(";")
        found.append(parse_history(rows.replace(";", "\n"), source) if semicolon else choose_described(text))
    return tuple(found)


def choose_described(text: str) -> Load:
    """A load from its text, which is no file's.

    Raises:
        InputError: it is none.
    """
    if text.partition(":")[0] not in LOADS:
        raise InputError(f"unknown load {text[:60]!r}; {SYNTAX}")
    return choose_load(text)


def _number(name: str, value: str) -> float:
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise InputError(f"{name} = {value!r} is not a finite number")
    return number
