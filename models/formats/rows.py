"""Rows of numbers, as files have them."""

from typing import Any


def size(rows: list[Any]) -> str:
    """How many rows there are, and how long they are."""
    lengths = " or ".join(str(length) for length in sorted({len(row) for row in rows})) or "no"
    return f"{len(rows)} row(s) of {lengths} number(s)"
