"""Drive files of rigs as text: a column of time, and one of heights for each wheel, named and with its unit above it.

MTS's binary RPC III is not read: the public reader, rpc-reader 0.9 of 2022, reads files of big-endian machines wrongly.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from models.common.errors import InputError
from models.common.files import reading
from models.common.quantities import check_unit_options
from models.common.table import find_table
from models.roads.rig import Rig, check_history, check_posts

FORMAT = "give a line of headings such as: time [s], front_left [mm], front_right [mm], and below it one line for each time"
UNITS = {"time_unit": "time", "height_unit": "height"}  # settings for headings without a unit


def read_rig(path: Path, settings: Mapping[str, str]) -> Rig:
    """Reads a rig from a text file.

    Args:
        settings: `time_unit` and `height_unit`, for headings without a unit.

    Raises:
        InputError: the file cannot be read, a heading or a line is wrong, or they make no histories. It names file and line.
    """
    check_unit_options(settings, UNITS)
    with reading(path, "drive file", FORMAT):
        table = find_table(path.read_text(encoding="utf-8-sig"), FORMAT)
        headings = table.headings(("s", "m"))
        clocks = [heading for heading in headings if heading.quantity == "time"]
        if len(clocks) != 1:
            raise InputError(f"{len(clocks)} columns are called time, but exactly one is needed; {FORMAT}")
        posts = [heading for heading in headings if heading is not clocks[0]]
        check_posts([post.name for post in posts])
        scales = [clocks[0].scale("time", "time_unit", settings.get("time_unit", ""))]
        scales += [post.scale("height", "height_unit", settings.get("height_unit", "")) for post in posts]
        numbers, lines = table.numbers([heading.column - 1 for heading in (*clocks, *posts)])
        time, *heights = (numbers * scales).T
        check_history(time, np.stack(heights, axis=-1), lambda i: f"line {lines[i]}")
        return Rig(time, np.stack(heights, axis=-1), tuple(post.name for post in posts), str(path))
