"""What commands print: lines of at most 80 columns, the width that every terminal, page and mail has.

The width is fixed, so that what is printed does not depend on where. A longer sentence goes on in the next line, further in; a
table gives a name that is too long a line of its own. Only what must not be cut may be longer: a path, and a line to be copied.
"""

import re
import textwrap
from collections.abc import Iterable, Iterator, Sequence

WIDTH = 80
GAP = "  "  # between columns
GLUE = "\N{NO-BREAK SPACE}"


class Whole(str):
    """A line that is to be copied as it stands, and so is never broken."""


def say(lines: Iterable[str]) -> None:
    """Prints lines, each as `fitted` has it."""
    print("\n".join(fitted(lines)), flush=True)


def fitted(lines: Iterable[str]) -> list[str]:
    """Lines that fit: what is too long goes on in the next line, by two columns further in than it began."""
    return [part for line in lines for part in (wrapped(line) if len(line) > WIDTH else [line])]


def titled(title: str, source: str) -> list[str]:
    """What is looked at, and below it the file that it comes from."""
    return [title, Whole(f"{GAP}{source}")]


def wrapped(text: str, start: str = "", hang: int | None = None) -> list[str]:
    """A text in lines that fit. A number stays with what follows it, which is its unit, and no word is cut.

    Args:
        text: the text; the spaces that it begins with stay.
        start: what stands before it in the first line.
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
    """A matrix after some text, each of its rows on a line of its own."""
    lines: list[str] = []
    for i, row in enumerate(rows):
        open_, close = "[[" if i == 0 else " [", "]]" if i == len(rows) - 1 else "],"
        start = text if i == 0 else " " * len(text)
        lines += wrapped(open_ + ", ".join(row) + close, start, len(text) + 2)
    return lines


def table(rows: Iterable[Sequence[str] | str], indent: str = GAP) -> list[str]:
    """Rows in aligned columns: names to the left, numbers to the right. A name that leaves them no room has a line of its own.

    Args:
        rows: of as many cells each, the first of them the name; a row that is a text alone goes over all columns.
        indent: what every line begins with.
    """
    every = list(rows)
    cells = [row for row in every if not isinstance(row, str)]
    widths = [max(len(cell) for cell in column) for column in list(zip(*cells, strict=True))[1:]]
    room = WIDTH - len(indent) - sum(len(GAP) + width for width in widths)
    name = max((len(row[0]) for row in cells if len(row[0]) <= room), default=0)
    return [line for row in every for line in _row(row, name, widths, indent)]


def _row(row: Sequence[str] | str, name: int, widths: Sequence[int], indent: str) -> Iterator[str]:
    if isinstance(row, str):
        yield f"{indent}{row}".rstrip()
        return
    first, *rest = row
    if len(first) > name:
        yield indent + first
        first = ""
    yield GAP.join([f"{indent}{first:{name}}", *(f"{cell:>{width}}" for cell, width in zip(rest, widths, strict=True))]).rstrip()


def command(words: Sequence[str], indent: str = GAP) -> list[str]:
    """A command to be copied, an option and its value a word here: where it is too long, a backslash goes on in the next line."""
    lines, line = [], indent + words[0]
    for word in words[1:]:
        if len(f"{line} {word} \\") > WIDTH:
            lines.append(Whole(f"{line} \\"))
            line = f"{indent}  {word}"
        else:
            line = f"{line} {word}"
    return [*lines, Whole(line)]
