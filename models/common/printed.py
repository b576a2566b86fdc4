"""Printed output: lines of at most 80 columns, formats of numbers, commands to paste into a shell, and progress.

The width is fixed, so the output does not depend on the terminal. A sentence that does not fit on a line continues on the next
line, indented. In a table, a name that is too long is on a separate line. Only paths, and lines that a user copies, may be
longer than 80 columns, because these lines must not be broken.
"""

import math
import re
import shlex
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

# Formats of numbers in sentences. Columns of tables use fields (`models.document.field`).
NORM_DIGITS = ".7g"  # format of a norm, a bound on a norm, or a level
digits = f"{{:{NORM_DIGITS}}}".format
entry = "{:.6g}".format  # format of an entry of a gain or of a control law
rough = "{:.4g}".format  # format of a pole, a rate, a time or a slope
brief = "{:.3g}".format  # format of a number that readers compare with other numbers
about = "{:.2g}".format  # format of an estimate
magnitude = "{:.0e}".format  # format of a rounding error
# Format of the claimed and the true value if a claim does not hold; the two values may differ only slightly
exactly = "{:.10g}".format


def finite(value: Any) -> float | None:
    """Returns a number for JSON; None if it is infinite or missing."""
    return float(value) if value is not None and math.isfinite(value) else None


def cell(value: float | None, form: str, unit: str = "") -> str:
    """Returns a number for a table; "-" if it is infinite or missing."""
    return f"{value:{form}}{unit}" if value is not None and math.isfinite(value) else "-"


def difference(value: float) -> str:
    """Returns a relative difference as text with two digits."""
    return f"{value:.1e}" if value else "0"


def as_name(name: str) -> str:
    """Returns a controller's name for a sentence, in backticks.

    On a page, a name in backticks appears as code; in a picture, it appears in quotes.
    """
    return f"`{name}`"


def by_text(said: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Groups names by the text that belongs to them.

    Args:
        said: pairs of a name and the text that belongs to the name.

    Returns:
        A mapping from each text to all names that have this text, in backticks and separated by commas.
    """
    alike: dict[str, list[str]] = {}
    for name, text in said:
        alike.setdefault(text, []).append(as_name(name))
    return {text: ", ".join(names) for text, names in alike.items()}


def three_digits(value: float) -> str:
    """Returns a number with three significant digits, or without decimals if it has three or more digits before the point."""
    return f"{value:.0f}" if value >= 99.95 or not value else f"{value:#.3g}"


def percent(share: float) -> str:
    """Returns a share (0 to 1) as text in percent. Shares up to 1e-9 count as rounding errors and become 0."""
    if share <= 1e-9:
        return "0 %"
    return f"{100 * share:.2g} %" if share < 0.995 else f"{100 * share:.0f} %"


def size(rows: Sequence[Any]) -> str:
    """Returns a phrase that gives the number of rows, and how many numbers a row contains."""
    lengths = " or ".join(str(length) for length in sorted({len(row) for row in rows})) or "no"
    return f"{len(rows)} row(s) of {lengths} number(s)"


def shell_line(words: Sequence[str]) -> str:
    """Returns a command as one line, with its words quoted for a shell."""
    return shlex.join(words)


def pasted_path(path: Path) -> str:
    """Returns a path as a quoted argument. A path that begins with "-" gets "./" in front."""
    return shell_line([f"./{path}" if str(path).startswith("-") else str(path)])


WIDEST = 79  # a longer line of progress would wrap, and could then not be overwritten


LONG_STAGE = 3.0  # a line of progress shows the elapsed time after this time [s]
_overwritten, _printing = threading.Event(), threading.Lock()


def show(message: str) -> None:
    """Prints a line to stderr that the next call overwrites; an empty text clears the line.

    A line that stays for longer than `LONG_STAGE` also shows the elapsed seconds.
    """
    global _overwritten
    if not sys.stderr or not sys.stderr.isatty():
        return
    with _printing:
        _overwritten.set()
        _overwritten = threading.Event()
        _show(message)
    if message:
        threading.Thread(target=_count, args=(message, _overwritten), name="progress", daemon=True).start()


def _count(message: str, overwritten: threading.Event) -> None:
    """Prints a line of progress with the elapsed time every second, until the line is overwritten."""
    start, pause = time.monotonic(), LONG_STAGE
    while not overwritten.wait(pause):
        pause = 1.0
        with _printing:
            if not overwritten.is_set():
                _show(f"{message[: WIDEST - 10]} ({time.monotonic() - start:.0f} s)")


def _show(message: str) -> None:
    print(f"\r{message[:WIDEST]:{WIDEST}}\r", end="", file=sys.stderr, flush=True)


class Stages:
    """Numbered stages of a command, shown as: `[2/6] margins: 31 runs of 12 s to go`."""

    def __init__(self, *names: str) -> None:
        """Sets the names of the stages, in order."""
        self._names, self._now = names, ""

    def __call__(self, text: str) -> None:
        """Begins the stage that has the name in the argument.

        A text that is not the name of a stage is shown as progress of the current stage; an empty text clears the line of
        progress.
        """
        if text in self._names:
            self._now, text = f"[{self._names.index(text) + 1}/{len(self._names)}] {text}", ""
        show(f"{self._now}: {text}" if text else self._now)

    def counted(self, name: str, total: int, what: str) -> Callable[[int], None]:
        """Begins a stage of the command, and returns a function that shows how many items out of `total` are done."""
        self(name)
        return lambda done: self(f"{done} of {total} {what}")

    def end(self) -> None:
        """Clears the line of progress before the result is printed."""
        show("")


WIDTH = 80
GAP = "  "  # space between two columns
GLUE = "\N{NO-BREAK SPACE}"


class Whole(str):
    """Line to be copied, which is never broken."""


def say(lines: Iterable[str]) -> None:
    """Prints lines after wrapping them by `fit_lines`."""
    print("\n".join(fit_lines(lines)), flush=True)


def fit_lines(lines: Iterable[str]) -> list[str]:
    """Returns lines of at most `WIDTH` columns.

    A line that is too long is broken, and the continuation is indented by two more columns.
    """
    return [part for line in lines for part in (wrap_text(line) if len(line) > WIDTH else [line])]


LINES = 24  # number of lines that a terminal shows
DETAIL_LINES = 40  # largest number of lines with `-v`
# Up to this number of controllers, each controller has its own statements; with more, the output would not fit into a terminal
FEW = 3


def some_sentences(sentences: Sequence[str], others: Iterable[str], most: int = LINES, source: str = "-v prints") -> list[str]:
    """Returns the sentences that fit on a terminal together with other lines, and a line that states how many are omitted.

    The first sentence is always included.

    Args:
        sentences: sentences in the order in which they are printed.
        others: lines that are printed together with the sentences.
        most: largest number of lines that may be printed.
        source: beginning of the line about omitted sentences.
    """
    room, lines = most - len(fit_lines(others)), list[str]()
    for i, sentence in enumerate(sentences):
        more = len(sentences) - i - 1
        if i and len(lines) + len(fit_lines([sentence])) + bool(more) > room:
            return [*lines, f"{source} {more + 1} more sentence{'s' * bool(more)}"]
        lines += fit_lines([sentence])
    return lines


def title_lines(title: str, source: str) -> list[str]:
    """Returns two lines: a title, and the path of the file to which the title refers."""
    return [title, Whole(f"{GAP}{source}")]


def wrap_text(text: str, start: str = "", hang: int | None = None) -> list[str]:
    """Returns a text as lines of at most `WIDTH` columns, without breaking words or separating a number from its unit.

    Args:
        text: the text; its leading spaces are kept.
        start: prefix of the first line.
        hang: number of spaces before the second and further lines; by default, two more than before the first line.
    """
    if isinstance(text, Whole):
        return [start + text]
    inner = text.lstrip(" ")
    start += text[: len(text) - len(inner)]
    if hang is None:
        hang = len(start) - len(start.lstrip(" ")) + len(GAP)
    glued = re.sub(r"(?<=\d) (?=\S)|(?<=\+-) (?=\d)", GLUE, inner)
    lines = textwrap.wrap(
        glued, WIDTH, initial_indent=start, subsequent_indent=" " * hang, break_long_words=False, break_on_hyphens=False
    )
    return [line.replace(GLUE, " ") for line in lines] or [start.rstrip()]


def table(rows: Iterable[Sequence[str] | str], indent: str = GAP, tight: bool = False) -> list[str]:
    """Returns rows in columns: names left-aligned, numbers right-aligned. A name that is too long is on a separate line.

    Args:
        rows: rows with the same number of cells, whose first cell is a name. A row can also be a text that spans all columns.
        indent: prefix of every line.
        tight: True to separate columns by a single space if more names fit in their column as a result.
    """
    all_rows = list(rows)
    cells = [row for row in all_rows if not isinstance(row, str)]
    widths = [max(len(cell) for cell in column) for column in list(zip(*cells, strict=True))[1:]]

    def fit(gap: str) -> list[int]:
        room = WIDTH - len(indent) - sum(len(gap) + width for width in widths)
        return [len(row[0]) for row in cells if len(row[0]) <= room]

    gap = " " if tight and len(fit(" ")) > len(fit(GAP)) else GAP
    return [line for row in all_rows for line in _row(row, max(fit(gap), default=0), widths, indent, gap)]


def _row(row: Sequence[str] | str, name: int, widths: Sequence[int], indent: str, gap: str) -> Iterator[str]:
    if isinstance(row, str):
        yield f"{indent}{row}".rstrip()
        return
    first, *rest = row
    if len(first) > name:
        yield indent + first
        first = ""
    yield gap.join([f"{indent}{first:{name}}", *(f"{cell:>{width}}" for cell, width in zip(rest, widths, strict=True))]).rstrip()


def command(words: Sequence[str]) -> list[str]:
    """Returns a command to copy, wrapped with backslashes. Each text in `words` is an option together with its value."""
    lines, line = [], GAP + words[0]
    for word in words[1:]:
        if len(f"{line} {word} \\") > WIDTH:
            lines.append(Whole(f"{line} \\"))
            line = f"{GAP}  {word}"
        else:
            line = f"{line} {word}"
    return [*lines, Whole(line)]
