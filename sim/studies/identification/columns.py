"""First version of a map file, which states which column contains which signal; it is guessed only from the column headings of
the logs.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from models.common.errors import InputError
from models.common.files import reading
from models.common.logs.measured_log import GIVE, name_key, times_of
from models.common.quantities import CORNERS, Heading, heading_of
from models.common.table import find_table, table_text
from models.common.toml_edit import toml_value
from models.common.units import unit_size
from models.vehicle.vehicle import Vehicle
from sim.studies.identification.log_map import LOGGED, UNKNOWN

# For each quantity, words that column headings use for it, then words for a place on the vehicle. All other words of a heading
# are ignored.
ACCELERATION = frozenset(["acc", "accel", "acceleration", "accelerometer", "accz", "az", "zacc"])
LENGTH = frozenset(["displacement", "height", "position", "amplitude", "disp"])
BODY, HUB = (
    frozenset(["body", "sprung", "chassis", "mass", "seat", "frame"]),
    frozenset(["hub", "unsprung", "wheel", "upright", "axle", "knuckle", "us"]),
)
TRAVEL = frozenset(["travel", "deflection", "stroke", "pot", "potentiometer", "lvdt", "damper", "shock", "suspension"])
VELOCITY = frozenset(["vel", "velocity", "speed"])
TYRE = frozenset(["tyre", "tire"])
ROAD = frozenset(["road", "post", "platform", "table", "shaker", "actuator", "ground", "profile", "plate", "pad"])
FORCE = frozenset(["force", "load", "loadcell"])
# A heading matches if it has a word of each of the first two sets, and no word of the third
WORDS: Mapping[str, tuple[frozenset[str], frozenset[str], frozenset[str]]] = {
    "unsprung_acceleration": (ACCELERATION, HUB, frozenset()),
    "sprung_acceleration": (ACCELERATION, frozenset(), HUB),
    "unsprung_velocity": (VELOCITY, HUB, TRAVEL - {"suspension"}),
    "sprung_velocity": (VELOCITY, BODY, HUB),
    "suspension_deflection": (TRAVEL, frozenset(), VELOCITY | ACCELERATION | FORCE | ROAD | TYRE),
    "road_displacement": (ROAD, frozenset(), VELOCITY | ACCELERATION | FORCE | BODY | TYRE | HUB - {"wheel"}),
    "unsprung_displacement": (LENGTH, HUB | TYRE, TRAVEL | FORCE),
    "sprung_displacement": (LENGTH, BODY, TRAVEL | FORCE | HUB | TYRE),
    "control_force": (FORCE, frozenset(), HUB),
}
ENDS = frozenset(["front", "rear", "left", "right"])
GUESSES = ("mm", "cm", "g", "deg", "rad")  # words in a column heading that are read as units
# for each SI unit, the unit that logs often use instead
NOTES = {"m": "mm", "m/s2": "g", "rad": "deg", "m/s": "mm/s", "N": "kN"}


@dataclass(frozen=True)
class ColumnGuess:
    """A column of a log that probably contains a signal of the vehicle.

    Attributes:
        signal: name of the signal that the column probably contains.
        column: heading of the column, with a unit, as written in the map file.
        warning: warning that the unit was guessed; empty if the heading contains the unit.
    """

    signal: str
    column: str
    warning: str


def _words(text: str) -> frozenset[str]:
    parts: list[str] = re.findall(r"[^\W\d_]+", re.sub(r"(?<=[a-z])(?=[A-Z])", " ", text).lower())
    return frozenset(piece for part in parts for piece in CORNERS.get(part, part).split("_"))


def guess(heading: Heading, units: Mapping[str, str]) -> ColumnGuess | None:
    """Returns the signal to which a heading seems to refer; None if there is no such signal, or if the heading's unit does not
    fit.

    Args:
        units: SI units of the vehicle's signals, by name.
    """
    words, same = _words(heading.text), {name_key(heading.name), name_key(heading.text)}
    for signal, unit in units.items():
        base = next((one for one in WORDS if signal.startswith(one)), "")
        ends = frozenset(signal.removeprefix(base).split("_")) - {""} if base else None
        some, places, none = WORDS.get(base, (frozenset[str](),) * 3)
        like = bool(words & some) and (not places or bool(words & places)) and not words & none
        if name_key(signal) not in same and not (like and ends == words & ENDS):
            continue
        if heading.unit:
            if unit_size(heading.unit, unit) is None:
                continue
            return ColumnGuess(signal, heading.text, "")
        word = next((one for one in GUESSES if one in words and unit_size(one, unit) is not None), "")
        if word:
            return ColumnGuess(signal, f"{heading.text} [{word}]", f"unit guessed from the heading; the signal is in {unit}")
        often = f"; many logs have {NOTES[unit]}" if unit in NOTES else ""
        return ColumnGuess(signal, f"{heading.text} [{unit}]", f"the heading has no unit: {unit} is assumed{often}")
    return None


def read_headings(path: Path, units: Mapping[str, str]) -> list[Heading]:
    """Returns the column headings of a log.

    Raises:
        InputError: the file is not a table with column headings.
    """
    with reading(path, "measured log", GIVE):
        table = find_table(table_text(path), GIVE)
        headings = [one for one in table.headings({*units.values(), "s"}, alike=True) if one.text]
        if not headings:
            raise InputError(f"the file has no line of headings; {GIVE}")
        return [one if one.name else heading_of(one.text, ("s",), one.column) for one in headings]


def map_text(paths: Sequence[Path], vehicle: Vehicle) -> str:
    """Returns a first map file for logs: a section for each heading that names a signal, and all other headings as comments.

    Raises:
        InputError: a file is not a table with column headings, or was written by `bump` or `drive` and therefore needs no map.
    """
    units = {name: one.unit for name, one in vehicle.kind.possible.items()}
    sections, others, timed = dict[str, list[ColumnGuess]](), list[str](), True
    for path in paths:
        headings = read_headings(path, units)
        clocks = {one.column for one in times_of(headings)}
        timed = timed and bool(clocks)
        for heading in headings:
            if heading.column in clocks:
                continue
            one = guess(heading, units)
            if one is None:
                others.append(f"{path.name}, column {heading.column}: {heading.text}")
            elif one not in sections.setdefault(one.signal, []):
                sections[one.signal].append(one)
    return "\n".join(_lines(paths, sections, others, timed, units)) + "\n"


def _lines(
    paths: Sequence[Path], sections: Mapping[str, list[ColumnGuess]], others: list[str], timed: bool, units: Mapping[str, str]
) -> Iterator[str]:
    yield f"# First map of {', '.join(path.name for path in paths)}, guessed from the headings alone."
    yield "# Check each signal, unit and sign. See docs/how-to/identify.md."
    road, hub = (any(one.startswith(name) for one in sections) for name in ("road_displacement", "unsprung_acceleration"))
    if road or not hub:
        yield f'road = {toml_value(LOGGED)}       # or "flat", "unknown", or a road such as "bump:height=0.05" with a speed'
        if not road:
            yield "# No heading names the height of the road: add [signals.road_displacement], or change road."
            yield '# If the log is from a random road at constant speed: road = "iso8608:class=C", and speed = "20 m/s"'
    else:
        yield f"road = {toml_value(UNKNOWN)}      # no heading names the road, so the input is the acceleration of the hub"
    yield 'start = "estimated"   # or "rest"'
    if any("mujoco" in one.column.lower().split() for each in sections.values() for one in each):
        yield 'heights = "held"      # constant during each step, as in a log of roadproof drive'
        yield 'forces = "held"'
    if not timed:
        yield "rate = 100.0          # samples per second, guessed, because no heading names the time; correct this number"
    for signal, guesses in sections.items():
        yield ""
        yield f"[signals.{signal}]  # {units[signal]}"
        for i, one in enumerate(guesses):
            warning = f"  # {one.warning}" if one.warning else ""
            yield f"{'# or: ' * bool(i)}column = {toml_value(one.column)}{warning}"
        yield "# sign = -1           # if the sensor counts the other direction as positive"
        yield '# delay = "10 ms"     # of the sensor; or "estimate"'
    if others:
        yield ""
        yield "# Columns that are not used:"
        yield from (f"# {one}" for one in others)
