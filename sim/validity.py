"""The map of validity: over a grid of bumps, where linear analysis holds, and what breaks first where it does not.

Before anything breaks, physics *is* linear, so what breaks first, and when, follows from the linear response alone; and that is
proportional to the height of the bump. One linear run per length and speed predicts a whole column of heights, and MuJoCo, run in
every cell, says whether that is so.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from models.arrays import Array
from models.vehicle import Vehicle
from sim.broken import first_end, reached, utilisation
from sim.linear import sampled_response
from sim.physics import simulate
from sim.response import Response
from sim.road import Bump
from synth.controller import Controller

CHUNK = 3_000_000  # numbers that a batch records: 125 runs of 3 s; more hardly saves time, and Ctrl-C would lose more
EDGE = 0.01  # relative height; a cell whose prediction changes within that lies at a boundary


@dataclass(frozen=True, eq=False)
class Cells:
    """Cells of the map, N of them, in the order of their bumps. What is measured is NaN, or -1, where a run did not happen.

    Attributes:
        bumps: one per cell.
        done: whether it was run, shape (N,).
        error: largest difference of physics from the linear prediction over the whole run, of any signal's peak, shape (N,).
        first: what broke first in physics, as an index into `ENDS`, -1 for nothing, shape (N,).
        time: when [s], infinite for never, shape (N,).
        predicted: the same from the linear response, shape (N,).
        predicted_time: the same [s], shape (N,).
        used: how much of the way to each of `ENDS` the linear response goes, shape (N, 4).
        edge: whether the prediction is another one at a height 1 % lower or higher, shape (N,).
    """

    bumps: tuple[Bump, ...]
    done: Array
    error: Array
    first: Array
    time: Array
    predicted: Array
    predicted_time: Array
    used: Array
    edge: Array

    @property
    def agrees(self) -> Array:
        """Where physics breaks first what was predicted, shape (N,)."""
        return self.done & (self.first == self.predicted)

    @property
    def agreement(self) -> float:
        """Share of the cells run whose prediction was right."""
        return float(self.agrees.sum() / max(self.done.sum(), 1))

    @property
    def unexplained(self) -> int:
        """Cells whose prediction was wrong though they lie at no boundary."""
        return int(np.sum(self.done & ~self.agrees & ~self.edge))


def validity(
    vehicle: Vehicle,
    controller: Controller,
    bumps: Sequence[Bump],
    time: Array,
    progress: Callable[[int], None] = lambda done: None,
) -> tuple[Cells, bool]:
    """Runs every bump in MuJoCo, in a few large batches, and compares with the linear prediction.

    Args:
        vehicle: the vehicle.
        controller: its controller.
        bumps: N of them.
        time: equidistant sample times from 0 [s].
        progress: is told how many cells are done.

    Returns:
        The cells, and whether all were run: Ctrl-C ends it early, with what is done.
    """
    count = len(bumps)
    unit: dict[tuple[float, float], _PerMetre] = {}
    error, first, when = np.full(count, np.nan), np.full(count, -1), np.full(count, np.nan)
    predicted_times, used = np.full((count, 4), np.inf), np.zeros((count, 4))
    edge, done = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
    size = max(1, CHUNK // (len(time) * len(vehicle.kind.signals)))
    try:
        for start in range(0, count, size):
            chunk = slice(start, min(start + size, count))
            some = bumps[chunk]
            physics = simulate([vehicle] * len(some), [controller] * len(some), some, time, threads=0).response
            ends = reached(vehicle, physics)
            for i, bump in enumerate(some, start):
                key = (bump.length, bump.speed)
                if key not in unit:
                    unit[key] = _per_metre(vehicle, controller, bump, time)
                linear = unit[key]
                used[i] = abs(bump.height) * (linear.used if bump.height > 0 else linear.used_down)
                heights = bump.height * np.array([1, 1 - EDGE, 1 + EDGE])
                times = reached(vehicle, linear.response, heights)
                predicted_times[i] = times[0]
                edge[i] = len(set(first_end(times).tolist())) > 1
                apart = np.abs(physics.values[i - start] - bump.height * linear.response.values).max(axis=0)
                share = (apart / (abs(bump.height) * linear.scales))[linear.outputs]
                error[i] = share.max() if np.all(np.isfinite(share)) else np.inf
            first[chunk], when[chunk] = first_end(ends), ends.min(axis=-1)
            done[chunk] = True
            progress(chunk.stop)
    except KeyboardInterrupt:
        pass
    predicted = first_end(predicted_times)
    cells = Cells(tuple(bumps), done, error, first, when, predicted, predicted_times.min(axis=-1), used, edge)
    return cells, bool(done.all())


@dataclass(frozen=True, eq=False)
class _PerMetre:
    """The linear response to a bump one metre high, and what scales with it."""

    response: Response
    scales: Array  # of every signal, shape (S,); infinite for one that never moves
    outputs: Array  # which of them are outputs, shape (S,)
    used: Array
    used_down: Array  # the same in a hole


def _per_metre(vehicle: Vehicle, controller: Controller, bump: Bump, time: Array) -> _PerMetre:
    response = sampled_response(vehicle, controller, bump.scaled(1 / bump.height), time)
    hole = Response(response.time, response.signals, -response.values)
    return _PerMetre(
        response=response,
        scales=np.array([response.scale(name) or np.inf for name in response.names]),
        outputs=np.array([name in vehicle.linear_model.outputs for name in response.names]),
        used=utilisation(vehicle, response),
        used_down=utilisation(vehicle, hole),
    )
