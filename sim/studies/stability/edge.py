"""Search for a stability limit in MuJoCo: the smallest gain factor, delay or sample period that makes a loop unstable.

Gain factor, delay and sample period are each called the *amount* of a search.

The derivative of MuJoCo's step shows whether a loop is stable (`simulated_loop.py`). Two runs then confirm the stability limit,
because one of them decays and the other grows. Each run starts in the slowest mode of its loop, so that growth or decay is
visible from the start. The duration of a run depends on the growth or decay rate of the slowest mode.
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

WIDTH = 2e-3  # a search ends when the relative width of the interval between stable and unstable amounts is at most this
# amounts (such as gain factors or delays) to try, relative to the expected limit
AROUND = 0.25, 0.6, 0.9, 0.98, 1.02, 1.2, 1.5, 2.5, 4.0, 8.0
CHANGE = 0.1  # a run may end after a mode has changed by this relative amount
# Durations of the shortest run, of the longest run, and of the longest run of a slow mode [s]. A run with a large delay may be
# longer.
SHORTEST, LONGEST, SLOW = 0.05, 0.15, 4.0
CLEAR = 1e-5  # smallest relative change of a mode over a run that geometry or rounding cannot have caused
SLOWEST = 8.0  # s; longest delay, and longest sample period, that is simulated in MuJoCo


def no_progress(message: str) -> None:
    """Ignores the message about progress."""


@dataclass(eq=False)
class StabilityEdge:
    """Search for the smallest gain factor, delay or sample period (the amount) that makes a loop unstable.

    Attributes:
        step: derivative of MuJoCo's step, see `step_derivative`.
        trial: function that returns the loop for an amount, which is a gain factor, delay or sample period.
        expected: predicted stability limit, at which the search starts; infinite if every amount is predicted to be stable.
        most: largest amount that the search tries if `expected` is infinite.
        multiple: step of the amounts if only integer multiples of this step are allowed; 0 if any positive amount is allowed.
        stable: largest amount below `unstable` that was found to be stable. An amount of zero is assumed to be stable.
        unstable: smallest amount that was found to be unstable; infinite if all tried amounts are stable.
        searched: True after the search has ended.
        runs: growth rate of each run below and above the limit [1/s], by amount; NaN if a run is too short to show the rate.
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
        """Timestep of the simulation [s]."""
        assert self.step.dt is not None
        return self.step.dt

    @property
    def decided(self) -> bool:
        """False if a run is too short to show the growth rate of its mode."""
        return not any(map(math.isnan, self.runs.values()))

    @property
    def confirmed(self) -> bool:
        """False if a run grows although the derivative of MuJoCo's step predicts decay, or decays although growth is
        predicted.
        """
        return not any(not math.isnan(rate) and (rate > 0) != (amount == self.unstable) for amount, rate in self.runs.items())

    @property
    def found(self) -> float:
        """Stability limit if the amount may be any real number: the geometric mean of `stable` and `unstable`; NaN if the runs
        are not decisive.
        """
        return math.nan if not self.decided else math.sqrt(self.stable * self.unstable)

    def loop(self, amount: float) -> SimulatedLoop:
        """Returns the MuJoCo loop for an amount, which is a gain factor, delay or sample period."""
        if amount not in self._loops:
            self._loops[amount] = simulated_loop(self.step, self.trial(amount))
        return self._loops[amount]

    def search(self) -> None:
        """Searches for the stability limit with the derivative of MuJoCo's step, without runs."""

        def grows(amount: float) -> bool:
            return self.loop(amount).grows

        self.stable, self.unstable = smallest_unstable(grows, self.expected, self.most, self.multiple)
        self.searched = True


def smallest_unstable(grows: Callable[[float], bool], expected: float, most: float, multiple: float = 0.0) -> tuple[float, float]:
    """Returns the ends of an interval that contains the stability limit: a stable amount and an unstable amount.

    The search first tries an amount on each side of the expected limit. If the limit is not between the two amounts that are
    tried first, the search begins again at the smallest amount.

    Args:
        grows: function that returns True if the loop is unstable for an amount.
        expected, most, multiple: attributes of the search, see `StabilityEdge`.
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
    """Searches for stability limits, and simulates two runs at each limit, one on each side; all runs form one batch.

    No run is simulated if the observer `growth` is not installed.

    Args:
        edges: searches for stability limits, all with the same timestep.
        progress: callback that receives a line about the progress.
    """
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
    """Simulates runs that each start in the slowest mode of a loop; returns the growth rates of these modes [1/s].

    A growth rate is NaN if the mode changes too little during the run.
    """
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
    """Returns the vehicle without a limit on the rate of control forces, so that the motion stays linear."""
    limits = vehicle.limits
    return vehicle if limits.force_rate is None else replace(vehicle, limits=replace(limits, force_rate=None))


def _duration(loop: SimulatedLoop) -> float:
    """Returns a duration [s] of a run, long enough for a clear change of the mode and for all pending forces to act."""
    rate = max(abs(loop.rate), CLEAR / SLOW)
    needed = min(max(CHANGE / rate, SHORTEST), max(LONGEST, min(20 * CLEAR / rate, SLOW)))
    return max(math.ceil(needed / loop.loop.period), loop.delay + 2) * loop.loop.period


def _rate(state: Array, start: Array, loop: SimulatedLoop, duration: float) -> float:
    """Returns the growth rate of a mode, computed from two states of a run [1/s]; NaN if the mode changes too little.

    Args:
        state: state of the loop at the end of the run, shape (n,).
        start: state of the loop at the start of the run, shape (n,).
        loop: loop that the run simulated.
        duration: duration of the run [s].
    """
    mode = loop.slowest[1][: len(state)]
    basis = np.stack([np.real(mode), -np.imag(mode)], axis=1)
    if not np.all(np.isfinite(state)):
        return math.inf
    sizes = np.linalg.norm(np.linalg.lstsq(basis, np.stack([start[: len(state)], state], axis=1))[0], axis=0)
    change = math.log(sizes[1] / sizes[0]) if sizes.all() else -math.inf
    return math.nan if abs(change) < CLEAR else change / duration
