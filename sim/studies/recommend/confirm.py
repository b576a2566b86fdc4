"""Simulates candidates in MuJoCo over several roads, with bump stops, clipped forces, lift-off and sensor noise."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from models.roads.iso8608 import Iso8608
from sim.drive.case import Batch, Case
from sim.drive.drive import drive
from sim.drive.driver import Failure
from sim.drive.loop import Block
from sim.observers.ends import Ends
from sim.runs.run import sample_times
from sim.studies.recommend.rating import Rating, margins_of
from sim.studies.recommend.task import WINDOW, Contender, Task
from sim.studies.recommend.within import MOST_GAIN, Usage
from sim.studies.ride.expected import passive_settling_time, settling_time
from sim.studies.ride.metrics import Meter
from sim.studies.ride.scores import score_of, score_over_runs
from synth.controller.controller import is_linear

SEEDS = (0, 1, 2, 3, 4, 5)  # seeds of the random roads on which candidates are compared
LONGEST = 5.0  # s, longest transient that is awaited before the measurement
SETTLED, MOST_TIME = 3.0, 60.0  # s, time that a run continues after an obstacle, and longest run over a road from a file
AT_ONCE = 48  # number of runs in a batch
BROKEN = Usage(math.inf, math.inf, 1.0, 0.0, 1.0)


class Peaks:
    """Observer of metrics, and of the lowest and highest values of deflections and forces."""

    def __init__(self, first: int, speed: float, names: Sequence[str], batch: Batch) -> None:
        """Prepares the measurement of a batch of runs, which begins at the sample `first`."""
        self._first, self._seen, self._ends, every = first, 0, Ends(batch), [one.name for one in batch.vehicles[0].kind.signals]
        self._meter = Meter(batch.vehicles, batch.timestep, first, speeds=[speed] * len(batch.vehicles))
        self._rows = [every.index(name) for name in names]
        # Largest values of the negated signals (first row), and of the signals (second row)
        self._high = np.full((2, len(names), len(batch.vehicles)), -np.inf)

    def take(self, block: Block) -> None:
        """Takes the next block."""
        self._meter.update(block.values)
        self._ends.take(block)
        part = block.values[max(self._first - self._seen, 0) :, self._rows]
        self._seen += len(block.values)
        if len(part):
            self._high = np.maximum(self._high, [-part.min(axis=0), part.max(axis=0)])

    def result(self) -> list[tuple[dict[str, float] | None, np.ndarray]]:
        """Returns for each run the metrics (None if the run was aborted) and the largest values down and up, shape (2, names)."""
        metrics = self._meter.result()
        each = [{name: float(values[i]) for name, values in metrics.items()} for i in range(self._high.shape[2])]
        ends = self._ends.result()
        return [
            (one if end.broke_off is None else None, self._high[..., i])
            for i, (one, end) in enumerate(zip(each, ends, strict=True))
        ]


def drive_candidates(
    task: Task, candidates: Sequence[Contender], progress: Callable[[str], None], seeds: Sequence[int] = SEEDS
) -> list[Rating]:
    """Returns the rating of each candidate in MuJoCo over the road, or over random roads with these seeds.

    A candidate with an aborted run has no values. On random roads, the measurement begins when the transients have decayed; on
    other roads it begins at the start.
    """
    road, names = task.road, [*task.strokes, *task.forces]
    roads = [replace(road, seed=seed) for seed in seeds] if isinstance(road, Iso8608) else [road]
    start, duration = 0.0, min(road.duration + SETTLED, MOST_TIME) if math.isfinite(road.duration) else WINDOW
    if task.random:
        linear = [one for one in candidates if is_linear(one.controller, one.vehicle)]
        slowest = [passive_settling_time(task.line), *(settling_time(one.vehicle.linearised, one.controller) for one in linear)]
        start = min(math.ceil(max(slowest)), LONGEST) if len(linear) == len(candidates) and max(slowest) < LONGEST else LONGEST
        duration = start + WINDOW
    time, ratings, count = sample_times(task.vehicle, duration, task.timestep), list[Rating](), max(1, AT_ONCE // len(roads))
    observer = partial(Peaks, round(start / task.timestep), road.speed, names)
    for first in range(0, len(candidates), count):
        progress(f"{first} of {len(candidates)} candidates simulated")
        some, failures = candidates[first : first + count], dict[int, Failure]()
        cases = [Case(one.vehicle, one.controller, each) for one in some for each in roads]
        (results,) = drive(cases, time, observer, threads=0, streamed=True, failures=failures)
        for i, one in enumerate(some):
            runs = range(i * len(roads), (i + 1) * len(roads))
            metrics = [None if k in failures else results[k][0] for k in runs]
            ratings.append(_rating(task, one, metrics, np.max([results[k][1] for k in runs], axis=0)))
    return ratings


def _rating(task: Task, one: Contender, runs: Sequence[dict[str, float] | None], high: np.ndarray) -> Rating:
    """Returns the rating of a candidate from the metrics of its runs and the largest values of deflections and forces."""
    whole = [run for run in runs if run is not None]
    if len(whole) < len(runs):
        return Rating(score_of(one.vehicle, one.name, {}).values, BROKEN)
    metrics = {name: np.array([run[name] for run in whole]) for name in whole[0]}
    strokes, forces = np.array([*task.strokes.values()]).T, np.array([*task.forces.values()])
    force = float((high[:, len(task.strokes) :] / forces).max()) if one.pushes else 0.0
    lifted = max((float(value.max()) for name, value in metrics.items() if name.endswith("off_ground")), default=0.0)
    margins = margins_of(task, one.controller) if one.pushes and is_linear(one.controller, one.vehicle) else (MOST_GAIN, 2.0)
    usage = Usage(float((high[:, : len(task.strokes)] / strokes).max()), force, *margins, lifted)
    return Rating(score_over_runs(one.vehicle, one.name, metrics).values, usage)
