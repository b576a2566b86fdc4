"""Growth or decay: what becomes of a loop in MuJoCo after a tiny bump.

A run that grows is unstable, one that decays is not. One that has settled into neither is run again, for twice as long.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.vehicle import Vehicle
from sim.physics.simulate import simulate
from sim.roads.road import Bump
from sim.stability.slowest_mode import slowest_rate
from synth.controller import Controller

BUMP = Bump(height=2e-3, length=20.0, speed=100.0, track="left")  # body and wheels, every roll; soon over for all wheels
TIMESTEP = 5e-4  # s, unless another is asked for
SHORTEST, LONGEST = 4.0, 32.0  # s; how long a run is first, and at most
HOLDS = 24  # of its controller's sample periods, or delays, a run has at least: what alternates from one to the next grows slowly
CERTAIN, EXPONENTIAL = 0.02, 0.3  # of the logarithm of energy from window to window: its size, its spread
FREE = 0.125  # of a run, after which the bump is over
LINEAR = 25.0  # growth of energy before a wheel may lift
GONE, ESCAPED = 1e-12, 1e4  # of the energy that the bump has left: nothing, and what no decaying run has between
ENTRIES = 2e7  # numbers in a batch's record; more run in turns


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
    """Whether runs grow, and how fast. Those that have not settled into growth or decay are run again, for twice as long."""
    found: list[Growth | None] = [None] * len(trials)
    duration = SHORTEST
    while True:
        open_ones = [i for i, growth in enumerate(found) if growth is None]
        if not open_ones:
            break
        time = np.arange(round(duration / timestep) + 1) * timestep
        signals = len(trials[0].vehicle.kind.signals)
        together = max(1, int(ENTRIES / (len(time) * signals)))
        for first in range(0, len(open_ones), together):
            progress(f"{len(open_ones) - first} runs of {duration:g} s to go")
            some = open_ones[first : first + together]
            states = _states([trials[i] for i in some], time)
            for i, one in zip(some, states, strict=True):
                enough = HOLDS * _hold(trials[i], timestep)
                rate = _rate(one, timestep, round(_hold(trials[i], timestep) / timestep))
                grows = _grows(one, rate, last=duration >= max(LONGEST, enough))
                if grows or (grows is False and duration >= enough):
                    found[i] = Growth(grows, rate)
        duration *= 2
    progress("")
    return [growth for growth in found if growth is not None]


def _hold(trial: Trial, timestep: float) -> float:
    """How long a measurement acts, or waits to [s]."""
    how = trial.vehicle.implementation
    return (how.sample_period or timestep) * (1 + how.delay)


def _states(trials: Sequence[Trial], time: Array) -> Array:
    """All states over time, each over its peak in the first half second, shape (N, n, T); infinite from where a run diverges."""
    vehicles, controllers = [trial.vehicle for trial in trials], [trial.controller for trial in trials]
    undelayed = [trial.undelayed for trial in trials] if any(trial.undelayed for trial in trials) else None
    response = simulate(vehicles, controllers, [BUMP] * len(trials), time, threads=0, undelayed=undelayed).response
    states = np.stack([response[name] for name in trials[0].vehicle.linear_model.states], axis=1)
    peaks = np.nanmax(np.abs(states[..., time < 0.5]), axis=-1, keepdims=True)
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
    that is told by the rate of its slowest mode, where that is known.
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
    if last or (settled and late > 0):
        return late > 0
    for sign in (np.ones(length), (-1.0) ** np.arange(length)):
        before, after = (float(((states[:, window] @ (sign * hann)) ** 2).sum()) for window in windows[1:])
        if after >= max(before, gone):
            return True if rate > 0 else None
    if settled:
        return False
    return None if math.isnan(rate) else rate > 0
