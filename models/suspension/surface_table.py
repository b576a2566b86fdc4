"""Tables of a damper's force over velocity and deflection: of a vehicle file, and of a CSV file in two forms.

A sheet has deflections in its first row, velocities in its first column, and in its first cell the quantities with their units:
`velocity [mm/s] / deflection [mm] / force [N]`. A list has a column for each, and a row for each pair of velocity and deflection.
"""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.checks import check_keys, is_finite
from models.common.errors import InputError, listing, quoted
from models.common.quantities import QUANTITIES, Heading
from models.common.table import NumberTable, find_table
from models.common.units import unit_named, unit_size
from models.suspension.surface import ForceSurface, surface_of

NAMES = ("velocity", "deflection", "force")
LARGEST = {"velocity": (50.0, "m/s, not mm/s"), "deflection": (5.0, "m, not mm"), "force": (1e9, "N")}
NAMED = re.compile(r"([a-zA-Z_ ]+)[\[(]\s*([^\])]+?)\s*[\])]")  # a quantity with its unit
FIRST_CELL = "velocity [m/s] / deflection [m] / force [N]"
CLOSEST, ROUNDING = 1e-9, 1e-9  # of a range
MEASURED = 4  # pairs of velocity and deflection per row: a list with more is not a table
GIVE = "{ velocity = [...], deflection = [...], force = [[...], ...] }, a list of forces for each velocity"


def surface_from(entry: Mapping[str, Any]) -> ForceSurface:
    """Returns a damper's force over velocity and deflection from its table in a vehicle file.

    Raises:
        InputError: the entry is not such a table, or not one that a damper can have.
    """
    check_keys("", entry, NAMES)
    if absent := [name for name in NAMES if name not in entry]:
        raise InputError(f"{absent[0]} is missing; give {GIVE}")
    v, d = (_axis(entry[name], name) for name in NAMES[:2])
    rows = entry["force"] if isinstance(entry["force"], list) else []
    widths = sorted({len(row) if isinstance(row, list) else 1 for row in rows})
    if len(rows) != len(v) or widths != [len(d)]:
        raise InputError(
            f"force has {len(rows)} lists, of {listing(map(str, widths)) or 0} numbers; give {len(v)} lists, one for each "
            f"velocity, of {len(d)} numbers, one for each deflection"
        )
    table = np.array([_numbers(row, "force") for row in rows])
    if not v[0] < 0 < v[-1]:
        raise InputError(f"velocity goes from {v[0]:g} to {v[-1]:g} m/s; give both sides of rest, above 0 in extension")
    if not d[0] <= 0 <= d[-1]:
        raise InputError(f"deflection goes from {d[0]:g} to {d[-1]:g} m; give a range with equilibrium, deflection 0, in it")
    at_rest, largest = np.array([np.interp(0.0, v, column) for column in table.T]), float(np.abs(table).max())
    for j in np.flatnonzero(~(np.abs(at_rest) <= ROUNDING * largest))[:1]:
        raise InputError(
            f"its force at rest is {at_rest[j]:g} N at deflection {d[j]:g} m, but a damper's must be 0; subtract its gas force"
        )
    if 0.0 not in v:
        i = int(np.searchsorted(v, 0.0))
        v, table = np.insert(v, i, 0.0), np.insert(table, i, 0.0, axis=0)
    table[v == 0] = 0.0
    for i, j in np.argwhere(v[:, None] * table < 0)[:1]:
        raise InputError(
            f"its force at {v[i]:g} m/s and {d[j]:g} m is {table[i, j]:g} N: that feeds energy in, where a damper takes it; give "
            "forces of the velocity's sign, both positive where the suspension extends"
        )
    ends = np.diff(table, axis=0)[[0, -1]]
    for i, j in np.argwhere(ends < 0)[:1]:
        raise InputError(
            f"its force at deflection {d[j]:g} m falls beyond {v[-i]:g} m/s, as it goes on from there; end the table where "
            "it is level or rises"
        )
    return surface_of(v, d, table, f"{len(v)} velocities by {len(d)} deflections, at most {largest:g} N")


def _axis(given: Any, name: str) -> Array:
    """Returns the ascending values of velocity or deflection."""
    x = _numbers(given, name)
    for i in np.flatnonzero(~(np.diff(x) > CLOSEST * np.ptp(x)))[:1]:
        raise InputError(f"{name} goes from {x[i]:g} to {x[i + 1]:g} at point {i + 2}; sort the points, each once")
    return x


def _numbers(given: Any, name: str) -> Array:
    """Returns a list of at least two numbers as an array."""
    largest, unit = LARGEST[name]
    if not isinstance(given, list) or len(given) < 2:
        raise InputError(f"{name} = {quoted(given)} is not a list of two numbers or more; give {GIVE}")
    for value in given:
        if not is_finite(value) or abs(value) > largest:
            raise InputError(f"{name} has {quoted(value)}; give numbers up to {largest:g} {unit}")
    return np.array(given, dtype=float)


def surface_columns(text: str, give: str) -> dict[str, Any] | None:
    """Returns the table of a CSV file in SI units, positive in extension, sorted; None for another file, as of a measured loop.

    Args:
        give: required content of the file, for messages.

    Raises:
        InputError: a sheet has no units, or a list has not each pair once.
    """
    table = find_table(text, give)
    corner, across = _first_row(table)
    if across is None:
        headings = table.headings([QUANTITIES[name].si for name in NAMES])
    else:
        headings = [Heading(name.strip(), name.strip(), unit_named(unit)) for name, unit in NAMED.findall(corner)]
    of = {name: [one for one in headings if unit_size(one.unit, QUANTITIES[name].si)] for name in NAMES}
    if len(headings) != len(NAMES) or any(len(found) != 1 for found in of.values()):
        if across is None:
            return None
        raise InputError(f"its first cell is {quoted(corner)}; write the quantities with their units there: {FIRST_CELL}")
    scale = {name: found[0].scale(name) for name, found in of.items()}
    directions = {name: found[0].direction for name, found in of.items()}
    numbers = table.numbers()[0]
    if across is None:
        columns = {name: numbers[:, found[0].column - 1] for name, found in of.items()}
        (v, i), (d, j) = (np.unique(columns[name], return_inverse=True) for name in NAMES[:2])
        if len(v) * len(d) > MEASURED * len(numbers):
            return None
        force = np.full((len(v), len(d)), np.nan)
        force[i, j] = columns["force"]
        if len(numbers) != force.size or np.isnan(force).any():
            raise InputError(f"has {len(numbers)} rows for {len(v)} velocities and {len(d)} deflections; give each pair once")
    else:
        v, d, force = numbers[:, 0], across, numbers[:, 1:]
    for name in NAMES[:2]:
        if not (directions[name] or name in of[name][0].words):
            raise InputError(
                f"{quoted(of[name][0].text)} has no direction; write {name}, which is positive in extension, or compression"
            )
    along = -1 if min(directions["velocity"], directions["force"]) < 0 else 1
    v, d, force = along * scale["velocity"] * v, scale["deflection"] * d, along * scale["force"] * force
    d = -d if directions["deflection"] < 0 else d
    i, j = np.argsort(v, kind="stable"), np.argsort(d, kind="stable")
    return {name: (x + 0.0).tolist() for name, x in zip(NAMES, (v[i], d[j], force[np.ix_(i, j)]), strict=True)}  # no -0.0


def _first_row(table: NumberTable) -> tuple[str, Array | None]:
    """Returns the first cell of a sheet and the numbers behind it, of the line above the table; None for no sheet."""
    above = [line for line in table.lines[: table.first] if line.strip()]
    row = above[-1].rsplit(table.separator.strip(" ") or None, table.count - 1) if above else []
    cells = [cell.strip(' "') for cell in row]
    try:
        across = np.array([float(cell if "." in cell else cell.replace(",", ".")) for cell in cells[1:]])
    except ValueError:
        return "", None
    return (cells[0], across) if len(across) == table.count - 1 and len(across) > 1 else ("", None)
