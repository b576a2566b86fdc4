"""The headings above a measured road: which column is what, in which unit. What contradicts how the file is read is refused."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from models.common.errors import InputError, listing

UNITS: Mapping[str, float] = {"m": 1.0, "km": 1e3, "cm": 1e-2, "mm": 1e-3, "in": 0.0254, "ft": 0.3048}
WORDS: Mapping[str, str] = {  # what units are called besides
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
    """What is written above a column.

    Attributes:
        text: as it stands there.
        meaning: one of `MEANT`, or "" where nobody knows.
        unit: one of `UNITS`, another that is written in brackets, or "".
    """

    text: str
    meaning: str = ""
    unit: str = ""


def read_heading(text: str) -> Heading:
    """What one heading says: `right [mm]`, `height_cm`, `Distance (ft)`, `[m]`."""
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
    """The headings of each column, from the lines above the numbers; nothing where these are prose.

    Args:
        lines: cells of those lines, in their order.
        count: columns of the numbers.

    Raises:
        InputError: two lines give a column two units, or two meanings.
    """
    found = [Heading("")] * count
    for cells in lines:
        row = [read_heading(cell) for cell in cells]
        says = [one for one in row if one.meaning or one.unit in UNITS]
        if len(row) != count or len(says) < min(2, count):
            continue
        for i, (old, new) in enumerate(zip(found, row, strict=True)):
            for what in ("meaning", "unit"):
                one, other = getattr(old, what), getattr(new, what)
                if one and other and one != other:
                    raise InputError(
                        f"the headings {old.text!r} and {new.text!r} of column {i + 1} contradict each other; mend them"
                    )
            text = " ".join(part for part in (old.text, new.text) if part)
            found[i] = Heading(text, old.meaning or new.meaning, old.unit or new.unit)
    return found


def choose_columns(headings: Sequence[Heading], columns: Sequence[int]) -> tuple[int, ...]:
    """The columns of distance and height, or distance, left and right, counted from 0: by their headings, else by their order.

    Args:
        headings: of all columns.
        columns: as they were asked for, from 1; empty where they were not.

    Raises:
        InputError: headings that contradict the columns asked for, or their order, or leave open which are meant.
    """
    at = {meaning: [i for i, one in enumerate(headings) if one.meaning == meaning] for meaning in MEANT}
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
    """How many metres one of a column's unit is: by what was asked for, by its heading, else one.

    Args:
        heading: of the column.
        asked: one of `UNITS`, or "".
        option: by which it is asked for.

    Raises:
        InputError: they contradict each other, or the heading has a unit that nobody knows.
    """
    if asked and heading.unit in UNITS and asked != heading.unit:
        raise InputError(
            f"the column {heading.text!r} is in {heading.unit}, and {option} = {asked} was asked for; leave one out, or mend it"
        )
    if not asked and heading.unit and heading.unit not in UNITS and heading.meaning:
        raise InputError(f"the unit of the column {heading.text!r} is none of {listing(UNITS)}; convert it, or give {option}")
    return UNITS[asked or (heading.unit if heading.unit in UNITS else "m")]
