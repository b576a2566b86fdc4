"""The one door for TOML: no text of a few kilobytes may take minutes or gigabytes to parse."""

import re
import tomllib
from typing import Any

from models.common.errors import InputError

MOST_DOTS = 8  # within one key; tomllib takes their square in time and memory, 4 MiB of such keys seconds; ours have two
# What may hold dots and is no key. What is not closed ends with its line, or the text: every text is read through once.
_NO_KEY = re.compile(
    r"""\#[^\n]*
    | \"{3} (?: [^"\\] | \\. | \"{1,2}(?!\") )*+ \"{0,5}
    | '{3} (?: [^'] | '{1,2}(?!') )*+ '{0,5}
    | " (?: [^"\\\n] | \\[^\n] )*+ "?
    | ' [^'\n]*+ '?""",
    re.VERBOSE | re.DOTALL,
)


def parse_toml(text: str) -> dict[str, Any]:
    """The tables of a TOML text.

    Raises:
        InputError: it is not TOML, or a key has more than `MOST_DOTS` dots.
    """
    keys = re.split(r"[,=\n{}\[\]]", _NO_KEY.sub("''", text))  # and unquoted values, which have one dot
    dots = max(key.count(".") for key in keys)
    if dots > MOST_DOTS:
        raise InputError(f"a key has {dots} dots, and at most {MOST_DOTS} are allowed; name a section's key by its own name")
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # not TOML; a number of 5000 digits; brackets in brackets in ...
        raise InputError(f"not TOML: {error}") from error
