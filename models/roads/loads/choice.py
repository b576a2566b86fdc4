"""Loads by name: `KIND[:NAME=VALUE...]`, or the name of a CSV file with values of a load against time.

A load is written in the same form on command lines, in campaign files and in logs.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, error_in, list_names
from models.common.files import path_from, reading
from models.common.schema import read_text
from models.common.table import find_table
from models.kinds.kind import Parameters, VehicleKind
from models.roads.loads.load import HEAVE, LOADS, PITCH, ROLL, Load
from models.roads.road import means
from models.vehicle.names import LOAD_SYNTAX, is_load_file

NAMES = {"heave": HEAVE, "pitch": PITCH, "roll": ROLL}
MOST_ROWS = 20_000
LARGEST = 1e9  # largest allowed force [N], moment [N m] and time [s]
GIVE = "give a .csv file with the heading time [s] and at least one of heave [N], pitch [N m], roll [N m]"


@dataclass(frozen=True, eq=False)
class History(Load):
    """Load from a file, interpolated linearly between the points in the file.

    Before the first point, the load is 0; a load that begins after 0 s must begin with the value 0. After the last point, the
    load keeps its last value.

    Attributes:
        source: name of the file.
        time: times of the points [s], ascending, shape (K,).
        columns: values of the load [N, N m] by heading of the column, each of shape (K,).
    """

    source: str
    time: Array
    columns: Mapping[str, Array]

    @property
    def text(self) -> str:
        """Text that defines the load: the name of the file and all numbers in the file, exactly. In the text, the rows of the
        CSV file are separated by `;`.
        """
        heading = ",".join(["time [s]", *(f"{name} [{'N' if name == 'heave' else 'N m'}]" for name in self.columns)])
        rows = zip(self.time.tolist(), *(column.tolist() for column in self.columns.values()), strict=True)
        return ";".join([self.source, heading, *(",".join(map(repr, row)) for row in rows)])

    @property
    def content(self) -> str:
        """Text that defines the load by all numbers in the file, without the name of the file."""
        return self.text.partition(";")[2]

    @property
    def label(self) -> str:
        """Name of the file that contains the load."""
        return self.source

    @property
    def kinks(self) -> tuple[float, ...]:
        """Times of all points [s]."""
        return tuple(self.time.tolist())

    @property
    def directions(self) -> tuple[str, ...]:
        """Names of the body loads (force and moments) in the columns."""
        return tuple(NAMES[name] for name in self.columns)

    def at(self, t: Array, p: Parameters, kind: VehicleKind | None = None) -> Mapping[str, Array]:
        """Returns the interpolated values of the load; see `Load`."""
        return {NAMES[name]: np.interp(t, self.time, column) for name, column in self.columns.items()}

    def step_means(self, t: Array, timestep: float, p: Parameters, kind: VehicleKind | None = None) -> Mapping[str, Array]:
        """Returns the mean load over each time step, because a step may contain several points of the table; see `Load`."""
        return {
            NAMES[name]: means(lambda at, column=column: np.interp(at, self.time, column), self.time, t, timestep)
            for name, column in self.columns.items()
        }

    def scaled(self, factor: float) -> "History":
        """Returns the load with all values multiplied by a factor."""
        return replace(self, columns={name: factor * column for name, column in self.columns.items()})


def check_file_name(path: Path | str) -> str:
    """Returns the name of a file in a form that the description of a load may contain. Texts that separate parts of a
    description, `;` and ` + `, are replaced.
    """
    return str(path).replace(";", "_").replace(" + ", "_+_")


def parse_history(text: str, source: str) -> History:
    """Reads a load from the text of a CSV file."""
    with error_in(f"load file {source}:"):
        return _history(text, source)


def _history(text: str, source: str) -> History:
    table = find_table(text, GIVE)
    values = table.quantities(("time", *NAMES))
    if "time" not in values or len(values) < 2:
        raise InputError(f"the file has only the columns {list_names(values)}; {GIVE}")
    lines = [line for line, _ in table.rows()]
    if not 2 <= len(lines) <= MOST_ROWS:
        raise InputError(f"the file has {len(lines)} row(s) of numbers; give 2 to {MOST_ROWS} rows")
    for name, column in values.items():
        for i in np.flatnonzero(np.abs(column) > LARGEST)[:1].tolist():
            raise InputError(
                f"line {lines[i]}: {name} is {column[i]:g}, but at most {LARGEST:g} (in SI units) is allowed; correct the value"
            )
    time = values.pop("time")
    for i in np.flatnonzero(np.diff(time) <= 0)[:1].tolist():
        raise InputError(f"line {lines[i + 1]}: time {time[i + 1]:g} s is not after the time of the previous row; sort the rows")
    acting = [name for name, column in values.items() if column[0] != 0]
    if time[0] > 0 and acting:
        raise InputError(
            f"the load begins at {time[0]:g} s, but {acting[0]} is not 0 at that time; begin the file at 0 s, or with a load of 0"
        )
    return History(source, time, values)


def choose_load(text: str, folder: Path = Path()) -> Load:
    """Returns the load that a text describes.

    Args:
        text: text that describes the load, or name of a file that contains it.
        folder: folder to which file names are relative.

    Raises:
        InputError: a name is unknown, a value is not allowed, or a file does not contain a load.
    """
    if is_load_file(text):
        path = path_from(text.strip(), folder)
        with reading(path, "load file", GIVE):
            return _history(path.read_text(encoding="utf-8-sig"), check_file_name(path))
    kind, colon, rest = text.strip().partition(":")
    if kind not in LOADS:
        raise InputError(f"unknown load {text!r}; {LOAD_SYNTAX}")
    return read_text(f"load {text!r}:", LOADS[kind], colon + rest)


def described_loads(texts: Sequence[str]) -> tuple[Load, ...]:
    """Returns the loads that texts in a log describe, without reading files.

    Raises:
        InputError: a text is not a load.
    """
    loads = []
    for text in texts:
        source, semicolon, rows = text.partition(";")
        if not semicolon and text.partition(":")[0] not in LOADS:
            raise InputError(f"unknown load {text[:60]!r}; {LOAD_SYNTAX}")
        loads.append(parse_history(rows.replace(";", "\n"), source) if semicolon else choose_load(text))
    return tuple(loads)
