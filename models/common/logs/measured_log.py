"""Measured logs: signals against time, from any table of numbers (`models.common.table`) whose columns have signal names.

A heading may contain the words of a signal name in any case and order: `Sprung Acceleration (m/s^2)`, `FL suspension_deflection
[mm]`. Cells of the log may be empty, and the sample rate may vary.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import cached_property
from itertools import islice
from pathlib import Path

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, alike, first_few, list_names, short_repr
from models.common.files import reading
from models.common.quantities import CORNERS, NAMES, Heading, columns_in_words, heading_of, left_out_words
from models.common.table import find_table, table_text
from models.common.units import unit_size

GIVE = "give a line of headings such as: time [s], sprung_acceleration [m/s2], and below it one line for each time"
PLOT_TIME, AMPLITUDE = "Time - ", "Amplitude - "  # beginnings of the headings of a plot that LabVIEW exported
GAP = 5.0  # longest time between two samples, relative to the median time; within longer gaps, the signals are unknown
ROWS = 100  # the number of columns is determined from this number of rows, because the first row may end with missing cells
LEAST = 3  # a log must have at least this number of samples


@dataclass(frozen=True, eq=False)
class MeasuredLog:
    """Log of measured signals against time.

    Attributes:
        source: path of the file.
        time: times of the samples on the log's own clock [s], ascending, shape (n,).
        signals: measured values in SI units by name of the signal, each of shape (n,); NaN for a missing cell.
        remarks: notes about omitted columns and assumed units.
        rounded: number of samples that are omitted because their rounded times in the file equal the time of the previous
            sample.
    """

    source: str
    time: Array
    signals: Mapping[str, Array]
    remarks: tuple[str, ...] = ()
    rounded: int = 0

    @cached_property
    def step(self) -> float:
        """Median step between samples [s]."""
        return float(np.median(np.diff(self.time)))

    def at(self, name: str, time: Array) -> Array:
        """Returns a signal at given times [s] by linear interpolation; NaN at times outside the log and in gaps of the log."""
        values = np.interp(time, self.time, self.signals[name], left=np.nan, right=np.nan)
        after = np.clip(np.searchsorted(self.time, time), 1, len(self.time) - 1)
        apart = self.time[after] - self.time[after - 1]
        between = (time > self.time[after - 1]) & (time < self.time[after])
        return np.where(between & (apart > GAP * self.step), np.nan, values)


def read_measured_log(
    path: Path, units: Mapping[str, str], rate: float | None = None, columns: Mapping[str, str] = {}
) -> MeasuredLog:
    """Reads the columns of a measured log whose names are signal names: .csv, .txt, .lvm, .mat, .xlsx, .parquet, .mf4 or .mcap.

    Times of day in the file are converted to times since the first sample. Times that are computed from the sample rate also
    start from 0 at the first sample.

    Args:
        path: path of the file.
        units: SI unit of each signal that may be read, by name of the signal.
        rate: sample rate of a file without a column of time [Hz]; None for a file with such a column.
        columns: heading in the file for each signal whose column does not have the signal's name, by name of the signal. If the
            file gives no unit for a column, the heading in `columns` may contain the unit.

    Returns:
        The measured signals in SI units, with their times.

    Raises:
        InputError: the file cannot be read, no column has the name of a signal, a unit is wrong, or times do not ascend.

    Example:
        >>> import tempfile
        >>> from pathlib import Path
        >>> from models import read_measured_log
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder, "log.csv")
        ...     _ = path.write_text("time [ms]; Sprung Acceleration (g)\\n0; 0,1\\n10; 0,2\\n20; 0,1\\n")
        ...     log = read_measured_log(path, {"sprung_acceleration": "m/s2"})
        >>> log.time.tolist(), log.signals["sprung_acceleration"].round(4).tolist()
        ([0.0, 0.01, 0.02], [0.9807, 1.9613, 0.9807])
    """
    with reading(path, "measured log", GIVE):
        if rate is not None and not 0 < rate < np.inf:
            raise InputError(f"a sample rate of {rate:g} Hz is not allowed; give a number above 0")
        for name in columns:
            if name not in units:
                raise InputError(f"there is no signal {short_repr(name)} to compare; give one of {alike(name, units)}")
        table = find_table(table_text(path), GIVE)
        table = replace(table, count=max(len(cells) for _, cells in islice(table.rows(), ROWS)))
        headings = table.headings({*units.values(), "s"}, alike=True)
        # The heading t_s means time in s, not the unit t/s.
        headings = [one if one.name or not one.text else heading_of(one.text, ("s",), one.column) for one in headings]
        clocks = times_of(headings)
        clocks = [one for one in clocks if one.quantity == "time"] or clocks
        if rate is None and not clocks:
            found = first_few([short_repr(one.text) for one in headings if one.text], 8)
            raise InputError(
                f"no column is called time (columns: {found}); give the column that contains the times a heading such "
                "as time [s], or give the sample rate with --beside-rate"
            )
        if rate is not None and clocks:
            raise InputError(
                f"{columns_in_words(clocks[:1])} contains times, which already determine the sample rate; omit --beside-rate"
            )
        timed = {one.column for one in clocks}
        used = _columns_of([one for one in headings if one.column not in timed], units, columns)
        clocks = clocks if clocks and clocks[0].text.startswith(PLOT_TIME) else clocks[:1]
        remarks = left_out_words(headings, [one.column for one in (*used.values(), *clocks)])
        stamped = rate is None and ":" in next(table.rows())[1][clocks[0].column - 1]  # the column contains times of day
        bare = [(one, units[name]) for name, one in used.items()] + [(one, "s") for one in clocks[:1] if not stamped]
        remarks += [f"{columns_in_words([one])} has no unit; {unit} is assumed" for one, unit in bare if not one.unit]
        scales = [_scale(one, units[name], name) for name, one in used.items()]
        numbers, lines = table.numbers([one.column - 1 for one in used.values()], ragged=True, gaps=True)
        time = np.arange(len(numbers)) / rate if rate is not None else table.seconds(clocks[0], "s")
        for other in clocks[1:]:  # the clock of each other plot
            if not np.array_equal(table.seconds(other, "s"), time, equal_nan=True):
                both = columns_in_words([clocks[0], other])
                raise InputError(
                    f"{both} contain different times, but all plots must have the same times; export the plots again "
                    "with common times"
                )
        time = time - time[0] if stamped else time
        for i in np.flatnonzero(np.diff(time) < 0)[:1]:
            raise InputError(
                f"time falls from {time[i]:.9g} to {time[i + 1]:.9g} s at line {lines[i + 1]}, so the file seems to "
                "contain several tests; write each test to its own file"
            )
        new = np.append(True, np.diff(time) > 0)  # successive times may be equal after rounding
        if new.sum() < LEAST:
            raise InputError(f"the file has {new.sum()} sample(s), but at least {LEAST} are needed; give a longer log")
        values = (numbers * scales)[new].T
        signals = dict(zip(used, values, strict=True))
        for name, one in signals.items():
            if np.isfinite(one).sum() < LEAST:
                raise InputError(
                    f"{columns_in_words([used[name]])} has fewer than {LEAST} numbers, too few for a comparison; remove "
                    "the column"
                )
        return MeasuredLog(str(path), time[new], signals, tuple(remarks), int(len(new) - new.sum()))


def is_time(heading: Heading) -> bool:
    """Returns True for a column of times, including LabVIEW's name for such a column, X_Value."""
    named = "time" in {NAMES.get(word) for word in heading.words} or heading.name.lower() == "x_value"
    return named and (not heading.unit or unit_size(heading.unit, "s") is not None)


def times_of(headings: Sequence[Heading]) -> list[Heading]:
    """Returns the columns of times. LabVIEW exports a graph with a column `Time - NAME` and a column `Amplitude - NAME` per plot.

    A heading `Time - NAME` can end with the unit of the plot. The times are in seconds.
    """
    named = [one for one in headings if is_time(one)]
    plots = {one.text.removeprefix(AMPLITUDE) for one in headings if one.text.startswith(AMPLITUDE)}
    pairs = [one for one in headings if one.text.startswith(PLOT_TIME) and one.text.removeprefix(PLOT_TIME) in plots]
    return named or [replace(one, unit="s") for one in pairs]


def name_key(text: str) -> frozenset[str]:
    """Returns the words of a name, independent of order and case. For example, the result is the same for `FrontLeftTravel` and
    `travel FL`.
    """
    words: list[str] = re.findall(r"[^\W_]+", re.sub(r"(?<=[a-z])(?=[A-Z])", " ", text).lower())
    return frozenset(part for word in words for part in CORNERS.get(word, word).split("_"))


def _columns_of(headings: list[Heading], units: Mapping[str, str], columns: Mapping[str, str]) -> dict[str, Heading]:
    """Returns the column of each signal, by the name of the signal.

    Raises:
        InputError: no column belongs to a signal, several columns belong to the same signal, or a heading in `columns` does not
            exist.
    """
    used = dict[str, Heading]()
    for name, unit in units.items():
        given = heading_of(columns[name], (unit,)) if name in columns else Heading(name, name)
        keys = {name_key(given.name), name_key(given.text)}
        ones = [one for one in headings if {name_key(one.name), name_key(one.text)} & keys]
        if name in columns:  # brackets that contain no unit are part of the name
            known = [[one for one in (given.unit, each.unit) if one and unit_size(one, one)] for each in ones]
            ones = [replace(one, unit=next(iter(some), "")) for one, some in zip(ones, known, strict=True)]
        if len(ones) > 1:
            raise InputError(
                f"{columns_in_words(ones)} all have the name of the signal {name}; rename all but one of these columns"
            )
        if name in columns and not ones:
            texts = alike(columns[name], [short_repr(one.text) for one in headings if one.text])
            raise InputError(f"no column is called {short_repr(columns[name])}; the columns are {texts}")
        used |= {name: ones[0]} if ones else {}
    if not used:
        near = [name for one in headings for name in get_close_matches(one.name.lower().replace(" ", "_"), units, 1)]
        found = first_few([short_repr(one.text) for one in headings if one.text], 8) or "without names"
        raise InputError(
            f"no column has the name of a signal (columns: {found}); rename a column, or give --beside-column "
            f"SIGNAL=HEADING. Possible names of signals are {list_names({*near} or units)}"
        )
    return used


def _scale(heading: Heading, si: str, name: str) -> float:
    """Returns the factor that converts a column from its own unit to the unit of its signal.

    Raises:
        InputError: the unit of the column is unknown, or is not a unit of the signal's quantity.
    """
    size = unit_size(heading.unit or si, si)
    if size is None:
        raise InputError(
            f"{columns_in_words([heading])} has the unit {short_repr(heading.unit)}, but the signal {name} needs "
            f"{si}; convert the column, and write its heading as {name} [{si}]"
        )
    return size
