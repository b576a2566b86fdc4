"""Printed output: lines of at most 80 columns, numbers, commands to be pasted into a shell, and progress.

The width is fixed, so that output does not depend on the terminal. A longer sentence goes on in the next line, indented; a table
gives a name that is too long a line of its own. Only paths and lines to be copied may be longer: they must not be cut.

A `Column` holds the key, title, digits and unit of a quantity of a result. The columns of a result make a table on the terminal
(`column_table`), one on a page (`models.figures.page.Table.of`), and the JSON object (`json_object`).
"""

import math
import re
import shlex
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any, Generic, TypeVar

from models.common.errors import InputError, listing

T = TypeVar("T")
Of = TypeVar("Of", contravariant=True)


def finite(value: Any) -> float | None:
    """Returns a number as JSON has it: None for one that is infinite or does not exist."""
    return float(value) if value is not None and math.isfinite(value) else None


def finite_pairs(values: Iterable[complex]) -> list[list[float | None]]:
    """Returns complex numbers as JSON has them: [real, imaginary]."""
    return [[finite(value.real), finite(value.imag)] for value in values]


def cell(value: float | None, form: str, unit: str = "") -> str:
    """Returns a number as a table has it, "-" for one that is infinite or does not exist."""
    return f"{value:{form}}{unit}" if value is not None and math.isfinite(value) else "-"


def percent(share: float) -> str:
    """Returns a share in percent; rounding errors are 0."""
    if share <= 1e-9:
        return "0 %"
    return f"{100 * share:.2g} %" if share < 0.995 else f"{100 * share:.0f} %"


def settings(text: str, allowed: Iterable[str]) -> dict[str, str]:
    """Parses `:NAME=VALUE:NAME=VALUE`, each name once.

    Raises:
        InputError: the text has another form.
    """
    values: dict[str, str] = {}
    for setting in text.split(":")[1:]:
        name, equals, value = setting.partition("=")
        if not equals or name not in allowed:
            raise InputError(f"{setting!r} is not NAME=VALUE with a NAME out of {listing(allowed)}")
        if name in values:
            raise InputError(f"{name} is given twice, {values[name]!r} and {value!r}; give it once")
        values[name] = value
    return values


def size(rows: list[Any]) -> str:
    """Returns the number of rows and their length as text."""
    lengths = " or ".join(str(length) for length in sorted({len(row) for row in rows})) or "no"
    return f"{len(rows)} row(s) of {lengths} number(s)"


ESCAPES = {"\\": r"\\", "'": r"\'", "\n": r"\n", "\r": r"\r", "\t": r"\t"}


def pasted(words: Sequence[str]) -> str:
    """Returns a command of these words, quoted for a shell, on one line."""
    return " ".join(map(_word, words))


def option(name: str, value: str) -> str:
    """Returns an option with its value, as one word if the value begins with "-"."""
    return pasted([f"{name}={value}"] if value.startswith("-") else [name, value])


def pasted_path(path: Path) -> str:
    """Returns a path as a quoted argument; if it begins as an option does, with its folder."""
    return pasted([f"./{path}" if str(path).startswith("-") else str(path)])


def _word(text: str) -> str:
    if text.isprintable():
        return shlex.quote(text)
    return "$'" + "".join(map(_escaped, text)) + "'"  # what would break the line, or the terminal


def _escaped(letter: str) -> str:
    if letter in ESCAPES or letter.isprintable():
        return ESCAPES.get(letter, letter)
    return "".join(f"\\{byte:03o}" for byte in letter.encode("utf-8", "surrogateescape"))


WIDEST = 79  # a longer line would go on in the next one, and stay there


def show(message: str) -> None:
    """Prints one line to stderr that the next one overwrites; an empty one clears it."""
    if sys.stderr and sys.stderr.isatty():
        print(f"\r{message[:WIDEST]:{WIDEST}}\r", end="", file=sys.stderr, flush=True)


class Stages:
    """Counted stages of a command: `[2/6] margins: 31 runs of 12 s to go`."""

    def __init__(self, *names: str) -> None:
        """Takes the names of the stages, in their order."""
        self._names, self._now = names, ""

    def __call__(self, text: str) -> None:
        """Begins the stage of that name. Any other text is the progress of the present one, an empty one clears the progress."""
        if text in self._names:
            self._now, text = f"[{self._names.index(text) + 1}/{len(self._names)}] {text}", ""
        show(f"{self._now}: {text}" if text else self._now)

    def counted(self, name: str, total: int, what: str) -> Callable[[int], None]:
        """Begins a stage. Returns a function that shows how many of `total` are done."""
        self(name)
        return lambda done: self(f"{done} of {total} {what}")

    def end(self) -> None:
        """Clears the line before the result is printed."""
        show("")


WIDTH = 80
GAP = "  "  # between columns
GLUE = "\N{NO-BREAK SPACE}"


class Whole(str):
    """Line that is to be copied unchanged and is never broken."""


def say(lines: Iterable[str]) -> None:
    """Prints lines, wrapped by `fitted`."""
    print("\n".join(fitted(lines)), flush=True)


def fitted(lines: Iterable[str]) -> list[str]:
    """Returns lines that fit: a line that is too long goes on in the next one, indented by two more columns."""
    return [part for line in lines for part in (wrapped(line) if len(line) > WIDTH else [line])]


def titled(title: str, source: str) -> list[str]:
    """Returns a title, and below it the file that it comes from."""
    return [title, Whole(f"{GAP}{source}")]


def wrapped(text: str, start: str = "", hang: int | None = None) -> list[str]:
    """Returns a text in lines that fit. Never separates a number from its unit, and never cuts a word.

    Args:
        text: the text; its leading spaces stay.
        start: prefix of the first line.
        hang: spaces before the other lines; by default two more than before the first.
    """
    if isinstance(text, Whole):
        return [start + text]
    inner = text.lstrip(" ")
    start += text[: len(text) - len(inner)]
    if hang is None:
        hang = len(start) - len(start.lstrip(" ")) + len(GAP)
    glued = re.sub(r"(?<=\d) (?=\S)|(?<=\+-) (?=\d)", GLUE, inner)
    lines = textwrap.wrap(
        glued,
        WIDTH,
        initial_indent=start,
        subsequent_indent=" " * hang,
        break_long_words=False,
        break_on_hyphens=False,
    )
    return [line.replace(GLUE, " ") for line in lines] or [start.rstrip()]


def matrix(text: str, rows: Sequence[Sequence[str]]) -> list[str]:
    """Returns a matrix after some text, each of its rows on a line of its own."""
    lines: list[str] = []
    for i, row in enumerate(rows):
        open_, close = "[[" if i == 0 else " [", "]]" if i == len(rows) - 1 else "],"
        start = text if i == 0 else " " * len(text)
        lines += wrapped(open_ + ", ".join(row) + close, start, len(text) + 2)
    return lines


def table(rows: Iterable[Sequence[str] | str], indent: str = GAP) -> list[str]:
    """Returns rows in aligned columns: names to the left, numbers to the right. A name that leaves them no room has its own line.

    Args:
        rows: all of the same number of cells, the first of them the name; a row that is a text goes over all columns.
        indent: prefix of every line.
    """
    all_rows = list(rows)
    cells = [row for row in all_rows if not isinstance(row, str)]
    widths = [max(len(cell) for cell in column) for column in list(zip(*cells, strict=True))[1:]]
    room = WIDTH - len(indent) - sum(len(GAP) + width for width in widths)
    name = max((len(row[0]) for row in cells if len(row[0]) <= room), default=0)
    return [line for row in all_rows for line in _row(row, name, widths, indent)]


def _row(row: Sequence[str] | str, name: int, widths: Sequence[int], indent: str) -> Iterator[str]:
    if isinstance(row, str):
        yield f"{indent}{row}".rstrip()
        return
    first, *rest = row
    if len(first) > name:
        yield indent + first
        first = ""
    yield GAP.join([f"{indent}{first:{name}}", *(f"{cell:>{width}}" for cell, width in zip(rest, widths, strict=True))]).rstrip()


def command(words: Sequence[str]) -> list[str]:
    """Returns a command to be copied, wrapped by backslashes; each of `words` is an option with its value."""
    lines, line = [], GAP + words[0]
    for word in words[1:]:
        if len(f"{line} {word} \\") > WIDTH:
            lines.append(Whole(f"{line} \\"))
            line = f"{GAP}  {word}"
        else:
            line = f"{line} {word}"
    return [*lines, Whole(line)]


class Shown:
    """Object with a short description: text at a prompt, a table in a notebook. A dataclass needs `repr=False` for it."""

    @property
    def shown(self) -> tuple[str, dict[str, str]]:
        """A title, and the rows below it by their names."""
        raise NotImplementedError

    def __repr__(self) -> str:
        title, rows = self.shown
        return "\n".join([title, *(f"  {name}: {text}" for name, text in rows.items())])

    def _repr_html_(self) -> str:
        title, rows = self.shown
        cells = "".join(f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>" for name, text in rows.items())
        return f"<table><caption>{escape(title)}</caption>{cells}</table>"


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
        return cell(value, self.form) if isinstance(self.form, str) else self.form(value)

    def of(self, get: Callable[[T], Of], title: str = "") -> "Column[T]":
        """Returns the same quantity of what has such a result, under another title if one is given."""
        return Column(title or self.title, lambda one: self.value(get(one)), self.form, self.scale, self.key)


def titles(columns: Iterable[Column[Any]]) -> tuple[str, ...]:
    """Returns the titles of the columns."""
    return tuple(column.title for column in columns)


def cells(columns: Sequence[Column[T]], ones: Iterable[T]) -> tuple[tuple[str, ...], ...]:
    """Returns the rows of a table, one per result."""
    return tuple(tuple(column.cell(one) for column in columns) for one in ones)


def column_table(columns: Sequence[Column[T]], ones: Iterable[T], indent: str = GAP) -> list[str]:
    """Returns the lines of a table on the terminal, a row per result."""
    return table([titles(columns), *cells(columns, ones)], indent)


def json_object(columns: Iterable[Column[T]], one: T) -> dict[str, Any]:
    """Returns a result as JSON has it: None for a number that is infinite or does not exist."""
    values = ((column.key, column.value(one)) for column in columns if column.key)
    return {key: finite(value) if isinstance(value, float) else value for key, value in values}
