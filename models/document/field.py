"""A quantity of a result: what it is called, its unit and digits, and its key in JSON. All outputs read it here.

The quantities are the columns of a table, and the values of a `Record`.
"""

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, is_dataclass, replace
from operator import attrgetter
from typing import Any, Generic, Literal, TypeAlias, TypeVar

from models.common.printed import cell, finite

T = TypeVar("T")
Of = TypeVar("Of", contravariant=True)
Detail = Literal["brief", "normal", "full"]  # shown even if the answer is to be brief; by default; only with -v, folded on a page


@dataclass(frozen=True)
class Field(Generic[Of]):
    """A quantity of a result.

    Attributes:
        label: name of the quantity.
        value: function of a result: a text, or a number in SI units.
        form: format of a number, or a function that formats it.
        scale: factor from SI units to `unit`.
        key: key in JSON, for the value in SI units; empty to omit the quantity there.
        unit: unit in which it is written; empty if it has none, or if `form` writes it.
        detail: lowest level of detail at which it is a column of a table.
        column: key of its column in the tables of a report in JSON; empty if that is the heading.
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
        """Returns the heading of its column."""
        return f"{self.label} [{self.unit}]" if self.unit else self.label

    def cell(self, one: Of) -> str:
        """Returns the text in a table; "-" for an absent number, or an infinite one if `form` is a format."""
        return self.digits(self.value(one))

    def digits(self, value: Any) -> str:
        """Returns a value of this quantity, in SI units, as `cell` does, without its unit."""
        if isinstance(value, str) or value is None:
            return "-" if value is None else value
        value = self.scale * value
        return cell(value, self.form) if isinstance(self.form, str) else self.form(value)

    def text(self, value: Any) -> str:
        """Returns a value of this quantity, in SI units, for a sentence: with its unit."""
        return f"{self.digits(value)} {self.unit}".rstrip()

    def of(self, get: Callable[[T], Of | None], label: str = "") -> "Field[T]":
        """Returns the field of objects from which `get` returns the result, or None for none; with a label if one is given."""

        def value(one: T) -> Any:
            result = get(one)
            return None if result is None else self.value(result)

        return replace(self, label=label or self.label, value=value)  # pyright: ignore


def titles(fields: Iterable[Field[Any]]) -> tuple[str, ...]:
    """Returns the headings of the fields."""
    return tuple(field.title for field in fields)


def cells(fields: Sequence[Field[T]], ones: Iterable[T]) -> tuple[tuple[str, ...], ...]:
    """Returns the rows of a table, one per result."""
    return tuple(tuple(field.cell(one) for field in fields) for one in ones)


Part: TypeAlias = str | Callable[[T], Mapping[str, Any]]
Value: TypeAlias = str | Callable[[T], Any]


def _value(get: "Field[T] | Value[T]", one: T) -> Any:
    return get.value(one) if isinstance(get, Field) else attrgetter(get)(one) if isinstance(get, str) else get(one)


class Record(Generic[T]):
    """JSON object of a result: values by their keys. A record is a function of the result, so that it can be a value of another.

    None stands for an infinite or absent number, [real, imaginary] for a complex
    one, a list for an array, and an object for a dataclass.
    """

    def __init__(self, *parts: "Field[T] | Part[T]", **values: "Field[Any] | Value[Any]") -> None:
        """Prepares the object.

        Args:
            parts: fields, without those that lack a key; names of attributes, which are also keys; and records or functions,
                whose keys become keys of this object.
            values: further values, after these: fields, functions, or attributes by their names, as in "certificate.norm".
        """
        keyed = [
            {part.key: part} if isinstance(part, Field) else {part: part} if isinstance(part, str) else part for part in parts
        ]
        self._parts: list[Callable[[T], Mapping[str, Any]] | Mapping[str, Any]] = [*keyed, values]

    def __call__(self, one: T) -> dict[str, Any]:
        """Returns the object of a result, without the keys whose value is `OMITTED_KEY`."""
        found: dict[str, Any] = {}
        for part in self._parts:
            found |= dict(part(one)) if callable(part) else {key: _value(get, one) for key, get in part.items() if key}
        return {key: plain(value) for key, value in found.items() if value is not OMITTED_KEY}

    def all(self, get: "Value[Any]") -> Callable[[Any], Any]:
        """Returns a value of another record: the object of a result there, or all objects in its list, tuple or mapping."""

        def each(results: Any) -> Any:
            if results is None or results is OMITTED_KEY:
                return results
            if isinstance(results, Mapping):
                return {key: self(one) if one and not isinstance(one, Mapping) else each(one) for key, one in results.items()}
            return [self(one) for one in results] if isinstance(results, list | tuple) else self(results)

        return lambda one: each(_value(get, one))


OMITTED_KEY: Any = object()


def if_any(get: Callable[[T], Any]) -> Callable[[T], Any]:
    """Returns a value of a record that omits its key if the value is None or empty."""

    def value(one: T) -> Any:
        found = get(one)
        return found if found is not None and (not isinstance(found, Collection) or len(found)) else OMITTED_KEY

    return value


def plain(value: Any) -> Any:
    """Returns a value for JSON, see `Record`."""
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
    values = getattr(value, "tolist", None)  # of an array, or of a number of NumPy
    return value if values is None else plain(values())


def at_most(value: float) -> str:
    """Returns a number with two digits, rounded up, for a sentence that says that something is within it."""
    if value <= 0:
        return "0"
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return f"{math.ceil(value / unit * (1 - 1e-12)) * unit:.1e}"
