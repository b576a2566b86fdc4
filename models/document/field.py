"""Quantity of a result, with the name, unit, digits and JSON key that it has in all forms of output.

Quantities are the columns of a table, and the values of a `Record`.
"""

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, is_dataclass, replace
from operator import attrgetter
from typing import Any, Generic, Literal, TypeAlias, TypeVar

from models.common.printed import cell, finite

T = TypeVar("T")
Of = TypeVar("Of", contravariant=True)
# Level of detail: shown even in brief output, shown by default, or shown only with -v (on a page: collapsed)
Detail = Literal["brief", "normal", "full"]


@dataclass(frozen=True)
class Field(Generic[Of]):
    """A quantity of a result.

    Attributes:
        label: name of the quantity.
        value: function that takes a result and returns a text, or a number in SI units.
        form: format of the number, or a function that formats the number.
        scale: factor from SI units to `unit`.
        key: key in JSON, for the value in SI units; empty to omit the quantity in JSON.
        unit: unit in which the quantity is written; empty for a quantity without a unit, or if `form` writes the unit.
        detail: lowest level of detail at which the quantity is a column of a table.
        column: key of the column in a report's JSON tables; empty if the key is the heading.
    """

    label: str
    value: Callable[[Of], Any]
    form: str | Callable[[float], str] = ""
    scale: float = 1.0
    key: str = ""
    unit: str = ""
    detail: Detail = "normal"
    column: str = ""

    @property
    def title(self) -> str:
        """Heading of the quantity's column."""
        return f"{self.label} [{self.unit}]" if self.unit else self.label

    def cell(self, one: Of) -> str:
        """Returns the cell of a table; "-" for a missing number, and for an infinite number if `form` is a format."""
        return self.digits(self.value(one))

    def digits(self, value: Any) -> str:
        """Converts a value in SI units to text without its unit, in the same form as `cell`."""
        if isinstance(value, str) or value is None:
            return "-" if value is None else value
        value = self.scale * value
        return cell(value, self.form) if isinstance(self.form, str) else self.form(value)

    def text(self, value: Any) -> str:
        """Returns a value in SI units as text for a sentence, with its unit."""
        return f"{self.digits(value)} {self.unit}".rstrip()

    def of(self, get: Callable[[T], Of | None], label: str = "") -> "Field[T]":
        """Returns a field that shows the same quantity for objects that contain the result.

        Args:
            get: function that returns the result in an object, or None for an object without a result.
            label: label of the new field; by default, the label of this field.
        """

        def value(one: T) -> Any:
            result = get(one)
            return None if result is None else self.value(result)

        return replace(self, label=label or self.label, value=value)  # pyright: ignore


def titles(fields: Iterable[Field[Any]]) -> tuple[str, ...]:
    """Returns the column headings of the fields."""
    return tuple(field.title for field in fields)


def cells(fields: Sequence[Field[T]], ones: Iterable[T]) -> tuple[tuple[str, ...], ...]:
    """Returns the rows of a table, one row per result."""
    return tuple(tuple(field.cell(one) for field in fields) for one in ones)


Part: TypeAlias = str | Callable[[T], Mapping[str, Any]]
Value: TypeAlias = str | Callable[[T], Any]


def _value(get: "Field[T] | Value[T]", one: T) -> Any:
    return get.value(one) if isinstance(get, Field) else attrgetter(get)(one) if isinstance(get, str) else get(one)


class Record(Generic[T]):
    """JSON object of a result: values by key.

    A record is a function of the result, so one record can be a value in another record.

    None represents an infinite or missing number, and [real, imaginary] a complex number. An array becomes a list, and a
    dataclass becomes an object.
    """

    def __init__(self, *parts: "Field[T] | Part[T]", **values: "Field[Any] | Value[Any]") -> None:
        """Prepares the record from the parts that give the values of the JSON object.

        Args:
            parts: fields, names of attributes, records or functions that give the values. Fields that have no JSON key are
                omitted. The name of an attribute is also the key of its value. The keys of objects that records and functions
                return become keys of the JSON object.
            values: further values by key, after those of the parts: fields, functions, or names of attributes, such as
                "certificate.norm".
        """
        keyed = [
            {part.key: part} if isinstance(part, Field) else {part: part} if isinstance(part, str) else part for part in parts
        ]
        self._parts: list[Callable[[T], Mapping[str, Any]] | Mapping[str, Any]] = [*keyed, values]

    def __call__(self, one: T) -> dict[str, Any]:
        """Returns the JSON object of a result, without keys whose value is `OMITTED_KEY`."""
        found: dict[str, Any] = {}
        for part in self._parts:
            found |= dict(part(one)) if callable(part) else {key: _value(get, one) for key, get in part.items() if key}
        return {key: plain(value) for key, value in found.items() if value is not OMITTED_KEY}

    def all(self, get: "Value[Any]") -> Callable[[Any], Any]:
        """Returns a function for use as a value in an outer record; the outer record then contains the JSON objects of this
        record.

        Args:
            get: field, function or attribute that gives one result, or a list, tuple or mapping of results.
        """

        def each(results: Any) -> Any:
            if results is None or results is OMITTED_KEY:
                return results
            if isinstance(results, Mapping):
                return {key: self(one) if one and not isinstance(one, Mapping) else each(one) for key, one in results.items()}
            return [self(one) for one in results] if isinstance(results, list | tuple) else self(results)

        return lambda one: each(_value(get, one))


OMITTED_KEY: Any = object()


def if_any(get: Callable[[T], Any]) -> Callable[[T], Any]:
    """Returns a function for use as a value in a record; if the function returns None or an empty value, the record omits the
    key.
    """

    def value(one: T) -> Any:
        found = get(one)
        return found if found is not None and (not isinstance(found, Collection) or len(found)) else OMITTED_KEY

    return value


def plain(value: Any) -> Any:
    """Returns a value in the form of JSON; see `Record`."""
    if isinstance(value, float):
        return finite(value)
    if isinstance(value, complex):
        return [finite(value.real), finite(value.imag)]
    if isinstance(value, Mapping):
        return {key: plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [plain(one) for one in value]
    if is_dataclass(value) and not isinstance(value, type):
        return plain(asdict(value))
    values = getattr(value, "tolist", None)  # NumPy arrays and NumPy numbers have the method `tolist`
    return value if values is None else plain(values())


def at_most(value: float) -> str:
    """Returns a number rounded up to two digits, for a sentence that gives an upper limit."""
    if value <= 0:
        return "0"
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return f"{math.ceil(value / unit * (1 - 1e-12)) * unit:.1e}"
