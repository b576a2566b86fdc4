"""What a file holds, in place of its name: lines of a vehicle file that name one, exchanged for its content."""

import re
from collections.abc import Mapping
from typing import Any

from models.common.errors import InputError
from models.common.toml import parse_toml


def controllers_of(text: str) -> dict[str, Any]:
    """`[controllers]` of a vehicle file's text; empty where there is none.

    Raises:
        InputError: it is not TOML.
    """
    sections = parse_toml(text).get("controllers")
    return sections if isinstance(sections, dict) else {}


def in_place_of(text: str, key: str, given: Mapping[str, str]) -> str:
    """A vehicle file's text with other lines in place of those that give a key a file's name.

    Where a key stands on no line of its own the text stays as it is there: whoever asks has to look at what it says.

    Args:
        text: TOML.
        key: of the sections of controllers.
        given: what stands there instead, by controller.
    """
    line = re.compile(rf"^[ \t]*{key}[ \t]*=[^\n]*$", re.M)
    # Each such line says where it stands, once; so the parser says which is whose.
    lines = {str(found.start()): found for found in line.finditer(text)}
    try:
        marked = controllers_of(line.sub(lambda found: f'{key} = "{found.start()}"', text))
    except InputError:
        marked = {}
    place = {name: str(marked.get(name, {}).get(key)) for name in given}
    for name in sorted(given, key=lambda name: -int(place[name]) if place[name] in lines else 0):
        if place[name] in lines:
            start, end = lines[place[name]].span()
            text = text[:start] + given[name] + text[end:]
    return text
