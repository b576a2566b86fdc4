"""A result as a document: statements, tables and figures under a title.

A document can be written as text, as a page, as CSV and as notebook output.

Every study has a function `describe` that returns the document of its result. A command prints the document
(`models.document.text`). A report is a page of many documents (`models.document.page`), so the same result has the same words
and digits in commands and in reports.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeAlias

from models.common.printed import by_text
from models.document.field import Detail, Field, T, cells, titles

if TYPE_CHECKING:
    from models.document.figure import Figure

# State of a claim: no claim, a true claim, a claim that holds only up to some point, or a wrong claim
State = Literal["note", "holds", "ends", "fails"]
STATES: tuple[State, ...] = ("note", "holds", "ends", "fails")
LEVELS: tuple[Detail, ...] = ("brief", "normal", "full")
# Heading of the last column of a table if this column has remarks; on a terminal, a long remark follows below its row
NOTE = "note"


@dataclass(frozen=True)
class Statement:
    """A sentence of a result.

    Attributes:
        text: the sentence, with names of controllers in backticks.
        state: state of the claim that the sentence makes; "note" for a sentence without a claim.
        detail: lowest level of detail at which the sentence is shown.
    """

    text: str
    state: State = "note"
    detail: Detail = "normal"


@dataclass(frozen=True)
class Pivot:
    """Definition of the short form of a long table.

    The short form has a row for each combination of values in some columns, and a column for each value of another column.

    Attributes:
        rows: headings of the columns whose values form the name of a row. If one of the columns is `unit`, its cell is added to
            the name in brackets.
        across: heading of the column whose values become the columns of the short form.
        values: headings of the columns whose numbers the short form shows.
    """

    rows: tuple[str, ...]
    across: str
    values: tuple[str, ...]


@dataclass(frozen=True)
class Table:
    """A table.

    Attributes:
        name: name of the CSV file to which the table is written, without suffix.
        caption: description of the table's content.
        headings: headings of the columns.
        rows: cells as text. The first cell of a row is its name.
        words: number of columns with text, which are left-aligned. The remaining columns are right-aligned numbers, except for
            a last column `NOTE`.
        pivot: short form of the table for a page; None to show all columns whose cells differ.
        detail: lowest level of detail at which the table is shown.
        wide: headings of columns that are omitted on a terminal, because a terminal has no room for them.
        keys: keys of the columns in JSON; empty if the headings are the keys.
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
        """Returns a table with a row for each result. Fields with the detail "full" become columns only in pages and files."""
        wide = tuple(field.title for field in fields if field.detail == "full")
        renamed = any(field.column for field in fields)
        keys = tuple(field.column or field.title for field in fields) if renamed else ()
        return cls(name, caption, titles(fields), cells(fields, ones), words, pivot, detail, wide, keys)

    @property
    def records(self) -> list[dict[str, str]]:
        """The rows of the table for JSON: each row maps the key of every column to the cell."""
        return [dict(zip(self.keys or self.headings, row, strict=True)) for row in self.rows]


Block: TypeAlias = "Statement | Table | Figure | Document"


@dataclass(frozen=True, eq=False)
class Document:
    """A result, or a part of a result.

    Attributes:
        title: title, a technical term that readers know from the literature.
        blocks: statements, tables, figures and documents, in the order of reading.
        detail: lowest level of detail at which the document is shown.
    """

    title: str
    blocks: tuple[Block, ...] = ()
    detail: Detail = "normal"

    def all(self) -> Iterator[Block]:
        """Yields every block, including the blocks of inner documents. An inner document is yielded before the blocks that it
        contains.
        """
        for block in self.blocks:
            yield block
            if isinstance(block, Document):
                yield from block.all()

    @property
    def statements(self) -> tuple[Statement, ...]:
        """All statements, including the statements of inner documents."""
        return tuple(block for block in self.all() if isinstance(block, Statement))

    @property
    def tables(self) -> tuple[Table, ...]:
        """All tables, including the tables of inner documents."""
        return tuple(block for block in self.all() if isinstance(block, Table))

    @property
    def figures(self) -> "tuple[Figure, ...]":
        """All figures, including the figures of inner documents."""
        return tuple(block for block in self.all() if not isinstance(block, Statement | Table | Document))

    @property
    def state(self) -> State:
        """The worst state that any statement of the document has."""
        return worst(self.statements)


def worst(statements: Iterable[Statement]) -> State:
    """Returns the worst state that any of the statements has."""
    return STATES[max((STATES.index(one.state) for one in statements), default=0)]


def notes(*texts: str, detail: Detail = "normal") -> tuple[Statement, ...]:
    """Returns statements that have the given texts and make no claim."""
    return tuple(Statement(text, detail=detail) for text in texts)


def statements(said: Iterable[tuple[str, str]], detail: Detail = "normal") -> list[Statement]:
    """Returns statements about controllers from pairs of name and text. Controllers with equal texts share a statement."""
    return [Statement(f"{names}: {text}", detail=detail) for text, names in by_text(said).items()]


def is_shown(block: Block, detail: Detail) -> bool:
    """Returns True if a block is shown at the requested level of detail."""
    figure = not isinstance(block, Statement | Table | Document)
    return figure or LEVELS.index(block.detail) <= LEVELS.index(detail)


def apart(*blocks: "Statement | Table | Document") -> tuple[Document, ...]:
    """Returns each block as a separate document, so that an empty line precedes the block on a terminal."""
    return tuple(Document("", (block,), block.detail) for block in blocks)
