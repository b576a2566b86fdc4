"""Growth or decay: what becomes of a loop in MuJoCo after a tiny bump.

A run that grows is unstable, one that decays is not. One that has settled into neither is run again, for twice as long.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from models.arrays import Array
from models.vehicle import Vehicle
from sim.physics import simulate
from sim.road import Bump
from synth.controller import Controller

BUMP = Bump(height=2e-3, length=20.0, speed=100.0, track="left")  # body and wheels, every roll; soon over for all wheels
SHORTEST, LONGEST = 4.0, 32.0  # s; how long a run is first, and at most
HOLDS = 24  # of its controller's sample periods, or delays, a run has at least: what alternates from one to the next grows slowly
CERTAIN, EXPONENTIAL = 0.02, 0.3  # of the logarithm of energy from window to window: its size, its spread
PURE, LINEAR = 0.1, 25.0  # the spread with which a rate is one; growth of energy before a wheel may lift
GONE, ESCAPED = 1e-12, 1e4  # of the energy that the bump has left: nothing, and what no decaying run has between
ENTRIES = 2e7  # numbers in a batch's record; more run in turns


@dataclass(frozen=True, eq=False)
class Trial:
    """One run that grows or decays.

    Attributes:
        vehicle: with its implementation of the controller.
        controller: the controller.
        at_once: a second one, whose forces act at every timestep, without delay, whatever the implementation; None where there is
            none.
    """

    vehicle: Vehicle
    controller: Controller
    at_once: Controller | None = None


@dataclass(frozen=True)
class Growth:
    """What became of a run.

    Attributes:
        grows: whether it grows; else it decays.
        rate: of its exponential [1/s]; NaN where it was gone, had escaped, or was still another before that could be read.
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
                growth = _growth(one, timestep, last=duration >= max(LONGEST, enough))
                found[i] = growth if growth and (growth.grows or duration >= enough) else None
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
    at_once = [trial.at_once for trial in trials] if any(trial.at_once for trial in trials) else None
    response = simulate(vehicles, controllers, [BUMP] * len(trials), time, threads=0, at_once=at_once).response
    states = np.stack([response[name] for name in trials[0].vehicle.linear_model.states], axis=1)
    peaks = np.nanmax(np.abs(states[..., time < 0.5]), axis=-1, keepdims=True)
    return np.nan_to_num(states / np.where(peaks > 0, peaks, 1.0), nan=np.inf)


def _growth(states: Array, timestep: float, last: bool) -> Growth | None:
    """Whether a run grows, and how fast; None where it has not settled yet.

    Its energy is taken in three windows, without the first quarter. A Hann window does not see the oscillation within it, so what
    is left of a run that has settled is an exponential: the same ratio from window to window. Two kinds of growth the bump hardly
    excites, so that they hide behind what decays: to one side, and from one side to the other with every step. They are told by
    the mean over a window, plain and with alternating sign, and nothing decays while they grow.
    """
    length = states.shape[-1] // 4
    hann = np.hanning(length)
    hann /= hann.sum()
    with np.errstate(over="ignore"):
        energy = (states**2).sum(axis=0)
    if not np.all(np.isfinite(energy)) or energy[-length:].max() > ESCAPED * energy[:length].max():
        return Growth(True)
    gone = GONE * energy[:length].max()
    windows = [slice(k * length, (k + 1) * length) for k in (1, 2, 3)]
    first, second, third = (float(hann @ energy[window]) for window in windows)
    if third <= gone:
        return Growth(False)
    early, late = math.log(second / first), math.log(third / second)
    pure = abs(late - early) < PURE * abs(late) and energy.max() < LINEAR * energy[:length].max()
    rate = late / (2 * length * timestep) if pure else math.nan  # energy goes with the square
    settled = abs(late) > CERTAIN and abs(late - early) < EXPONENTIAL * abs(late)
    if last or (settled and late > 0):
        return Growth(late > 0, rate)
    for sign in (np.ones(length), (-1.0) ** np.arange(length)):
        before, after = (float(((states[:, window] @ (sign * hann)) ** 2).sum()) for window in windows[1:])
        settled = settled and (after < before or after < gone)
    return Growth(False, rate) if settled else None
