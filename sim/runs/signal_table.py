"""Signals of runs over time as a CSV table: the time, followed by a column for each signal, run and source."""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from models.common.arrays import Array
from models.document.reading import write_rows
from sim.drive.response import Response
from sim.runs.result import RunResult

Column = tuple[str, Array]  # heading of a column, and its values over time


def run_columns(name: str, responses: Mapping[str, Response]) -> Iterator[Column]:
    """Yields the columns of a run with the headings `SIGNAL NAME SOURCE [UNIT]`, signal by signal.

    Args:
        name: name of the run, usually the name of the controller.
        responses: responses of the run by source, for example "mujoco", all at the same sample times, which start at 0.
    """
    for signal in dict.fromkeys(signal for response in responses.values() for signal in response.signals):
        for source, response in responses.items():
            if signal in response.signals:
                yield f"{signal.name} {name} {source} [{signal.unit}]", response[signal.name]


def write_runs(path: Path, runs: Sequence[RunResult]) -> None:
    """Writes the simulated signals and the exact sampled signals of runs over one road to a CSV file. The errors are those of
    `write_columns`.
    """
    each = (run_columns(run.controller.name, {"mujoco": run.physics, "sampled": run.sampled}) for run in runs)
    write_columns(path, runs[0].prediction.time, list(itertools.chain(*each)))


def write_columns(path: Path, time: Array, columns: Sequence[Column]) -> None:
    """Writes the time and columns of numbers to a CSV file. Cells without a finite number, and cells after the end of a column,
    are empty.

    Args:
        path: path of the file. The file is written under a temporary name, and renamed to `path` when it is complete.
        time: times of the longest column [s].

    Raises:
        InputError: the file cannot be written.
    """
    headings, cells = ["time [s]", *(heading for heading, _ in columns)], (map(_cell, values) for _, values in columns)
    write_rows(path, itertools.chain([headings], itertools.zip_longest(map(float, time), *cells, fillvalue="")))


def _cell(value: float) -> float | str:
    return float(value) if math.isfinite(value) else ""
