"""Curve files, `file = "damper.csv"` in `[curves]` or `[actuators]`: the table replaces the name when a vehicle file is read.

So a vehicle that was read needs no other files, as with laws and families. Two formats are known: CSV, whose header names
quantity and unit of each column, `velocity [mm/s], force [kN]`; and the damper property files, `.dpr`, of Adams/Car, in the
TeimOrbit format: blocks in brackets, tables under a row of names in braces, comments from `$` or `!` on, units in `[UNITS]`, the
table in `[CURVE]` (MSC Software, Adams Tire help, "About tire property files"; Altair MotionView help,
READ_T_O_START_TABLE_READ).
"""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from models.common.errors import InputError, listing, quoted
from models.common.files import origin, reading
from models.common.quantities import QUANTITIES, Heading
from models.common.table import NumberTable, find_table, table_text
from models.common.toml_edit import Replacement
from models.common.units import unit_size
from models.suspension.surface_table import surface_columns

GIVE = "give a .csv file with a header such as velocity [m/s], force [N], or a .dpr file"
BLOCK = re.compile(r"^\s*\[\s*([^\]]+?)\s*\]\s*$(.*?)(?=^\s*\[|\Z)", re.M | re.S)
HEAD = re.compile(r"\{(.*?)\}")


def curve_tables(data: Mapping[str, Any], folder: Path) -> Iterator[Replacement]:
    """Yields the tables of a vehicle file's curves that name files.

    Args:
        data: tables of the vehicle file.
        folder: folder of the file, to which its paths are relative.

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
    """Returns the table of a file, a comment with its source, and the file.

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
        text = table_text(path)
        table = _of_dpr(text) if file.lower().endswith(".dpr") else surface_columns(text, GIVE) or _of_csv(text)
        if over and over not in table:
            raise InputError(f"has the columns {listing(table)}; give {over} and force")
    return table, origin(file, content), path


def _of_csv(text: str) -> dict[str, list[float]]:
    """Returns columns by their headings, in SI units."""
    table = find_table(text, GIVE)
    if (sided := _by_side(table)) is not None:
        return sided
    columns = table.quantities(("velocity", "deflection", "force"))
    if len(columns) != 2 or "force" not in columns:
        raise InputError(f"has the columns {', '.join(columns)}; give two, force and either velocity or deflection")
    return {name: column.tolist() for name, column in columns.items()}


def _by_side(table: NumberTable) -> dict[str, list[float]] | None:
    """Returns a table whose headings name compression or extension, in SI units and positive in extension; None for others.

    The sheet of a damper dynamometer has speeds, and forces in compression and in rebound: F(v) is the rebound force at v, and
    F(-v) is minus the compression force. In a table over compression, both columns change sign.
    """
    headings = table.headings([QUANTITIES[name].si for name in ("velocity", "deflection", "force")])
    forces = [bool(unit_size(heading.unit, "N")) for heading in headings]
    sides = [_side(heading) for heading in headings]
    if not any(sides) or len(headings) not in (2, 3):
        return None
    numbers, argument = table.numbers()[0], forces.index(False) if False in forces else 0
    over = "velocity" if unit_size(headings[argument].unit, "m/s") else "deflection"
    values = numbers * [one.scale("force" if is_force else over) for one, is_force in zip(headings, forces, strict=True)]
    if len(headings) == 2 and forces.count(True) == 1:
        sign = sides[argument] or sides[1 - argument]
        x, force = sign * values.T[[argument, 1 - argument]]
        order = np.argsort(x, kind="stable")
        return {over: x[order].tolist(), "force": force[order].tolist()}
    if forces.count(True) != 2 or sorted(side for side, is_force in zip(sides, forces, strict=True) if is_force) != [-1, 1]:
        return None
    speed, rebound, compression = (values[:, i] for i in (argument, sides.index(1), sides.index(-1)))
    if (speed < 0).any():
        raise InputError("has a speed below 0; give speeds from 0 on, with the forces in compression and in rebound")
    moving = speed > 0
    v = np.concatenate([-speed[moving][::-1], [0.0], speed[moving]])
    return {
        over: v.tolist(),
        "force": np.concatenate([-np.abs(compression[moving])[::-1], [0.0], np.abs(rebound[moving])]).tolist(),
    }


def _side(heading: Heading) -> int:
    """Returns -1 for a heading that names compression, 1 for one that names extension, and 0 for others."""
    words = set(re.findall(r"[a-z]+", heading.name.lower()))
    return -1 if words & {"compression", "bump", "jounce"} else int(bool(words & {"extension", "rebound", "droop"}))


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
