"""Signals of runs over time as one CSV table: time first, then a column for each signal, run and source of the numbers."""

import csv
import itertools
import math
from collections.abc import Iterable, Sequence
from pathlib import Path

from models.common.arrays import Array
from models.common.files import whole_file
from sim.response.response import Response
from sim.runs.run import Run

Column = tuple[str, Array]  # heading and values over time


def run_columns(name: str, responses: Iterable[tuple[str, Response]]) -> list[Column]:
    """Returns the columns of a run, headed `SIGNAL NAME SOURCE [UNIT]`, signal by signal.

    Args:
        name: of the run, usually its controller's.
        responses: each with its source, as in ("mujoco", response), over the same samples from 0.
    """
    named = [
        (signal.name, (f"{signal.name} {name} {source} [{signal.unit}]", response[signal.name]))
        for source, response in responses
        for signal in response.signals
    ]
    order = list(dict.fromkeys(signal for signal, _ in named))
    return [column for _, column in sorted(named, key=lambda one: order.index(one[0]))]


def write_runs(path: Path, runs: Sequence[Run]) -> None:
    """Writes MuJoCo's signals and those of the exact sampled response of runs over one road; errors as `write_columns`."""
    columns = [run_columns(run.controller.name, (("mujoco", run.physics), ("sampled", run.sampled))) for run in runs]
    write_columns(path, runs[0].prediction.time, list(itertools.chain(*columns)))


def write_columns(path: Path, time: Array, columns: Sequence[Column]) -> None:
    """Writes columns over time; cells without a finite number, and those after the end of a column, are empty.

    Args:
        path: the file; it gets its name when it is whole.
        time: of the longest column [s].

    Raises:
        InputError: the file cannot be written.
    """
    with whole_file(path, "csv") as beside, beside.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["time [s]", *(heading for heading, _ in columns)])
        cells = (map(_cell, values) for _, values in columns)
        writer.writerows(itertools.zip_longest(map(float, time), *cells, fillvalue=""))


def _cell(value: float) -> float | str:
    return float(value) if math.isfinite(value) else ""
