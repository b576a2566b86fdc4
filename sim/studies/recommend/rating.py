"""Rating of a candidate in linear analysis: expected metrics over the road, and margins of the implemented loop."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from models.common.errors import InputError
from models.laws.linear import LinearLaw
from models.vehicle.vehicle import Vehicle
from sim.studies.recommend.task import GOALS, ROADS, WINDOW, Candidate, Task
from sim.studies.recommend.within import MOST_GAIN, Usage
from sim.studies.ride.expected import expect
from sim.studies.ride.standing import score_of
from synth.controller.controller import AnyController, Controller
from synth.controller.disk_margin import disk_margin
from synth.controller.law_margins import law_margins
from synth.controller.loop_of import loop_of, radius
from synth.plant.state_space import StateSpace

FACTORS = np.geomspace(1.0, MOST_GAIN, 61)[1:]
ANY = (MOST_GAIN, 2.0)  # margins of a loop without forces
EXCESS = 4.0  # factor on the excess over limits in the penalty of a search


@dataclass(frozen=True, eq=False)
class Rating:
    """Metrics of a candidate, and its use of the limits.

    Attributes:
        values: columns of the comparison of controllers, by key [SI]; None if the vehicle lacks it or a run broke off.
        usage: what it uses of its limits.
    """

    values: Mapping[str, float | None]
    usage: Usage

    def value(self, task: Task) -> float:
        """Returns the value that the goal minimises; infinite if there is none."""
        value = self.values.get(GOALS[task.goal])
        return math.inf if value is None else value

    def used(self, task: Task, reserve: float = 0.0) -> dict[str, float]:
        """Returns how much of each limit is used, 1 at the limit, by name."""
        return task.within.used(self.usage, reserve)

    def keeps(self, task: Task, reserve: float = 0.0) -> bool:
        """Returns True if all limits are kept."""
        return math.isfinite(self.value(task)) and all(share <= 1 for share in self.used(task, reserve).values())

    def penalised(self, task: Task, share: float = 1.0) -> float:
        """Returns the value with a penalty for each limit that is exceeded.

        Args:
            share: share of stroke and force that may be used.
        """
        excess = sum(max(0.0, min(one, 10.0) - 1) for one in self.used(task, 1 - share).values())
        return self.value(task) * (1 + EXCESS * excess)


def rate_expected(task: Task, candidate: Candidate) -> Rating | None:
    """Returns the rating of a candidate over the random road of the designs; None if its loop is unstable or not linear."""
    controller = candidate.controller
    if controller.linear is not True:
        return None
    if changed := candidate.vehicle is not task.vehicle and not controller.acts:
        car = replace(candidate.vehicle, implementation=candidate.vehicle.implementation.without_noise)
    else:
        car = task.line
    if controller.acts and radius(loop_of(car, controller, task.coarse_step)) >= 1:
        return None
    expected = expect(car, controller, task.spectrum, task.coarse_step, ROADS * WINDOW)
    if expected is None:
        return None
    mean, room = expected.mean, task.room
    score = score_of(task.pushed, candidate.name, mean)
    stroke = 0.0
    for name, (bump, rebound) in room.strokes.items():
        offset = expected.line.mean.get(name, 0.0) if changed else task.offset(name)
        peak = mean[f"{name}_peak"] - (abs(offset) if changed else 0.0)
        stroke = max(stroke, (peak - offset) / bump, (peak + offset) / rebound)
    force = max((mean[f"{name}_peak"] / most for name, most in room.forces.items()), default=0.0) if controller.acts else 0.0
    gain, disk = margins_of(car, controller, task.coarse_step)
    return Rating(score.values, Usage(stroke, force, gain, disk, score.values.get("off_ground") or 0.0))


def margins_of(car: Vehicle, controller: Controller, timestep: float) -> tuple[float, float]:
    """Returns gain and disk margin of the implemented loop, cut at all forces."""
    if not controller.acts:
        return ANY
    loop = loop_of(car, controller.feedback, timestep)
    cut = loop.cut(loop.forces)
    both = np.concatenate([FACTORS, 1 / FACTORS])
    growing = np.abs(np.linalg.eigvals(cut.loop_matrix(both))).max(axis=-1).reshape(2, -1) > 1 + 1e-9
    first = [FACTORS[int(np.argmax(row))] if row.any() else MOST_GAIN for row in growing]
    try:
        # The bilinear transform keeps the largest gain of the loop.
        law = LinearLaw(cut.A, cut.B, cut.C, cut.D, loop.period).continuous()
    except InputError:
        return float(min(first)), 0.0
    disk = disk_margin(StateSpace(law.A, law.B, law.C, law.D, cut.inputs, cut.outputs)).size
    return float(min(first)), disk


def with_ideal_margins(task: Task, controller: AnyController, usage: Usage) -> Usage:
    """Returns the use of limits with the margins of the ideal loop, too, which other commands print."""
    if controller.linear is not True or not controller.acts:
        return usage
    ideal = law_margins(task.line, controller)
    gain = min(ideal.gain, 1 / ideal.gain_lower if ideal.gain_lower else math.inf, usage.gain_margin)
    return replace(usage, gain_margin=gain, disk=usage.disk if ideal.disk is None else min(usage.disk, ideal.disk))
