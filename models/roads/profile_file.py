"""Measured roads from text files: distance and height in any columns, separators, headings and units."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from models.common.errors import InputError, listing, quoted
from models.common.files import read_text, reading
from models.common.table import SEPARATORS, Heading, NumberTable, find_table, heading_of, merged
from models.common.units import LENGTH as UNITS
from models.roads.profile import Profile, check_points

MEANT: Mapping[str, frozenset[str]] = {
    "distance": frozenset({"distance", "dist", "x", "s", "u", "station", "chainage", "position", "pos"}),
    "height": frozenset({"height", "heights", "h", "z", "elevation", "elev", "altitude", "profile"}),
    "left": frozenset({"left", "l", "lwp"}),
    "right": frozenset({"right", "r", "rwp"}),
    "another quantity": frozenset({"time", "t", "speed", "v", "velocity", "acceleration", "lat", "latitude", "lon", "longitude",
                                   "iri", "slope", "width", "y", "n", "no", "number", "index", "id"}),
}  # fmt: skip
READ = ("distance", "height", "left", "right")
BESIDE = frozenset({"wheel", "wheelpath", "path", "track", "road", "surface", "along", "the", "of", "in", "side", "vertical"})
SAY = "say which columns are meant, as in :columns=1,3 or :columns=1,3,4, or mend the headings"
A_RIG = "; heights over time are of a rig's posts: give rig:file=..., then the file"


def read_heading(text: str, column: int = 0) -> Heading:
    """Reads a heading: `right [mm]`, `height_cm`, `Distance (ft)`, `[m]`. Its name is one of `MEANT`, or "" if unknown."""
    heading = heading_of(text, UNITS, column)
    rest, unit = heading.name.lower(), heading.unit
    timed = unit == "s" and {"time", "t"} & set(re.findall(r"[a-z]+", rest))
    if unit not in UNITS and not timed and any(word in words for word in re.findall(r"[a-z]+", unit) for words in MEANT.values()):
        rest, unit = f"{rest} {unit}", ""  # as in "height (left)"
    words = re.findall(r"[a-z]+", rest)
    meanings = [meaning for meaning, names in MEANT.items() if any(word in names for word in words)]
    if {"left", "right"} & set(meanings) and len(meanings) == 2 and "height" in meanings:
        meanings.remove("height")  # "left height"
    strange = [word for word in words if word not in BESIDE and not any(word in names for names in MEANT.values())]
    return replace(heading, name=meanings[0] if len(meanings) == 1 and not strange else "", unit=unit)


WORD = re.compile(r"[^\W\d]\w*")


def stem(heading: Heading) -> str:
    """Returns the text of a heading without its unit."""
    return heading_of(heading.text, UNITS).name


def headings_of(table: NumberTable) -> list[Heading]:
    """Returns the heading of each column, from the lines above the numbers; empty headings if these lines are prose.

    A line of single words, one for each column, is no prose, whatever they are.

    Raises:
        InputError: two lines give a column two units, or two meanings.
    """
    headings = [Heading("", column=i) for i in range(1, table.count + 1)]
    for line, cells in table.above:
        row = [read_heading(cell, i) for i, cell in enumerate(cells, 1)]
        prose = table.mark == " " or table.is_comment(line)  # "in metres" is no pair of units
        named = re.search(r"[\[(]", table.texts[line - 1]) or any(heading.name for heading in row)
        says = [heading for heading in row if heading.name or heading.unit in UNITS]
        words = not prose and table.mark in table.texts[line - 1] and all(WORD.fullmatch(stem(heading)) for heading in row)
        if words or (len(says) >= min(2, table.count) and (named or not prose)):
            headings = [merged(old, new) for old, new in zip(headings, row, strict=True)]
    return headings


def choose_columns(headings: Sequence[Heading], columns: Sequence[int]) -> tuple[int, ...]:
    """Returns the columns of distance and height, or distance, left and right, from 0: by their headings, else by their order.

    Args:
        headings: of all columns.
        columns: the requested columns, from 1; empty for none.

    Raises:
        InputError: headings contradict the requested columns, or their order, or are ambiguous.
    """
    for meaning in READ if not columns else ():
        if len(same := [heading for heading in headings if heading.name == meaning]) > 1:
            texts = " and ".join(f"{heading.column}, {quoted(heading.text)}" for heading in same)
            raise InputError(f"columns {texts}, are both {meaning}; {SAY}")
    at = {meaning: [i for i, heading in enumerate(headings) if heading.name == meaning] for meaning in MEANT}
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
        meaning = headings[i].name if i < len(headings) else ""
        if not columns and not meaning and stem(headings[i]):
            raise InputError(f"column {i + 1} is called {quoted(headings[i].text)}, and none of {listing(READ)}; {SAY}{A_RIG}")
        if meaning and meaning not in allowed:
            role = allowed[0] if len(allowed) == 1 or len(used) == 2 else f"the height of the {allowed[-1]} track"
            raise InputError(f"column {i + 1} is called {headings[i].text!r}, and would be read as {role}; {SAY}{A_RIG}")
    return used


WHOLE, PADDED = re.compile(r"[+-]?\d+"), re.compile(r"0\d")  # cells that may be decimals behind a decimal comma
WIDEST = 20.0  # m between points; if no unit is given, wider ones may be in another

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


def table_format(settings: Mapping[str, str]) -> TableFormat:
    """Returns the format of a road file, from settings by name.

    Raises:
        InputError: a value that is unknown.
    """
    allowed = {"distance_unit": UNITS, "height_unit": UNITS, "separator": SEPARATORS}
    for name, value in settings.items():
        if name in allowed and value not in allowed[name]:
            raise InputError(f"{name} = {value!r} is unknown; give one of {listing(allowed[name])}")
    columns = settings.get("columns", "")
    if "columns" in settings and not re.fullmatch(r"[1-9]\d{0,2}(,[1-9]\d{0,2}){1,2}", columns):
        raise InputError(
            f"columns = {columns!r} is not allowed; give two or three numbers from 1, as in columns=1,3 or columns=1,3,4"
        )
    numbers = tuple(map(int, columns.split(","))) if columns else ()
    return TableFormat(**{**settings, "columns": numbers})  # pyright: ignore[reportArgumentType] - the others are texts


def read_profile(path: Path, speed: float, table: TableFormat | None = None) -> Profile:
    """Reads a profile from a text file. Lines of headings may come first, with the meaning and the unit of each column.

    Args:
        speed: [m/s].

    Raises:
        InputError: the file cannot be read, a line has no such numbers, or they make no road. The message names file and line.
    """
    form = table or TableFormat()
    text = read_text(path, "road file", FORMAT)
    with reading(path, "road file", FORMAT):
        return _profile(text, speed, str(path), form)


def _profile(text: str, speed: float, source: str, form: TableFormat) -> Profile:
    table = find_table(text, FORMAT, form.separator, (form.columns or (1,))[0] - 1)
    headings = headings_of(table)
    columns = choose_columns(headings, form.columns)
    if len(columns) not in (2, 3):
        raise InputError(f"line {table.first + 1} has {table.count} column(s); {FORMAT}, or say which, as in :columns=1,4{A_RIG}")
    points, lines = table.numbers(columns, ragged=bool(form.columns))
    used = [headings[column] if column < table.count else Heading("", column=column + 1) for column in columns]
    used = [heading if heading.name or heading.unit in UNITS else replace(heading, unit="") for heading in used]
    distances = used[0].scale(UNITS, form.distance_unit, "distance_unit", "m")
    metres = [heading.scale(UNITS, form.height_unit, "height_unit", "m") for heading in used[1:]]
    if len(columns) == 3 and not (form.separator or form.columns or used[1].name):
        _check_commas(table, columns[1:], max(metres) == UNITS["m"])
    distance, heights = points[:, 0] * distances, points[:, [1, -1]] * [metres[0], metres[-1]]
    check_points(distance, heights, lambda i: f"line {lines[i]}")
    spacing = float(np.median(np.diff(distance)))
    if spacing > WIDEST and not (used[0].unit or form.distance_unit):
        raise InputError(
            f"points are {spacing:.3g} m apart, in metres as no unit is given; distances in mm or cm? then say "
            ":distance_unit=mm, and :distance_unit=m if they are in m"
        )
    return Profile(distance, heights, speed, source)


def _check_commas(table: NumberTable, columns: Sequence[int], in_metres: bool) -> None:
    """Refuses 0,0,01 for two heights where it may be one, with a decimal comma."""
    cells = ([row[column] for column in columns] for _, row in table.rows())
    if table.mark == "," and all(WHOLE.fullmatch(cell) for row in cells for cell in row):
        number, row = next(table.rows())
        if in_metres or any(PADDED.match(row[columns[-1]]) for _, row in table.rows()):
            raise InputError(
                f"line {number}: {','.join(row)!r} is a distance and two heights, or one height with a decimal comma; "
                "say :separator=comma for two heights, or separate columns by ;"
            )
