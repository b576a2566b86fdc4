"""The signals of a log as one CSV table: MuJoCo's, the sampled response as it was logged, and as it is computed anew."""

import csv
import math
from pathlib import Path

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.whole_file import whole_file
from sim.inspect.proof import Inspected, Proof
from sim.inspect.reproduction import as_response
from sim.recording.format import MUJOCO, SAMPLED


def write_signals(path: Path, proof: Proof) -> None:
    """One line per sample and run, units in the headings; a number that is missing or not finite is left empty.

    Args:
        path: the file; it gets its name when it is whole.
        proof: of the log.

    Raises:
        InputError: the log has no signals of a vehicle that is known, or the file cannot be written.
    """
    if proof.vehicle is None or not any(one.samples for one in proof.runs):
        raise InputError("--csv: there are no signals in the log to write; leave it out")
    with whole_file(path, "csv") as beside, beside.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        columns = [
            f"{signal.name} {which} [{signal.unit}]"
            for signal in proof.vehicle.kind.signals
            for which in ("mujoco", "sampled", "recomputed")
        ]
        writer.writerow(["run", "time [s]", *columns])
        for one in proof.runs:
            time = (np.arange(one.samples) * proof.timestep).tolist()
            for t, row in zip(time, _rows(proof, one).tolist(), strict=True):
                writer.writerow([one.recorded.name, t, *(value if math.isfinite(value) else "" for value in row)])


def _rows(proof: Proof, one: Inspected) -> Array:
    """The three of every signal beside each other, shape (T, 3 S), NaN where there is none."""
    assert proof.vehicle is not None, "the caller has asked"
    nothing = np.full((one.samples, len(proof.vehicle.kind.signals)), np.nan)
    tables = []
    for name in (MUJOCO, SAMPLED):
        try:
            tables.append(as_response(proof.vehicle, one.recorded, name, one.samples, proof.timestep).values)
        except InputError:
            tables.append(nothing)
    tables.append(one.again.sampled.values if one.again else nothing)
    return np.stack(tables, axis=-1).reshape(one.samples, -1)
