"""A result as a document: statements, tables and figures under a title. Text, pages, CSV and notebooks are made of it.

Every study has a function `describe` that returns the document of its result. A command prints it (`models.document.text`), and a
report is a page of many such documents (`models.document.page`), so that both have the same words and digits.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeAlias

from models.common.printed import by_text
from models.document.field import Detail, Field, T, cells, titles

if TYPE_CHECKING:
    from models.document.figure import Figure

State = Literal["note", "holds", "ends", "fails"]  # of a claim: none is made; it holds; it ends somewhere; it is wrong
STATES: tuple[State, ...] = ("note", "holds", "ends", "fails")
LEVELS: tuple[Detail, ...] = ("brief", "normal", "full")
NOTE = "note"  # heading of a last column of remarks: the terminal prints a remark below its row if it is too long


@dataclass(frozen=True)
class Statement:
    """A sentence of a result.

    Attributes:
        text: the sentence; names of controllers in backticks.
        state: claim about the result; "note" for none.
        detail: lowest level of detail at which it is shown.
    """

    text: str
    state: State = "note"
    detail: Detail = "normal"


@dataclass(frozen=True)
class Pivot:
    """A short form of a long table: one row for each of some columns' values, one column for each value of another.

    Attributes:
        rows: headings of the columns that name a row; a column `unit` follows the name before it, in brackets.
        across: heading of the column whose values become columns.
        values: headings of the numbers that are shown.
    """

    rows: tuple[str, ...]
    across: str
    values: tuple[str, ...]


@dataclass(frozen=True)
class Table:
    """A table.

    Attributes:
        name: name of its CSV file, without suffix.
        caption: description of the table's content.
        headings: headings of the columns.
        rows: cells as text; the first is the row's name.
        words: number of left-aligned columns of text; the other columns are numbers, right-aligned, except a last one `NOTE`.
        pivot: short form for a page, or None to show all columns that differ.
        detail: lowest level of detail at which it is shown.
        wide: headings of columns that a terminal has no room for.
        keys: keys of the columns in JSON; empty if those are the headings.
    """

    name: str
    caption: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    words: int = 1
    pivot: Pivot | None = None
    detail: Detail = "normal"
    wide: tuple[str, ...] = ()
    keys: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if len(set(self.headings)) < len(self.headings):
            raise ValueError(f"headings of table {self.name!r} are not distinct: {', '.join(self.headings)}")

    @classmethod
    def of(
        cls,
        name: str,
        caption: str,
        fields: Sequence[Field[T]],
        ones: Iterable[T],
        words: int = 1,
        pivot: Pivot | None = None,
        detail: Detail = "normal",
    ) -> "Table":
        """Returns the table of some results, a row each. Fields of detail "full" are columns of pages and files only."""
        wide = tuple(field.title for field in fields if field.detail == "full")
        renamed = any(field.column for field in fields)
        keys = tuple(field.column or field.title for field in fields) if renamed else ()
        return cls(name, caption, titles(fields), cells(fields, ones), words, pivot, detail, wide, keys)

    @property
    def records(self) -> list[dict[str, str]]:
        """Returns the rows for JSON, their cells by key."""
        return [dict(zip(self.keys or self.headings, row, strict=True)) for row in self.rows]


Block: TypeAlias = "Statement | Table | Figure | Document"


@dataclass(frozen=True, eq=False)
class Document:
    """A result, or a part of one.

    Attributes:
        title: the field's term for it.
        blocks: statements, tables, figures and documents, in the order of reading.
        detail: lowest level of detail at which it is shown.
    """

    title: str
    blocks: tuple[Block, ...] = ()
    detail: Detail = "normal"

    def all(self) -> Iterator[Block]:
        """Yields every block, also those of the documents in it, which come before their blocks."""
        for block in self.blocks:
            yield block
            if isinstance(block, Document):
                yield from block.all()

    @property
    def statements(self) -> tuple[Statement, ...]:
        """Returns all statements."""
        return tuple(block for block in self.all() if isinstance(block, Statement))

    @property
    def tables(self) -> tuple[Table, ...]:
        """Returns all tables."""
        return tuple(block for block in self.all() if isinstance(block, Table))

    @property
    def figures(self) -> "tuple[Figure, ...]":
        """Returns all figures."""
        return tuple(block for block in self.all() if not isinstance(block, Statement | Table | Document))

    @property
    def state(self) -> State:
        """Returns the worst state of all statements."""
        return worst(self.statements)


def worst(statements: Iterable[Statement]) -> State:
    """Returns the worst state of some statements."""
    return STATES[max((STATES.index(one.state) for one in statements), default=0)]


def notes(*texts: str, detail: Detail = "normal") -> tuple[Statement, ...]:
    """Returns texts as statements that claim nothing."""
    return tuple(Statement(text, detail=detail) for text in texts)


def statements(said: Iterable[tuple[str, str]], detail: Detail = "normal") -> list[Statement]:
    """Returns statements on controllers from pairs of name and text; controllers with the same text share a statement."""
    return [Statement(f"{names}: {text}", detail=detail) for text, names in by_text(said).items()]


def is_shown(block: Block, detail: Detail) -> bool:
    """Returns True if a block is shown at this level of detail."""
    figure = not isinstance(block, Statement | Table | Document)
    return figure or LEVELS.index(block.detail) <= LEVELS.index(detail)


def apart(*blocks: "Statement | Table | Document") -> tuple[Document, ...]:
    """Returns each block as a document, so that it follows an empty line on a terminal."""
    return tuple(Document("", (block,), block.detail) for block in blocks)
