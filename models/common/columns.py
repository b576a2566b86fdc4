"""Results as tables and as JSON: the key, title, digits and unit of a quantity stand in one place, its `Column`.

The columns of a result make a table on the terminal (`table`), one on a page (`models.figures.page.Table.of`), and the JSON
object (`json_object`).
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from models.common import printed

T = TypeVar("T")
Of = TypeVar("Of", contravariant=True)


@dataclass(frozen=True)
class Column(Generic[Of]):
    """A quantity of a result.

    Attributes:
        title: above it in a table.
        value: reads it off a result: a text, or a number in SI units.
        form: its digits in a table, as a format, or what writes the number.
        scale: of the number in a table, over SI units.
        key: in JSON, in SI units; empty if it is not there.
    """

    title: str
    value: Callable[[Of], Any]
    form: str | Callable[[float], str] = ""
    scale: float = 1.0
    key: str = ""

    def cell(self, one: Of) -> str:
        """Returns the text in a table; "-" for a number that does not exist, or is infinite and has but a format."""
        value = self.value(one)
        if isinstance(value, str) or value is None:
            return "-" if value is None else value
        value = self.scale * value
        return printed.cell(value, self.form) if isinstance(self.form, str) else self.form(value)

    def of(self, get: Callable[[T], Of], title: str = "") -> "Column[T]":
        """Returns the same quantity of what has such a result, under another title if one is given."""
        return Column(title or self.title, lambda one: self.value(get(one)), self.form, self.scale, self.key)


def titles(columns: Iterable[Column[Any]]) -> tuple[str, ...]:
    """Returns the titles of the columns."""
    return tuple(column.title for column in columns)


def cells(columns: Sequence[Column[T]], ones: Iterable[T]) -> tuple[tuple[str, ...], ...]:
    """Returns the rows of a table, one per result."""
    return tuple(tuple(column.cell(one) for column in columns) for one in ones)


def table(columns: Sequence[Column[T]], ones: Iterable[T], indent: str = printed.GAP) -> list[str]:
    """Returns the lines of a table on the terminal, a row per result."""
    return printed.table([titles(columns), *cells(columns, ones)], indent)


def json_object(columns: Iterable[Column[T]], one: T) -> dict[str, Any]:
    """Returns a result as JSON has it: None for a number that is infinite or does not exist."""
    values = ((column.key, column.value(one)) for column in columns if column.key)
    return {key: printed.finite(value) if isinstance(value, float) else value for key, value in values}
