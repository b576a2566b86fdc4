"""Rating of a candidate in linear analysis: expected metrics over the road, and stability margins."""

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from sim.studies.recommend import GOALS
from sim.studies.recommend.task import ROADS, WINDOW, Contender, Task
from sim.studies.recommend.within import MOST_GAIN, Usage
from sim.studies.ride.expected import expect
from sim.studies.ride.scores import score_of
from synth.controller.controller import Controller
from synth.controller.disk_margin import disk_margin
from synth.controller.loop_of import loop_of
from synth.controller.stability_margins import bilinear
from synth.plant.loop import Loop
from synth.plant.state_space import StateSpace

# Step between the gain factors to try, in powers of e; number of bisections; and end of the range, as a power of the limit
GRID, HALVINGS, BEYOND = 0.144, 6, 1.1
NEARLY = 1e-6
SWEEP = (0.3, 3e3, 200)  # lowest and highest frequency of the sweep [rad/s], and number of frequencies
EXCESS = 4.0  # penalty for exceeding a limit by a factor e, relative to the goal's value for the passive vehicle


@dataclass(frozen=True, eq=False)
class Rating:
    """Metrics of a candidate, and how much of each limit it uses.

    Attributes:
        values: metrics in the comparison of controllers, by key [SI]; None if the vehicle lacks the metric or a run was aborted.
        usage: quantities to compare with the limits.
    """

    values: Mapping[str, float | None]
    usage: Usage

    def value(self, task: Task) -> float:
        """Returns the value that the goal minimises; infinite if a run was aborted."""
        value = self.values.get(GOALS[task.goal])
        return math.inf if value is None else value

    def penalised(self, task: Task, factors: Mapping[str, float] | None = None) -> float:
        """Returns the value that the goal minimises, plus a penalty for exceeded limits.

        Args:
            factors: factors by which the used share of each limit is multiplied, by name; 1 if not given.
        """
        used = {name: (factors or {}).get(name, 1.0) * one for name, one in task.within.used(self.usage).items()}
        return self.value(task) + EXCESS * task.usual * sum(math.log(max(one, 1.0)) for one in used.values())


def rate_expected(task: Task, candidate: Contender) -> Rating | None:
    """Returns the rating of a candidate over the design road; None if the candidate's loop is unstable or not linear."""
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
    return Rating(values, Usage(stroke, force, *margins_of(task, one, rough=True), *lifts))


def margins_of(task: Task, controller: Controller, rough: bool = False) -> tuple[float, float]:
    """Returns the gain margin and the disk margin at all forces; each is the smaller one of implemented and ideal loop.

    Args:
        rough: True for a fast search: gain factors only up to the limit to the power `BEYOND`, disk margin on a frequency grid.
    """
    if not controller.acts:
        return MOST_GAIN, 2.0
    most = (task.within.gain_margin or 1.0) ** BEYOND if rough else MOST_GAIN
    pairs = [_margins(loop_of(task.line, controller.feedback, task.coarse_step), most, rough)]
    with suppress(InputError):  # without delay, the ideal loop has no solution if the measurements contain the force
        pairs.append(_margins(loop_of(task.line, controller.feedback), most, rough))
    gains, disks = zip(*pairs, strict=True)
    return min(gains), min(disks)


def _margins(loop: Loop, most: float, rough: bool) -> tuple[float, float]:
    cut, factors = loop.cut(loop.forces), np.exp(np.arange(0.0, math.log(most) + GRID, GRID))[1:]

    def grows(factors: Array) -> Array:
        poles = np.linalg.eigvals(cut.loop_matrix(factors))
        return np.any(np.abs(poles) > 1 + 1e-9 if loop.period else poles.real > 1e-9, axis=-1)

    growing, gain = grows(np.concatenate([factors, 1 / factors, [1.0]])), most
    if growing[-1]:
        return 1.0, 0.0
    for power, row in zip((1.0, -1.0), growing[:-1].reshape(2, -1), strict=True):
        if row.any():
            high = float(factors[int(np.argmax(row))])
            low = high * math.exp(-GRID)
            for _ in range(HALVINGS):
                middle = math.sqrt(low * high)
                low, high = (low, middle) if grows(np.array([middle**power]))[0] else (middle, high)
            gain = min(gain, low)
    if rough:
        return gain, _disk_by_sweep(cut)
    # poles are moved slightly inwards, because the bilinear transform does not map a pole at z = -1
    cut = replace(cut, A=(1 - NEARLY) * cut.A) if loop.period else cut
    return gain, disk_margin(bilinear(cut) if loop.period else cut).size


def _disk_by_sweep(cut: StateSpace) -> float:
    """Returns the disk margin over a grid and the pole frequencies; it is at least the true margin."""
    poles, modes = np.linalg.eig(cut.loop_matrix(1.0))
    rates = np.log(poles[np.abs(poles) > NEARLY].astype(complex)) / cut.dt if cut.dt else poles
    omega = np.concatenate([np.geomspace(*SWEEP), *(share * np.abs(rates) for share in (0.97, 1.0, 1.03))])
    inverse = np.linalg.inv(np.eye(len(cut.D)) - cut.D)
    s = np.exp(1j * np.minimum(omega * cut.dt, np.pi)) if cut.dt else 1j * omega
    left, right = inverse @ cut.C @ modes, np.linalg.solve(modes, cut.B @ inverse)
    S = inverse + (left / (s[:, None, None] - poles)) @ right
    return min(1 / float(np.linalg.svd(S - np.eye(len(cut.D)) / 2, compute_uv=False).max()), 2.0)
