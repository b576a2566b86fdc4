"""Measured roads from text files: distance and height in any columns, separators, headings and units."""

import re
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from models.common.errors import InputError, listing
from models.common.files import TABLE, read_text
from models.roads.profile import Profile, check_points

UNITS: Mapping[str, float] = {"m": 1.0, "km": 1e3, "cm": 1e-2, "mm": 1e-3, "in": 0.0254, "ft": 0.3048}
WORDS: Mapping[str, str] = {  # other names of units
    **dict.fromkeys(("metre", "metres", "meter", "meters"), "m"),
    **dict.fromkeys(("inch", "inches", '"'), "in"),
    **dict.fromkeys(("foot", "feet", "'"), "ft"),
    **{f"{prefix}{word}": unit for prefix, unit in (("kilo", "km"), ("centi", "cm"), ("milli", "mm"))
       for word in ("metre", "metres", "meter", "meters")},
}  # fmt: skip
MEANT: Mapping[str, frozenset[str]] = {
    "distance": frozenset({"distance", "dist", "x", "s", "u", "station", "chainage", "position", "pos"}),
    "height": frozenset({"height", "heights", "h", "z", "elevation", "elev", "altitude", "profile"}),
    "left": frozenset({"left", "l", "lwp"}),
    "right": frozenset({"right", "r", "rwp"}),
    "another quantity": frozenset({"time", "t", "speed", "v", "velocity", "acceleration", "lat", "latitude", "lon", "longitude",
                                   "iri", "slope", "width", "y", "n", "no", "number", "index", "id"}),
}  # fmt: skip
BESIDE = frozenset({"wheel", "wheelpath", "path", "track", "road", "surface", "along", "the", "of", "in", "side", "vertical"})
IN_BRACKETS = re.compile(r"\s*[\[(]\s*([^\])]*?)\s*[\])]$")
AT_THE_END = re.compile(r"(?<=\w)\s*[\s_/,-]\s*([a-z]+)$")
SAY = "say which columns are meant, as in :columns=1,3 or :columns=1,3,4, or mend the headings"
A_RIG = "; heights over time are of a rig's posts: give rig:file=..., then the file"


@dataclass(frozen=True)
class Heading:
    """Heading of a column.

    Attributes:
        text: text of the heading.
        meaning: one of `MEANT`, or "" if unknown.
        unit: one of `UNITS`, another one in brackets, or "".
    """

    text: str
    meaning: str = ""
    unit: str = ""


def read_heading(text: str) -> Heading:
    """Reads a heading: `right [mm]`, `height_cm`, `Distance (ft)`, `[m]`."""
    text = text.strip(" \t\"'#")
    rest, unit = text.lower(), ""
    bracket = IN_BRACKETS.search(rest)
    if bracket:
        rest, unit = rest[: bracket.start()], WORDS.get(bracket[1], bracket[1])
        timed = unit == "s" and {"time", "t"} & set(re.findall(r"[a-z]+", rest))
        if (
            unit not in UNITS
            and not timed
            and any(word in words for word in re.findall(r"[a-z]+", unit) for words in MEANT.values())
        ):
            rest, unit = f"{rest} {unit}", ""  # as in "height (left)"
    else:
        end = AT_THE_END.search(rest)
        if end and WORDS.get(end[1], end[1]) in UNITS:
            rest, unit = rest[: end.start()], WORDS.get(end[1], end[1])
        elif WORDS.get(rest, rest) in UNITS:
            rest, unit = "", WORDS.get(rest, rest)
    words = re.findall(r"[a-z]+", rest)
    meanings = [meaning for meaning, names in MEANT.items() if any(word in names for word in words)]
    if {"left", "right"} & set(meanings) and len(meanings) == 2 and "height" in meanings:
        meanings.remove("height")  # "left height"
    strange = [word for word in words if word not in BESIDE and not any(word in names for names in MEANT.values())]
    return Heading(text, meanings[0] if len(meanings) == 1 and not strange else "", unit)


def headings_of(lines: Sequence[Sequence[str]], count: int) -> list[Heading]:
    """Returns the heading of each column, from the lines above the numbers; empty headings if these lines are prose.

    Args:
        lines: cells of those lines, in their order.

    Raises:
        InputError: two lines give a column two units, or two meanings.
    """
    headings = [Heading("")] * count
    for cells in lines:
        row = [read_heading(cell) for cell in cells]
        says = [heading for heading in row if heading.meaning or heading.unit in UNITS]
        if len(row) != count or len(says) < min(2, count):
            continue
        for i, (old, new) in enumerate(zip(headings, row, strict=True)):
            for what in ("meaning", "unit"):
                first, second = getattr(old, what), getattr(new, what)
                if first and second and first != second:
                    raise InputError(
                        f"the headings {old.text!r} and {new.text!r} of column {i + 1} contradict each other; mend them"
                    )
            text = " ".join(part for part in (old.text, new.text) if part)
            headings[i] = Heading(text, old.meaning or new.meaning, old.unit or new.unit)
    return headings


def choose_columns(headings: Sequence[Heading], columns: Sequence[int]) -> tuple[int, ...]:
    """Returns the columns of distance and height, or distance, left and right, from 0: by their headings, else by their order.

    Args:
        headings: of all columns.
        columns: the requested columns, from 1; empty for none.

    Raises:
        InputError: headings contradict the requested columns, or their order, or are ambiguous.
    """
    at = {meaning: [i for i, heading in enumerate(headings) if heading.meaning == meaning] for meaning in MEANT}
    if not columns and len(at["distance"]) == 1:
        if len(at["left"]) == len(at["right"]) == 1:
            return (*at["distance"], *at["left"], *at["right"])
        if len(at["height"]) == 1 and not at["left"] and not at["right"]:
            return (*at["distance"], *at["height"])
    used = tuple(column - 1 for column in columns) or tuple(range(len(headings)))
    if len(used) not in (2, 3):
        return used
    tracks = (("height", "left", "right"),) if len(used) == 2 else (("height", "left"), ("height", "right"))
    roles: tuple[tuple[str, ...], ...] = (("distance",), *tracks)
    for i, allowed in zip(used, roles, strict=True):
        meaning = headings[i].meaning if i < len(headings) else ""
        if meaning and meaning not in allowed:
            role = allowed[0] if len(allowed) == 1 or len(used) == 2 else f"the height of the {allowed[-1]} track"
            raise InputError(f"column {i + 1} is called {headings[i].text!r}, and would be read as {role}; {SAY}{A_RIG}")
    return used


def unit_of(heading: Heading, asked: str, option: str) -> float:
    """Returns a column's unit in metres: the requested one, or its heading's, or a metre.

    Args:
        asked: requested unit, one of `UNITS`, or "".
        option: name of the setting that requests it.

    Raises:
        InputError: request and heading contradict each other, or the heading's unit is unknown.
    """
    if asked and heading.unit in UNITS and asked != heading.unit:
        raise InputError(
            f"the column {heading.text!r} is in {heading.unit}, and {option} = {asked} was asked for; leave one out, or mend it"
        )
    if not asked and heading.unit and heading.unit not in UNITS and heading.meaning:
        raise InputError(f"the unit of the column {heading.text!r} is none of {listing(UNITS)}; convert it, or give {option}")
    return UNITS[asked or (heading.unit if heading.unit in UNITS else "m")]


SEPARATORS: Mapping[str, str] = {"comma": ",", "semicolon": ";", "tab": "\t", "space": " "}
HEADINGS = 50  # lines that may come before the numbers
WHOLE, PADDED = re.compile(r"[+-]?\d+"), re.compile(r"0\d")  # cells that may be decimals behind a decimal comma
STEEPEST = 1.0  # rms slope; the roughest class of ISO 8608 has a half
WIDEST = 20.0  # m between points; wheels drive over the road between them as well

FORMAT = "give two columns, distance and height [m], or three, distance, left and right"


@dataclass(frozen=True)
class TableFormat:
    """Format of a road file.

    Attributes:
        distance_unit, height_unit: one of `UNITS`; empty for the headings' units, else metres.
        separator: one of `SEPARATORS`; empty to find out. With any but a comma, a comma may be the decimal point.
        columns: of distance and height, or distance, left and right, counted from 1; empty for those of the headings, else the
            first two or three.
    """

    distance_unit: str = ""
    height_unit: str = ""
    separator: str = ""
    columns: tuple[int, ...] = ()


def read_table(settings: Mapping[str, str]) -> TableFormat:
    """Returns the format of a road file, from settings by name.

    Raises:
        InputError: a name or a value that is unknown.
    """
    allowed = {"distance_unit": UNITS, "height_unit": UNITS, "separator": SEPARATORS}
    for name, value in settings.items():
        if name not in (*allowed, "columns"):
            raise InputError(f"{name!r} is unknown; a road file takes {listing((*allowed, 'columns'))}")
        if name in allowed and value not in allowed[name]:
            raise InputError(f"{name} = {value!r} is unknown; give one of {listing(allowed[name])}")
    columns = settings.get("columns", "")
    if "columns" in settings and not re.fullmatch(r"[1-9]\d{0,2}(,[1-9]\d{0,2}){1,2}", columns):
        raise InputError(f"columns = {columns!r} is none; give two or three numbers from 1, as in columns=1,3 or columns=1,3,4")
    numbers = tuple(map(int, columns.split(","))) if columns else ()
    return TableFormat(**{**settings, "columns": numbers})  # pyright: ignore[reportArgumentType] - the others are texts


def read_profile(path: Path, speed: float, table: TableFormat | None = None) -> Profile:
    """Reads a profile from a text file. Lines of headings may come first, with the meaning and the unit of each column.

    Blank lines and lines that begin with # are skipped; before the numbers, lines with # may be headings.

    Args:
        speed: [m/s].

    Raises:
        InputError: the file cannot be read, a line has no such numbers, or they make no road. The message names file and line.
    """
    table = table or TableFormat()
    try:
        return _profile(read_text(path, "road file", TABLE, FORMAT), speed, str(path), table)
    except InputError as error:
        said = str(error)
        raise InputError(said if said.startswith("road file") else f"road file {path}: {said}") from error


def _profile(text: str, speed: float, source: str, table: TableFormat) -> Profile:
    rows = text.replace("\r", "\n").split("\n")  # lines of old Macs end so
    first, mark = _first(rows, table)
    count = len(split_cells(rows[first], mark)) if first < len(rows) else 2
    headings = headings_of([_heading_cells(line, mark, count) for line in rows[:first] if line.strip()], count)
    columns = choose_columns(headings, table.columns)
    if len(columns) not in (2, 3):
        raise InputError(f"line {first + 1} has {count} column(s); {FORMAT}, or say which, as in :columns=1,4{A_RIG}")

    # 0,0,01 may be two heights, or one with a decimal comma.
    doubtful = mark == "," and len(columns) == 3 and not (table.separator or table.columns or headings[columns[1]].meaning)
    padded = False

    lines, values = array("Q"), array("d")
    for number, line in enumerate(rows[first:], first + 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        cells = split_cells(line, mark)
        used = [cells[column] if column < len(cells) else "" for column in columns]
        numbers = _numbers(used)
        if not table.columns and len(cells) != count and _numbers(cells) is not None:
            raise InputError(f"line {number} has {len(cells)} column(s), and line {first + 1} has {count}; {FORMAT}")
        if numbers is None:
            raise InputError(
                f"line {number}: {' '.join(used if table.columns else cells)!r} is not {len(used)} numbers; {FORMAT}"
            )
        if doubtful:
            doubtful, padded = all(WHOLE.fullmatch(cell) for cell in used[1:]), padded or bool(PADDED.match(used[2]))
        lines.append(number)
        values.extend(numbers)
    points = np.frombuffer(values, dtype=float).reshape(-1, len(columns)) if values else np.zeros((0, len(columns)))
    named = [headings[column] if column < count else Heading("") for column in columns]
    metres = [unit_of(heading, table.height_unit, "height_unit") for heading in named[1:]]
    if doubtful and (padded or max(metres) == UNITS["m"]):
        raise InputError(
            f"line {lines[0]}: {rows[lines[0] - 1].strip()!r} is a distance and two heights, or one height with a decimal comma; "
            "say :separator=comma for two heights, or separate columns by ;"
        )
    distance = points[:, 0] * unit_of(named[0], table.distance_unit, "distance_unit")
    heights = points[:, [1, -1]] * [metres[0], metres[-1]]
    check_points(distance, heights, lambda i: f"line {lines[i]}")
    _check_units(distance, heights)
    return Profile(distance, heights, speed, source)


def _first(rows: Sequence[str], table: TableFormat) -> tuple[int, str]:
    """Returns the index of the first line of numbers, and the separator of its cells."""
    headings, column = 0, (table.columns or (1,))[0] - 1
    for i, line in enumerate(rows):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        mark = SEPARATORS.get(table.separator) or separator_of(line)
        if _numbers(split_cells(line, mark)[column : column + 1] or [""]) is not None:
            return i, mark
        headings += 1
        if headings > HEADINGS:
            raise InputError(f"no line of numbers among the first {HEADINGS}; {FORMAT}")
    return len(rows), ","


def split_cells(line: str, mark: str) -> list[str]:
    """Returns the cells of a line of numbers; if the separator is no comma, a comma may be the decimal point."""
    cells = line.split() if mark == " " else [cell.strip() for cell in line.split(mark)]
    if mark != ",":  # then a comma can only be a decimal point
        cells = [cell.replace(",", ".", 1) if cell.count(",") == 1 and "." not in cell else cell for cell in cells]
    while len(cells) > 1 and not cells[-1]:
        cells.pop()  # a separator at the end of the line
    return cells


def _heading_cells(line: str, mark: str, count: int) -> list[str]:
    """Returns the cells of a line above the numbers, which may have another separator; empty if it is prose."""
    text = line.lstrip("# \t")
    if mark == " ":  # a unit in brackets belongs to the word before it
        text = re.sub(r"\s+(?=[\[(])", "", text)
    cells = split_cells(text, mark)
    if len(cells) != count and separator_of(text) != " ":
        cells = split_cells(text, separator_of(text))
    loose = mark == " " or line.lstrip().startswith("#")
    named = re.search(r"[\[(]", text) or any(read_heading(cell).meaning for cell in cells)
    return cells if named or not loose else []  # "in metres" is no pair of units


def separator_of(line: str) -> str:
    """Returns the separator of a line's cells: the least doubtful of those in it."""
    return next((mark for mark in (";", "\t", ",") if mark in line), " ")


def _numbers(cells: list[str]) -> list[float] | None:
    try:
        return [float(cell) for cell in cells]
    except ValueError:
        return None


def _check_units(distance: np.ndarray, heights: np.ndarray) -> None:
    """Refuses numbers that can only be in other units."""
    spacing = float(np.median(np.diff(distance)))
    length, low, high = float(distance[-1] - distance[0]), float(heights.min()), float(heights.max())
    described = f"{length:.4g} m long in steps of {spacing:.3g} m, heights from {low:.4g} to {high:.4g} m"
    if spacing > WIDEST:
        raise InputError(f"{described}: too coarse for a road; distances in mm or cm? then say :distance_unit=mm")
    slope = float(np.sqrt(np.mean((np.diff(heights, axis=0) / np.diff(distance)[:, None]) ** 2)))
    if slope > STEEPEST:
        raise InputError(
            f"{described}: an rms slope of {slope:.3g}, steeper than any road; distances in km, or heights in mm? then say "
            ":distance_unit=km or :height_unit=mm"
        )
