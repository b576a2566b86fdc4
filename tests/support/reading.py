"""The content of a report: its page, read back from the HTML, and its tables."""

import contextlib
import html
import io
import json
import re
from pathlib import Path
from typing import Any

from sim.report.__main__ import main

PLAIN = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")


class PageRead:
    """A page: its text, the sentences and state of its answer, and its tables as rows.

    Args:
        path: the page.
        result: what its command prints with `--json`.
    """

    def __init__(self, path: Path, result: dict[str, Any]) -> None:
        own = re.sub(r"<(script|style)\b.*?</\1>", "", path.read_text(encoding="utf-8"), flags=re.S)
        (self.state,) = re.findall(r'<p class="verdict (\w+)">', own)
        self.answer: list[str] = [sentence.replace("`", "") for sentence in result["answer"]]
        self.text = " ".join(html.unescape(re.sub(r"<[^>]+>", " ", re.sub(r"</?(bdi|code)>", "", own))).split())
        self.tables: dict[str, list[dict[str, str]]] = result["tables"]

    def row(self, table: str, **cells: str) -> dict[str, str]:
        """The only row of a table that has these cells."""
        (found,) = [row for row in self.tables[table] if all(row[name] == value for name, value in cells.items())]
        return found


def read_report(path: Path, *arguments: str) -> PageRead:
    """Returns the page of a report that finishes."""
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        assert main(["--out", str(path), "--json", *arguments]) == 0
    return PageRead(path, json.loads(printed.getvalue()))


def number(text: str) -> float:
    """Returns a number as a page writes it: 1.4·10⁻³, 10⁻³, or −3."""
    plain = re.sub(r"(?<![\d·])10(?=[⁻⁰¹²³⁴⁵⁶⁷⁸⁹])", "1·10", text)
    return float(re.sub("·10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)", lambda power: f"e{power[1].translate(PLAIN)}", plain).replace("−", "-"))
