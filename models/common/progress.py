"""How far long work has come: on stderr, and only where that is a terminal."""

import sys
from collections.abc import Callable

WIDEST = 79  # a longer line would go on in the next one, and stay there


def show(message: str) -> None:
    """One line that the next one overwrites; an empty one clears it."""
    if sys.stderr and sys.stderr.isatty():
        print(f"\r{message[:WIDEST]:{WIDEST}}\r", end="", file=sys.stderr, flush=True)


class Stages:
    """What a command does one after another, counted: `[2/6] margins: 31 runs of 12 s to go`."""

    def __init__(self, *names: str) -> None:
        """Names of the stages, in their order."""
        self._names, self._now = names, ""

    def __call__(self, text: str) -> None:
        """Begins the stage of that name; any other text is how far the present one is, and an empty one that nothing is known."""
        if text in self._names:
            self._now, text = f"[{self._names.index(text) + 1}/{len(self._names)}] {text}", ""
        show(f"{self._now}: {text}" if text else self._now)

    def counted(self, name: str, total: int, what: str) -> Callable[[int], None]:
        """Begins a stage that is told how many of so many are done."""
        self(name)
        return lambda done: self(f"{done} of {total} {what}")

    def end(self) -> None:
        """Clears the line: what is printed next is the result."""
        show("")
