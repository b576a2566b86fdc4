"""Confirmation of candidates in MuJoCo: several roads, with stops, clipped forces, lift-off and noise."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from models.common.arrays import Array
from models.roads.iso8608 import Iso8608
from models.roads.road import Road
from sim.drive.case import Batch, Case
from sim.drive.drive import drive
from sim.drive.driver import Failure
from sim.drive.loop import Block
from sim.observers.ends import Ends
from sim.runs.run import sample_times
from sim.studies.recommend.rating import ANY, Rating, margins_of, with_ideal_margins
from sim.studies.recommend.task import SEEDS, WINDOW, Candidate, Task
from sim.studies.recommend.within import Usage
from sim.studies.ride.expected import passive_settling_time, settling_time
from sim.studies.ride.metrics import Meter
from sim.studies.ride.standing import score_of, standing_over_runs
from synth.controller.controller import is_linear

LONGEST = 6.0  # s, of a transient that is waited for
SETTLED = 3.0  # s, of runs behind an obstacle
MOST_TIME = 60.0  # s, of a run over a road from a file
AT_ONCE = 48  # runs in a batch


class Peaks:
    """Observer of metrics, and of the largest travel to each side and force."""

    def __init__(self, first: int, speed: float, batch: Batch) -> None:
        """Prepares the runs of a batch, measured from a sample on."""
        self._first, self._seen, self._ends, vehicle = first, 0, Ends(batch), batch.vehicles[0]
        self._meter = Meter(batch.vehicles, batch.timestep, first, speeds=[speed] * len(batch.vehicles))
        names = [signal.name for signal in vehicle.kind.signals]
        wanted = [*(one.deflection for one in vehicle.kind.suspensions), *vehicle.linear_model.inputs]
        self._index = {name: names.index(name) for name in wanted if name in names}
        self._low = np.full((len(self._index), len(batch.vehicles)), np.inf)
        self._high = -self._low

    def take(self, block: Block) -> None:
        """Takes the next block."""
        self._meter.update(block.values)
        self._ends.take(block)
        skip = min(max(self._first - self._seen, 0), len(block.values))
        self._seen += len(block.values)
        part = block.values[skip:, list(self._index.values())]
        if len(part):
            self._low, self._high = np.minimum(self._low, part.min(axis=0)), np.maximum(self._high, part.max(axis=0))

    def result(self) -> list[tuple[bool, dict[str, float], dict[str, tuple[float, float]]]]:
        """Returns for each run whether it went through, its metrics, and the lowest and highest value of travel and force."""
        metrics = self._meter.result()
        return [
            (
                end.broke_off is None,
                {name: float(values[i]) for name, values in metrics.items()},
                {name: (float(self._low[k, i]), float(self._high[k, i])) for k, name in enumerate(self._index)},
            )
            for i, end in enumerate(self._ends.result())
        ]


class Confirmation:
    """Runs of candidates over the roads of a task."""

    def __init__(self, task: Task, seeds: Sequence[int] = SEEDS) -> None:
        """Prepares the roads.

        Args:
            seeds: seeds of the random roads.
        """
        self.task, self.random = task, task.road.spectrum is not None
        self.seeds = tuple(seeds) if isinstance(task.road, Iso8608) else (0,)

    @cached_property
    def roads(self) -> list[Road]:
        """The roads that every candidate drives over."""
        road = self.task.road
        return [replace(road, seed=seed) for seed in self.seeds] if isinstance(road, Iso8608) else [road]

    def start(self, candidates: Sequence[Candidate]) -> float:
        """Returns the time at which the measurement begins [s], when the candidates have settled."""
        if not self.random:
            return 0.0
        times = [
            settling_time(one.vehicle.linearised, one.controller) if is_linear(one.controller, one.vehicle) else math.inf
            for one in candidates
        ]
        usual = passive_settling_time(self.task.vehicle.linearised)
        slowest = max([usual, *(time for time in times if math.isfinite(time))])
        return min(math.ceil(slowest), LONGEST) if math.isfinite(slowest) else LONGEST

    def duration(self, start: float) -> float:
        """Returns the duration of a run [s]."""
        road = self.task.road
        if self.random:
            return start + WINDOW
        return min(road.duration + SETTLED, MOST_TIME) if math.isfinite(road.duration) else WINDOW

    def drive(self, candidates: Sequence[Candidate], progress: Callable[[str], None]) -> list[Rating]:
        """Returns the rating of each candidate; runs that break off have no values."""
        ratings = list[Rating]()
        start = self.start(candidates)
        each = max(1, AT_ONCE // len(self.roads))
        for first in range(0, len(candidates), each):
            progress(f"{first} of {len(candidates)} candidates driven")
            ratings += self._batch(candidates[first : first + each], start)
        return ratings

    def _batch(self, candidates: Sequence[Candidate], start: float) -> list[Rating]:
        task, timestep = self.task, self.task.timestep
        time = sample_times(task.vehicle, self.duration(start), timestep)
        cases = [Case(one.vehicle, one.controller, road) for one in candidates for road in self.roads]
        first, speed = round(start / timestep), task.road.speed

        def observer(batch: Batch) -> Peaks:
            return Peaks(first, speed, batch)

        failures = dict[int, Failure]()
        (results,) = drive(cases, time, observer, threads=0, streamed=True, failures=failures)
        count = len(self.roads)
        return [
            self._rating(one, results[i * count : (i + 1) * count], any(k // count == i for k in failures))
            for i, one in enumerate(candidates)
        ]

    def _rating(
        self, one: Candidate, runs: Sequence[tuple[bool, dict[str, float], dict[str, tuple[float, float]]]], failed: bool
    ) -> Rating:
        task, room = self.task, self.task.room
        if failed or not all(through for through, *_ in runs):
            return Rating(score_of(one.vehicle, one.name, {}).values, Usage(math.inf, math.inf, 1.0, 0.0, 1.0))
        metrics: dict[str, Array] = {name: np.array([each[name] for _, each, _ in runs]) for name in runs[0][1]}
        score = standing_over_runs(one.vehicle, one.name, metrics)
        stroke = max(
            max(-ends[name][0] / bump, ends[name][1] / rebound)
            for *_, ends in runs
            for name, (bump, rebound) in room.strokes.items()
        )
        pushing = one.controller.acts and not one.vehicle.dampers
        force = max(
            (max(-ends[name][0], ends[name][1]) / most for *_, ends in runs for name, most in room.forces.items()), default=0.0
        )
        lifted = float(max((value.max() for name, value in metrics.items() if name.endswith("off_ground")), default=0.0))
        gain, disk = ANY
        if pushing and is_linear(one.controller, one.vehicle):
            gain, disk = margins_of(task.line, one.controller, task.coarse_step)
        usage = Usage(stroke, force if pushing else 0.0, gain, disk, lifted)
        return Rating(score.values, with_ideal_margins(task, one.controller, usage) if pushing else usage)
