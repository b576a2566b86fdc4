"""Drive files of rigs as text: a column of time, and one of heights for each wheel, named and with its unit above it.

MTS's binary RPC III is not read. The public package for it, rpc-reader 0.9 of 2022, is not fit for damaged files, or files of
another machine: it ends the process if a header is wrong, takes as much memory as the header says, reads big-endian
files as if they were little-endian, and prints as it goes.
"""

import re
from array import array
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from models.common.errors import InputError, listing, quoted
from models.common.files import TABLE, read_text
from models.roads.profile_file import UNITS, WORDS, separator_of, split_cells
from models.roads.rig import Rig, check_history, check_posts, post_name

TIMES: Mapping[str, float] = {"s": 1.0, "ms": 1e-3}
TIME_WORDS = {**dict.fromkeys(("sec", "second", "seconds"), "s"), **dict.fromkeys(("msec", "millisecond", "milliseconds"), "ms")}
CLOCK = ("time", "t")
HEADING = re.compile(r"(?P<name>[^\[(]*?)\s*([\[(]\s*(?P<unit>[^\])]*?)\s*[\])])?")
FORMAT = "give a line of headings, as in: time [s], front_left [mm], front_right [mm], and below it a line for each time"
SETTINGS = ("time_unit", "height_unit")  # for headings without a unit


def read_rig(path: Path, settings: Mapping[str, str]) -> Rig:
    """Reads a rig from a text file. Its first line has the separator of all; blank lines and lines that begin with # are skipped.

    Args:
        settings: `time_unit` and `height_unit`, for headings without a unit.

    Raises:
        InputError: the file cannot be read, a heading or a line is wrong, or they make no histories. It names file and line.
    """
    for name, allowed in zip(SETTINGS, (TIMES, UNITS), strict=True):
        if name in settings and settings[name] not in allowed:
            raise InputError(f"{name} = {settings[name]!r} is unknown; give one of {listing(allowed)}")
    try:
        return _rig(read_text(path, "drive file", TABLE, FORMAT), settings, str(path))
    except InputError as error:
        said = str(error)
        raise InputError(said if said.startswith("drive file") else f"drive file {path}: {said}") from error


def unit_of(name: str, unit: str, asked: str, option: str, time: bool) -> float:
    """Returns a column's unit in seconds or metres.

    Args:
        unit: unit of its heading; empty for none.
        asked: unit for headings without one; empty if not given.
        option: name of the setting that gives it.
        time: True for the column of time.

    Raises:
        InputError: the unit is unknown or missing, or the two contradict each other.
    """
    known, words = (TIMES, TIME_WORDS) if time else (UNITS, WORDS)
    unit = words.get(unit.lower(), unit.lower())
    if unit and unit not in known:
        raise InputError(f"the column {quoted(name)} is in {quoted(unit)}; units are {listing(known)}: convert it")
    if unit and asked and unit != asked:
        raise InputError(f"the column {quoted(name)} is in {unit}, and {option} = {asked} was asked for; leave one out")
    if not unit and not asked:
        example = "s" if time else "mm"
        raise InputError(f"the column {quoted(name)} has no unit; write {name} [{example}] above it, or say :{option}={example}")
    return known[unit or asked]


def _rig(text: str, settings: Mapping[str, str], source: str) -> Rig:
    rows = text.replace("\r", "\n").split("\n")
    first = next((i for i, line in enumerate(rows) if line.strip() and not line.lstrip().startswith("#")), len(rows))
    if first == len(rows):
        raise InputError(f"it is empty; {FORMAT}")
    mark = separator_of(rows[first].strip())
    heads = re.sub(r"\s+(?=[\[(])", "", rows[first].strip()) if mark == " " else rows[first]
    matches = [HEADING.fullmatch(cell.strip(" \"'")) for cell in heads.split(None if mark == " " else mark)]
    headings = [(match["name"].strip(), match["unit"] or "") if match else ("", "") for match in matches]
    clocks = [i for i, (name, _) in enumerate(headings) if post_name(name) in CLOCK]
    if len(clocks) != 1:
        raise InputError(f"line {first + 1}: {len(clocks)} columns are called time, and one must be; {FORMAT}")
    posts = [i for i in range(len(headings)) if i != clocks[0]]
    check_posts([headings[i][0] for i in posts])
    scales = [
        unit_of(*headings[i], settings.get(option := SETTINGS[i != clocks[0]], ""), option, i == clocks[0])
        for i in (clocks[0], *posts)
    ]
    lines, values = array("Q"), array("d")
    for number, line in enumerate(rows[first + 1 :], first + 2):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        cells = split_cells(line.strip() if mark == " " else line, mark)
        try:
            numbers = [float(cell) for cell in cells]
        except ValueError:
            raise InputError(f"line {number}: {quoted(' '.join(cells))} is not {len(headings)} numbers; {FORMAT}") from None
        if len(numbers) != len(headings):
            raise InputError(f"line {number} has {len(numbers)} column(s), and the headings are {len(headings)}; {FORMAT}")
        lines.append(number)
        values.extend(numbers)
    table = np.frombuffer(values, dtype=float).reshape(-1, len(headings)) if values else np.zeros((0, len(headings)))
    time, heights = table[:, clocks[0]] * scales[0], table[:, posts] * scales[1:]
    check_history(time, heights, lambda i: f"line {lines[i]}")
    return Rig(time, heights, tuple(headings[i][0] for i in posts), source)
