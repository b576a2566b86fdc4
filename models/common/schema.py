"""Declarations of sections of TOML files: the allowed keys, their units, ranges and meanings.

A section is a frozen dataclass; the annotation of each field gives the unit, range and meaning of a key.

    @dataclass(frozen=True)
    class Payload(Section):
        mass: Annotated[float, SI("kg", "point mass on the body", high=1e5)]
        x: Annotated[float, SI("m", "position of the mass, forward", -20.0, 20.0)] = 0.0

The declaration determines how the section is read, and the messages for invalid input (`read`). The declaration also determines
the record of the section in logs (`Section.record`), the reference page (`keys`) and the JSON schema (`json_schema`).
`models.common.checks` uses the same annotations for public functions.
"""

import functools
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import MISSING, Field, dataclass, field, fields
from typing import Annotated, Any, ClassVar, TypeVar, get_args, get_origin

from models.common.checks import HERE, is_finite
from models.common.errors import InputError, alike, error_in, list_names, number_range, short_repr
from models.common.units import in_unit, setting

SMALLEST, LARGEST = 1e-6, 1e12  # limits of numbers in files [SI]; a larger or smaller number is probably a mistake
# JSON schemas of the types
TEXT, NUMBER, PAIR = {"type": "string"}, {"type": ["number", "string"]}, {"type": "array", "minItems": 2, "maxItems": 2}
# Pattern of a text that consists of a number and a unit
WITH_UNIT = r"^\s*[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?\s*[^\s\d.,eE+-]"
MOST_SEED = 2**63 - 1
# `read` replaces this placeholder by section and key; if ".NAME" follows, NAME is a key inside the value
PLACES = re.compile(HERE + r"((?:\.\w+)*)")


class Key:
    """Annotation of a key.

    The method `read` converts and checks the value of the key. The attributes describe the key in the reference page and the
    JSON schema.

    Attributes:
        unit: unit of the value; empty for a value without a unit.
        meaning: description of the key in one phrase.
        schema: JSON schema of the value, if all keys of the class have the same schema.
    """

    unit: str = ""
    meaning: str = ""
    schema: ClassVar[Mapping[str, Any]] = {}

    @property
    def json(self) -> Mapping[str, Any]:
        """JSON schema of the value."""
        return self.schema

    def read(self, value: Any, context: Mapping[str, Any]) -> Any:
        """Returns the converted value of the key.

        Args:
            value: value of the key in the file.
            context: facts about the vehicle (see `read`), and the values of the keys that are declared before the key that is
                read.

        Raises:
            InputError: the value is not allowed. The message of the error contains the placeholder `HERE`, not the names of
                section and key.
        """
        raise NotImplementedError


@dataclass(frozen=True)
class SI(Key):
    """Key whose value is a number with a unit and a range, written as 380 or "380 kg". `more` is the end of the message for an
    invalid value.

    The number may be infinite if the range has no upper limit. Like `Must`, the annotation `SI` can also be a condition for
    `models.common.checks`.
    """

    unit: str = "1"
    meaning: str = ""
    low: float = SMALLEST
    high: float = LARGEST
    more: str = ""

    def read(self, value: Any, context: Mapping[str, Any]) -> float:
        """Returns the number in SI units."""
        return self.number(HERE, value)

    def number(self, what: str, value: Any) -> float:
        """Returns a number in SI units. `what` is the name of the number in messages.

        Raises:
            InputError: the value is not a number, is out of range, or has a unit of the wrong dimension.
        """
        value = in_unit(value, self.unit, what)
        if not (is_finite(value) or (isinstance(value, float) and value == self.high)) or not self.low <= value <= self.high:
            raise InputError(f"{what} = {short_repr(value)} is not allowed; give {self.words}{self.more}")
        return float(value)

    @property
    def words(self) -> str:
        """Description of the allowed values; see `models.common.checks.Must`."""
        return number_range(self.low, self.high, self.unit)

    @property
    def json(self) -> Mapping[str, Any]:
        """JSON schema of the number."""
        number = {"type": "number", "minimum": self.low} | ({"maximum": self.high} if self.high < math.inf else {})
        return {"anyOf": [number, {"type": "string", "pattern": WITH_UNIT}]}


@dataclass(frozen=True)
class Flag(Key):
    """Key whose value is true or false. `more` is the end of the message for an invalid value."""

    schema: ClassVar[Mapping[str, Any]] = {"type": "boolean"}
    meaning: str = ""
    more: str = ""

    def read(self, value: Any, context: Mapping[str, Any]) -> bool:
        """Returns True or False."""
        if not isinstance(value, bool):
            raise InputError(f"{HERE} = {short_repr(value)} is not allowed; give true or false{self.more}")
        return value


@dataclass(frozen=True)
class Integer(Key):
    """Key whose value is an integer in a range. `more` is the end of the message for an invalid value."""

    meaning: str = ""
    low: int = 0
    high: int = 100_000
    more: str = ""

    def read(self, value: Any, context: Mapping[str, Any]) -> int:
        """Returns the integer."""
        if isinstance(value, bool) or not isinstance(value, int) or not self.low <= value <= self.high:
            raise InputError(
                f"{HERE} = {short_repr(value)} is not allowed; give an integer from {self.low} to {self.high}{self.more}"
            )
        return value

    @property
    def json(self) -> Mapping[str, Any]:
        """JSON schema of the integer."""
        return {"type": "integer", "minimum": self.low, "maximum": self.high}


@dataclass(frozen=True)
class Choice(Key):
    """Key whose value is one of several texts. `more` is the end of the message for an invalid value."""

    meaning: str = ""
    texts: tuple[str, ...] = ()
    more: str = ""

    def read(self, value: Any, context: Mapping[str, Any]) -> str:
        """Returns the text."""
        if not isinstance(value, str) or value not in self.texts:
            raise InputError(f"{HERE} = {short_repr(value)} is not allowed; give {' or '.join(map(repr, self.texts))}{self.more}")
        return value

    @property
    def json(self) -> Mapping[str, Any]:
        """JSON schema of the text."""
        return {"enum": list(self.texts)}


@dataclass(frozen=True)
class Text(Key):
    """Key whose value is a text. `more` is the end of the message for an invalid value."""

    schema: ClassVar[Mapping[str, Any]] = TEXT
    meaning: str = ""
    more: str = ""

    def read(self, value: Any, context: Mapping[str, Any]) -> str:
        """Returns the text."""
        if not isinstance(value, str):
            raise InputError(f"{HERE} = {short_repr(value)} is not allowed; give a text in quotes{self.more}")
        return value


@dataclass(frozen=True)
class ListedValues(Key):
    """Key whose value is a list; each value in the list is read by the `Key` in `each`.

    `more` is the end of the message for a list of invalid length.
    """

    meaning: str = ""
    each: Key = Text()
    more: str = ""
    least: int = 1
    most: int | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "unit", self.each.unit)

    def read(self, value: Any, context: Mapping[str, Any]) -> tuple[Any, ...]:
        """Returns the values."""
        listed = isinstance(value, list | tuple)
        if not listed or not self.least <= len(value) <= (self.most or len(value)):
            wrong = f"has {len(value)} value(s)" if listed and value else f"= {short_repr(value)} is not allowed"
            least = f" of at least {'one value' if self.least == 1 else f'{self.least} values'}" * bool(self.least)
            most = f", and at most {self.most}" if self.most else ""
            raise InputError(f"{HERE} {wrong}; give a list{least}{most}{self.more}")
        return tuple(below(f"[{i}]", self.each, one, context) for i, one in enumerate(value))

    @property
    def json(self) -> Mapping[str, Any]:
        """JSON schema of the list."""
        return {"type": "array", "items": dict(self.each.json), "minItems": self.least}


@dataclass(frozen=True)
class AnyTable(Key):
    """Key whose value is a table in which the keys are names. The values of the table are read later, when more information is
    available.
    """

    schema: ClassVar[Mapping[str, Any]] = {"type": "object"}
    meaning: str = ""

    def read(self, value: Any, context: Mapping[str, Any]) -> Mapping[str, Any]:
        """Returns the table."""
        if not isinstance(value, Mapping):
            raise InputError(
                f"{HERE} = {short_repr(value)} is not a table; write the name of the table in single brackets, and "
                "its keys on the lines below"
            )
        return value


@dataclass(frozen=True)
class Subsection(Key):
    """Key whose value is a table that is read as a section.

    If several sections are possible, the section is the one whose required key is in the table.

    `give` is the end of the message for an invalid value.
    """

    meaning: str = ""
    sections: "tuple[type[Section], ...]" = ()
    give: str = "a table"

    def read(self, value: Any, context: Mapping[str, Any]) -> Any:
        """Returns the section."""
        fitting = self.sections if isinstance(value, Mapping) else ()
        if len(fitting) > 1:
            fitting = [one for one in fitting if next(iter(required_keys(one))) in value]
        if len(fitting) != 1:
            raise InputError(f"{HERE} = {short_repr(value)} is not allowed; give {self.give}")
        return read(HERE, fitting[0], value, **context)

    @property
    def json(self) -> Mapping[str, Any]:
        """JSON schema of the section."""
        return {"anyOf": [json_schema(one) for one in self.sections]}


@dataclass(frozen=True)
class BySignal(Key):
    """Key whose value is a table of numbers by name, such as the name of a signal. Each number has the unit of its signal, or
    all numbers have the same unit.

    The entry `names` in the argument `context` gives the unit of each allowed name.
    """

    meaning: str = ""
    names: str = "signals"
    low: float = 0.0
    high: float = LARGEST
    unit: str = ""

    def read(self, value: Any, context: Mapping[str, Any]) -> dict[str, float]:
        """Returns the numbers in SI units, by signal."""
        units, what = context[self.names], self.names.removesuffix("s")
        if not isinstance(value, Mapping):
            example = f"{{ {next(iter(units), what)} = {max(self.low, 0.01):g} }}"
            raise InputError(f"{HERE} = {short_repr(value)} is not a table; give a table, as in {example}")
        for name in value:
            if name not in units:
                raise InputError(f"{HERE}: unknown {what} {short_repr(name)}; give one of {alike(name, units)}")
        ranges = {name: SI(self.unit or units[name], low=self.low, high=self.high) for name in value}
        return {name: ranges[name].number(f"{HERE}.{name}", one) for name, one in value.items()}

    @property
    def json(self) -> Mapping[str, Any]:
        """JSON schema of the table."""
        return {"type": "object", "additionalProperties": SI("of its signal", "", self.low, self.high).json}


@dataclass(frozen=True)
class ReadBy(Key):
    """Key whose value has a form that only one section uses.

    The function `function` takes the value and the context, and returns the converted value; `allowed` is the JSON schema of
    the value.
    """

    meaning: str = ""
    function: Callable[[Any, Mapping[str, Any]], Any] = lambda value, _: value
    unit: str = ""
    allowed: Mapping[str, Any] = field(default_factory=dict, compare=False)

    @property
    def json(self) -> Mapping[str, Any]:
        """JSON schema of the value."""
        return self.allowed

    def read(self, value: Any, context: Mapping[str, Any]) -> Any:
        """Returns the value as converted by `function`."""
        return self.function(value, context)


def below(place: str, key: Key, value: Any, context: Mapping[str, Any]) -> Any:
    """Reads one part of the value of a key. Messages also contain the place of the part within the value, as `.NAME` or
    `[INDEX]`.
    """
    try:
        return key.read(value, context)
    except InputError as error:
        raise InputError(str(error).replace(HERE, f"{HERE}{place}")) from error


class Section:
    """Base class of dataclasses that are sections of a file.

    Attributes:
        hints: advice about keys that a user may expect but that the section does not have, by key.
        by_place: True if the section may contain sections for single suspensions or axles.
    """

    hints: ClassVar[Mapping[str, str]] = {}
    by_place: ClassVar[bool] = False

    @classmethod
    def prepared(cls, given: Mapping[str, Any]) -> Mapping[str, Any]:
        """Returns the table of a file after converting those values that depend on other keys.

        The values in the table have not been checked yet.
        """
        return given

    @property
    def record(self) -> dict[str, Any]:
        """The section as it is written to a log: the keys whose values differ from the defaults, with values in SI units."""
        given = {one.name: (getattr(self, one.name), one.default) for one in fields(self)}  # pyright: ignore[reportArgumentType]
        return {name: _plain_value(value) for name, (value, usual) in given.items() if value != usual}


def _plain_value(value: Any) -> Any:
    """Converts a value of a section to the form in which TOML and JSON files contain the value."""
    if isinstance(value, Section):
        return value.record
    return [_plain_value(one) for one in value] if isinstance(value, tuple) else value


S = TypeVar("S", bound=Section)


def read(where: str, section: type[S], given: Any, /, **context: Any) -> S:
    """Reads a section of a TOML or JSON file.

    Args:
        where: name of the section, such as "[payload]", for messages.
        section: dataclass of the section.
        given: table of the section, as read from TOML or JSON.
        context: facts about the vehicle on which the allowed values depend, by name.

    Returns:
        The section, an object of the dataclass.

    Raises:
        InputError: a key is missing or unknown, a value is not allowed, or values do not fit together. The error message gives
            section and key, the wrong value, the allowed values and a correction.
    """
    if not isinstance(given, Mapping):
        write = f"section; write {where} once, and its keys below"
        if not where.endswith("]"):
            write = f"table; give {{ ... }} with keys of {list_names(keys(section))}"
        raise InputError(f"{where} = {short_repr(given)} is not a {write}")
    with error_in(where):
        given = section.prepared(given)
    for name in given:
        if name not in keys(section):
            if hint := section.hints.get(name):
                raise InputError(f"{where} {short_repr(name)} {hint}".lstrip())
            stem = next((key for key in keys(section) if section.by_place and name.startswith(f"{key}_")), "")
            known = f"known keys: {alike(name, keys(section))}"
            instead = f"write {stem} in a section {where[:-1]}.{name.removeprefix(f'{stem}_')}]" if stem else known
            raise InputError(f"{where} unknown key {short_repr(name)}; {instead}".lstrip())
    values, seen = dict[str, Any](), dict[str, Any]()
    for one in fields(section):  # pyright: ignore[reportArgumentType]
        name, key, usual = one.name, keys(section)[one.name], _default(one)
        if name not in given and usual is MISSING:
            unit = f" [{key.unit}]" if key.unit else ""
            raise InputError(f"{where} {name} is missing; give {name}{unit}: {key.meaning}".lstrip())
        if name in given and (given[name] is not None or usual is not None):  # in a log, a value that is not given is null
            with locate_errors(where, [name]):
                values[name] = key.read(given[name], {**seen, **context})
        seen[name] = values.get(name, usual)
    with locate_errors(where, []):
        return section(**values)


@contextmanager
def locate_errors(where: str, path: Sequence[str]) -> Iterator[None]:
    """Adds section and key to the message of an InputError: they replace `HERE` if the message contains it, and precede the
    message otherwise.
    """
    try:
        yield
    except InputError as error:
        text = str(error) if HERE in str(error) else f"{HERE} {error}"
        raise InputError(PLACES.sub(lambda found: _place(where, [*path, *found[1].split(".")[1:]]), text)) from error


def read_text(where: str, section: type[S], text: str, names: Sequence[str] = ()) -> S:
    """Reads a section from a text `:NAME=VALUE:NAME=VALUE`, as on a command line. Numbers in the text may have no unit.

    Args:
        where: name of the section, for messages.
        section: dataclass of the section.
        text: text of the section, such as ":class=C:seed=3".
        names: names of the keys that the text may contain; by default, the names of all keys.

    Raises:
        InputError: the text does not have the form `:NAME=VALUE`, or a name or value is not allowed.
    """
    known, given = keys(section), dict[str, Any]()
    with error_in(where):
        for part in text.split(":")[1:]:
            name, equals, value = part.partition("=")
            if not equals:
                raise InputError(f"{part!r} does not have the form NAME=VALUE; NAME must be one of {list_names(names or known)}")
            if name not in (names or known):
                raise InputError(f"the name {name!r} in {part!r} is unknown; give one of {list_names(names or known)}")
            if re.search(r",\s*\w+=", value):
                raise InputError(f"the values in {part!r} are separated by commas; separate them by colons, as in a=1:b=2")
            if name in given:
                raise InputError(f"{name} is given twice, as {given[name]!r} and as {value!r}; give it once")
            given[name] = value
        numbers = {
            name: setting(name, given[name], key.unit) for name, key in known.items() if isinstance(key, SI) and name in given
        }
    return read(where, section, given | numbers)


def _place(where: str, path: Sequence[str]) -> str:
    """Returns the name of a key as in TOML, with the names of its tables in brackets."""
    if where.startswith(HERE):
        return ".".join([where, *path])
    if not where.endswith("]"):
        return " ".join(filter(None, (where, ".".join(path))))
    return " ".join([f"{where[:-1]}.{'.'.join(path[:-1])}]" if path[1:] else where, *path[-1:]])


@functools.cache
def keys(section: type) -> dict[str, Key]:
    """Returns the annotation of every key of a section by name, with its unit, meaning and allowed values."""
    return {one.name: _key(one.type) for one in fields(section)}


def required_keys(section: type) -> list[str]:
    """Returns the names of the keys of a section that do not have a default."""
    return [one.name for one in fields(section) if _default(one) is MISSING]


def _default(field: "Field[Any]") -> Any:
    """Returns the default of a field; `MISSING` for a field without a default."""
    return field.default if field.default_factory is MISSING else field.default_factory()


def json_schema(section: type) -> dict[str, Any]:
    """Returns the JSON schema of a section."""
    properties = {name: described_key(key.json, key.meaning, key.unit) for name, key in keys(section).items()}
    return {"type": "object", "properties": properties, "required": required_keys(section), "additionalProperties": False}


def described_key(schema: Mapping[str, Any], meaning: str, unit: str) -> dict[str, Any]:
    """Returns the JSON schema of a key with its meaning and unit, which editors show."""
    return {**schema, "description": f"{meaning}{f' [{unit}]' if unit else ''}"}


def _key(annotation: Any) -> Key:
    """Returns the `Key` in an annotation; the annotation may also allow None."""
    if get_origin(annotation) is Annotated:
        return next(one for one in get_args(annotation)[1:] if isinstance(one, Key))
    return next(_key(one) for one in get_args(annotation) if get_origin(one) is Annotated)
