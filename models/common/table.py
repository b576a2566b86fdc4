"""Tables of numbers in text files, spreadsheets, MATLAB and LabVIEW files.

The functions that read roads, rigs, characteristics and logs use this module.

Cells are separated by semicolons, tabs, commas or spaces, and may be in quotes. A comma that does not separate cells is a
decimal comma. A table uses one decimal mark and no thousands separators. A comment begins with `#`; a line that begins with
`%`, `!` or `//` is also a comment. The names and units of the columns are on a line above the numbers, as in `force [kN]`,
`height_cm` or `left / mm`. The units may be on a separate line between names and numbers. `csv.Sniffer` is not used, because it
would take the decimal comma of `0,5;0,02` for the separator.
"""

import csv
import math
import re
import warnings
from array import array
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, list_names, short_repr
from models.common.logs.lvm import MAGIC, lvm_text
from models.common.logs.recordings import MDF_SUFFIXES, mcap_rows, mdf_rows
from models.common.quantities import QUANTITIES, UNREAD, Heading, heading_of
from models.common.units import unit_size

# Separators of cells, in the order in which they are tried: the least ambiguous separator is first
SEPARATORS: Mapping[str, str] = {"semicolon": ";", "tab": "\t", "comma": ",", "space": " "}
COMMENT = re.compile(r"\s*(#|%|!|//)")
# Pattern of an ambiguous number: a number between 1 and 1000 with a decimal comma, or an integer with a thousands separator
THOUSANDS = re.compile(r"[-+]?[1-9]\d{0,2},\d{3}")
# Pattern of a cell, in which a unit in brackets belongs to the preceding word
SPACED_CELL = re.compile(r'"[^"]*"|(?:[^\s\[(]+\s*)?[\[(][^\])]*[\])]|\S+')
LINE_IN_QUOTES = re.compile(r'(?<![^;,\t\n])"[^"\n]*\n[^"]*"')
CLOCK = re.compile(r"(?:(\d+):)?(\d+):(\d+(?:[.,]\d+)?)")
LONGEST_UNIT = 3  # a word with at most this number of characters counts as an unknown unit
MOST_BYTES = 500 * 10**6  # size of the largest file that is read; the text of a larger file would not fit into memory
HALF_A_DAY = 43200.0  # 12-hour clocks start again after this time [s]
DIGITS = re.compile(r"[-+.,\d]*\d[-+.,\deE]*")
# Texts, in lower case, that mean that a cell has no number
MISSING = frozenset(("", "nan", "na", "n/a", "null", "none", "-", "--", "---"))


@dataclass(frozen=True)
class NumberTable:
    """Table of numbers in the text of a file.

    Attributes:
        lines: lines of the text.
        first: index of the first line of numbers.
        separator: character that separates the cells of a line.
        count: number of columns.
        give: description of the content that the file must have, for messages.
    """

    lines: Sequence[str]
    first: int
    separator: str
    count: int
    give: str

    def headings(self, units: Collection[str], optional: bool = False, alike: bool = False) -> list[Heading]:
        """Returns the headings of all columns. The headings are on the line above the numbers, or above a line with units.

        Args:
            units: units whose dimensions are allowed for the columns of the table.
            optional: True if the table needs no headings. For such a table, a comment is read as headings only if the comment
                contains nothing but names of quantities.
            alike: True if several columns of the table may have the same name.

        Raises:
            InputError: headings are missing, two headings are equal, or a heading contains a number.
        """
        text = LINE_IN_QUOTES.sub(lambda cell: " ".join(cell[0].split()), "\n".join(self.lines[: self.first]))
        # The lists of headings have the key True for lines that are comments
        above: dict[bool, list[list[Heading]]] = {True: [], False: []}
        for line in text.split("\n"):
            comment = COMMENT.match(line)
            cells = self._heading_cells(line[comment.end() :] if comment else line)
            row = [heading_of(cell, units, i) for i, cell in enumerate(cells, 1)]
            prose = comment and optional and not above[True] and not all(heading.quantity for heading in row)
            if row and not prose:
                above[bool(comment)].append(row)
        rows = above[False] or above[True]
        if not rows and optional:
            return [Heading(column=i) for i in range(1, self.count + 1)]
        if not rows:
            raise InputError(
                f"the numbers begin at line {self.first + 1}, but no line above them has one heading for each of the "
                f"{self.count} column(s); {self.give}"
            )
        headings = rows[-1]
        if len(rows) > 1 and any(one.text and not one.name for one in headings) and all(map(_maybe_unit, headings)):
            for heading, below in zip(rows[-2], headings, strict=True):
                if heading.unit and below.unit not in ("", heading.unit):
                    texts = f"{heading.text!r} and {below.text!r}"
                    raise InputError(
                        f"the headings {texts} of column {heading.column} contradict each other; correct one of the headings"
                    )
            units_below = [one.unit or one.name.lower() for one in headings]
            headings = [replace(one, unit=one.unit or unit) for one, unit in zip(rows[-2], units_below, strict=True)]
        readable = (one for one in headings if not one.unit or any(unit_size(one.unit, unit) for unit in units))
        same = [one.quantity or one.name for one in readable]
        for heading in headings:
            if DIGITS.fullmatch(heading.text):
                found = f"the heading of column {heading.column} is {short_repr(heading.text)}, not a name"
                raise InputError(f"{found}; above the numbers, put # before each line that contains no headings, or {self.give}")
            if not (optional or alike) and same.count(heading.quantity or heading.name) > 1:
                raise InputError(
                    f"two columns are called {short_repr(heading.quantity or heading.name)}; remove or rename one of "
                    "these columns"
                )
        return headings

    def _heading_cells(self, line: str) -> list[str]:
        """Returns the cells of a line above the numbers; empty if the number of cells is wrong.

        The line above the numbers may have a different separator from the lines of numbers.
        """
        if self.count == 1 and line.strip():
            return [line.strip("\"'; ")]
        for mark in dict.fromkeys((self.separator.strip(" ") or ";", *SEPARATORS.values())):
            for cells in (SPACED_CELL.findall(line), re.split(r"\s{2,}", line.strip())) if mark == " " else (_cells(line, mark),):
                if mark in line and len(_trim_cells(cells)) <= self.count <= len(cells):
                    return [cell.strip("\"' ") for cell in cells[: self.count]]
        return []

    def rows(self) -> Iterator[tuple[int, list[str]]]:
        """Yields the number of every line of numbers, counted from 1, and its cells."""
        for number, line in enumerate(self.lines[self.first :], self.first + 1):
            if self.separator != ";" and line.lstrip().startswith(";"):
                continue  # a line that begins with ; is a comment
            if cells := _trim_cells(_cells(_without_comment(line), self.separator)):
                yield number, cells

    def numbers(self, columns: Sequence[int] = (), ragged: bool = False, gaps: bool = False) -> tuple[Array, Sequence[int]]:
        """Returns the numbers in columns, shape (rows, columns), and the line number of every row, counted from 1.

        Args:
            columns: column numbers, counted from 0; empty for all columns. Columns that are not listed, and text after the last
                column, are ignored.
            ragged: True if a line may contain more numbers than the table has columns.
            gaps: True if cells may be empty or contain a text in `MISSING`, such as "n/a"; these cells become NaN.

        Raises:
            InputError: a cell is not a finite number, a line has more or fewer cells than the first line, or decimal and
                thousands marks are ambiguous.
        """
        used = columns or range(self.count)
        lines, values, marked, integers, thousands = array("Q"), array("d"), dict[str, str](), False, True
        for line, cells in self.rows():
            cells += [""] * ((max(used) + 1 - len(cells)) * gaps)
            if len(cells) <= max(used) or not (ragged or all(_number(cell) is None for cell in cells[self.count :])):
                there = f"line {line} has {len(cells)} column(s), but line {self.first + 1} has {self.count}"
                raise InputError(f"{there}; {self.give}")
            for column in used:
                cell = cells[column]
                if gaps and cell.lower() in MISSING:
                    values.append(math.nan)
                    continue
                for mark in ".,":
                    if mark in cell and mark not in marked:
                        marked[mark] = f"line {line} has {short_repr(cell)}"
                if "," in cell:
                    thousands = thousands and THOUSANDS.fullmatch(cell) is not None
                number = _number(cell)
                if len(marked) == 2:
                    both = " and ".join(dict.fromkeys(marked.values()))
                    raise InputError(
                        f"some numbers contain both a comma and a dot: {both}; write numbers without thousands separators"
                    )
                if number is None or not math.isfinite(number):
                    raise InputError(f"line {line}, column {column + 1}: {short_repr(cell)} is not a finite number; {self.give}")
                values.append(number)
                integers = integers or (number != 0 and "," not in cell)
            lines.append(line)
        if [*marked] == [","] and thousands and integers:
            raise InputError(
                f"{marked[',']}, which may be a thousands separator; write numbers without thousands separators, and "
                "with a decimal point"
            )
        return np.frombuffer(values, dtype=float).reshape(-1, len(used)), lines

    def seconds(self, heading: Heading, default: str = "") -> Array:
        """Returns the times in a column [s], shape (rows,).

        The cells are numbers, whose unit is in the heading, or times of day.

        Times of day may pass midnight once.

        Args:
            heading: heading of the column of times.
            default: the unit of a heading without a unit; empty if a unit is required.

        Raises:
            InputError: the unit is missing, or a cell is neither a number nor a time of day.
        """
        column, times = heading.column - 1, list[float]()
        if _number(next(self.rows())[1][column]) is not None:
            return self.numbers([column], ragged=True)[0][:, 0] * heading.scale("time", default=default)
        for line, cells in self.rows():
            stamp = CLOCK.search(" ".join(cells[column : column + 1]))
            if stamp is None:
                raise InputError(f"line {line}, column {column + 1}: this is not a time, such as 12:34:56.789; {self.give}")
            hours, minutes, seconds = stamp.groups("0")
            times.append(60 * (60 * int(hours) + int(minutes)) + float(seconds.replace(",", ".")))
        return np.unwrap(times, period=HALF_A_DAY)

    def quantities(self, known: Sequence[str]) -> dict[str, Array]:
        """Returns all columns in SI units, by quantity.

        Args:
            known: quantities that the columns may contain.

        Raises:
            InputError: the quantity of a column is not in `known`, or `headings`, `Heading.scale` or `numbers` raises this
                error.
        """
        headings = self.headings([QUANTITIES[name].si for name in known])
        for heading in headings:
            if heading.quantity not in known:
                signs = [f"{name} (positive: {QUANTITIES[name].positive})".replace(" (positive: )", "") for name in known]
                called = f"column {heading.column} is called {short_repr(heading.text)}"
                raise InputError(f"{called}, which is not one of {list_names(signs)}; {self.give}")
        numbers = self.numbers()[0] * [heading.scale(heading.quantity) for heading in headings]
        return {heading.quantity: column for heading, column in zip(headings, numbers.T, strict=True)}


def table_text(path: Path) -> str:
    """Returns the content of a file as text.

    Text files are read as UTF-8; if they are not valid UTF-8, they are read as Windows-1252. For LabVIEW files, units are added
    to the headings. All other files are converted to lines whose cells are separated by tabs. For a spreadsheet (.xlsx), the
    text is the sheet that contains a table; if no sheet contains a table, it is the first sheet. For a MATLAB file (.mat), the
    text contains the arrays; for a Parquet file (.parquet), it contains the columns of numbers. For recordings (MDF4, .mf4, and
    MCAP, .mcap), the text contains the channels.

    Raises:
        InputError: the package for spreadsheets is not installed, or the file is too large. The error is also raised if several
            sheets contain a table, or if a MATLAB or Parquet file contains no table.
    """
    suffix = path.suffix.lower()
    if path.exists() and (size := path.stat().st_size) > MOST_BYTES:
        most = f"at most {MOST_BYTES // 10**6} MB are read"
        raise InputError(f"the file has {size // 10**6} MB, but {most}; shorten the record, or resample it at a lower rate")
    if suffix == ".mcap" or suffix in MDF_SUFFIXES:
        return _tab_text((mcap_rows if suffix == ".mcap" else mdf_rows)(path))
    if suffix == ".parquet":
        return _tab_text(_parquet_rows(path))
    if suffix == ".xlsx":
        try:
            from python_calamine import CalamineWorkbook  # pyright: ignore[reportMissingImports] - an extra
        except ImportError:
            raise InputError(
                "reading a spreadsheet needs python-calamine; run pip install 'roadproof[excel]', or save the spreadsheet as .csv"
            ) from None
        book = CalamineWorkbook.from_path(str(path))
        sheets = {
            one.name: book.get_sheet_by_name(one.name).to_python() for one in book.sheets_metadata if "Work" in str(one.typ)
        }
        tables = [name for name, rows in sheets.items() if sum(_has_numbers(row) for row in rows) > 1]
        if len(tables) > 1:
            raise InputError(
                f"has tables in the sheets {list_names(tables)}, but only one sheet can be read; delete the other "
                "sheets, or save one sheet as .csv"
            )
        return _tab_text(sheets[(tables or [*sheets])[0]])
    if suffix == ".mat":
        return _tab_text(_matlab_rows(path.read_bytes()))
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        text = path.read_text(encoding="cp1252", errors="replace")
    return lvm_text(text) if MAGIC in text.partition("\n")[0] else text


def _has_numbers(row: Sequence[Any]) -> bool:
    """Returns True if a row of a spreadsheet contains at least two numbers."""
    return sum(isinstance(cell, (int, float)) for cell in row) > 1


def _tab_text(rows: Iterable[Sequence[Any]]) -> str:
    return "\n".join("\t".join(" ".join(str(cell).split()) for cell in row) for row in rows)


def _parquet_rows(path: Path) -> list[Sequence[Any]]:
    """Returns names and numbers of the columns in a Parquet file. Missing numbers are NaN."""
    from pyarrow import ArrowInvalid, types
    from pyarrow.parquet import read_table

    try:
        table = read_table(path)
    except ArrowInvalid as error:
        raise InputError(f"this is not a Parquet file, or it is damaged ({error}); write the file again") from error
    numbers = [i for i, one in enumerate(table.schema) if types.is_integer(one.type) or types.is_floating(one.type)]
    if not numbers:
        raise InputError(
            f"no column of {list_names(table.column_names)} contains numbers; give columns of numbers, with times in seconds"
        )
    columns = [table.column(i).to_numpy() for i in numbers]
    return [[table.column_names[i] for i in numbers], *zip(*(one.tolist() for one in columns), strict=True)]


def _matlab_rows(content: bytes) -> list[Sequence[Any]]:
    """Returns names and columns of the vectors in a MATLAB file, or the rows of its only matrix."""
    arrays = {name: value for name, value in matlab_variables(content).items() if not name.startswith("__")}
    # The only variable is a struct
    while len(arrays) == 1 and (value := next(iter(arrays.values()))).dtype.names and value.shape == (1, 1):
        arrays = {name: value[name][0, 0] for name in value.dtype.names}
    columns = {name: value for name, value in arrays.items() if value.dtype.kind in "fiu" and value.ndim == 2 and value.size > 1}
    vectors = {name: value.ravel() for name, value in columns.items() if 1 in value.shape}
    if len(columns) == 1 and not vectors:
        return np.asarray(next(iter(columns.values())), dtype=float).tolist()
    if not vectors or len({len(value) for value in vectors.values()}) > 1:
        sizes = ", ".join(f"{name} {'x'.join(map(str, value.shape))}" for name, value in arrays.items()) or "nothing"
        raise InputError(
            f"the file contains {sizes}, which do not form one table; save vectors of equal length, such as distance and "
            "height, or one matrix"
        )
    return [[*vectors], *np.column_stack([value.astype(float) for value in vectors.values()]).tolist()]


def matlab_variables(content: bytes) -> dict[str, Any]:
    """Returns the variables of a MATLAB file, version 4 to 7, by name. In the result of SciPy, entries that are not variables
    begin with two underscores.

    Raises:
        InputError: the file is not a MATLAB file, or has version 7.3.
    """
    from scipy.io import loadmat

    try:
        with warnings.catch_warnings(action="ignore"):  # SciPy would warn about two objects with the same name
            return loadmat(BytesIO(content))
    except NotImplementedError as error:
        raise InputError(
            "the file has MATLAB version 7.3 (HDF5), which cannot be read; save the file in MATLAB with '-v7'"
        ) from error
    except Exception as error:
        raise InputError(
            f"this is not a MATLAB file, or it is damaged ({error}); save the file again in MATLAB, with '-v7'"
        ) from error


def find_table(text: str, give: str, separator: str = "", column: int = 0) -> NumberTable:
    """Finds the table in a text. The table begins with the first line that has a number in the column `column`.

    Args:
        text: text of the whole file.
        give: description of the content that the file must have, for messages.
        separator: separator from `SEPARATORS`; empty to detect the separator in the first line of the table.
        column: number of the column in which the first line must have a number, counted from 0.

    Raises:
        InputError: no line has a number in the column `column`.
    """
    if "\0" in text:
        raise InputError(
            "this is not a text file in UTF-8, because it contains a NUL character (the file may be in UTF-16); save "
            f"the file as UTF-8, or {give}"
        )
    lines = text.removeprefix("\ufeff").replace("\r\n", "\n").replace("\r", "\n").split("\n")
    for first, line in enumerate(lines):
        mark, cells = _split(line, separator)
        if column < len(cells) and _number(cells[column]) is not None:
            return NumberTable(lines, first, mark, len(cells), give)
    # If no line has a number in this column, as with times of day, the table consists of the lines with the most frequent
    # combination of numbers and texts.
    splits = [_split(line, separator) for line in lines]
    kinds = [(mark, tuple(_number(cell) is None for cell in cells)) for mark, cells in splits]
    for usual, _ in Counter(kind for kind in kinds if not all(kind[1])).most_common(1):
        return NumberTable(lines, kinds.index(usual), usual[0], len(usual[1]), give)
    raise InputError(f"{'the file has no line of numbers' if text.strip() else 'the file is empty'}; {give}")


def _split(line: str, separator: str) -> tuple[str, list[str]]:
    """Returns the separator of a line, and the cells of the line without comments. If `separator` is empty, the separator is
    detected.
    """
    numbers = _without_comment(line)
    marks = [SEPARATORS[separator]] if separator else [mark for mark in SEPARATORS.values() if mark in numbers] or [" "]
    splits = {mark: _trim_cells(_cells(numbers, mark)) for mark in marks}
    whole = [mark for mark in marks if None not in map(_number, splits[mark])]
    return (mark := (whole or marks)[0]), splits[mark]


def _number(cell: str) -> float | None:
    """Returns the number in a cell, with a decimal point or comma; None if the cell is not a number. NaN counts as a number."""
    try:
        return float(cell if "." in cell else cell.replace(",", "."))
    except ValueError:
        return None


def _maybe_unit(heading: Heading) -> bool:
    """Returns True for a cell that may belong to a line of units: an empty cell, a known unit, or a short word such as V."""
    return heading.name == "s" or (len(heading.name) <= LONGEST_UNIT and heading.quantity in ("", UNREAD))


def _without_comment(line: str) -> str:
    return "" if COMMENT.match(line) else line.partition("#")[0]


def _cells(line: str, separator: str) -> list[str]:
    """Returns the cells of a line. Cells may be in quotes."""
    if '"' in line:
        return [cell.strip() for cell in next(csv.reader([line.strip(" ")], delimiter=separator, skipinitialspace=True))]
    return line.split() if separator == " " else [cell.strip() for cell in line.split(separator)]


def _trim_cells(cells: list[str]) -> list[str]:
    """Returns cells without the empty cells at the end, which spreadsheets often write."""
    while cells and not cells[-1]:
        cells = cells[:-1]
    return cells
