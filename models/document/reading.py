"""Conversion of tables and sentences to a form for readers: short, aligned and in a uniform notation. The data in CSV and JSON
output are not changed.
"""

import csv
import re
import unicodedata
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from html import escape
from itertools import count
from pathlib import Path
from string import ascii_lowercase
from typing import Any

from models.common.files import whole_file
from models.document.document import Pivot, Table

SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
NUMBER = re.compile(r"([+-]?\d+(?:\.(\d+))?)(e[+-]\d+)?( %|\*)?")
# Pattern of the space between a number and its unit, which becomes a no-break space
UNIT = re.compile(r"(?<=\d) (?=(?:%|mm?|ms|s|k?N|Hz|rad|deg|J|kg)(?![\w/]))")
POWER = re.compile(r"(?<![\w.+-])(\d+(?:\.\d+)?)e([+-]\d+)(?![\w.])")
SQUARED_SECONDS = re.compile(r"\b(m|rad)/s2\b")
LONG = 28  # largest number of letters of a remark in a row; a longer remark that several rows share becomes a footnote
BLANK = "\u2004"  # a space that has about the width of a footnote mark
DIGIT, POINT = "\u2007", "\u2008"  # a space that has the width of a digit, and a space that has the width of a decimal point
MANY = 10  # a page collapses a table with more rows than this
LONG_NAME = 16  # a line may break within a name that has more letters than this
# A name ends at a space, or at any punctuation mark except - and _.
NAME = re.compile(r"[^\s!-,./:-@\[-^`{-~]+")


@dataclass(frozen=True)
class Reading:
    """A table in short form for readers.

    Attributes:
        headings: headings of the columns whose cells differ between rows.
        rows: cells of the columns in `headings`.
        words: number of columns with text, which are left-aligned.
        same: texts `heading: value` for the columns whose cells are equal in all rows.
        notes: remarks that occur in several rows, each with its footnote mark.
        folded: True if the table is so long that a page collapses it.
    """

    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    words: int
    same: tuple[str, ...]
    notes: tuple[tuple[str, str], ...]
    folded: bool


def notation(text: str) -> str:
    """Returns a text in the notation of a page: 1.4·10⁻³, m/s², ±."""
    text = UNIT.sub("\N{NO-BREAK SPACE}", POWER.sub(_power, text))
    return SQUARED_SECONDS.sub(r"\1/s²", text).replace("+-", "±").replace(" <= ", " ≤ ").replace(" >= ", " ≥ ")


def _power(one: re.Match[str]) -> str:
    """Returns a number with an exponent, such as 1.4·10⁻³; the power of ten is omitted if the exponent is 0."""
    power = f"·10{str(int(one[2])).translate(SUPERSCRIPT)}" if int(one[2]) else ""
    return f"{one[1]}{power}" if float(one[1]) else "0"


def write_rows(path: Path, rows: Iterable[Iterable[Any]]) -> None:
    """Writes rows as a complete CSV file.

    Raises:
        InputError: the file cannot be written.
    """
    with whole_file(path, "csv") as beside, beside.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(rows)


def pivot_table(headings: Sequence[str], rows: Sequence[Sequence[str]], pivot: Pivot) -> tuple[list[str], list[list[str]], int]:
    """Returns the headings and rows of a table's short form, and the number of columns that form the name of a row."""
    at = {heading: i for i, heading in enumerate(headings)}
    names = [heading for heading in pivot.rows if heading != "unit"]
    across = dict.fromkeys(row[at[pivot.across]] for row in rows)
    cells: dict[tuple[str, ...], dict[tuple[str, str], str]] = {}
    for row in rows:
        key = [row[at[name]] for name in names]
        if "unit" in pivot.rows and row[at["unit"]] not in ("-", ""):
            key[-1] += f" [{notation(row[at['unit']])}]"
        for value in pivot.values:
            cells.setdefault(tuple(key), {})[row[at[pivot.across]], value] = row[at[value]]
    columns = [(one, value) for one in across for value in pivot.values]
    several = len(pivot.values) > 1
    titles = [f"{one}, {value}" if several else one for one, value in columns]
    return [*names, *titles], [[*key, *(own.get(column, "-") for column in columns)] for key, own in cells.items()], len(names)


def short_form(table: Table) -> Reading:
    """Returns a table in the form that a page shows first."""
    return read(table.headings, table.rows, table.words, table.pivot)


def whole_form(table: Table) -> Reading | None:
    """Returns the whole table, which a page shows below the short form; None if the short form is complete."""
    return read(table.headings, table.rows, table.words) if table.pivot is not None else None


def read(headings: Sequence[str], rows: Sequence[Sequence[str]], words: int, pivot: Pivot | None = None) -> Reading:
    """Returns a table for readers: without constant columns, with aligned numbers, and with repeated remarks as footnotes."""
    if pivot is not None and rows:
        headings, rows, words = pivot_table(headings, rows, pivot)
    columns = [list(column) for column in zip(*rows, strict=True)]
    constant = [i for i in range(1, len(columns)) if len(rows) > 2 and len(set(columns[i])) == 1 and columns[i][0] != ""]
    if pivot is not None or len(constant) == len(columns) - 1:
        constant = []
    same = tuple(f"{headings[i]}: {notation(columns[i][0])}" for i in constant if columns[i][0] != "-")
    marks, notes = (ascii_lowercase[k] if k < len(ascii_lowercase) else str(k) for k in count()), dict[str, str]()
    kept = [i for i in range(len(columns)) if i not in constant]
    cells = [
        align_numbers(columns[i]) if pivot is not None else _with_footnotes(align_numbers(columns[i]), marks, notes)
        for i in kept[1:]
    ]
    shown = [columns[0], *([notation(cell) for cell in column] for column in cells)] if kept else []
    return Reading(
        tuple(notation(headings[i]) for i in kept) if rows else tuple(headings),
        tuple(zip(*shown, strict=True)),
        sum(i < words for i in kept),
        same,
        tuple((mark, notation(text)) for text, mark in notes.items()),
        len(rows) > MANY,
    )


def _with_footnotes(column: Sequence[str], marks: Iterable[str], notes: dict[str, str]) -> list[str]:
    """Returns a column with footnote marks instead of long remarks that occur in several rows."""
    often = Counter(column)
    iterator = iter(marks)
    cells = []
    for cell in column:
        if len(cell) > LONG and often[cell] > 1:
            notes[cell] = notes.get(cell) or next(iterator)
            cell = f"({notes[cell]})"
        cells.append(cell)
    return cells


def align_numbers(column: Sequence[str]) -> list[str]:
    """Returns numbers that are padded with figure spaces, so that the decimal points are aligned.

    A column that contains a word other than "-" is not changed.
    """
    matches = [NUMBER.fullmatch(cell) for cell in column]
    if not any(matches) or not all(one or cell in ("-", "any", "") for one, cell in zip(matches, column, strict=True)):
        return list(column)
    most = max(len(one[2] or "") for one in matches if one)
    marked = any(one and one[4] == "*" for one in matches)
    texts = []
    for one, cell in zip(matches, column, strict=True):
        if one is None:
            texts.append(cell)
            continue
        size = len(one[2] or "")
        space = ("" if size else POINT) * bool(most) + DIGIT * (most - size) if not one[3] else ""
        mark = one[4] or BLANK * marked
        sign, number = ("−", one[1][1:]) if cell.startswith("-") else ("", one[1])
        texts.append(f"{sign}{notation(number + (one[3] or ''))}{mark}{space}")
    return texts


def drawn_text(text: str) -> str:
    """Returns a text for SVG and for attributes: escaped, with quotes around code."""
    return escape(quoted_code(text))


def quoted_code(text: str) -> str:
    """Returns a text with quotes instead of backticks, for output that cannot show code in another font."""
    return text.replace("`", "'")


def page_text(text: str) -> str:
    """Returns a text as HTML. Text in backticks becomes a `code` element.

    Long names become `bdi` elements, in which lines may break. Names that are written from right to left also become `bdi`
    elements, which isolate them from the text around them. Without `bdi` elements, such names would reverse the order of
    adjacent numbers and commas (Unicode Bidirectional Algorithm, UAX #9).
    """
    return re.sub("`([^`]+)`", r"<code>\1</code>", NAME.sub(_apart, escape(text)))


def _apart(name: re.Match[str]) -> str:
    leftward = not name[0].isascii() and any(unicodedata.bidirectional(letter) in ("R", "AL", "AN") for letter in name[0])
    return f"<bdi>{name[0]}</bdi>" if leftward or len(name[0]) > LONG_NAME else name[0]


def text_width(text: str, size: float) -> float:
    """Returns an upper estimate of the width of a text, in the unit of the font size."""
    return size * sum(map(_letter_width, text))


@lru_cache(maxsize=1024)
def _letter_width(letter: str) -> float:
    if unicodedata.east_asian_width(letter) in "WF":
        return 1.04
    if letter in "mwMW%@&…":
        return 1.0
    if letter.isupper():
        return 0.8
    return 0.42 if letter in " .,:;'()[]/fijlrt" else 0.64


def cut(text: str, room: float, size: float) -> str:
    """Returns a text, shortened at its end if it is wider than `room`."""
    if text_width(text, size) <= room:
        return text
    while text and text_width(f"{text}…", size) > room:
        text = text[:-1]
    return f"{text}…"


def wrap_at_spaces(text: str, room: float, size: float) -> list[str]:
    """Breaks a text at spaces into lines of at most the width `room`. A word that is wider than `room` is shortened."""
    lines = list[str]()
    for part in text.splitlines():
        lines.append("")
        for word in part.split():
            longer = f"{lines[-1]} {word}".strip()
            if lines[-1] and text_width(longer, size) > room:
                lines.append(cut(word, room, size))
            else:
                lines[-1] = cut(longer, room, size)
    return lines
