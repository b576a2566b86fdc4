"""Documents as text: lines of at most 80 columns for a terminal and for a Python prompt, and Markdown."""

import itertools
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from models.common.errors import InputError
from models.common.extensions import FEATURES
from models.common.printed import GAP, GLUE, LINES, WIDTH, as_name, fit_lines, table, wrap_text
from models.document.document import NOTE, Block, Detail, Document, Statement, Table, is_shown, notes

HANG = 6  # spaces at the beginning of a remark that is printed below its row
HEADING = 3  # largest number of lines of a column heading
# A table with more rows than this counts as long; the space between its columns is reduced before a heading gets a third line
LONG = 10
CHANGE = " change [%]"  # end of the heading of a column that shows the changes of the numbers in the preceding column
BEST = "*"  # this mark follows the best number in a column


def names_text(names: Iterable[str]) -> str:
    """Returns the names of several controllers as a list for a sentence: `a`, `b` and `c`."""
    return join_words([as_name(name) for name in names])


def join_words(words: list[str]) -> str:
    """Returns several words as a list for a sentence: a, b and c."""
    return " and ".join(filter(None, [", ".join(words[:-1]), *words[-1:]]))


def text_lines(document: Document, detail: Detail = "normal") -> list[str]:
    """Returns the lines of a document for a terminal: its title, then its blocks. An empty line precedes every inner document.

    Figures are omitted. Below a title, statements and tables are indented. Without a title, an empty line precedes a table.
    """
    lines, before = [document.title] if document.title else [], None
    indent = GAP if document.title else ""
    for block in document.blocks:
        if not is_shown(block, detail):
            continue
        if isinstance(block, Statement):
            lines += [*([""] if isinstance(before, Document) else []), *wrap_text(block.text.replace("`", ""), indent)]
        elif isinstance(block, Table):
            lines += [*([""] if isinstance(before, Statement) and not document.title else []), *table_lines(block, indent)]
        elif isinstance(block, Document):
            lines += [*([""] if lines else []), *text_lines(block, detail)]
        before = block
    return lines


def screen_lines(document: Document, verbose: bool, others: Iterable[str] = ()) -> list[str]:
    """Returns the lines of a document at a level of detail that suits the terminal.

    If `verbose` is True, the function returns all lines. If `verbose` is False, it returns the normal lines, or the brief lines
    if a terminal has no room for the normal lines.

    Args:
        document: document whose lines are returned.
        verbose: True for all lines.
        others: lines that are printed together with the document.
    """
    if verbose:
        return text_lines(document, "full")
    lines = text_lines(document)
    return lines if len(fit_lines([*others, *lines])) <= LINES else text_lines(document, "brief")


def table_lines(one: Table, indent: str = GAP) -> list[str]:
    """Returns the lines of a table for a terminal.

    If the table is too wide, headings are wrapped, and headings of columns with relative changes are shortened to "%". If
    several rows have the same name, the name is on a separate line, and the rows are indented below the name. If the last
    column is `NOTE`, the remarks in it are printed to the right of the rows or below the rows.
    """
    columns = [each for each in zip(one.headings, *one.rows, strict=True) if each[0] not in one.wide]
    remarks: Sequence[str] = ()
    if one.headings[-1] == NOTE:
        _, *remarks = columns.pop()
    several = one.words > 1 and not remarks and len({*columns[0]}) < len(columns[0])
    above = columns.pop(0)[1:] if several else ("",) * len(one.rows)
    words = one.words - several
    columns[0] = tuple(f"{GAP * several}{cell}" for cell in columns[0])
    columns = [*columns[:words], *map(_align_column, columns[words:])]
    shown, widths = columns, list[int]()
    gaps = (GAP, " ") if len(one.rows) < LONG else (" ",)
    for gap, short, most in itertools.product(gaps, (CHANGE.strip(), "%"), range(1, HEADING + 1)):
        tops = [_heading(short if heading.endswith(CHANGE) else heading, most) for heading, *_ in columns]
        high = max(map(len, tops))
        shown = [[*[""] * (high - len(top)), *top, *cells] for top, (_, *cells) in zip(tops, columns, strict=True)]
        widths = [max(map(len, column)) for column in shown]
        if len(indent) + sum(widths) + len(gap) * (len(widths) - 1) <= WIDTH:
            break
    cells = [*zip(*shown, strict=True)]
    rows: list[Sequence[str] | str] = [*cells[: len(cells) - len(one.rows)]]
    for i, row in enumerate(cells[len(rows) :]):
        rows += [above[i], row] if above[i] and above[i] not in above[i - 1 : i] else [row]
    lines = table(rows, indent, tight=True)
    if remarks:
        rests, lines = lines[-len(remarks) :], lines[: -len(remarks)]
        for line, remark in zip(rests, remarks, strict=True):
            beside = f"{line}{GAP}{remark}".rstrip()
            lines += [beside] if len(beside) <= WIDTH else [line, *wrap_text(remark, " " * HANG)]
    return lines


def _align_column(column: Sequence[str]) -> list[str]:
    """Returns a column of aligned numbers, in which a mark on the best numbers does not disturb the alignment."""
    heading, *numbers = column
    marked = any(cell.endswith(BEST) for cell in numbers)
    return [heading, *(f"{cell} " if marked and not cell.endswith(BEST) else cell for cell in numbers)]


def _heading(text: str, most: int) -> list[str]:
    """Returns a heading in at most `most` lines, as narrow as possible. The unit in the heading is not broken."""
    glued = text.replace("] ", f"]{GLUE}")
    broken = (textwrap.wrap(glued, width, break_long_words=False, break_on_hyphens=False) for width in range(1, len(text) + 1))
    return [line.replace(GLUE, " ") for line in next(lines for lines in broken if len(lines) <= most)]


def markdown(document: Document, level: int = 2) -> str:
    """Returns a document as Markdown, with all its blocks except figures."""
    parts = [f"{'#' * level} {document.title}"] if document.title else []
    for block in document.blocks:
        if isinstance(block, Statement):
            parts.append(block.text)
        elif isinstance(block, Table):
            rows = [block.headings, ["---"] * len(block.headings), *block.rows]
            parts.append("\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows))
        elif isinstance(block, Document):
            parts.append(markdown(block, level + 1))
    return "\n\n".join(parts)


class ShownResult:
    """Base class of results that a Python prompt shows as text, and a notebook as HTML.

    A dataclass that is derived from this class must set `repr=False`.
    """

    @property
    def summary(self) -> Document:
        """The result as a document."""
        raise NotImplementedError

    @property
    def figures(self) -> tuple[Block, ...]:
        """Figures and tables that a notebook shows below the document."""
        return ()

    def __repr__(self) -> str:
        return "\n".join(text_lines(self.summary))

    def _repr_html_(self) -> str | None:
        page = FEATURES.load("pages")
        try:
            page.check_page()
        except InputError:  # a notebook shows this text if the HTML cannot be created
            return None
        document = self.summary
        return page.fragment(replace(document, blocks=(*document.blocks, *self.figures)))


def facts(title: str, rows: Mapping[str, str]) -> Document:
    """Returns a document with a line `name: text` for each fact. A fact with an empty text is omitted."""
    return Document(title, notes(*(f"{name}: {text}" for name, text in rows.items() if text), detail="brief"))
