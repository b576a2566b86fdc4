"""Reading of measured roads from files: columns of distance and height in many formats, or heights at a constant step.

ERD is the format of the University of Michigan Transportation Research Institute. LTPP and ProVAL use ERD files to exchange
profiles. An ERD file has a header of keywords, then heights at a constant step, for one or two tracks.

RDF files contain roads for tyre models in Adams and MotionView. RDF files of the type `poly_line` have a table of the distance
and of the heights of the left and right track. On `poly_line` roads, vehicles start at distance 0, which is not always the
first distance in the table.

Surveys have two horizontal coordinates of each point, on a map or as latitude and longitude, in driving order. The distance of
a point is the length of the path to this point in the horizontal plane. Steps in degrees are converted to metres with the radii
of curvature of the ellipsoid WGS 84 (NIMA TR8350.2, 2000) at the latitude of the step.
"""

import itertools
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, list_names, short_repr
from models.common.files import reading
from models.common.printed import percent, rough
from models.common.quantities import UNREAD, Heading, columns_in_words, left_out_words
from models.common.schema import HERE, LARGEST, SI, Choice, ReadBy, Section
from models.common.table import SEPARATORS, NumberTable, find_table, table_text
from models.common.units import LENGTH, setting, unit_size
from models.roads.profile import JOINS, Join, Profile, check_points

READ = ("distance", "height", "left", "right")
# Names of the height columns of a file with this number of columns
TRACKS = {2: (("height", "left", "right"),), 3: (("height", "left"), ("height", "right"))}
COLUMNS = re.compile(r"[1-9]\d{0,2}(,[1-9]\d{0,2}){0,2}")
GIVE_COLUMNS = "give two or three column numbers, as in columns=1,3 or columns=1,3,4, or one or two with :step"
UNITS = tuple(LENGTH)
# First word of an ERD file; number of letters of a keyword and of a value; value of KEYNUM in files with numbers as text
ERD, FIELD, IN_TEXT = "ERDFILE", 8, 5
RDF, RDF_UNITS = "(XZ_DATA)", {"meter": "m", "millimeter": "mm", "centimeter": "cm", "kilometer": "km", "foot": "ft"}
SAY = "choose columns with :columns=1,3 or :columns=1,3,4, or correct the headings, or put # before lines that are not headings"
A_RIG = "; for heights of a rig's posts over time, give rig:file=FILE"
# Distance between points [m]; if the distance column has no unit and a wider spacing, its unit is probably not m
WIDEST = 20.0
STEP_REFUSAL = "step is given, but the file has distances or more than two columns of heights; give :columns=2, or omit step"
# A column is a distance if its slope over the distance of the rows, in any units of length, is in this range. The heights of a
# road do not rise with such a slope along the whole length.
LIKE_DISTANCE = (0.2, 5.0)
FORMAT = "give columns of distance and height [m], or of distance, left and right, or only heights, with a step as in :step=0.25"
DEGREES = ("longitude lon lng long längengrad länge longx", "latitude lat breitengrad breite laty")
PLANES = (  # words by which headings name coordinates to the east and to the north; a path has one column of each type
    ("easting east rechtswert ostwert rw ost utmx", "northing north hochwert nordwert hw nord utmy"),
    ("e", "n"), ("x", "y"), DEGREES,
)  # fmt: skip
AXIS, FLATTENING = 6378137.0, 1 / 298.257223563  # semi-major axis [m] and flattening of the Earth's ellipsoid
BLOCK = 5.0  # positions are averaged over this length of path [m]
# Relative amount by which noise may lengthen a path: more than the first number causes a warning, more than the second number
# an error
NOTABLE, NOISY = 0.01, 0.05
# Two lengths of a road cause a warning if their relative difference is above the first number, and an error if their ratio is
# above the second number
DIFFERENT, OTHER = 0.05, 2.5
APART = 100.0  # largest allowed difference between the heights of two tracks [m]
# Largest change along a road of the height difference between two tracks [m], and the same change relative to the distance
SLIGHT, DIVERGING = 2.0, 0.2


def _columns(value: Any, context: Mapping[str, Any]) -> tuple[int, ...]:
    """Reads column numbers from a text such as 1,3, in which they are counted from 1; returns them counted from 0."""
    if not isinstance(value, str) or not COLUMNS.fullmatch(value):
        raise InputError(f"{HERE} = {short_repr(value)} is not allowed; {GIVE_COLUMNS}")
    return tuple(int(column) - 1 for column in value.split(","))


@dataclass(frozen=True)
class TableSettings(Section):
    """Settings for reading a road from a file."""

    start: Annotated[float, SI("m", "`from`, the distance at which the vehicle starts", low=-LARGEST)] | None = None
    distance_unit: Annotated[str, Choice("unit of distances without a unit in the heading; default: m", UNITS)] = ""
    height_unit: Annotated[str, Choice("unit of heights without a unit in the heading; default: m", UNITS)] = ""
    unit: Annotated[str, Choice("the same as `height_unit`", UNITS)] = ""
    separator: Annotated[str, Choice("separator of columns; default: found in the file", tuple(SEPARATORS))] = ""
    columns: Annotated[tuple[int, ...], ReadBy("columns of distance and height, or distance, left and right", _columns)] = ()
    step: Annotated[float, SI("m", "constant spacing of the rows, of height, or left and right")] | None = None
    join: Join = JOINS[0]

    @classmethod
    def prepared(cls, given: Mapping[str, Any]) -> Mapping[str, Any]:
        """Returns the settings with the name `start` for the key `from`, which is a reserved word in Python."""
        start = {"start": setting("from", given["from"], "m")} if "from" in given else {}
        return {name: value for name, value in given.items() if name != "from"} | start

    def __post_init__(self) -> None:
        if self.step is None and len(self.columns) == 1:
            raise InputError(f"columns = {self.columns[0] + 1} is not allowed; {GIVE_COLUMNS}")


def read_profile(path: Path, speed: float, given: TableSettings = TableSettings()) -> Profile:
    """Reads a profile from a text file. The headings in the file may give the quantity and the unit of each column.

    Args:
        path: path of the file with the profile.
        speed: vehicle speed [m/s].
        given: settings that replace headings which are missing or have no unit.

    Raises:
        InputError: the file cannot be read, or its numbers are not a valid road. The message gives the file and the line.
    """
    with reading(path, "road file", FORMAT):
        text = table_text(path)
        if text.startswith(ERD):
            text, step = erd_text(text)
            given = given if given.step is not None else replace(given, step=SI("m").number("step", setting("step", step, "m")))
        if path.suffix.lower() != ".rdf":
            return _profile(text, speed, str(path), given)
        whole = _profile(rdf_text(text), speed, str(path), given)
        return whole.begun_at(0.0) if whole.distance[0] < 0 < whole.distance[-1] and given.start is None else whole


def _profile(text: str, speed: float, source: str, given: TableSettings) -> Profile:
    wanted, step, stepped = given.columns, given.step, given.step is not None
    table = find_table(text, FORMAT, given.separator, (wanted or [0])[0])
    headings = table.headings(("m",), optional=True)
    headings += [Heading(column=i + 1) for i in range(table.count, max(wanted, default=0) + 1)]
    place = _coordinates(headings, wanted) if not stepped else []
    path = bool(place) and not any(one.quantity == "distance" for i, one in enumerate(headings) if i not in place)
    names = {place[0]: "distance", place[1]: UNREAD} if path else dict.fromkeys(place, UNREAD)
    roles = [replace(one, name=names.get(i, one.name)) for i, one in enumerate(headings)]
    used = choose_columns(table, roles, [i for i in wanted if not path or i != place[1]], stepped)
    points, lines = table.numbers(used, ragged=bool(wanted))
    note = left_out_words(headings, [i + 1 for i in (*used, *place[: 2 * path])])

    height_unit, unit = given.unit or given.height_unit, given.distance_unit
    scales = [headings[i].scale("distance", "height_unit", height_unit, "m") for i in used[not stepped :]]
    heights = points[:, [-len(scales), -1]] * [scales[0], scales[-1]]
    if step is not None:
        if len(used) == 2 and not wanted and not headings[used[0]].quantity and _is_distance(points[:, 0], step):
            raise InputError(STEP_REFUSAL)
        distance = step * np.arange(len(points))
    elif path:
        distance, said = _path(table, [headings[i] for i in place], unit, bool(wanted))
        moved = np.append(True, np.diff(distance) > 0)
        distance, heights, lines, note = distance[moved], heights[moved], np.array(lines)[moved], [said, *note]
    else:
        distance = points[:, 0] * headings[used[0]].scale("distance", "distance_unit", unit, "m")
        note += _other_length(table, [headings[i] for i in place], distance, headings[used[0]], bool(wanted))
    if len(used) == 3 and not any(headings[i].name for i in used):
        if table.separator == "," and not (given.separator or wanted):
            _check_commas(table)
        _check_tracks(distance, heights, table.first + 1)
    check_points(distance, heights, lambda i: f"line {lines[i]}")
    spacing = float(np.median(np.diff(distance)))
    known = stepped or given.distance_unit or headings[used[0]].unit or (path and _in_degrees([headings[i] for i in place]))
    if spacing > WIDEST and not known:
        raise InputError(
            f"the distances have no unit. If they are in m, the points are {spacing:.3g} m apart, which is not "
            "plausible; give the unit of the distances, as in :distance_unit=mm or :distance_unit=m"
        )
    return Profile(distance, heights, speed, source, note="; ".join(note))


def choose_columns(
    table: NumberTable, headings: Sequence[Heading], wanted: Sequence[int], stepped: bool = False
) -> Sequence[int]:
    """Returns the columns of distance and height, or of distance, left and right, counted from 0.

    The columns are identified by their headings or, if there are no headings, by their order.

    Args:
        table: table of numbers in the file, which contains the columns.
        headings: headings of all columns.
        wanted: the requested columns, counted from 0; empty if no columns are requested.
        stepped: True if the rows have a constant step, so that there is no column of distance.

    Raises:
        InputError: the headings are ambiguous or contradict the requested columns, or the number of columns is not two or
            three.
    """
    names = [heading.quantity for heading in headings]
    for name in READ if not wanted else ():
        if names.count(name) > 1:
            texts = " and ".join(f"{one.column}, {short_repr(one.text)}" for one in headings if one.quantity == name)
            raise InputError(f"columns {texts}, both contain {name}; {SAY}")
    if stepped:
        heights = [names.index(name) for name in ("left", "right", "height") if name in names]
        used = wanted or heights[:2] or range(len(headings))
        if len(used) > 2 or (not wanted and "distance" in names):
            raise InputError(STEP_REFUSAL)
        return used
    if not wanted and {"distance", "left", "right"} <= {*names}:
        return [names.index(name) for name in ("distance", "left", "right")]
    if not wanted and {"distance", "height"} <= {*names} and not {"left", "right"} & {*names}:
        return [names.index(name) for name in ("distance", "height")]
    used = wanted or range(len(headings))
    if len(used) not in TRACKS:
        which = f"{FORMAT}, or choose columns, as in :columns=1,4"
        raise InputError(f"line {table.first + 1} has {table.count} column(s); {which}{A_RIG}")
    for i, allowed in zip(used, (("distance",), *TRACKS[len(used)]), strict=True):
        column = f"column {i + 1} is called {short_repr(headings[i].text)}"
        if headings[i].name and not names[i] and not wanted:
            raise InputError(f"{column}, but only columns called {list_names(READ)} are read; {SAY}{A_RIG}")
        if names[i] and names[i] not in allowed:
            role = f"the height of the {allowed[1]} track" if len(allowed) == 2 else allowed[0]
            raise InputError(f"{column}, but this column would be read as {role}; {SAY}{A_RIG}")
    return used


def erd_text(text: str) -> tuple[str, str]:
    """Returns the numbers of an ERD file as a table with headings, and the step as text with its unit.

    Raises:
        InputError: the numbers in the file are binary, or the header contains no sizes or has no end.
    """
    header, end, numbers = re.split(r"^(END)\s*$", text, maxsplit=1, flags=re.MULTILINE) if "\nEND" in text else (text, "", "")
    lines = header.splitlines()
    sizes = [part.strip() for part in lines[1].split(",")] if len(lines) > 1 else []
    if not end or len(sizes) < 6:
        raise InputError(
            "line 2 of the ERD file does not give the numbers of channels and samples, or the file has no END line; "
            "export the profile as a text file instead"
        )
    if sizes[4] != str(IN_TEXT):
        raise InputError(f"the ERD file has binary numbers (KEYNUM {sizes[4]}); export it with numbers as text (KEYNUM 5)")
    values = {line[:FIELD].strip(): line[FIELD:] for line in lines[2:]}
    fields = range(0, int(sizes[0]) * FIELD, FIELD)
    names, units = ([values.get(keyword, "")[i : i + FIELD].strip() for i in fields] for keyword in ("SHORTNAM", "UNITSNAM"))
    names = {1: ["height"], 2: ["left", "right"]}.get(len(names), names)
    headings = [f"{name} [{unit or 'm'}]" for name, unit in zip(names, units, strict=True)]
    return "\t".join(headings) + "\n" + numbers.replace(",", " "), f"{sizes[5]} {values.get('XUNITS', 'm').strip()}"


def rdf_text(text: str) -> str:
    """Returns the table of an RDF file of the type `poly_line` with headings, and the line number of each row in the file.

    Raises:
        InputError: the road in the file has a type other than `poly_line`, or the file has no table.
    """
    lines = [re.split(r"[$!]", line)[0].strip() for line in text.splitlines()]
    values = {name.strip().upper(): value.strip(" '\"").lower() for name, _, value in (line.partition("=") for line in lines)}
    if (kind := values.get("ROAD_TYPE", "")) != "poly_line":
        raise InputError(
            f"ROAD_TYPE = {short_repr(kind)} cannot be read; only the type 'poly_line' is supported; give such a "
            "road, or a .csv file of heights"
        )
    marks = [i for i, line in enumerate(lines) if line.upper() == RDF]
    if not marks:
        raise InputError(
            f"the file has no table {RDF} (distance, left height, right height), so the file seems to be incomplete; "
            "give the whole file"
        )
    for name, value in values.items():
        if name.startswith("ROTATION") and not re.fullmatch(r"[+-]?0*\.?0*(e[+-]?\d+)?", value):
            raise InputError(
                f"{name} = {value} rotates the road, but rotated roads are not supported; give a road along the x axis, "
                f"with {name} = 0"
            )
    unit = values.get("LENGTH", "")
    if not unit:
        raise InputError(
            "the file has no LENGTH in [UNITS], so the unit of the table is unknown; give the unit, as in LENGTH = 'meter'"
        )
    begin, length = marks[0] + 1, RDF_UNITS.get(unit, unit)
    rows = itertools.takewhile(lambda line: not line.startswith(("[", "(")), lines[begin:])
    numbers = ["" if line.startswith("{") else line for line in rows]
    count = max((len(line.split()) for line in numbers), default=0)
    names = ["distance", "left", "right"] if count == 3 else ["distance", "height"]
    return "\n" * (begin - 1) + "\t".join(f"{name} [{length}]" for name in names) + "\n" + "\n".join(numbers)


def _coordinates(headings: Sequence[Heading], wanted: Sequence[int]) -> Sequence[int]:
    """Returns the columns of two horizontal coordinates, east and north, counted from 0.

    The result is empty if the table lacks a column of either coordinate or of height.
    """
    if len(wanted) == 2 or not (wanted or {"height", "left", "right"} & {one.quantity for one in headings}):
        return []
    for words in PLANES:
        east, north = ([i for i, one in enumerate(headings) if one.words & {*names.split()}] for names in words)
        if len(east) == len(north) == 1 and east != north and (not wanted or {*east, *north} <= {*wanted}):
            return [*east, *north]
    return []


def _in_degrees(headings: Sequence[Heading]) -> bool:
    return any(one.words & {*DEGREES[1].split()} for one in headings)


def _path(table: NumberTable, headings: Sequence[Heading], option: str, ragged: bool) -> tuple[Array, str]:
    """Returns the length of a surveyed path up to each of its points [m], shape (P,), and a warning.

    Args:
        table: table of numbers in the file, which contains the columns.
        headings: headings of the east and north coordinates.
        option: name of the option that gives the unit of lengths without a unit.
        ragged: True if rows may have different numbers of cells.

    Raises:
        InputError: a unit or a coordinate is wrong, or noise makes the path much longer than the road.
    """
    numbers, columns = table.numbers([one.column - 1 for one in headings], ragged)[0], columns_in_words(headings)
    if _in_degrees(headings):
        degrees = numbers * [unit_size(one.unit or "deg", "deg") or 1.0 for one in headings]
        if not (np.abs(degrees) <= (360, 90)).all():
            raise InputError(
                f"{columns} go up to {np.abs(degrees).max():.6g}, beyond the range of degrees; give decimal degrees, up "
                "to 360 for longitude and 90 for latitude"
            )
        eccentricity = FLATTENING * (2 - FLATTENING)
        turn, latitude = np.deg2rad(np.diff(degrees, axis=0)), np.deg2rad((degrees[1:, 1] + degrees[:-1, 1]) / 2)
        across = AXIS / np.sqrt(1 - eccentricity * np.sin(latitude) ** 2)
        along = across**3 * (1 - eccentricity) / AXIS**2
        steps = np.stack([across * np.cos(latitude) * np.sin(turn[:, 0]), along * turn[:, 1]], axis=-1)
    else:
        steps = np.diff(numbers * [one.scale("distance", "distance_unit", option, "m") for one in headings], axis=0)
    distance = np.concatenate([[0.0], np.cumsum(np.hypot(*steps.T))])

    position = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    _, block = np.unique(distance // BLOCK, return_inverse=True)
    means = [np.bincount(block, values) / np.bincount(block) for values in (distance, *position.T)]
    smooth = float(np.hypot(*np.diff(means[1:])).sum())
    noise = float(np.ptp(means[0])) / smooth - 1 if smooth else 0.0
    longer = f"the path through the points is {percent(noise)} longer than the path through mean positions of {BLOCK:g} m each"
    if noise > NOISY:
        do = "because the positions are noisy or not in driving order; smooth or sort the points, or give a column of distance"
        raise InputError(f"{columns} are coordinates, but {longer}, {do}")
    repeated = int(np.sum(np.diff(distance) <= 0))
    remarks = [f"{columns} are coordinates; the distance is the length of their path, {rough(distance[-1])} m"]
    remarks += [f"{repeated} points have the same position as the previous point, and are left out"] if repeated else []
    return distance, "; ".join(remarks + ([f"{longer}: check the positions for noise"] if noise > NOTABLE else []))


def _other_length(table: NumberTable, headings: Sequence[Heading], distance: Array, heading: Heading, ragged: bool) -> list[str]:
    """Returns a warning if a column of distance differs from the length of the path through coordinates in the same table.

    If the coordinates cannot be read, the function returns no warning.

    Raises:
        InputError: the difference is larger than map projections cause, for example because the column contains station
            numbers.
    """
    own, length = float(np.ptp(distance)), 0.0
    with suppress(InputError):
        length = float(_path(table, headings, "", ragged)[0][-1]) if headings else 0.0
    if not length or abs(length - own) <= DIFFERENT * own:
        return []
    column, columns = f"column {heading.column} ({short_repr(heading.text)})", columns_in_words(headings)
    found = f"{column} is {rough(own)} m long, but the path through {columns} is {rough(length)} m long"
    if max(own, length) > OTHER * min(own, length):
        raise InputError(f"{found}; remove the wrong columns, or choose the columns of distance and height, as in :columns=3,4")
    return [found]


def _check_tracks(distance: Array, heights: Array, first: int) -> None:
    """Refuses three columns without headings that are probably two coordinates and a height.

    Args:
        distance: values of the first column, shape (P,).
        heights: values of the second and third column, shape (P, 2).
        first: number of the first line, for the message.
    """
    difference = heights[:, 0] - heights[:, 1]
    if (largest := np.abs(difference).max()) > APART or np.ptp(difference) > max(SLIGHT, DIVERGING * np.ptp(distance)):
        raise InputError(
            f"the last two columns lack headings and differ by up to {largest:.6g} m, too much for two tracks; "
            f"write headings above line {first}, such as x [m], y [m], height [m] or distance [m], left [mm], right [mm]"
        )


def _is_distance(column: Array, step: float) -> bool:
    """Returns True if the values rise evenly, by about the step [m] in some unit; they are then distances, not heights."""
    rises = np.diff(column)
    mean = float(rises.mean()) if len(rises) else 0.0
    low, high = LIKE_DISTANCE
    return low * step < mean < high * step and bool((np.abs(rises - mean) < mean / 2).all())


def _check_commas(table: NumberTable) -> None:
    """Refuses rows such as 0,0,01 without headings, which may contain two heights, or one height with a decimal comma."""
    number, row = next(table.rows())
    if not any("." in cell for _, cells in table.rows() for cell in cells[1:]):
        raise InputError(
            f"line {number}: {','.join(row)!r} can be read as a distance and two heights, or as a distance and one "
            "height with a decimal comma; give :separator=comma for two heights, or separate the columns with "
            "semicolons"
        )
