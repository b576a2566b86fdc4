"""Commands that are printed to be pasted: whatever a file or a controller is called, a POSIX shell reads it back as it was."""

import shlex
from collections.abc import Sequence
from pathlib import Path

ESCAPES = {"\\": r"\\", "'": r"\'", "\n": r"\n", "\r": r"\r", "\t": r"\t"}


def pasted(words: Sequence[str]) -> str:
    """A command of these words, on one line."""
    return " ".join(map(_word, words))


def option(name: str, value: str) -> str:
    """An option with its value, as one word where the value would be taken for an option itself."""
    return pasted([f"{name}={value}"] if value.startswith("-") else [name, value])


def pasted_path(path: Path) -> str:
    """A path as an argument; one that begins as an option does is named from the folder that it is in."""
    return pasted([f"./{path}" if str(path).startswith("-") else str(path)])


def _word(text: str) -> str:
    if text.isprintable():
        return shlex.quote(text)
    return "$'" + "".join(map(_escaped, text)) + "'"  # what would break the line, or the terminal


def _escaped(letter: str) -> str:
    if letter in ESCAPES or letter.isprintable():
        return ESCAPES.get(letter, letter)
    return "".join(f"\\{byte:03o}" for byte in letter.encode("utf-8", "surrogateescape"))
