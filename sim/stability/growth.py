"""Growth or decay: what becomes of a loop in MuJoCo after a tiny bump.

A run that grows is unstable, one that decays is not. One that has settled into neither runs on, for twice as long.
"""

import functools
import math
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.common.cores import cores
from models.common.side_by_side import side_by_side
from models.roads.road import Bump
from models.vehicle import Vehicle
from sim.physics.blocks import Course, in_blocks
from sim.physics.readout import stage_of
from sim.physics.simulate import on_each, shared
from sim.stability.slowest_mode import slowest_rate
from synth.controller import Controller

BUMP = Bump(height=2e-3, length=20.0, speed=100.0, track="left")  # body and wheels, every roll; soon over for all wheels
TIMESTEP = 5e-4  # s, unless another is asked for
SHORTEST, LONGEST = 4.0, 32.0  # s; how long a run is first, and at most
HOLDS = 24  # of its controller's sample periods, or delays, a run has at least: what alternates from one to the next grows slowly
CERTAIN, EXPONENTIAL = 0.02, 0.3  # of the logarithm of energy from window to window: its size, its spread
FREE = 0.125  # of a run, after which the bump is over
CREEPS = 3.0  # time constants of its slowest mode that a run has at least where a controller has states: some are slow, and faint
LINEAR = 25.0  # growth of energy before a wheel may lift
GONE, ESCAPED = 1e-12, 1e4  # of the energy that the bump has left: nothing, and what no decaying run has between
TOGETHER = 16  # runs in a batch at most: more hardly save time, and a batch goes on until its last run has settled
ENTRIES = 1e7  # numbers in a batch's record


@dataclass(frozen=True, eq=False)
class Trial:
    """One run that grows or decays.

    Attributes:
        vehicle: with its implementation of the controller.
        controller: the controller.
        undelayed: a second one, whose forces act at every timestep, without delay, whatever the implementation; or None.
    """

    vehicle: Vehicle
    controller: Controller
    undelayed: Controller | None = None


@dataclass(frozen=True)
class Growth:
    """What became of a run.

    Attributes:
        grows: whether it grows; else it decays.
        rate: of the slowest mode in it [1/s]; NaN where too little of it was free and linear.
    """

    grows: bool
    rate: float = math.nan


def silent(message: str) -> None:
    """Shows no progress."""


def grow(trials: Sequence[Trial], timestep: float, progress: Callable[[str], None] = silent) -> list[Growth]:
    """Whether runs grow, and how fast. Those that have not settled into growth or decay run on, for twice as long."""
    found: dict[int, Growth] = {}
    batches = _batches(trials, timestep)
    progress(f"{len(trials)} runs to go")
    pieces = [functools.partial(_settled, [trials[i] for i in batch], timestep) for batch in batches]
    with closing(side_by_side(pieces, cores())) as done:
        for number, growths in done:
            found |= zip(batches[number], growths, strict=True)
            progress(f"{len(trials) - len(found)} of {len(trials)} runs to go")
    progress("")
    return [found[i] for i in range(len(trials))]


def _batches(trials: Sequence[Trial], timestep: float) -> list[list[int]]:
    """Which trials run in one batch, the longest first: such as take as long, and whose forces are computed alike.

    So what becomes of a run does not depend on the others, to the last bit.
    """
    alike: dict[tuple[object, ...], list[int]] = {}
    for i, trial in enumerate(trials):
        how, laws = trial.vehicle.implementation, [one for one in (trial.controller, trial.undelayed) if one is not None]
        stage = max(stage_of(trial.vehicle, one, timestep) for one in laws)
        states = tuple(one.law.states for one in laws)
        key = stage, states, how.sample_period is None, how.ideal and trial.undelayed is None
        alike.setdefault(key, []).append(i)
    batches: list[tuple[float, list[int]]] = []
    for group in alike.values():
        group.sort(key=lambda i: -_enough(trials[i], timestep))
        while group:
            first = trials[group[0]]
            samples = _duration(first, timestep) / timestep
            most = max(1, min(TOGETHER, int(ENTRIES / (samples * len(first.vehicle.kind.signals)))))
            share = shared(len(group), max(cores(), math.ceil(len(group) / most)))[0]
            batches.append((samples, group[share]))
            del group[share]
    return [batch for _, batch in sorted(batches, key=lambda one: -one[0] * len(one[1]))]


def _settled(trials: Sequence[Trial], timestep: float, stopped: Callable[[], bool]) -> list[Growth]:
    """What becomes of some runs in one batch; less than all of them once it is stopped."""
    found: dict[int, Growth] = {}
    duration = max(_duration(trial, timestep) for trial in trials)
    while (left := [i for i in range(len(trials)) if i not in found]) and not stopped():
        with closing(_watched([trials[i] for i in left], duration, timestep, stopped)) as growths:
            found |= ((left[i], growth) for i, growth in growths)
        duration *= 2
    return list(found[i] for i in sorted(found))


def _watched(
    trials: Sequence[Trial], duration: float, timestep: float, stopped: Callable[[], bool]
) -> Generator[tuple[int, Growth]]:
    """What becomes of the trials that settle within some time [s], which are looked at each time that it has doubled."""
    time = np.arange(round(duration / timestep) + 1) * timestep
    vehicles, controllers = [trial.vehicle for trial in trials], [trial.controller for trial in trials]
    undelayed = [trial.undelayed for trial in trials] if any(trial.undelayed for trial in trials) else None
    now, midway = (on_each(vehicles, [BUMP] * len(trials), "displacement", times) for times in (time, time + timestep / 2))
    ends = [1 + round(SHORTEST * k / timestep) for k in range(1, round(duration / SHORTEST) + 1)]
    doubled = {1 + round(SHORTEST * 2**k / timestep): SHORTEST * 2**k for k in range(len(ends).bit_length())}
    names = [signal.name for signal in vehicles[0].kind.signals]
    rows = [names.index(name) for name in vehicles[0].linear_model.states]
    states, diverged, going = (
        np.empty((len(trials), len(rows), len(time))),
        np.full(len(trials), np.inf),
        np.full(len(trials), True),
    )
    course = Course(vehicles, controllers, now, midway, timestep, (0, *ends), undelayed, going, accelerations=False)
    for block in in_blocks(course):
        end = block.start + len(block.values)
        states[:, :, block.start : end] = block.values[:, rows].transpose(2, 1, 0)
        diverged = np.minimum(diverged, block.diverged(time))
        if end in doubled:
            for i in np.flatnonzero(going).tolist():
                seen = _over_its_peak(states[i, :, :end], time[:end], diverged[i])
                if (growth := _growth(trials[i], seen, timestep, doubled[end])) is not None:
                    going[i] = False
                    yield i, growth
        if stopped() or not going.any():
            return


def _growth(trial: Trial, states: Array, timestep: float, duration: float) -> Growth | None:
    """What is made of a run that has gone for so long [s]; None where that is not enough."""
    enough = _enough(trial, timestep)
    rate = _rate(states, timestep, round(_hold(trial, timestep) / timestep))
    if trial.controller.law.states:
        enough = max(enough, min(CREEPS / abs(rate), LONGEST) if rate else LONGEST)
    grows = _grows(states, rate, last=duration >= max(LONGEST, enough))
    return Growth(grows, rate) if grows or (grows is False and duration >= enough) else None


def _duration(trial: Trial, timestep: float) -> float:
    """How long a run has to be before it can be said to decay [s]."""
    return SHORTEST * 2 ** max(0, math.ceil(math.log2(_enough(trial, timestep) / SHORTEST)))


def _enough(trial: Trial, timestep: float) -> float:
    return HOLDS * _hold(trial, timestep)


def _hold(trial: Trial, timestep: float) -> float:
    """How long a measurement acts, or waits to [s]."""
    how = trial.vehicle.implementation
    return (how.sample_period or timestep) * (1 + how.delay)


def _over_its_peak(states: Array, time: Array, diverged: float) -> Array:
    """States over time, each over its peak in the first half second, shape (n, T); infinite from where the run diverged."""
    states = np.where(time >= diverged, np.nan, states)
    peaks = np.nanmax(np.abs(states[:, time < 0.5]), axis=-1, keepdims=True)
    return np.nan_to_num(states / np.where(peaks > 0, peaks, 1.0), nan=np.inf)


def _rate(states: Array, timestep: float, hold: int) -> float:
    """The rate of a run's slowest mode [1/s], see `slowest_mode`, from when the bump is over until a wheel may lift."""
    free = states[:, round(FREE * states.shape[1]) :]
    with np.errstate(over="ignore"):
        energy = (free**2).sum(axis=0)
    far = ~(energy < LINEAR * energy[: len(energy) // 4].max())
    return slowest_rate(free[:, : int(far.argmax())] if far.any() else free, timestep, hold)


def _grows(states: Array, rate: float, last: bool) -> bool | None:
    """Whether a run grows; None where it has not settled yet.

    Its energy is taken in three windows, without the first quarter. A Hann window does not see the oscillation within it, so what
    is left of a run that has settled is an exponential: the same ratio from window to window. Two kinds of growth the bump hardly
    excites, so that they hide behind what decays: to one side, and from one side to the other with every step. They are told by
    the mean over a window, plain and with alternating sign, and nothing decays while they grow. A run that has not settled by
    that is told by the rate of its slowest mode, where that is known. Where that rate says otherwise than the windows, a mode
    that creeps, or turns but once in the run, is hidden in them by what is faster: a longer run tells, and at last the rate.
    """
    length = states.shape[-1] // 4
    hann = np.hanning(length)
    hann /= hann.sum()
    with np.errstate(over="ignore"):
        energy = (states**2).sum(axis=0)
    if not np.all(np.isfinite(energy)) or energy[-length:].max() > ESCAPED * energy[:length].max():
        return True
    gone = GONE * energy[:length].max()
    windows = [slice(k * length, (k + 1) * length) for k in (1, 2, 3)]
    first, second, third = (float(hann @ energy[window]) for window in windows)
    if third <= gone:
        return False
    early, late = math.log(second / first), math.log(third / second)
    settled = abs(late) > CERTAIN and abs(late - early) < EXPONENTIAL * abs(late)
    if last:
        return late > 0 if math.isnan(rate) else rate > 0
    if settled and rate * late < 0:
        return None
    if settled and late > 0:
        return True
    for sign in (np.ones(length), (-1.0) ** np.arange(length)):
        before, after = (float(((states[:, window] @ (sign * hann)) ** 2).sum()) for window in windows[1:])
        if after >= max(before, gone):
            return True if rate > 0 else None
    if settled:
        return False
    return None if math.isnan(rate) else rate > 0
