"""Rating of a candidate controller: by linear analysis, by stability margins, and in MuJoCo over several roads.

In linear analysis, metrics are expected values on a random road. Runs in MuJoCo include bump stops, clipped forces, lift-off
and sensor noise.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from models.common.errors import InputError
from models.roads.iso8608 import Iso8608
from sim.drive.case import Case
from sim.drive.drive import drive
from sim.drive.driver import Failure
from sim.drive.regime import FLAT, REGIME_ENDS, end_times
from sim.drive.response import Response
from sim.observers.recorder import Recorder
from sim.runs.run import sample_times
from sim.studies.recommend import GOALS
from sim.studies.recommend.task import ROADS, SEEDS, WINDOW, Contender, Task
from sim.studies.recommend.within import MOST_GAIN, Usage
from sim.studies.ride.expected import expect, passive_settling_time, settling_time
from sim.studies.ride.metrics import measure
from sim.studies.ride.scores import score_of, score_over_runs
from synth.controller.controller import Controller, is_linear
from synth.controller.disk_margin import disk_margin
from synth.controller.loop_of import loop_of
from synth.controller.stability_margins import bilinear, gain_crossings
from synth.plant.loop import Loop

# gain factors between which stability limits are searched for; 1 is midway between two of them, so that limits close to 1 are
# found
GAINS = np.geomspace(1 / MOST_GAIN, MOST_GAIN, 16)
EXCESS = 4.0  # penalty for exceeding a limit by a factor e, relative to the goal's value for the passive vehicle
LONGEST = 5.0  # s, longest transient that is awaited before the measurement
SETTLED, MOST_TIME = 3.0, 60.0  # s, time that a run continues after an obstacle, and longest run over a road from a file
AT_ONCE = 12  # number of runs in a batch, which records all signals (about 30 MB for a run of a full car)
BROKEN = Usage(math.inf, math.inf, 1.0, 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class Rating:
    """Metrics of a candidate controller, and how close this candidate comes to each limit.

    Attributes:
        values: values of the compared metrics, by key [SI]; None if the vehicle has no such metric or a run was aborted.
        usage: quantities of the candidate that are compared with the limits of the task.
    """

    values: Mapping[str, float | None]
    usage: Usage

    def value(self, task: Task) -> float:
        """Returns the metric value that the goal minimises; infinite if a run was aborted."""
        value = self.values.get(GOALS[task.goal])
        return math.inf if value is None else value

    def penalised(self, task: Task, factors: Mapping[str, float] | None = None) -> float:
        """Returns the metric value that the goal minimises, plus a penalty for limits that are exceeded.

        Args:
            factors: factor that multiplies the used share of each limit, by name of the limit; 1 for all other limits.
        """
        used = {name: (factors or {}).get(name, 1.0) * one for name, one in task.within.used(self.usage).items()}
        usual = task.passive_values.get(GOALS[task.goal]) or 1.0
        return self.value(task) + EXCESS * usual * sum(math.log(max(one, 1.0)) for one in used.values())


def rate_expected(task: Task, candidate: Contender) -> Rating | None:
    """Returns the rating of a candidate on the design road; None if the candidate's loop is unstable or not linear."""
    one = candidate.controller
    if one.linear is not True:
        return None
    changed = candidate.vehicle is not task.vehicle and not one.acts
    car = replace(candidate.vehicle, implementation=candidate.vehicle.implementation.without_noise) if changed else task.line
    expected, usual = expect(car, one, task.spectrum, task.coarse_step, ROADS * WINDOW), task.expected_passive
    if expected is None:
        return None
    mean, stroke = expected.mean, 0.0
    for name, (bump, rebound) in task.strokes.items():
        offset = (expected if changed or usual is None else usual).line.mean.get(name, 0.0)
        peak = mean[f"{name}_peak"] - abs(expected.line.mean.get(name, 0.0))
        stroke = max(stroke, (peak - offset) / bump, (peak + offset) / rebound)
    force = max(mean[f"{name}_peak"] / most for name, most in task.forces.items())
    values = score_of(task.pushed, candidate.name, mean).values
    lifts = (values.get("off_ground") or 0.0, task.passive_values.get("off_ground") or 0.0)
    return Rating(values, Usage(stroke, force, *margins_of(task, one), *lifts))


def margins_of(task: Task, controller: Controller) -> tuple[float, float]:
    """Returns the gain margin and the disk margin at all forces; each is the smaller value of the implemented and the ideal
    loop.
    """
    if not controller.acts:
        return MOST_GAIN, 2.0
    gain, disk = _margins(loop_of(task.line, controller.feedback, task.coarse_step))
    with suppress(InputError):  # without delay, the ideal loop has no solution if the measurements contain the force
        ideal = _margins(loop_of(task.line, controller.feedback))
        gain, disk = min(gain, ideal[0]), min(disk, ideal[1])
    return gain, disk


def _margins(loop: Loop) -> tuple[float, float]:
    cut = loop.cut(loop.forces)
    poles = np.linalg.eigvals(cut.loop_matrix(1.0))
    if np.any(np.abs(poles) > 1 + 1e-9 if loop.period else poles.real > 1e-9):
        return 1.0, 0.0
    gains = [max(one, 1 / one) for one in gain_crossings(cut, GAINS)]
    return min([MOST_GAIN, *gains]), disk_margin(bilinear(cut) if loop.period else cut).size


def drive_candidates(
    task: Task, candidates: Sequence[Contender], progress: Callable[[str], None], seeds: Sequence[int] = SEEDS
) -> list[Rating]:
    """Returns the rating of each candidate in MuJoCo over the task's road, or over random roads, one for each seed.

    A candidate whose run was aborted has no metric values. On random roads, the measurement begins when the transients have
    decayed; on other roads, at the start of the run.
    """
    road = task.road
    roads = [replace(road, seed=seed) for seed in seeds] if isinstance(road, Iso8608) else [road]
    start, duration = 0, min(road.duration + SETTLED, MOST_TIME) if math.isfinite(road.duration) else WINDOW
    if task.random:
        each = (settling_time(one.vehicle.linearised, one.controller) for one in candidates)
        start = math.ceil(min(max(0.0, passive_settling_time(task.line), *each), LONGEST))
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
    """Returns the rating of a candidate from its runs, where the metrics begin at the sample `first`."""
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
    margins = margins_of(task, one.controller) if one.pushes and is_linear(one.controller, one.vehicle) else (MOST_GAIN, 2.0)
    values = score_over_runs(one.vehicle, one.name, metrics).values
    return Rating(values, Usage(stroke, force, *margins, values.get("off_ground") or 0.0))
