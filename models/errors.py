"""The one error that is the user's to mend: every command turns it into one line and exit code 2."""


class InputError(ValueError):
    """Something given from outside is wrong. The message says what was found, what is allowed, and what to do."""


def known(names) -> str:
    """The names that are allowed, as a list for a message."""
    return ", ".join(sorted(names)) or "none"
