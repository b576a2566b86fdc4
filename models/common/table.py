"""Tables of numbers in text files: the one reader of roads, rigs, curves, loads and families.

Cells are separated by semicolons, tabs, commas or spaces, and may stand in quotes. The decimal point may be a comma wherever a
comma separates no cells; one table has one decimal mark. `#` begins a comment. Lines above the numbers name the columns and
their units: `force [kN]`, `height_cm`, `left / mm`, or units in a line of their own.
"""

import csv
import math
import re
from array import array
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, listing, quoted
from models.common.units import unit_named

SEPARATORS: Mapping[str, str] = {"semicolon": ";", "tab": "\t", "comma": ",", "space": " "}  # the least ambiguous first
ABOVE = 50  # lines that may come before the numbers
IN_BRACKETS = re.compile(r"\s*[\[(]\s*([^\])]*?)\s*[\])]$")
AT_THE_END = re.compile(r"(?<=\w)\s*[\s_/,-]\s*([A-Za-z]+)$")
SPACED = re.compile(r'"[^"]*"|(?:[^\s\[(]+\s{0,9})?[\[(][^\[\]()]{0,60}[\])]|\S+')  # a unit in brackets goes with its word
LONGEST = 200  # characters of a heading
WITH_COMMA = re.compile(r"[+-]?(\d+,\d*|,\d+)([eE][+-]?\d+)?")
WITH_BOTH = re.compile(r"[+-]?\d+(\.\d*)*\.\d*,\d+|[+-]?\d+(,\d*)*,\d*\.\d*")  # 1.300,0 and 1,300.0
THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}([.,]\d{3})+")


@dataclass(frozen=True)
class Heading:
    """Heading of a column.

    Attributes:
        text: text of the heading.
        name: the text without its unit.
        unit: its unit, by its usual name if it is known; empty for none.
        column: from 1.
    """

    text: str
    name: str = ""
    unit: str = ""
    column: int = 0

    def scale(self, units: Mapping[str, float], wanted: str = "", option: str = "", unsaid: str = "") -> float:
        """Returns the size of the column's unit in SI.

        Args:
            units: the allowed ones.
            wanted: the unit that the option asks for; empty for none.
            option: the setting's name; empty for none.
            unsaid: the unit of a heading without one; empty if a unit is required.

        Raises:
            InputError: the unit is missing or unknown, or another one was asked for.
        """
        column = f"column {self.column}, {quoted(self.text)}," if self.text else f"column {self.column}"
        if wanted and self.unit in units and wanted != self.unit:
            raise InputError(f"{column} is in {self.unit}, and {option} = {wanted} was asked for; leave one out, or mend it")
        allowed, instead = f"allowed: {listing(units)}", f", or say :{option}={next(iter(units))}" if option else ""
        if not wanted and self.unit and self.unit not in units:
            raise InputError(f"{column} is in {quoted(self.unit)}; {allowed}; convert it{instead}")
        unit = wanted or self.unit or unsaid
        if not unit:
            raise InputError(f"{column} has no unit; {allowed}; write {self.name} [{next(iter(units))}] above it{instead}")
        return units[unit]


def heading_of(text: str, units: Mapping[str, float], column: int = 0) -> Heading:
    """Returns a heading from its cell: `right [mm]`, `height_cm`, `Distance (ft)`, `left / mm`, `[m]`, `m`.

    Args:
        units: which words at the end are units; in brackets every word is one.
    """
    text = text.strip(" \t\"'#")
    if len(text) > LONGEST:
        return Heading(text, text, "", column)
    if bracket := IN_BRACKETS.search(text):
        return Heading(text, text[: bracket.start()].strip(), unit_named(bracket[1]), column)
    end = AT_THE_END.search(text)
    if end and unit_named(end[1]) in units:
        return Heading(text, text[: end.start()].strip(), unit_named(end[1]), column)
    return Heading(text, "", unit_named(text), column) if unit_named(text) in units else Heading(text, text, "", column)


@dataclass(frozen=True)
class NumberTable:
    """Table of numbers in a text.

    Attributes:
        texts: lines of the text.
        first: index of the first line of numbers.
        mark: separator of cells.
        count: number of columns.
        above: lines above the numbers with as many cells: line, from 1, and cells. Comments may be among them.
        give: what a file must hold, for messages.
    """

    texts: Sequence[str]
    first: int
    mark: str
    count: int
    above: Sequence[tuple[int, list[str]]]
    give: str

    def names(self, headings: Sequence[Heading], known: Collection[str]) -> list[str]:
        """Returns the name of each heading, in small letters.

        Raises:
            InputError: a name is not a known one.
        """
        for heading in headings:
            if heading.name.lower() not in known:
                called = f"column {heading.column} is called {quoted(heading.text)}"
                raise InputError(f"{called}, and none of {listing(known)}; {self.give}")
        return [heading.name.lower() for heading in headings]

    def headings(self, units: Mapping[str, float]) -> list[Heading]:
        """Returns the heading of every column, from the first line that can hold them, and a line of units below it.

        Args:
            units: all that columns may have.

        Raises:
            InputError: headings are missing, twice the same, or followed by what is neither units nor numbers.
        """
        above = [row for row in self.above if not self.is_comment(row[0])] or self.above[:1]
        if not above:
            raise InputError(f"no line above line {self.first + 1} names its {self.count} column(s); {self.give}")
        headings: list[Heading] = []
        for line, cells in above:
            row = [heading_of(cell, units, i) for i, cell in enumerate(cells, 1)]
            for new in row if headings else ():
                if new.name:
                    raise InputError(f"line {line}, column {new.column}: {quoted(new.text)} is no number; {self.give}")
            headings = [merged(old, new) for old, new in zip(headings, row, strict=True)] if headings else row
        for heading in headings:
            if [other.name for other in headings].count(heading.name) > 1:
                raise InputError(f"line {above[0][0]}: two columns are called {quoted(heading.name)}; leave one out")
        return headings

    def is_comment(self, line: int) -> bool:
        """Returns True for a line of comment, from 1."""
        return self.texts[line - 1].lstrip().startswith("#")

    def rows(self) -> Iterator[tuple[int, list[str]]]:
        """Yields every line of numbers from 1, and its cells."""
        for number, text in enumerate(self.texts[self.first :], self.first + 1):
            if "#" in text:
                text = text[: text.index("#")]
            if text and not text.isspace() and any(cells := split_cells(text, self.mark)):  # `;;` ends many a spreadsheet
                yield number, cells

    def check_marks(self, columns: Sequence[int]) -> None:
        """Refuses a table in which comma and dot both are decimal marks: one of them may separate thousands.

        Args:
            columns: those whose dots count, from 0. Every cell's decimal comma counts.

        Raises:
            InputError: both marks are there; the message names a cell of each.
        """
        dot, comma = ("", ""), ("", "")  # the first cell with each mark, and its line
        for number, text in enumerate(self.texts[self.first :], self.first + 1):
            text = text.partition("#")[0]
            new = ("." in text and not dot[0]) or ("," in text and (not comma[0] or "." in text))
            if not new or (self.mark == "," and '"' not in text):
                continue
            for column, cell in enumerate(_separated(text, self.mark)):
                if column in columns and WITH_BOTH.fullmatch(cell):
                    raise InputError(f"{BOTH}: line {number} has {quoted(cell)}; write {' or '.join(_one_mark(cell))}")
                if column in columns and not dot[0] and "." in cell and numbers_of([cell]) is not None:
                    dot = cell, f"line {number}"
                if not comma[0] and WITH_COMMA.fullmatch(cell):
                    comma = cell, f"line {number}"
            if dot[0] and comma[0]:
                beside = f"{comma[1]} has {quoted(comma[0])}, and {dot[1]} has {quoted(dot[0])}"
                raise InputError(f"{BOTH}: {beside}; write {' or '.join(_one_mark(dot[0]))}")

    def numbers(self, columns: Sequence[int] = (), ragged: bool = False) -> tuple[Array, Sequence[int]]:
        """Returns the finite numbers of columns, shape (rows, columns), and the line of every row, from 1.

        Args:
            columns: from 0; all if empty. Other columns, and what is more in a line, may be text.
            ragged: True if lines may have other numbers of cells.

        Raises:
            InputError: a cell is no finite number, a line has another number of them, or the decimal marks differ. It names line
                and column.
        """
        used = columns or range(self.count)
        self.check_marks(used)
        lines, values = array("Q"), array("d")
        for line, cells in self.rows():
            if len(cells) != self.count and not ragged and (len(cells) <= max(used) or numbers_of(cells) is not None):
                there = f"line {line} has {len(cells)} column(s), and line {self.first + 1} has {self.count}"
                raise InputError(f"{there}; {self.give}")
            try:
                numbers = [float(cells[column]) for column in used]
            except (ValueError, IndexError):
                numbers = [math.nan]
            if not all(map(math.isfinite, numbers)):
                cells += [""] * (max(used) + 1 - len(cells))
                wrong = next(column for column in used if not math.isfinite((numbers_of([cells[column]]) or [math.nan])[0]))
                raise InputError(f"line {line}, column {wrong + 1}: {quoted(cells[wrong])} is no finite number; {self.give}")
            lines.append(line)
            values.extend(numbers)
        return np.frombuffer(values, dtype=float).reshape(-1, len(used)), lines


def find_table(text: str, give: str, separator: str = "", column: int = 0) -> NumberTable:
    """Finds the table in a text: it begins with the first line that has a number in a column.

    Args:
        give: what a file must hold, for messages.
        separator: one of `SEPARATORS`; empty to find out from that line.
        column: that column, from 0.

    Raises:
        InputError: no line has one, or more than `ABOVE` lines come before it.
    """
    texts, before = text.replace("\r\n", "\n").replace("\r", "\n").split("\n"), 0  # lines of old Macs end in \r alone
    for first, line in enumerate(texts):
        numbers = line.partition("#")[0]
        if not numbers.strip():
            continue
        mark = SEPARATORS.get(separator) or separator_of(numbers)
        cells = split_cells(numbers, mark)
        if column < len(cells) and _numeric(cells[column]):
            above = [(i, _heading_cells(text, mark, len(cells))) for i, text in enumerate(texts[:first], 1) if text.strip()]
            return NumberTable(texts, first, mark, len(cells), [row for row in above if row[1]], give)
        before += 1
        if before > ABOVE:
            raise InputError(f"no line of numbers among the first {ABOVE}; {give}")
    raise InputError(f"{'no line of numbers' if text.strip() else 'it is empty'}; {give}")


def merged(one: Heading, other: Heading) -> Heading:
    """Returns the heading that two lines give a column.

    Raises:
        InputError: they contradict each other.
    """
    if one.unit and other.unit and one.unit != other.unit:
        raise InputError(f"the headings {one.text!r} and {other.text!r} of column {one.column} contradict each other; mend them")
    text = " ".join(part for part in (one.text, other.text) if part)
    return Heading(text, one.name or other.name, one.unit or other.unit, one.column)


def numbers_of(cells: Sequence[str]) -> list[float] | None:
    """Returns cells as numbers, finite or not; None if one is not a number."""
    try:
        return [float(cell) for cell in cells]
    except ValueError:
        return None


def separator_of(line: str) -> str:
    """Returns the separator of a line's cells: the least ambiguous that makes all of them numbers, or that of any."""
    marks = [mark for mark in SEPARATORS.values() if mark in line] or [" "]
    return next((mark for mark in marks if all(map(_numeric, split_cells(line, mark)))), marks[0])


def _numeric(cell: str) -> bool:
    """Returns True for a number, and for one with both decimal marks."""
    return numbers_of([cell]) is not None or WITH_BOTH.fullmatch(cell) is not None


BOTH = "comma and dot both stand as decimal marks"


def _one_mark(cell: str) -> list[str]:
    """Returns how a cell may be written in a table with decimal commas: without thousands marks, or with a decimal comma."""
    if WITH_BOTH.fullmatch(cell):
        mark = max(".,", key=cell.rfind)
        whole, _, decimals = cell.rpartition(mark)
        return [f"{whole.replace('.', '').replace(',', '')}{mark}{decimals}"]
    decimal = cell.replace(".", ",")
    whole = [cell.replace(".", "")] if THOUSANDS.fullmatch(cell) else []
    return [*whole, (decimal.rstrip("0") if whole else decimal).rstrip(",")]


def split_cells(line: str, mark: str) -> list[str]:
    """Returns the cells of a line of numbers. A comma that separates no cells is the decimal point."""
    cells = _separated(line, mark)
    if "," not in line or (mark == "," and '"' not in line):
        return cells
    return [cell.replace(",", ".", 1) if cell.count(",") == 1 and "." not in cell else cell for cell in cells]


def _separated(line: str, mark: str) -> list[str]:
    """Returns the cells of a line as they are written."""
    return line.split() if mark == " " and '"' not in line else _cells(line, mark)


def _cells(line: str, mark: str) -> list[str]:
    """Returns the cells of a line, some of which may be in quotes."""
    try:
        parts = next(csv.reader([line.strip(" ")], delimiter=mark, skipinitialspace=True)) if '"' in line else line.split(mark)
    except csv.Error:  # a cell of more than 128 KiB
        return [line]
    cells = [cell.strip() for cell in parts]
    while len(cells) > 1 and not cells[-1]:
        cells.pop()  # a separator at the end of the line
    return cells


def _heading_cells(line: str, mark: str, count: int) -> list[str]:
    """Returns the cells of a line above the numbers, which may have another separator; empty if they are not so many."""
    text = line.lstrip("# \t")
    own = next((mark for mark in SEPARATORS.values() if mark in text), " ")
    for by in (own, mark) if mark == " " else (mark, own):
        cells = SPACED.findall(text) if by == " " else _cells(text, by)
        if len(cells) == count:
            return cells
    return []
