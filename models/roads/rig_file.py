"""Drive files of rigs as text: a column of time, and one of heights for each wheel, named and with its unit above it.

MTS's binary RPC III is not read. The public package for it, rpc-reader 0.9 of 2022, is not fit for damaged files, or files of
another machine: it ends the process if a header is wrong, takes as much memory as the header says, reads big-endian
files as if they were little-endian, and prints as it goes.
"""

from collections.abc import Mapping
from pathlib import Path

from models.common.errors import InputError, listing
from models.common.files import read_text, reading
from models.common.table import find_table
from models.common.units import LENGTH, TIME
from models.roads.rig import Rig, check_history, check_posts, post_name

CLOCK = ("time", "t")
FORMAT = "give a line of headings, as in: time [s], front_left [mm], front_right [mm], and below it a line for each time"
SETTINGS = ("time_unit", "height_unit")  # for headings without a unit


def read_rig(path: Path, settings: Mapping[str, str]) -> Rig:
    """Reads a rig from a text file.

    Args:
        settings: `time_unit` and `height_unit`, for headings without a unit.

    Raises:
        InputError: the file cannot be read, a heading or a line is wrong, or they make no histories. It names file and line.
    """
    for name, allowed in zip(SETTINGS, (TIME, LENGTH), strict=True):
        if name in settings and settings[name] not in allowed:
            raise InputError(f"{name} = {settings[name]!r} is unknown; give one of {listing(allowed)}")
    text = read_text(path, "drive file", FORMAT)
    with reading(path, "drive file", FORMAT):
        return _rig(text, settings, str(path))


def _rig(text: str, settings: Mapping[str, str], source: str) -> Rig:
    table = find_table(text, FORMAT)
    headings = table.headings(TIME | LENGTH)
    clocks = [heading for heading in headings if post_name(heading.name) in CLOCK]
    if len(clocks) != 1:
        raise InputError(f"{len(clocks)} columns are called time, and one must be; {FORMAT}")
    posts = [heading for heading in headings if heading is not clocks[0]]
    check_posts([heading.name for heading in posts])
    given = [settings.get(name, "") for name in SETTINGS]
    scales = [clocks[0].scale(TIME, given[0], SETTINGS[0]), *(post.scale(LENGTH, given[1], SETTINGS[1]) for post in posts)]
    numbers, lines = table.numbers([heading.column - 1 for heading in (clocks[0], *posts)])
    numbers = numbers * scales
    time, heights = numbers[:, 0], numbers[:, 1:]
    check_history(time, heights, lambda i: f"line {lines[i]}")
    return Rig(time, heights, tuple(post.name for post in posts), source)
