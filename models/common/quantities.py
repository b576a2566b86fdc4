"""Names, units and signs of columns in the tables of users' files.

The same table of quantities is used for road profiles, drive files of rigs, characteristics of dampers and springs, and loads
against time.
"""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from models.common.errors import InputError, list_names, short_repr
from models.common.units import FORCE, LENGTH, MOMENT, TIME, VELOCITY, unit_named, unit_size


@dataclass(frozen=True)
class Quantity:
    """Quantity in a column of a table.

    Attributes:
        units: factor from each unit to SI units. The first unit is the SI unit. Units of the same dimension that are not listed
            are also allowed.
        positive: direction in which a number is positive, such as "in extension"; empty if only one meaning is possible.
        words: synonyms of the quantity's name, in lower case.
    """

    units: Mapping[str, float]
    positive: str
    words: str = ""

    @property
    def si(self) -> str:
        """SI unit of the quantity."""
        return next(iter(self.units))


QUANTITIES: Mapping[str, Quantity] = {
    "distance": Quantity(LENGTH, "along the road", "dist x s u station chainage position pos strecke stationierung"),
    "height": Quantity(LENGTH, "up", "heights h z elevation elevations elev ele altitude alt profile höhe höhen"),
    "left": Quantity(LENGTH, "up, under the left wheels", "l lwp"),
    "right": Quantity(LENGTH, "up, under the right wheels", "r rwp"),
    "time": Quantity(TIME, "", "t timestamp zeit temps"),
    "heave": Quantity(FORCE, "up"),
    "pitch": Quantity(MOMENT, "nose down"),
    "roll": Quantity(MOMENT, "right side down"),
    "velocity": Quantity(VELOCITY, "in extension"),
    "deflection": Quantity(LENGTH, "in extension"),
    "force": Quantity(FORCE, "against extension"),
}
UNREAD = "another quantity"
_WORDS: Mapping[str, str] = {  # quantities that no reader uses, and words in headings that do not name a quantity
    UNREAD: "speed v acceleration lat latitude lon longitude iri slope width n no number index id",
    "": "wheel wheelpath path track road surface ground along the of in side vertical gps gnss point above sea level",
    **{name: f"{name} {quantity.words}" for name, quantity in QUANTITIES.items()},
}
NAMES: Mapping[str, str] = {word: name for name, words in _WORDS.items() for word in words.split()}
# Words of a heading that state the sign of the numbers below it: 1 for positive in extension, -1 for positive in compression
DIRECTIONS: Mapping[str, int] = {
    word: sign
    for sign, words in (
        (-1, "compression comp bump bound jounce druck druckkraft druckstufe einfederung einfederweg"),
        (1, "extension ext rebound reb droop zug zugkraft zugstufe ausfederung ausfederweg détente"),
    )
    for word in words.split()
}
CORNERS = {"fl": "front_left", "lf": "front_left", "fr": "front_right", "rf": "front_right"}
# Other names of the vehicle's corners, as in the files of test rigs
CORNERS |= {"rl": "rear_left", "lr": "rear_left", "rr": "rear_right"}
BRACKETS = re.compile(r"\s*[\[(]\s*([^\])]*?)\s*[\])]$")


@dataclass(frozen=True)
class Heading:
    """Heading of a column.

    Attributes:
        text: whole text of the heading, including the unit.
        name: text of the heading without the unit.
        unit: usual name of the unit; for an unknown unit, the text in the heading. Empty for a heading without a unit.
        column: number of the column, counted from 1.
    """

    text: str = ""
    name: str = ""
    unit: str = ""
    column: int = 0

    @property
    def quantity(self) -> str:
        """Key in `QUANTITIES` of the column's quantity; empty if a word is unknown, or if the heading does not name exactly one
        quantity.
        """
        named = {NAMES.get(word, "unknown") for word in self.words} - {""}
        if len(named) == 2:
            named.discard("height")  # a heading "left height" means the same as "height left"
        return named.pop() if len(named) == 1 and named != {"unknown"} else ""

    @property
    def words(self) -> frozenset[str]:
        """Words of the heading's name, in lower case."""
        return frozenset(re.findall(r"[^\W\d_]+", self.name.lower()))

    @property
    def direction(self) -> int:
        """Positive direction that the heading gives: 1 for extension, -1 for compression, 0 if the heading gives neither or
        both.
        """
        return sum({DIRECTIONS[word] for word in self.words & DIRECTIONS.keys()})

    def scale(self, quantity: str, option: str = "", given: str = "", default: str = "") -> float:
        """Returns the factor from the column's unit to SI units.

        Args:
            quantity: quantity of the column, a key of `QUANTITIES`.
            option: name of the setting that can give the unit; empty if no setting gives the unit.
            given: the unit that the setting gives; empty if the setting gives no unit.
            default: the unit of a heading without a unit; empty if a unit is required.

        Raises:
            InputError: the unit is missing, does not belong to the quantity, or contradicts the setting.
        """
        units, si = QUANTITIES[quantity].units, QUANTITIES[quantity].si
        size = unit_size(self.unit, si)
        column = f"column {self.column}, {short_repr(self.text)}," if self.text else f"column {self.column}"
        allowed, instead = f"allowed: {list_names(units)}", f", or give :{option}={si}" if option else ""
        if given and size not in (None, units[given]):
            raise InputError(
                f"{column} has a heading with the unit {self.unit}, but {option} = {given} gives a different unit; "
                f"make the two units agree, or omit {option}"
            )
        if not given and self.unit and size is None:
            raise InputError(
                f"{column} has the unit {short_repr(self.unit)} ({allowed}); convert the column to an allowed unit{instead}"
            )
        if not (given or self.unit or default):
            name = f"{self.name}_{re.sub('[ /]', '_', si)}"  # a heading in this form can also be the name of a MATLAB variable
            raise InputError(
                f"the heading of {column} has no unit ({allowed}); change the heading to {self.name} [{si}] or to {name}{instead}"
            )
        return units[given or default] if given or size is None else size


def heading_of(text: str, units: Collection[str], column: int = 0) -> Heading:
    """Returns a heading from the text of its cell, such as `right [mm]`, `height_cm`, `Distance (ft)`, `left / mm`, `[m]`, `m`.

    If `units` contains units of force, a pound (lb) is a force.

    Args:
        text: text of the cell.
        units: units whose dimensions are allowed for a unit without brackets.
        column: number of the column, counted from 1.
    """
    text = " ".join(text.split())
    if bracket := BRACKETS.search(text):
        is_unit = any(unit_size(bracket[1], quantity.si) for quantity in QUANTITIES.values())
        if Heading(name=bracket[1]).quantity in QUANTITIES and not is_unit:
            return Heading(text, text, "", column)  # the brackets contain no unit, as in "height (left)"
        return Heading(text, text[: bracket.start()], _unit_of(bracket[1], units), column)
    for gap in re.finditer(r"^|[\s_/,-]+", text):
        # The underscore replaces / in names of MATLAB variables such as velocity_mm_s
        written = text[gap.end() :].replace("_", "/")
        if any(unit_size(_unit_of(written, units), unit) for unit in units):
            return Heading(text, text[: gap.start()], _unit_of(written, units), column)
    return Heading(text, text, "", column)


def columns_in_words(headings: Sequence[Heading]) -> str:
    """Returns a phrase with the numbers and headings of columns, for example: columns 1 ('X') and 2 ('Y')."""
    names = [f"{one.column} ({short_repr(one.text)})" for one in headings]
    return f"column{'s' * (len(names) > 1)} {' and '.join(filter(None, (', '.join(names[:-1]), names[-1])))}"


def left_out_words(headings: Sequence[Heading], used: Collection[int]) -> list[str]:
    """Returns a remark about columns that have a heading but are not used; empty if all columns are used.

    Args:
        headings: headings of all columns.
        used: numbers of the columns that are used, counted from 1.
    """
    left = [one for one in headings if one.text and one.column not in used]
    return [f"{columns_in_words(left)} {'are' if len(left) > 1 else 'is'} left out"] if left else []


def _unit_of(written: str, units: Collection[str]) -> str:
    """Returns the usual name of a unit that a heading contains."""
    unit = unit_named(written)
    return "lbf" if unit == "lb" and "N" in units else unit
