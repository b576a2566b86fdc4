"""Documents as text: lines of at most 80 columns for a terminal, and Markdown."""

from collections.abc import Iterable, Sequence

from models.common.printed import GAP, WIDTH, as_name, table, wrapped
from models.document.document import NOTE, Detail, Document, Statement, Table, is_shown
from models.document.field import Field, T, cells, titles

HANG = 6  # spaces before a remark below its row


def field_table(fields: Sequence[Field[T]], ones: Iterable[T]) -> list[str]:
    """Returns the lines of a table for the terminal, a row per result."""
    return table([titles(fields), *cells(fields, ones)])


def names_text(names: Iterable[str]) -> str:
    """Returns names of controllers in a sentence: `a`, `b` and `c`."""
    return joined([as_name(name) for name in names])


def joined(words: list[str]) -> str:
    """Returns words in a sentence: a, b and c."""
    return " and ".join(filter(None, [", ".join(words[:-1]), *words[-1:]]))


def text_lines(document: Document, detail: Detail = "normal") -> list[str]:
    """Returns a document's lines for a terminal: its title, then its blocks; tables and documents follow an empty line.

    Figures are left out. A statement of the document itself is indented below its title.
    """
    lines = [document.title] if document.title else []
    indent = GAP if document.title else ""
    for block in document.blocks:
        if not is_shown(block, detail):
            continue
        if isinstance(block, Statement):
            lines += wrapped(block.text.replace("`", ""), indent)
        elif isinstance(block, Table):
            lines += table_lines(block, indent)
        elif isinstance(block, Document):
            lines += [*([""] if lines else []), *text_lines(block, detail)]
    return lines


def table_lines(one: Table, indent: str = GAP) -> list[str]:
    """Returns a table's lines for a terminal. Remarks of a last column `NOTE` stand right of the row, or below it."""
    columns = [each for each in zip(one.headings, *one.rows, strict=True) if each[0] not in one.wide]
    if one.headings[-1] != NOTE:
        return table([*zip(*columns, strict=True)], indent)
    *rows, remarks = columns
    lines = []
    for line, remark in zip(table([*zip(*rows, strict=True)], indent), ("", *remarks[1:]), strict=True):
        beside = f"{line}{GAP}{remark}".rstrip()
        lines += [beside] if len(beside) <= WIDTH else [line, *wrapped(remark, " " * HANG)]
    return lines


def markdown(document: Document, level: int = 2) -> str:
    """Returns a document as Markdown, with all that it has but figures."""
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
