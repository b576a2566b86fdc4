"""What a controller may be called."""

import unicodedata
from collections.abc import Collection

from models.common.errors import InputError

LONGEST_NAME = 60  # bytes; the names of three controllers go into a file name


def check_name(where: str, name: str, taken: Collection[str]) -> None:
    """Whether a controller may be called so.

    Args:
        where: its section, for messages.
        name: its name.
        taken: names that always exist.

    Raises:
        InputError: it may not.
    """
    if name in taken or name == "all":
        raise InputError(f"{where} the name {name!r} is taken: passive, state and all always exist; rename it")
    if len(name.encode()) > LONGEST_NAME or not _is_name(name):
        raise InputError(
            f"{where} a controller's name has letters, digits, '_' and '-' only, at most {LONGEST_NAME} bytes of UTF-8, and no "
            "'-' first, as an option has"
        )


def _is_name(name: str) -> bool:
    """Whether it is made of what names are; vowel signs, as in Hindi and Thai, are marks on letters."""
    kinds = ["L" if one.isalnum() else "-" if one in "_-" else unicodedata.category(one) for one in name]
    return "L" in kinds and {*kinds} <= {"L", "-", "Mn", "Mc"} and kinds[0] not in ("Mn", "Mc") and not name.startswith("-")
