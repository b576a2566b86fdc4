"""How far long work has come: on stderr, and only where that is a terminal."""

import sys
from collections.abc import Callable


def show(message: str) -> None:
    """One line that the next one overwrites; an empty one clears it."""
    if sys.stderr and sys.stderr.isatty():
        print(f"\r{message:70}\r", end="", file=sys.stderr, flush=True)


def bar(total: int, what: str) -> Callable[[int], None]:
    """A bar that is told how many are done."""

    def update(done: int) -> None:
        show("" if done >= total else f"[{'#' * round(30 * done / total):30}] {done} of {total} {what}")

    return update
