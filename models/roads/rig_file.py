"""Drive files of test rigs as text: a column of time, and a column of heights for each wheel.

The heading of a column gives its name and unit. The binary format RPC III of MTS is not supported, because the public reader
(rpc-reader 0.9 of 2022) reads big-endian files incorrectly.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from models.common.errors import InputError
from models.common.files import reading
from models.common.schema import Choice, Section
from models.common.table import find_table, table_text
from models.common.units import LENGTH, TIME
from models.roads.rig import Rig, check_history, check_posts

FORMAT = "give a line of headings such as: time [s], front_left [mm], front_right [mm], and below it one line for each time"


@dataclass(frozen=True)
class RigSettings(Section):
    """Settings for reading a drive file whose headings have no units."""

    time_unit: Annotated[str, Choice("unit of time", tuple(TIME))] = ""
    height_unit: Annotated[str, Choice("unit of all heights", tuple(LENGTH))] = ""


def read_rig(path: Path, settings: RigSettings) -> Rig:
    """Reads a rig from a text file.

    Args:
        path: path of the drive file.
        settings: units for headings without a unit.

    Raises:
        InputError: the file cannot be read, a heading or a line of the file is wrong, or the heights are not valid. The message
            gives the file and the line.
    """
    with reading(path, "drive file", FORMAT):
        table = find_table(table_text(path), FORMAT)
        headings = table.headings(("s", "m"))
        clocks = [heading for heading in headings if heading.quantity == "time"]
        if len(clocks) != 1:
            raise InputError(f"{len(clocks)} columns are called time, but exactly one column of times is needed; {FORMAT}")
        posts = [heading for heading in headings if heading is not clocks[0]]
        check_posts([post.name for post in posts])
        scales = [clocks[0].scale("time", "time_unit", settings.time_unit)]
        scales += [post.scale("height", "height_unit", settings.height_unit) for post in posts]
        numbers, lines = table.numbers([heading.column - 1 for heading in (*clocks, *posts)])
        time, *heights = (numbers * scales).T
        check_history(time, np.stack(heights, axis=-1), lambda i: f"line {lines[i]}")
        return Rig(time, np.stack(heights, axis=-1), tuple(post.name for post in posts), str(path))
