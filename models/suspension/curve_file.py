"""Curve files, `file = "damper.csv"` in `[curves]` or `[actuators]`: the table replaces the name when a vehicle file is read.

So a vehicle that was read needs no other files, as with laws and families. Two formats are known: CSV, whose header names
quantity and unit of each column, `velocity [mm/s], force [kN]`; and the damper property files, `.dpr`, of Adams/Car, in the
TeimOrbit
format: blocks in brackets, tables under a row of names in braces, comments from `$` or `!` on, units in `[UNITS]`, the table in
`[CURVE]` (MSC Software, Adams Tire help, "About tire property files"; Altair MotionView help, READ_T_O_START_TABLE_READ).
"""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from models.common.errors import InputError, listing, quoted
from models.common.files import TEXT, origin, parse_toml, read_content
from models.common.quantities import QUANTITIES
from models.common.table import find_table
from models.common.units import unit_size

GIVE = "give a .csv file with a header such as velocity [m/s], force [N], or a .dpr file"
BLOCK = re.compile(r"^\s*\[\s*([^\]]+?)\s*\]\s*$(.*?)(?=^\s*\[|\Z)", re.M | re.S)
HEAD = re.compile(r"\{(.*?)\}")


def with_tables(text: str, folder: Path) -> tuple[str, tuple[Path, ...]]:
    """Returns a vehicle file's text with tables in place of its curve files, and those files.

    Args:
        folder: folder of the vehicle file, to which its paths are relative.

    Raises:
        InputError: the text is not TOML, or a file is missing, or holds no curve; the message names it.
    """
    files = []
    for path, entry in _asked(parse_toml(text)):
        try:
            table, comment, file = _read(entry, folder, _argument(path))
        except InputError as error:
            raise InputError(f"{_words(path)}: {error}") from error
        files.append(file)
        text = _in_place(text, path, entry, table, comment)
    if len(text.encode()) > TEXT:
        raise InputError("with the tables of its files it is too large; thin them")
    return text, tuple(files)


def _asked(data: Mapping[str, Any]) -> list[tuple[tuple[str, ...], Mapping[str, Any]]]:
    """Returns the entries that name files, each with its keys: curves, and limits of all dampers, or of single ones."""
    file_entries: list[tuple[tuple[str, ...], Mapping[str, Any]]] = []
    for section in ("curves", "actuators"):
        entries = data.get(section)
        for name, entry in entries.items() if isinstance(entries, dict) else ():
            if not isinstance(entry, dict):
                continue
            if "file" in entry:
                file_entries.append(((section, name), entry))
            elif section == "actuators":
                inner = {key: value for key, value in entry.items() if isinstance(value, dict) and "file" in value}
                file_entries += [((section, name, key), value) for key, value in inner.items()]
    return file_entries


def _words(path: tuple[str, ...]) -> str:
    """Names an entry, for messages."""
    return f"[{'.'.join(path[:-1])}] {path[-1]}"


def _argument(path: tuple[str, ...]) -> str:
    """Returns the quantity over which an entry's force is; empty for a parameter of an own name."""
    if path[0] == "actuators" or "damping" in path[-1]:
        return "velocity"
    return "deflection" if "stiffness" in path[-1] else ""


def _changed(data: Mapping[str, Any], path: tuple[str, ...], value: Any) -> dict[str, Any]:
    """Returns a copy of nested tables with another value at a path of keys."""
    first, *rest = path
    return {**data, first: _changed(data[first], tuple(rest), value) if rest else value}


def _in_place(text: str, path: tuple[str, ...], entry: Mapping[str, Any], table: Mapping[str, Any], comment: str) -> str:
    """Returns the text with a table in place of a file, which a line of its own must name."""
    name, before = path[-1], parse_toml(text)
    whole = {key: value for key, value in entry.items() if key != "file"} | dict(table)
    after = _changed(before, path, whole)
    lines = [f"{key} = {json.dumps(value)}" for key, value in table.items()]
    others = [f"{key} = {json.dumps(value)}" for key, value in entry.items() if key != "file"]
    inline, own = f"{comment}\n{name} = {{ {', '.join([*lines, *others])} }}", "\n".join([comment, *lines])
    for key, instead in ((name, inline), ("file", own)):
        for line in re.finditer(rf"^[ \t]*{re.escape(key)}[ \t]*=[^\n]*$", text, re.M):
            changed = text[: line.start()] + instead + text[line.end() :]
            try:
                if parse_toml(changed) == after:
                    return changed
            except InputError:
                continue
    raise InputError(f'{_words(path)}: its file is not named on a line of its own; write {name} = {{ file = "NAME.csv" }} on one')


def _read(entry: Mapping[str, Any], folder: Path, over: str) -> tuple[dict[str, Any], str, Path]:
    """Returns the table of a file, a comment with its source, and the file.

    Args:
        over: "velocity" or "deflection", which the file must have; empty for any.
    """
    file = entry["file"]
    if not isinstance(file, str) or not file:
        raise InputError(f"file = {quoted(file)} is no file's name; {GIVE}")
    if beside := [key for key in ("velocity", "deflection", "force") if key in entry]:
        raise InputError(f"has a file and {listing(beside)}; a file is whole by itself, so leave one out")
    path = folder / file
    table, content = read_content(path, "curve", TEXT, GIVE, _of_dpr if path.suffix.lower() == ".dpr" else _of_csv)
    if over and over not in table:
        raise InputError(f"curve {path}: has the columns {listing(table)}; give {over} and force")
    return table, origin(file, content), path


def _of_csv(text: str) -> dict[str, list[float]]:
    """Returns columns by their headings, in SI units."""
    table = find_table(text, GIVE)
    columns = table.quantities(("velocity", "deflection", "force"))
    if len(columns) != 2 or "force" not in columns:
        raise InputError(f"has the columns {', '.join(columns)}; give two, force and either velocity or deflection")
    return {name: column.tolist() for name, column in columns.items()}


def _of_dpr(text: str) -> dict[str, list[float]]:
    """Returns the table of a damper property file, in SI units."""
    text = re.sub(r"[$!].*", "", text)
    before = {block[1].upper(): text[: block.start(2)].count("\n") for block in BLOCK.finditer(text)}  # lines before a block
    blocks = {block[1].upper(): block[2] for block in BLOCK.finditer(text)}
    for name in ("UNITS", "CURVE"):
        if name not in blocks:
            raise InputError(f"has no block [{name}]; a damper property file has [UNITS] and [CURVE]")
    units = {key.upper(): unit.strip() for key, unit in re.findall(r"""(\w+)\s*=\s*['"]?([^'"\n]+)""", blocks["UNITS"])}
    if below := re.search(r"\{(.*?)\}\s*(.*)", blocks["UNITS"]):  # the units are in a table, too
        units |= dict(zip(below[1].upper().split(), below[2].replace("'", " ").split(), strict=False))
    length, force, time = (
        _size(units, key, name) for key, name in (("LENGTH", "distance"), ("FORCE", "force"), ("TIME", "time"))
    )
    heads = HEAD.findall(blocks["CURVE"])
    if len(heads) != 1:
        raise InputError(f"has {len(heads)} tables in [CURVE]; give one, under {{ vel force }}")
    names = re.sub(r"<[^>]*>", "", heads[0]).lower().split()
    if names not in (["vel", "force"], ["velocity", "force"]):
        raise InputError(f"has a table of {', '.join(names) or 'nothing'} in [CURVE]; give one of vel and force")
    rows = "\n" * before["CURVE"] + HEAD.sub("", blocks["CURVE"])
    numbers, _ = find_table(rows, "give two numbers, velocity and force").numbers((0, 1))
    v, forces = (numbers * [length / time, force]).T.tolist()
    return {"velocity": v, "force": forces}


def _size(units: Mapping[str, str], key: str, name: str) -> float:
    """Returns the size of a unit of `[UNITS]` in SI, of the dimension of a quantity."""
    allowed = listing(QUANTITIES[name].units)
    if key not in units:
        raise InputError(f"[UNITS] has no {key}; give one of {allowed}")
    size = unit_size(units[key], QUANTITIES[name].si)
    if size is None:
        raise InputError(f"[UNITS] has {key} = {quoted(units[key])}; give one of {allowed}")
    return size
