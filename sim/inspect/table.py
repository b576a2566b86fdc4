"""The signals of a log as one CSV table: MuJoCo's, the logged sampled response, and the recomputed one."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from models.common.errors import InputError
from models.vehicle.vehicle import Vehicle
from sim.inspect.proof import Inspected, Proof
from sim.inspect.replay import as_response, kept
from sim.recording.run_log import MUJOCO, SAMPLED
from sim.response.response import Response
from sim.runs.signal_table import run_columns, write_columns


def write_signals(path: Path, proof: Proof) -> None:
    """Writes the signals of all runs of a log, as `sim.bump --csv` does; a response that the log lacks has no columns.

    Raises:
        InputError: the log has no signals of a known vehicle, or the file cannot be written.
    """
    vehicle = proof.vehicle
    columns = [] if vehicle is None else [(one, dict(_responses(proof, vehicle, one))) for one in proof.runs]
    longest = max((len(one.time) for _, responses in columns for one in responses.values()), default=0)
    if not longest:
        raise InputError("--csv: there are no signals in the log to write; omit it")
    time = np.arange(longest) * proof.log.timestep
    write_columns(path, time, [column for one, some in columns for column in run_columns(one.recorded.name, some)])


def _responses(proof: Proof, vehicle: Vehicle, one: Inspected) -> Iterator[tuple[str, Response]]:
    """Yields the responses of a run, each with its source."""
    states = kept(one.again.run.controller) if one.again else ()
    for source, name in (("mujoco", MUJOCO), ("sampled", SAMPLED)):
        with contextlib.suppress(InputError):
            yield source, as_response(vehicle, one.recorded, name, proof.log.timestep, states)
    if one.again:
        yield "recomputed", one.again.run.prediction.sampled
