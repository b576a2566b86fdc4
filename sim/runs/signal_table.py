"""Signals of runs over time as one CSV table: time first, then a column for each signal, run and source of the numbers."""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from models.common.arrays import Array
from models.document.reading import write_rows
from sim.drive.response import Response
from sim.runs.result import RunResult

Column = tuple[str, Array]  # heading and values over time


def run_columns(name: str, responses: Mapping[str, Response]) -> Iterator[Column]:
    """Yields the columns of a run, headed `SIGNAL NAME SOURCE [UNIT]`, signal by signal.

    Args:
        name: name of the run, usually its controller's.
        responses: responses by source, as in "mujoco", over the same samples from 0.
    """
    for signal in dict.fromkeys(signal for response in responses.values() for signal in response.signals):
        for source, response in responses.items():
            if signal in response.signals:
                yield f"{signal.name} {name} {source} [{signal.unit}]", response[signal.name]


def write_runs(path: Path, runs: Sequence[RunResult]) -> None:
    """Writes MuJoCo's signals and those of the exact sampled response of runs over one road; errors as `write_columns`."""
    each = (run_columns(run.controller.name, {"mujoco": run.physics, "sampled": run.sampled}) for run in runs)
    write_columns(path, runs[0].prediction.time, list(itertools.chain(*each)))


def write_columns(path: Path, time: Array, columns: Sequence[Column]) -> None:
    """Writes columns over time; cells without a finite number, and those after the end of a column, are empty.

    Args:
        path: the file; it gets its name when it is whole.
        time: times of the longest column [s].

    Raises:
        InputError: the file cannot be written.
    """
    headings, cells = ["time [s]", *(heading for heading, _ in columns)], (map(_cell, values) for _, values in columns)
    write_rows(path, itertools.chain([headings], itertools.zip_longest(map(float, time), *cells, fillvalue="")))


def _cell(value: float) -> float | str:
    return float(value) if math.isfinite(value) else ""
