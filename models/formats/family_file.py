"""A family of vehicles in a file of its own, `family = "fleet.csv"` in a controller's section: its members in place of its name.

Of a TOML file its `family`, as a section would have it; of a CSV file a vehicle for every row, whose header names parameters and
whose numbers are factors on them. So a vehicle file is whole once it is read, as with laws.
"""

import csv
import io
import json
import re
from pathlib import Path
from typing import Any

from models.common.errors import InputError, quoted
from models.common.read_file import read_content
from models.common.toml import parse_toml
from models.formats.in_place import controllers_of, in_place_of

KEY = "family"
GIVE = "give a .toml file with family = [{ ... }, ...], or a .csv file whose header names parameters"


def with_families(text: str, folder: Path) -> tuple[str, tuple[Path, ...]]:
    """A vehicle file's text with families in place of the files that it names for them, and those files.

    Args:
        text: TOML.
        folder: where the vehicle file lies, from which its paths go.

    Raises:
        InputError: it is not TOML, or a file is not there, or holds no family; the message names it.
    """
    if not re.search(rf"\b{KEY}\b", text):
        return text, ()
    asked = {
        name: entry[KEY]
        for name, entry in controllers_of(text).items()
        if isinstance(entry, dict) and isinstance(entry.get(KEY), str)
    }
    if not asked:
        return text, ()
    given, families, files = {}, {}, []
    for name, file in asked.items():
        try:
            families[name], comment = _read(file, folder)
        except InputError as error:
            raise InputError(f"[controllers.{name}] {error}") from error
        given[name] = f"{comment}\n{KEY} = [{', '.join(map(_table, families[name]))}]"
        files.append(folder / file)
    whole = in_place_of(text, KEY, given)
    for name, family in families.items():
        if repr(controllers_of(whole)[name].get(KEY)) != repr(family):  # NaN is not NaN; it is refused where a member is read
            raise InputError(f'[controllers.{name}] its {KEY} is not named on a line of its own; write {KEY} = "NAME.csv" on one')
    return whole, tuple(files)


def _read(file: str, folder: Path) -> tuple[list[dict[str, Any]], str]:
    """The members of a file, and a comment that says where they are from."""
    path = folder / file
    family, said = read_content(path, KEY, GIVE, _of_toml if path.suffix.lower() == ".toml" else _of_csv)
    return family, f"# from {file!a}, {said}"


def _of_toml(text: str) -> list[dict[str, Any]]:
    found = parse_toml(text)
    family = found.get(KEY)
    if set(found) != {KEY} or not isinstance(family, list) or not all(isinstance(member, dict) for member in family):
        raise InputError(f"holds no {KEY} alone; {GIVE}")
    return family


def _of_csv(text: str) -> list[dict[str, Any]]:
    try:  # lines may end as on any system, old Macs too
        rows = [row for row in csv.reader(io.StringIO(text, newline=None)) if any(cell.strip() for cell in row)]
    except csv.Error as error:
        raise InputError(f"is no table ({error}); {GIVE}") from error
    if len(rows) < 2:
        raise InputError(f"has {len(rows)} row(s) and no vehicle below a header; {GIVE}")
    names = [name.strip() for name in rows[0]]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"has {quoted(name)} as the name of {names.count(name)} columns; give a column for each parameter")
    family = []
    for number, row in enumerate(rows[1:], 2):
        if len(row) != len(names):
            raise InputError(f"row {number} has {len(row)} numbers, and the header {len(names)} names; give as many")
        try:
            family.append({name: float(cell) for name, cell in zip(names, row, strict=True)})
        except ValueError as error:
            raise InputError(f"row {number} is {quoted(row)}; give numbers, factors on the parameters") from error
    return family


def _table(member: dict[str, Any]) -> str:
    """A member on one line of TOML."""
    numbers = {name: repr(value) if isinstance(value, float) else json.dumps(value) for name, value in member.items()}  # NaN, too
    return "{ " + ", ".join(f"{json.dumps(name)} = {number}" for name, number in numbers.items()) + " }"
