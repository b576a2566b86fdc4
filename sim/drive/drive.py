"""Simulation of one or thousands of runs in MuJoCo: `drive` simulates the cases step by step, and observers receive the samples
in blocks.

The simulation agrees with linear analysis up to the error of RK4, which is proportional to the fourth power of the time step.
Four measures ensure this accuracy:

- In MuJoCo, the road is a mocap body, which stays at rest during each step. During a step, the road is therefore at
  `RoadInput.midway`: its height midway through the step or, if measured, its mean height over the step.
- Signals are computed with the road height at the sample, not with the height during the step.
- External loads on the body are also constant during each step, with the values of `RoadInput.held_loads`. Signals are computed
  with the value of each load at the sample.
- The controller is sampled: it receives the signals at each sample, and its force is constant until the next sample.
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

# Smallest number of runs per thread. Only one thread at a time can execute the NumPy code between two steps. With fewer runs
# per thread, this code takes as long as the steps.
FEWEST = 4


class Observer(Protocol):
    """Object that receives and evaluates the samples of a batch. An observer is created by a function that receives a `Batch`."""

    def take(self, block: Block) -> None:
        """Receives the next block of samples."""
        ...

    def result(self) -> Sequence[Any]:
        """Returns the observer's result for each of the N runs; called after the last block."""
        ...


class StoppedError(Exception):
    """Error that is raised if the simulation of runs was stopped before its end."""


def drive(
    cases: Sequence[Case],
    time: Array,
    *observers: Callable[[Batch], Observer],
    threads: int = 1,
    streamed: bool = False,
    failures: dict[int, Failure] | None = None,
    stopped: Callable[[], bool] = lambda: False,
) -> list[list[Any]]:
    """Simulates several cases in MuJoCo. Cases that can be simulated together, step by step, form a batch.

    Args:
        cases: the N cases to simulate.
        time: equidistant sample times from 0 [s], shape (T,).
        observers: functions that create an observer for a batch, for example the classes in `sim.observers`.
        threads: largest number of threads, each of which simulates at least `FEWEST` runs. 0 means one thread per core. The
            results do not depend on the number of threads.
        streamed: True to pass blocks of `BLOCK` samples to the observers, without storing whole roads; False to pass all
            samples in a single block.
        failures: dictionary that receives the failures of Python control laws, by index of the case. Runs with failed laws
            continue without control forces. If `failures` is None, the first failure is raised as an error.
        stopped: function that returns True to stop the simulation; called regularly during the runs.

    Returns:
        One list per observer, which contains the observer's result for each case.

    Raises:
        InputError: a Python control law fails.
        StoppedError: `stopped` returned True.
    """
    results: list[dict[int, Any]] = [{} for _ in observers]
    timestep, edges = float(time[1] - time[0]), [*range(0, len(time), BLOCK if streamed else len(time)), len(time)]
    for numbers in _together(cases, timestep):
        loop = Loop([cases[i] for i in numbers], timestep)
        serial = any(cases[i].driver.serial for i in numbers)
        shares = [numbers[runs] for runs in _shares(len(numbers), 1 if serial else threads or cores())]
        parts = [batch_of([cases[i] for i in some], time, some, streamed, failures) for some in shares]
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
    """Groups the cases that can be simulated together, step by step; returns the indices of the cases in each group."""
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
    """Splits the runs evenly among threads.

    The runs of each thread form a separate batch. Separate batches are faster than a single batch on all threads. The threads
    of a single batch would wait for each other at each step, and would also wait for Python code.
    """
    shares = min(threads, count // FEWEST)
    if shares <= 1:
        return [slice(None)]
    edges = [count * i // shares for i in range(shares + 1)]
    return [slice(*pair) for pair in itertools.pairwise(edges)]


def _results_of(
    loop: Loop, batch: Batch, edges: Sequence[int], observers: Sequence[Callable[[Batch], Observer]], stopped: Callable[[], bool]
) -> list[Sequence[Any]]:
    """Returns the results of all observers for a batch, or for a part of it."""
    watching = [make(batch) for make in observers]
    for block in _complete_blocks(loop, batch, edges, stopped):
        for one in watching:
            one.take(block)
    return [one.result() for one in watching]


def _complete_blocks(loop: Loop, batch: Batch, edges: Sequence[int], stopped: Callable[[], bool]) -> Iterator[Block]:
    """Adds road velocities and the signals of steady motion to blocks of samples, and yields the blocks.

    In diverged runs, values that are too large or not finite are replaced by finite values.
    """
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
