"""The signals of a log as one CSV table: MuJoCo's, the sampled response as it was logged, and as it is computed anew."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from models.common.errors import InputError
from sim.inspect.proof import Inspected, Proof
from sim.inspect.reproduction import as_response, kept
from sim.recording.run_log import MUJOCO, SAMPLED
from sim.response.response import Response
from sim.runs.signal_table import run_columns, write_columns


def write_signals(path: Path, proof: Proof) -> None:
    """Writes the signals of all runs of a log, as `sim.bump --csv` does; a response that the log lacks has no columns.

    Raises:
        InputError: the log has no signals of a vehicle that is known, or the file cannot be written.
    """
    if proof.vehicle is None or not any(one.samples for one in proof.runs):
        raise InputError("--csv: there are no signals in the log to write; leave it out")
    time = np.arange(max(one.samples for one in proof.runs)) * proof.timestep
    write_columns(
        path, time, [column for one in proof.runs for column in run_columns(one.recorded.name, dict(_responses(proof, one)))]
    )


def _responses(proof: Proof, one: Inspected) -> Iterator[tuple[str, Response]]:
    """Yields the responses of a run, each with its source."""
    assert proof.vehicle is not None, "the caller has asked"
    states = kept(one.again.controller) if one.again else ()
    for source, name in (("mujoco", MUJOCO), ("sampled", SAMPLED)):
        with contextlib.suppress(InputError):
            yield source, as_response(proof.vehicle, one.recorded, name, one.samples, proof.timestep, states)
    if one.again:
        yield "recomputed", one.again.sampled
