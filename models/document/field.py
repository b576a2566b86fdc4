"""A quantity of a result: what it is called, its unit and digits, and its key in JSON. All outputs read it here."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, Literal, TypeVar

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


def json_object(fields: Iterable[Field[T]], one: T) -> dict[str, Any]:
    """Returns a result for JSON, with None for infinite or absent numbers."""
    values = ((field.key, field.value(one)) for field in fields if field.key)
    return {key: finite(value) if isinstance(value, float) else value for key, value in values}


def at_most(value: float) -> str:
    """Returns a number with two digits, rounded up, for a sentence that says that something is within it."""
    if value <= 0:
        return "0"
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return f"{math.ceil(value / unit * (1 - 1e-12)) * unit:.1e}"
