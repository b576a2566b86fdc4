"""Simulates candidates in MuJoCo over several roads, with bump stops, clipped forces, lift-off and sensor noise."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from models.roads.iso8608 import Iso8608
from sim.drive.case import Case
from sim.drive.drive import drive
from sim.drive.driver import Failure
from sim.drive.regime import FLAT, REGIME_ENDS, end_times
from sim.drive.response import Response
from sim.observers.recorder import Recorder
from sim.runs.run import sample_times
from sim.studies.recommend.rating import Rating, margins_of
from sim.studies.recommend.task import SEEDS, WINDOW, Contender, Task
from sim.studies.recommend.within import MOST_GAIN, Usage
from sim.studies.ride.expected import passive_settling_time, settling_time
from sim.studies.ride.metrics import measure
from sim.studies.ride.scores import score_of, score_over_runs
from synth.controller.controller import is_linear

LONGEST = 5.0  # s, longest transient that is awaited before the measurement
SETTLED, MOST_TIME = 3.0, 60.0  # s, time that a run continues after an obstacle, and longest run over a road from a file
AT_ONCE = 24  # number of runs in a batch
BROKEN = Usage(math.inf, math.inf, 1.0, 0.0, 1.0)


def drive_candidates(
    task: Task, candidates: Sequence[Contender], progress: Callable[[str], None], seeds: Sequence[int] = SEEDS
) -> list[Rating]:
    """Returns the rating of each candidate in MuJoCo over the road, or over random roads with these seeds.

    A candidate with an aborted run has no values. On random roads, the measurement begins when the transients have decayed; on
    other roads it begins at the start.
    """
    road = task.road
    roads = [replace(road, seed=seed) for seed in seeds] if isinstance(road, Iso8608) else [road]
    start, duration = 0.0, min(road.duration + SETTLED, MOST_TIME) if math.isfinite(road.duration) else WINDOW
    if task.random:
        linear = [one for one in candidates if is_linear(one.controller, one.vehicle)]
        slowest = [passive_settling_time(task.line), *(settling_time(one.vehicle.linearised, one.controller) for one in linear)]
        start = min(math.ceil(max(slowest)), LONGEST) if len(linear) == len(candidates) and max(slowest) < LONGEST else LONGEST
        duration = start + WINDOW
    time, ratings, count = sample_times(task.vehicle, duration, task.timestep), list[Rating](), max(1, AT_ONCE // len(roads))
    for first in range(0, len(candidates), count):
        progress(f"{first} of {len(candidates)} candidates simulated")
        some, failures = candidates[first : first + count], dict[int, Failure]()
        cases = [Case(one.vehicle, one.controller, each) for one in some for each in roads]
        (recordings,) = drive(cases, time, Recorder, threads=0, failures=failures)
        for i, one in enumerate(some):
            runs = range(i * len(roads), (i + 1) * len(roads))
            responses = [] if {*runs} & {*failures} else [recordings[k].response for k in runs]
            ratings.append(_rating(task, one, responses, round(start / task.timestep)))
    return ratings


def _rating(task: Task, one: Contender, responses: Sequence[Response], first: int) -> Rating:
    """Returns the rating of a candidate from its runs, of which the samples from `first` on are measured."""
    flat = REGIME_ENDS.index(FLAT)
    ends = [min(each.diverged, end_times(one.vehicle, each)[flat]) for each in responses] or [0.0]
    if math.isfinite(min(ends)):
        return Rating(score_of(one.vehicle, one.name, {}).values, BROKEN)
    runs = [measure(one.vehicle, each, first, speed=task.road.speed) for each in responses]
    metrics = {name: np.array([run[name] for run in runs]) for name in runs[0]}

    def most(name: str, down: float, up: float) -> float:
        return max(float(max(-each[name][first:].min() / down, each[name][first:].max() / up)) for each in responses)

    stroke = max(most(name, *ends) for name, ends in task.strokes.items())
    force = max(most(name, limit, limit) for name, limit in task.forces.items()) if one.pushes else 0.0
    lifted = max(score_of(one.vehicle, one.name, run).values.get("off_ground") or 0.0 for run in runs)
    margins = margins_of(task, one.controller) if one.pushes and is_linear(one.controller, one.vehicle) else (MOST_GAIN, 2.0)
    return Rating(score_over_runs(one.vehicle, one.name, metrics).values, Usage(stroke, force, *margins, lifted))
