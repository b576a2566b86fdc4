"""The smallest amount of something that makes a loop unstable in MuJoCo, and runs on both sides of it.

The derivative of MuJoCo's step decides whether a loop grows (`simulated_loop.py`). Two runs confirm an edge, one that decays and
one that grows. Each starts in the slowest mode of its loop, so that its growth is seen at once, and takes as long as the rate of
that mode needs.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from models.common.arrays import Array
from models.common.extensions import OBSERVERS
from models.roads.obstacles import Flat
from models.vehicle.vehicle import Vehicle
from sim.drive.case import Case
from sim.drive.drive import drive
from sim.studies.stability.simulated_loop import LoopCase, SimulatedLoop, simulated_loop
from synth.plant.state_space import StateSpace

WIDTH = 2e-3  # relative; of the bracket of a real number
AROUND = 0.25, 0.6, 0.9, 0.98, 1.02, 1.2, 1.5, 2.5, 4.0, 8.0  # times what is expected
CHANGE = 0.1  # of the size of a mode over its run, where it moves as much in time
SHORTEST, LONGEST, SLOW = 0.05, 0.15, 4.0  # s; of a run, unless its delay is longer, and of a slow mode
CLEAR = 1e-5  # change of a mode over its run that is told from geometry and rounding
SLOWEST = 8.0  # s; longer delays and sample periods are not run


def no_progress(message: str) -> None:
    """Ignores progress."""


@dataclass(eq=False)
class StabilityEdge:
    """Search for the smallest amount of something that makes a loop unstable.

    Attributes:
        step: derivative of MuJoCo's step.
        trial: amount -> the loop with it.
        expected: amount to start from; infinite if no amount is expected to matter.
        most: largest amount to try then.
        multiple: amounts are its multiples; 0 where they are real numbers.
        stable: largest amount below `unstable` that is known to decay. Zero is taken to decay.
        unstable: smallest amount that grows; infinite if none does.
        searched: True once it has been searched.
        runs: rates of the runs on both sides by their amounts [1/s]; NaN if a run is too short to tell its rate.
    """

    step: StateSpace
    trial: Callable[[float], LoopCase]
    expected: float
    most: float
    multiple: float = 0.0
    stable: float = 0.0
    unstable: float = math.inf
    searched: bool = False
    runs: dict[float, float] = field(default_factory=dict)
    _loops: dict[float, SimulatedLoop] = field(default_factory=dict)

    @property
    def timestep(self) -> float:
        """Timestep of the physics [s]."""
        assert self.step.dt is not None
        return self.step.dt

    @property
    def decided(self) -> bool:
        """Returns False if a run on one side does not tell its rate."""
        return not any(map(math.isnan, self.runs.values()))

    @property
    def confirmed(self) -> bool:
        """Returns False if a run decays where the derivative grows, or grows where it decays."""
        return not any(not math.isnan(rate) and (rate > 0) != (amount == self.unstable) for amount, rate in self.runs.items())

    @property
    def found(self) -> float:
        """Returns the middle of the two, for a real number; NaN if no run decides it."""
        return math.nan if not self.decided else math.sqrt(self.stable * self.unstable)

    def loop(self, amount: float) -> SimulatedLoop:
        """Returns the loop in MuJoCo with an amount."""
        if amount not in self._loops:
            self._loops[amount] = simulated_loop(self.step, self.trial(amount))
        return self._loops[amount]

    def search(self) -> None:
        """Searches by the derivative."""

        def grows(amount: float) -> bool:
            return self.loop(amount).grows

        self.stable, self.unstable = smallest_unstable(grows, self.expected, self.most, self.multiple)
        self.searched = True


def smallest_unstable(grows: Callable[[float], bool], expected: float, most: float, multiple: float = 0.0) -> tuple[float, float]:
    """Returns the largest amount that decays and the smallest that grows, next to each other; arguments as in `StabilityEdge`.

    The search looks at both sides of the expected amount first, and else begins at the smallest amount.
    """

    def multiples(amounts: Sequence[float]) -> list[float]:
        if multiple:
            amounts = [max(1, round(amount / multiple)) * multiple for amount in amounts]
        return sorted(set(amounts))

    if math.isinf(expected):
        amounts = multiples(np.geomspace(multiple or most / 32, most, 4)[1:].tolist())
    else:
        near, below = WIDTH / 2.1 * expected, math.floor(expected / multiple) * multiple if multiple else 0.0
        low, high = (below, below + multiple) if multiple else (expected - near, expected + near)
        if grows(high) and not (low and grows(low)):
            return low, high
        amounts = multiples([share * expected for share in AROUND])
    stable, unstable = 0.0, math.inf
    for amount in amounts:
        if grows(amount):
            unstable = amount
            break
        stable = amount
    while math.isfinite(unstable) and unstable - stable > (1.5 * multiple or WIDTH * unstable):
        (middle,) = multiples([(stable + unstable) / 2])
        stable, unstable = (stable, middle) if grows(middle) else (middle, unstable)
    return stable, unstable


def search_and_run(edges: Sequence[StabilityEdge], progress: Callable[[str], None] = no_progress) -> None:
    """Searches for edges of one timestep, and runs both sides of each, all in one batch, if `Growth` is among the observers."""
    for number, edge in enumerate(edges):
        progress(f"{len(edges) - number} margins to go")
        edge.search()
    both = [(edge, amount) for edge in edges if math.isfinite(edge.unstable) for amount in (edge.stable, edge.unstable)]
    due = [(edge, amount) for edge, amount in both if amount and "growth" in OBSERVERS]
    progress(f"{len(due)} runs")
    rates = rates_of_runs([edge.trial(amount) for edge, amount in due], [edge.loop(amount) for edge, amount in due])
    for (edge, amount), rate in zip(due, rates, strict=True):
        edge.runs[amount] = rate
    progress("")


def rates_of_runs(trials: Sequence[LoopCase], loops: Sequence[SimulatedLoop]) -> list[float]:
    """Returns the rate of each run of MuJoCo that starts in the slowest mode of its loop [1/s]; NaN if it moves too little."""
    if not trials:
        return []
    vehicles, timestep = [_without_rate_limit(trial.vehicle) for trial in trials], loops[0].loop.step or 0.0
    starts = [loop.start(vehicle.limits.actuator_force) for loop, vehicle in zip(loops, vehicles, strict=True)]
    lengths = [round(_duration(loop) / loop.loop.period) * round(loop.loop.period / timestep) for loop in loops]
    flat = Flat()
    cases = [
        Case(vehicle, trial.controller.feedback, flat, start, trial.undelayed_controller)
        for vehicle, trial, start in zip(vehicles, trials, starts, strict=True)
    ]
    (states,) = drive(cases, np.arange(max(lengths) + 1) * timestep, partial(OBSERVERS.load("growth"), lengths), streamed=True)
    return [
        _rate(state, one.start.motion, loop, end * timestep)
        for state, one, loop, end in zip(states, cases, loops, lengths, strict=True)
        if one.start is not None
    ]


def _without_rate_limit(vehicle: Vehicle) -> Vehicle:
    """Returns the vehicle without its rate limit, so that a mode is that of the linear loop; itself if it has no such limit."""
    limits = vehicle.limits
    return vehicle if limits.force_rate is None else replace(vehicle, limits=replace(limits, force_rate=None))


def _duration(loop: SimulatedLoop) -> float:
    """Returns how long a run takes [s]: until its mode has changed, or all pending forces have acted."""
    rate = max(abs(loop.rate), CLEAR / SLOW)
    needed = min(max(CHANGE / rate, SHORTEST), max(LONGEST, min(20 * CLEAR / rate, SLOW)))
    return max(math.ceil(needed / loop.loop.period), loop.delay + 2) * loop.loop.period


def _rate(state: Array, start: Array, loop: SimulatedLoop, duration: float) -> float:
    """Returns the rate of a mode between two states of a run [1/s]; NaN if it moves too little."""
    mode = loop.slowest[1][: len(state)]
    basis = np.stack([np.real(mode), -np.imag(mode)], axis=1)
    if not np.all(np.isfinite(state)):
        return math.inf
    sizes = np.linalg.norm(np.linalg.lstsq(basis, np.stack([start[: len(state)], state], axis=1))[0], axis=0)
    change = math.log(sizes[1] / sizes[0]) if sizes.all() else -math.inf
    return math.nan if abs(change) < CLEAR else change / duration
