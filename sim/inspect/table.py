"""The signals of a log as one CSV table: MuJoCo's, the sampled response as it was logged, and as it is computed anew."""

import contextlib
import csv
import math
from pathlib import Path

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.files import whole_file
from sim.inspect.proof import Inspected, Proof
from sim.inspect.reproduction import as_response, kept
from sim.recording.run_log import MUJOCO, SAMPLED


def write_signals(path: Path, proof: Proof) -> None:
    """Writes a row per sample and run, with units in the headings; missing or non-finite numbers are left empty.

    The controller states of several runs share columns, by number.

    Args:
        path: the file; it gets its name when it is whole.

    Raises:
        InputError: the log has no signals of a vehicle that is known, or the file cannot be written.
    """
    if proof.vehicle is None or not any(one.samples for one in proof.runs):
        raise InputError("--csv: there are no signals in the log to write; leave it out")
    with whole_file(path, "csv") as beside, beside.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        states = max((kept(one.again.controller) for one in proof.runs if one.again), key=len, default=())
        columns = [
            f"{signal.name} {which} [{signal.unit}]"
            for signal in (*proof.vehicle.kind.signals, *states)
            for which in ("mujoco", "sampled", "recomputed")
        ]
        writer.writerow(["run", "time [s]", *columns])
        for one in proof.runs:
            time = (np.arange(one.samples) * proof.timestep).tolist()
            for t, row in zip(time, _rows(proof, one, len(columns)).tolist(), strict=True):
                writer.writerow([one.recorded.name, t, *(value if math.isfinite(value) else "" for value in row)])


def _rows(proof: Proof, one: Inspected, columns: int) -> Array:
    """Returns the three values of every signal side by side, shape (T, columns), NaN if one is missing."""
    assert proof.vehicle is not None, "the caller has asked"
    states = kept(one.again.controller) if one.again else ()
    rows = np.full((3, one.samples, columns // 3), np.nan)
    for row, name in zip(rows, (MUJOCO, SAMPLED), strict=False):
        with contextlib.suppress(InputError):
            values = as_response(proof.vehicle, one.recorded, name, one.samples, proof.timestep, states).values
            row[:, : values.shape[1]] = values
    if one.again:
        rows[2][:, : one.again.sampled.values.shape[1]] = one.again.sampled.values
    return np.moveaxis(rows, 0, -1).reshape(one.samples, -1)
