"""Recorder of every sample of a run: signals, states, measurements and commands."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from models.common.arrays import Array
from models.kinds.signals import kept_signals
from models.roads.road import RoadInput
from models.vehicle.limits_and_implementation import steps_per_sample
from models.vehicle.vehicle import Vehicle
from sim.drive.case import Batch, Case
from sim.drive.drive import drive
from sim.drive.driver import RunDriver
from sim.drive.jumps import with_decisions
from sim.drive.loop import Block
from sim.drive.response import Response


@dataclass(frozen=True, eq=False)
class Recording:
    """Recording of one MuJoCo run.

    Attributes:
        case: vehicle, controller and road that were simulated.
        input: vehicle and road of the run, with the road heights at the samples.
        response: signals of the vehicle, followed by the states of a linear law; these states are those at the law's most
            recent sample. After a divergence of the run, signals are NaN. If states of the law caused the divergence, the
            states are then infinite; otherwise, the states are NaN.
        qpos: MuJoCo's generalised positions, shape (T, nq), for drawing the run.
        qvel: MuJoCo's generalised velocities, shape (T, nv).
        measured: measured signals and closing velocities at the samples of the controller, each of shape (T,), by name; see
            `Block.measured`.
        commands: commands of the actuators at every time step, shape (T, m) or (T, 2 m); see `sim.drive.actuators`.
    """

    case: Case
    input: RoadInput
    response: Response
    qpos: Array
    qvel: Array
    measured: Mapping[str, Array]
    commands: Array

    @property
    def vehicle(self) -> Vehicle:
        """Vehicle of the run."""
        return self.case.vehicle

    @property
    def driver(self) -> RunDriver:
        """Controller, or known commands, of the run."""
        return self.case.driver

    @cached_property
    def diverged(self) -> float:
        """Time at which the run diverged [s]; infinity if the run did not diverge."""
        return self.response.diverged

    @property
    def law_states(self) -> Array:
        """States that a linear law had at its most recent sample, shape (T, k)."""
        return self.response.values[:, len(self.vehicle.kind.signals) :]


class Recorder:
    """Records N runs."""

    def __init__(self, batch: Batch) -> None:
        """Prepares the recording of a batch of runs."""
        self._batch, self._blocks = batch, list[Block]()

    def take(self, block: Block) -> None:
        """Receives the next block of samples."""
        self._blocks.append(block)

    def result(self) -> list[Recording]:
        """Returns the recording of each run."""
        batch, (first, *_), vehicle = self._batch, self._blocks, self._batch.vehicles[0]
        names = ("values", "qpos", "qvel", "requested_force", "law_states", "measured")
        parts = [[getattr(one, name) for one in self._blocks] for name in names]
        values, qpos, qvel, commands, law_states, measured = (np.concatenate(one) if len(one) > 1 else one[0] for one in parts)
        time, gone = batch.time, batch.time[:, None] >= batch.diverged
        values[np.broadcast_to(gone[:, None], values.shape)] = np.nan
        response = Response(time, vehicle.kind.signals, np.moveaxis(values, 2, 0))
        response = with_decisions(response, batch.vehicles)
        if others := {k: other.T for one in self._blocks for k, other in one.others.items()}:
            response = response.with_sides(others)
        recordings = []
        for i, (case, on) in enumerate(zip(batch.cases, batch.inputs, strict=True)):
            period = steps_per_sample(case.vehicle.implementation, batch.timestep) * batch.timestep
            states = law_states[:, i, : case.driver.states] * case.driver.state_scale(period)
            states[gone[:, i]] = np.inf if batch.law_diverged[i] else np.nan
            one = response.run(i).with_signals(kept_signals(range(1, case.driver.states + 1)), states)
            seen = dict(zip(first.names, measured[:, i].T, strict=True))
            recordings.append(Recording(case, on, one, qpos[:, i], qvel[:, i], seen, commands[:, i]))
        return recordings


def from_steady(road: RoadInput, response: Response) -> Response:
    """Returns a response relative to the steady motion in which the vehicle starts; unchanged if the vehicle starts in
    equilibrium.
    """
    steady = road.steady_signals(response.time)
    if steady is None:
        return response
    values = response.values.copy()
    values[..., : steady.shape[-1]] -= steady
    return Response(response.time, response.signals, values)


def record(cases: "list[Case]", time: Array, threads: int = 1) -> list[Recording]:
    """Simulates cases; returns the recordings of the cases at the sample times `time` [s]. For the arguments, see `drive`."""
    (recordings,) = drive(cases, time, Recorder, threads=threads)
    return recordings
