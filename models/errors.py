"""The one error that is the user's to mend: every command turns it into one line and exit code 2."""

from collections.abc import Sequence


class InputError(ValueError):
    """Something given from outside is wrong. The message says what was found, what is allowed, and what to do."""


def known(names) -> str:
    """The names that are allowed, as a list for a message."""
    return ", ".join(sorted(names)) or "none"


def some(names: Sequence[str], most: int = 3) -> str:
    """The first of many names, and how many more there are."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")
