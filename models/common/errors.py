"""The error for invalid input. If an InputError is raised, a command prints a one-line message and returns the exit code 2."""

import difflib
import reprlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

TRACEBACK = "--traceback"  # option that every command has
LONGEST = 1000  # largest number of characters of a message; the longest list of allowed names has 700 characters
LONGEST_VALUE = 60  # largest number of characters of a value that a message quotes

_shortly = reprlib.Repr()
_shortly.maxlevel, _shortly.maxstring, _shortly.maxlong, _shortly.maxother = 3, LONGEST_VALUE, LONGEST_VALUE, LONGEST_VALUE


class InputError(ValueError):
    """Invalid input. The message of an InputError is one line (`one_line`) with the wrong value, the allowed values and a
    correction.

    Attributes:
        exit_code: exit code of a command that ends because of an InputError.
    """

    exit_code = 2

    def __init__(self, message: object = "") -> None:
        super().__init__(one_line(str(message)))


@contextmanager
def error_in(where: str) -> Iterator[None]:
    """Puts a place, such as the name of a file, in front of the message of an InputError that the block raises."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{where} {error}") from error


def one_line(message: str) -> str:
    """Returns a message as one printable line. A long message is shortened in the middle, between the error and the advice."""
    line = " ".join(part.strip() for part in message.splitlines())
    return middle_cut("".join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in line), LONGEST)


def short_repr(value: Any) -> str:
    """Returns the `repr` of any value for a message, shortened in the middle."""
    return middle_cut(_shortly.repr(getattr(value, "tolist", lambda: value)()), LONGEST_VALUE)


def middle_cut(text: str, most: int) -> str:
    """Returns a text unchanged; a text with more than `most` characters is reduced to its beginning and end."""
    if len(text) <= most:
        return text
    kept = most - len(" ... ")
    return f"{text[: kept - kept // 2]} ... {text[-(kept // 2) :]}"


def list_names(names) -> str:
    """Returns names as a sorted list for a message."""
    return ", ".join(sorted(names)) or "none"


def number_range(smallest: float, largest: float, unit: str = "") -> str:
    """Returns the allowed range of a number with the unit, for a message; the units "1", "-" and "" denote pure numbers."""
    return f"a number from {smallest:g} to {largest:g} {'' if unit in ('1', '-') else unit}".rstrip()


def alike(name: object, names: Iterable[str], most: int = 12) -> str:
    """Returns the allowed names as a list for a message.

    If there are more than `most` names, the list contains only names that are similar to the wrong name.
    """
    known = sorted(names)
    if len(known) <= most:
        return list_names(known)
    near = difflib.get_close_matches(str(name)[:LONGEST_VALUE], known, n=most // 2, cutoff=0.0)
    return first_few(near + [one for one in known if one not in near], most // 2)


def first_few(names: Sequence[str], most: int = 3) -> str:
    """Returns a text with the first few of many names, and with the number of the remaining names."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")
