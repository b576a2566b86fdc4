"""The MuJoCo response of one run or ten thousand: `drive` steps cases, and observers take their samples block by block.

It agrees with the analysis to the integrator's own error (RK4's, to the fourth power of the step), because

- the road is a mocap body that MuJoCo holds over a step, so it is put at `RoadInput.midway`: its height midway through the
  step, and of a measured road the mean height over the step;
- signals are read with the road's height at the sample;
- loads on the body are held over a step at `RoadInput.held_loads`, as the road is, and signals are read with the load there;
- the controller is sampled: it reads the signals once a step, and its force is held.
"""

import functools
import itertools
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from typing import Any, Protocol

import numpy as np

from models.common.arrays import Array
from models.common.threads import cores, side_by_side
from sim.drive.case import Batch, Case, batch_of
from sim.drive.driver import Failure
from sim.drive.loop import Block, Loop
from sim.drive.regime import BLOCK
from sim.drive.sensor_readout import hardware, reads_out

FEWEST = 4  # runs per thread: with fewer, numpy between the steps, one thread at a time, takes as long as the steps


class Observer(Protocol):
    """Object that takes the samples of a batch; a function makes it from the `Batch`."""

    def take(self, block: Block) -> None:
        """Takes the next block of samples."""
        ...

    def result(self) -> Sequence[Any]:
        """Returns what is known of each of the N runs after the last block."""
        ...


class StoppedError(Exception):
    """The runs were told to stop before their end."""


def drive(
    cases: Sequence[Case],
    time: Array,
    *observers: Callable[[Batch], Observer],
    threads: int = 1,
    streamed: bool = False,
    failures: dict[int, Failure] | None = None,
    stopped: Callable[[], bool] = lambda: False,
) -> list[list[Any]]:
    """Drives cases in MuJoCo, side by side as far as they can be stepped together.

    Args:
        cases: N runs.
        time: equidistant sample times from 0 [s], shape (T,).
        observers: functions that make an observer of a batch, such as the classes in `sim.observers`.
        threads: largest number of threads, with `FEWEST` runs or more each; results do not depend on it. 0 means one per core.
        streamed: True for blocks of `BLOCK` samples, without keeping roads whole; False for a single block.
        failures: receives the failure of a law in Python by the number of its case, whose run goes on without forces; None to
            raise the first one.
        stopped: function that returns True to end the runs; called from time to time.

    Returns:
        For each observer its results, one for each case.

    Raises:
        InputError: a law in Python fails.
        StoppedError: `stopped` returned True.
    """
    results: list[dict[int, Any]] = [{} for _ in observers]
    for numbers in _together(cases, float(time[1] - time[0])):
        batch = batch_of([cases[i] for i in numbers], time, numbers, streamed, failures)
        loop, edges = Loop(batch), [0, len(time)]
        if streamed:
            edges = [*range(0, len(time), BLOCK), len(time)]
        serial = any(one.serial for one in batch.drivers)
        shares = _shares(len(numbers), 1 if serial else threads or cores())
        parts = [batch] if len(shares) == 1 else [batch.part(runs) for runs in shares]
        pieces = [functools.partial(_results_of, loop, part, edges, observers) for part in parts]
        if len(pieces) == 1:
            done = [(0, pieces[0](stopped))]
        else:
            with closing(side_by_side(pieces, len(pieces))) as running:
                done = list(running)
        for number, of_part in done:
            for known, each in zip(results, of_part, strict=True):
                known |= zip(parts[number].numbers, each, strict=True)
    return [[known[i] for i in range(len(cases))] for known in results]


def _together(cases: Sequence[Case], timestep: float) -> list[list[int]]:
    """Returns the numbers of the cases that can be stepped side by side, group by group."""
    distinct = {id(one.vehicle): one.vehicle for one in cases}
    if len(distinct) == 1:
        return [[*range(len(cases))]]
    models = {key: hardware(one) for key, one in distinct.items()}
    one_of = {models[key]: one for key, one in distinct.items()}
    alike = {key: reads_out(one, timestep) if len(one_of) > 1 else b"" for key, one in one_of.items()}
    groups = dict[bytes, list[int]]()
    for i, one in enumerate(cases):
        groups.setdefault(alike[models[id(one.vehicle)]], []).append(i)
    return list(groups.values())


def _shares(count: int, threads: int) -> list[slice]:
    """Splits runs evenly among threads.

    Each share has its batch and thread. That is faster than one batch on all threads: those wait while Python has its turn, and
    on a busy machine for each other.
    """
    shares = min(threads, count // FEWEST)
    if shares <= 1:
        return [slice(None)]
    edges = [count * i // shares for i in range(shares + 1)]
    return [slice(*pair) for pair in itertools.pairwise(edges)]


def _results_of(
    loop: Loop, batch: Batch, edges: Sequence[int], observers: Sequence[Callable[[Batch], Observer]], stopped: Callable[[], bool]
) -> list[Sequence[Any]]:
    """Returns the results of all observers of a batch, or of a part."""
    watching = [make(batch) for make in observers]
    for block in _complete_blocks(loop, batch, edges, stopped):
        for one in watching:
            one.take(block)
    return [one.result() for one in watching]


def _complete_blocks(loop: Loop, batch: Batch, edges: Sequence[int], stopped: Callable[[], bool]) -> Iterator[Block]:
    """Yields the blocks with the road's velocities and the steady motion; values of runs that have diverged are finite."""
    kind, end = batch.vehicles[0].kind, 0
    names = [signal.name for signal in kind.signals]
    roads = [names.index(wheel.road_velocity) for wheel in kind.wheels]
    for block in loop.blocks(batch, edges, stopped):
        end = block.start + len(block.values)
        some = slice(block.start, end)
        batch.law_diverged[...] |= block.law_diverged & np.isinf(batch.diverged)
        batch.diverged[...] = np.minimum(batch.diverged, block.diverged(batch.time))
        if np.isfinite(batch.diverged).any():
            block.clip(batch.time[some, None] >= batch.diverged)
        if batch.velocities is not None:
            block.values[:, roads] = np.moveaxis(batch.velocities[some], 1, 2)
        for i, steady in batch.steady(some):
            block.values[..., i] += steady
        yield block
    if end < edges[-1]:
        raise StoppedError
