"""CSV files with a table of a damper's force against velocity and deflection, in one of two forms: a sheet or a list.

A sheet has deflections in its first row and velocities in its first column. The first cell of a sheet contains the quantities
and units: `velocity [mm/s] / deflection [mm] / force [N]`. A list has a column for each quantity, and a row for each pair of
velocity and deflection.
"""

import re
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, short_repr
from models.common.quantities import QUANTITIES, Heading
from models.common.table import NumberTable, find_table
from models.common.units import unit_named, unit_size

NAMES = ("velocity", "deflection", "force")
# Pattern of a quantity that is followed by its unit
QUANTITY_WITH_UNIT = re.compile(r"([a-zA-Z_ ]+)[\[(]\s*([^\])]+?)\s*[\])]")
FIRST_CELL = "velocity [m/s] / deflection [m] / force [N]"
# A list is read as a table of this type only if its grid has at most this many cells per row of the list. In a larger grid
# (number of velocities times number of deflections), too many cells would be empty
PAIRS_PER_ROW = 4


def surface_columns(text: str, give: str) -> dict[str, Any] | None:
    """Returns the table of a CSV file, sorted and in SI units. Velocities and deflections are positive in extension.

    Returns None for a file in neither of the two forms, such as a measured loop.

    Args:
        text: content of the file.
        give: description of the content that the file must have, for messages.

    Raises:
        InputError: a sheet has no units, or a list does not contain each pair of velocity and deflection exactly once.
    """
    table = find_table(text, give)
    corner, across = _first_row(table)
    if across is None:
        headings = table.headings([QUANTITIES[name].si for name in NAMES])
    else:
        headings = [Heading(name.strip(), name.strip(), unit_named(unit)) for name, unit in QUANTITY_WITH_UNIT.findall(corner)]
    of = {name: [one for one in headings if unit_size(one.unit, QUANTITIES[name].si)] for name in NAMES}
    if len(headings) != len(NAMES) or any(len(found) != 1 for found in of.values()):
        if across is None:
            return None
        raise InputError(
            f"its first cell is {short_repr(corner)}, but it must contain the quantities with their units; write in "
            f"this cell: {FIRST_CELL}"
        )
    scale = {name: found[0].scale(name) for name, found in of.items()}
    directions = {name: found[0].direction for name, found in of.items()}
    numbers = table.numbers()[0]
    if across is None:
        columns = {name: numbers[:, found[0].column - 1] for name, found in of.items()}
        (v, i), (d, j) = (np.unique(columns[name], return_inverse=True) for name in NAMES[:2])
        if len(v) * len(d) > PAIRS_PER_ROW * len(numbers):
            return None
        force = np.full((len(v), len(d)), np.nan)
        force[i, j] = columns["force"]
        if len(numbers) != force.size or np.isnan(force).any():
            raise InputError(
                f"has {len(numbers)} rows for {len(v)} velocities and {len(d)} deflections; give one row for each pair of "
                "velocity and deflection"
            )
    else:
        v, d, force = numbers[:, 0], across, numbers[:, 1:]
    for name in NAMES[:2]:
        if not (directions[name] or name in of[name][0].words):
            raise InputError(
                f"{short_repr(of[name][0].text)} does not state the positive direction; write {name} in this heading "
                "if extension is positive, or compression if compression is positive"
            )
    along = -1 if min(directions["velocity"], directions["force"]) < 0 else 1
    v, d, force = along * scale["velocity"] * v, scale["deflection"] * d, along * scale["force"] * force
    d = -d if directions["deflection"] < 0 else d
    i, j = np.argsort(v, kind="stable"), np.argsort(d, kind="stable")
    # Adding 0.0 turns -0.0 into 0.0
    return {name: (x + 0.0).tolist() for name, x in zip(NAMES, (v[i], d[j], force[np.ix_(i, j)]), strict=True)}


def _first_row(table: NumberTable) -> tuple[str, Array | None]:
    """Returns the first cell of a sheet, and the numbers in the rest of the first row; None for a file that is not a sheet."""
    above = [line for line in table.lines[: table.first] if line.strip()]
    row = above[-1].rsplit(table.separator.strip(" ") or None, table.count - 1) if above else []
    cells = [cell.strip(' "') for cell in row]
    try:
        across = np.array([float(cell if "." in cell else cell.replace(",", ".")) for cell in cells[1:]])
    except ValueError:
        return "", None
    return (cells[0], across) if len(across) == table.count - 1 and len(across) > 1 else ("", None)
