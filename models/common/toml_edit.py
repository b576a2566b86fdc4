"""Functions that change a user's TOML text but keep comments, order and blank lines, and functions that write new sections."""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import getitem
from pathlib import Path
from typing import Any

from models.common.errors import InputError, list_names
from models.common.files import parse_toml


@dataclass(frozen=True)
class Replacement:
    """Replacement of one key in a TOML text by several keys with values.

    Attributes:
        path: names of the sections that contain the key, from the outermost, and the name of the key itself.
        values: the new keys with their values.
        comment: comment on the line above the new keys; empty for no comment.
        files: paths of the files from which the values were read.
    """

    path: tuple[str, ...]
    values: Mapping[str, Any]
    comment: str = ""
    files: tuple[Path, ...] = ()


def with_replacements(text: str, replacements: Sequence[Replacement]) -> str:
    """Returns a TOML text in which some keys are replaced. A comment on the line of a replaced key stays on the line of the
    first new key.

    Raises:
        InputError: the text is not TOML, or the changed text would not contain exactly the expected values.
    """
    if not replacements:
        return text
    expected = parse_toml(text)
    for replacement in replacements:
        *sections, key = replacement.path
        table = reduce(getitem, sections, expected)
        table.pop(key)
        table.update(replacement.values)
    cause: Exception | None = None
    try:
        changed = _replace_texts(text, replacements)
        if _normal(parse_toml(changed)) == _normal(expected):
            return changed
    except Exception as error:  # the resulting text shows that tomlkit has read or written the file incorrectly
        cause = error
    names = list_names(".".join(replacement.path) for replacement in replacements)
    raise InputError(
        f"Roadproof cannot replace {names} in the file as these keys are written now; write each key on its own line "
        "below its [section]"
    ) from cause


def _replace_texts(text: str, replacements: Sequence[Replacement]) -> str:
    import tomlkit
    from tomlkit.items import Comment, Float, SingleKey, Trivia

    document = tomlkit.parse(text)
    for replacement in replacements:
        (body, i), (outer, line) = _place(document.body, replacement.path)
        place, written = body[i][1].trivia, {key: toml_value(value) for key, value in replacement.values.items()}
        if outer is not body:  # the text of an inline table's first item also contains all other items
            name, *others = written
            written = {name: ", ".join([written[name], *(f"{_key(key)} = {written[key]}" for key in others)])}
        # tomlkit would take seconds to create the items of large matrices. A number whose text is the whole value takes almost
        # no time.
        new = [(SingleKey(key), Float(0.0, Trivia(place.indent, trail="\n"), value)) for key, value in written.items()]
        first, last = new[0][1].trivia, new[-1][1].trivia
        first.comment_ws, first.comment, last.trail = place.comment_ws, place.comment, place.trail
        body[i : i + 1] = new
        if replacement.comment:
            outer.insert(line, (None, Comment(Trivia(outer[line][1].trivia.indent, comment=replacement.comment))))
    return document.as_string()


def _place(body: list[Any], path: tuple[str, ...], line: Any = None) -> Any:
    """Returns the place of a key in a tomlkit document.

    Args:
        body: body of the document or of a table.
        path: names of the sections of the key, and of the key itself.
        line: place of the item whose line contains the whole body; None if every item of the body has its own line.

    Returns:
        Two places, each given by a body and an index: the place of the key, and that of the item on whose line the key is.
    """
    from tomlkit.items import InlineTable

    name, *rest = path
    for i, (key, item) in enumerate(body):
        if key is not None and key.key == name:
            if not rest:
                return (body, i), line or (body, i)
            outer = line or ((body, i) if isinstance(item, InlineTable) else None)
            if found := _place(item.value.body, tuple(rest), outer):
                return found
    return None


def _normal(value: Any) -> str:
    """Returns a text that is equal for equal tables, independent of the order of their keys. All NaN values count as equal."""
    return json.dumps(value, sort_keys=True, default=str)


def section_lines(path: Sequence[str], values: Mapping[str, Any], comment: str = "") -> list[str]:
    """Returns a section as lines of TOML.

    Args:
        path: names of the sections that contain the section, and its own name.
        values: keys of the section with their values.
        comment: comment after the name of the section.
    """
    name = ".".join(map(_key, path))
    return [f"[{name}]    {comment}".rstrip(), *(f"{_key(key)} = {toml_value(value)}" for key, value in values.items())]


def toml_value(value: Any) -> str:
    """Returns a number, text, list or mapping as one line of TOML."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(key)} = {toml_value(item)}" for key, item in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml_value, value)) + "]"
    if isinstance(value, float):
        return float.__repr__(value)
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else toml_value(name)
