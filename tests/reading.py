"""The content of a report's page, read back from its HTML as a reader has it."""

import html
import re
from pathlib import Path


class PageRead:
    """A page: its text, the sentences and state of its answer, its captions, and its tables as rows by heading."""

    def __init__(self, path: Path) -> None:
        own = re.sub(r"<(script|style)\b.*?</\1>", "", path.read_text(encoding="utf-8"), flags=re.S)
        (self.state,) = re.findall(r'<h2 class="verdict (\w+)">', own)
        (box,) = re.findall(r'<div class="answer">(.*?)</div>', own, re.S)
        self.answer = [_text(sentence) for sentence in re.findall(r"<p>(.*?)</p>", box, re.S)]
        self.captions = [_text(caption) for caption in re.findall(r"<figcaption>(.*?)</figcaption>", own, re.S)]
        self.text = _text(own)
        self.tables = {
            name: _rows(table)
            for name, table in re.findall(r'<div class="table" id="table-([^"]+)"[^>]*>(.*?)</table>', own, re.S)
        }

    def row(self, table: str, **cells: str) -> dict[str, str]:
        """The only row of a table that has these cells."""
        (found,) = [row for row in self.tables[table] if all(row[name] == value for name, value in cells.items())]
        return found


def _rows(table: str) -> list[dict[str, str]]:
    headings = [_text(cell) for cell in re.findall(r'<th scope="col"[^>]*>(.*?)</th>', table, re.S)]
    (body,) = re.findall(r"<tbody>(.*?)</tbody>", table, re.S)
    cells = [
        [_text(cell) for cell in re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row, re.S)]
        for row in re.findall(r"<tr>(.*?)</tr>", body, re.S)
    ]
    return [dict(zip(headings, row, strict=True)) for row in cells]


def _text(piece: str) -> str:
    return " ".join(html.unescape(re.sub(r"<[^>]+>", " ", re.sub(r"</?bdi>", "", piece))).split())
