"""Curve files, `file = "damper.csv"` in `[curves]` or `[actuators]`: the table replaces the name when a vehicle file is read.

So a vehicle that was read needs no other files, as with laws and families. Two formats are known: CSV, whose header names
quantity and unit of each column, `velocity [mm/s], force [kN]`; and the damper property files, `.dpr`, of Adams/Car, in the
TeimOrbit
format: blocks in brackets, tables under a row of names in braces, comments from `$` or `!` on, units in `[UNITS]`, the table in
`[CURVE]` (MSC Software, Adams Tire help, "About tire property files"; Altair MotionView help, READ_T_O_START_TABLE_READ).
"""

import itertools
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from models.common.errors import InputError, listing, quoted
from models.common.files import origin, reading
from models.common.table import find_table
from models.common.toml_edit import Replacement
from models.common.units import FORCE, LENGTH, TIME, VELOCITY, unit_named

GIVE = "give a .csv file with a header such as velocity [m/s], force [N], or a .dpr file"
UNITS: Mapping[str, Mapping[str, float]] = {"velocity": VELOCITY, "deflection": LENGTH, "force": FORCE}
BLOCK = re.compile(r"^\[\s*([^\]]+?)\s*\]$")


def curve_tables(data: Mapping[str, Any], folder: Path) -> Iterator[Replacement]:
    """Yields the tables of a vehicle file's curves that name files.

    Args:
        data: tables of the vehicle file.
        folder: its folder, to which its paths are relative.

    Raises:
        InputError: a file is missing, or does not contain a curve; the message names it.
    """
    for path, entry in _with_files({name: data.get(name) for name in ("curves", "actuators")}, ()):
        try:
            table, comment, file = _read(entry, folder, _argument(path))
        except InputError as error:
            raise InputError(f"[{'.'.join(path[:-1])}] {path[-1]}: {error}") from error
        yield Replacement((*path, "file"), table, comment, file)


def _with_files(tables: Mapping[str, Any], path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Mapping[str, Any]]]:
    """Yields the tables below a path that name files, each with its own path."""
    for name, entry in tables.items():
        if isinstance(entry, dict) and "file" in entry:
            yield (*path, name), entry
        elif isinstance(entry, dict):
            yield from _with_files(entry, (*path, name))


def _argument(path: tuple[str, ...]) -> str:
    """Returns the quantity over which an entry's force is; empty for a parameter of an own name."""
    if path[0] == "actuators" or "damping" in path[-1]:
        return "velocity"
    return "deflection" if "stiffness" in path[-1] else ""


def _read(entry: Mapping[str, Any], folder: Path, over: str) -> tuple[dict[str, Any], str, Path]:
    """Returns the table of a file, as TOML has it; a comment with its source; and the file.

    Args:
        over: "velocity" or "deflection", which the file must have; empty for any.
    """
    file = entry["file"]
    if not isinstance(file, str) or not file:
        raise InputError(f"file = {quoted(file)} is not the name of a file; {GIVE}")
    if others := [key for key in ("velocity", "deflection", "force") if key in entry]:
        raise InputError(f"has a file and {listing(others)}; a file has the whole table, so omit one of them")
    path = folder / file
    with reading(path, "curve", GIVE):
        content = path.read_bytes()
        text = content.decode("utf-8-sig").replace("\r\n", "\n")
        table = _of_dpr(text) if file.lower().endswith(".dpr") else _of_csv(text)
        if over and over not in table:
            raise InputError(f"has the columns {listing(table)}; give {over} and force")
    return table, origin(file, content), path


def _of_csv(text: str) -> dict[str, list[float]]:
    """Returns columns by their headings, in SI units."""
    table = find_table(text, GIVE)
    headings = table.headings(VELOCITY | LENGTH | FORCE)
    names = table.names(headings, UNITS)
    if len(names) != 2 or "force" not in names:
        raise InputError(f"has the columns {', '.join(names)}; give two, force and either velocity or deflection")
    scales = [heading.scale(UNITS[name]) for heading, name in zip(headings, names, strict=True)]
    return dict(zip(names, (table.numbers()[0] * scales).T.tolist(), strict=True))


def _of_dpr(text: str) -> dict[str, list[float]]:
    """Returns the table of a damper property file, in SI units."""
    blocks: dict[str, list[str]] = {}
    lines = [re.split(r"[$!]", line, maxsplit=1)[0].strip() for line in text.replace("\r", "\n").split("\n")]
    inside: list[str] = []
    for i, line in enumerate(lines):
        if block := BLOCK.match(line):
            inside = blocks.setdefault(block[1].upper(), [])
        elif line:
            inside.append(line)
        if inside is not blocks.get("CURVE") or block or line.startswith("{"):
            lines[i] = ""  # only the numbers remain, a row in each line
    for name in ("UNITS", "CURVE"):
        if name not in blocks:
            raise InputError(f"has no block [{name}]; a damper property file has [UNITS] and [CURVE]")
    units = _units(blocks["UNITS"])
    length, force, time = (_unit(units, key, known) for key, known in (("LENGTH", LENGTH), ("FORCE", FORCE), ("TIME", TIME)))
    heads = [line for line in blocks["CURVE"] if line.startswith("{")]
    if len(heads) != 1:
        raise InputError(f"has {len(heads)} tables in [CURVE]; give one, under {{ vel force }}")
    names = [re.sub(r"<.*", "", name).lower() for name in heads[0].strip("{} ").split()]
    if names not in (["vel", "force"], ["velocity", "force"]):
        raise InputError(f"has a table of {', '.join(names) or 'nothing'} in [CURVE]; give one of vel and force")
    table = find_table("\n".join(lines), "give two numbers, velocity and force")
    v, forces = (table.numbers((0, 1))[0] * [length / time, force]).T.tolist()
    return {"velocity": v, "force": forces}


def _units(lines: list[str]) -> dict[str, str]:
    """Returns the units of a block, given as `KEY = 'unit'`, or as a table."""
    units = {key.strip().upper(): value.strip(" '\"") for key, _, value in (line.partition("=") for line in lines) if value}
    for head, row in itertools.pairwise(lines):
        if head.startswith("{"):
            units = dict(zip(head.strip("{} ").upper().split(), row.replace("'", " ").split(), strict=False)) | units
            break
    return units


def _unit(units: Mapping[str, str], key: str, known: Mapping[str, float]) -> float:
    if key not in units:
        raise InputError(f"[UNITS] has no {key}; give one of {listing(known)}")
    if unit_named(units[key]) not in known:
        raise InputError(f"[UNITS] has {key} = {quoted(units[key])}; give one of {listing(known)}")
    return known[unit_named(units[key])]
