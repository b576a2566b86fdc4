"""Growth or decay of a loop in MuJoCo after a tiny bump.

A run that grows is unstable, one that decays is not. What its sampled loop does is known exactly. A run ends as soon as its
slowest mode is that of the loop, or if it continues as the loop does from the run's own past. Otherwise it has to settle by
itself. A run that has not settled after a first, short duration is repeated, and checked each time that its length has doubled. A
run that takes long from the outset continues instead.
"""

import functools
import math
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np

from models.common.arrays import Array
from models.common.threads import cores, side_by_side
from models.roads.road import Bump, RoadInput
from models.vehicle.vehicle import Vehicle
from sim.physics.run_blocks import BatchInputs, in_blocks
from sim.physics.sensor_readout import stage_of
from sim.physics.simulate import held_on, met_alike, shared
from sim.studies.stability.late_loop import LateLoop, late_loop
from sim.studies.stability.slowest_mode import slowest_rate
from synth.controller.controller import Controller

BUMP = Bump(height=2e-5, length=20.0, speed=100.0, track="left")  # body and wheels, every roll; soon over; lifts none
EARLIER = replace(BUMP, height=2e-3)  # which logs of earlier versions were driven over
SOON = 2.0  # s; when a run is looked at first: its bump is over, and modes are told from each other
SHORTEST, LONGEST = 4.0, 32.0  # s; how long a run is first, and one that has not settled by then
CONFIRMED = 1e-2  # relative; how close the rate that is found in a run is to its loop's, where both are of the same mode
FREE_FROM = 0.5  # s; when the bump is over for every wheel
FOLLOWS = 1e-3  # of what is left of a run: how far it may be from what its loop makes of it
SAME_SIGN = 2 / 3  # of what the slowest mode grows or decays by: how far a run may be from that
STANDS = 1e-9  # change of a mode in the longest run that is none: an integrator's without its reading
CREEPING = 0.06  # the same, of a mode that is not told from one that stands: rates of runs are about 5e-4 1/s off
PASSES = 3  # of its controller's sample periods, or delays, a run has at least for that
HOLDS = 24  # of its controller's sample periods, or delays, a run has at least: what alternates from one to the next grows slowly
STILL = 2  # of them without motion are enough: then nothing is on its way either
CERTAIN, EXPONENTIAL = 0.02, 0.3  # of the logarithm of energy from window to window: its size, its spread
FREE = 0.125  # of a run, after which the bump is over
CREEPS = 3.0  # time constants of its slowest mode that a run has at least where a controller has states: some are slow, and faint
LINEAR = 25.0  # growth of energy before a wheel may lift
GONE, ESCAPED = 1e-12, 1e4  # of the energy that the bump has left: nothing, and what no decaying run has between
TOGETHER = 16  # runs in a batch at most: more hardly save time, and a batch goes on until its last run has settled
ENTRIES = 1e7  # numbers in a batch's record


@dataclass(frozen=True, eq=False)
class Trial:
    """Run that grows or decays.

    Attributes:
        vehicle: vehicle with its implementation of the controller.
        controller: the controller.
        undelayed: second controller, whose forces act at every timestep without delay, or None.
    """

    vehicle: Vehicle
    controller: Controller
    undelayed: Controller | None = None


@dataclass(frozen=True)
class Growth:
    """Result of a growth test.

    Attributes:
        grows: True if the run grows, False if it decays.
        rate: rate of its slowest mode [1/s], or NaN if too little of the run was free and linear.
        decided: False if the loop's slowest mode creeps so that the run does not show it; `grows` is then the loop's own.
    """

    grows: bool
    rate: float = math.nan
    decided: bool = True


def no_progress(message: str) -> None:
    """Ignores progress."""


def grows(trials: Sequence[Trial], timestep: float, progress: Callable[[str], None] = no_progress) -> list[Growth]:
    """Tests runs for growth, and finds their rates. Unsettled runs start again, and run until they settle."""
    growths_by_trial: dict[int, Growth] = {}
    for least in (SHORTEST, LONGEST):
        going = [i for i in range(len(trials)) if i not in growths_by_trial]
        if not going:
            break
        batches = [[going[i] for i in batch] for batch in _batches([trials[i] for i in going], timestep, least)]
        progress(f"{len(going)} runs to go")
        pieces = [functools.partial(_settled, [trials[i] for i in batch], timestep, least) for batch in batches]
        with closing(side_by_side(pieces, cores())) as done:
            for number, growths in done:
                growths_by_trial |= {batches[number][i]: growth for i, growth in growths.items()}
                progress(f"{len(trials) - len(growths_by_trial)} of {len(trials)} runs to go")
    progress("")
    return [growths_by_trial[i] for i in range(len(trials))]


def _batches(trials: Sequence[Trial], timestep: float, least: float) -> list[list[int]]:
    """Groups trials into batches of equal computation and similar duration, the longest first.

    Therefore the numbers of a run are bit for bit independent of the others.
    """
    alike: dict[tuple[object, ...], list[int]] = {}
    for i, trial in enumerate(trials):
        how, laws = trial.vehicle.implementation, [one for one in (trial.controller, trial.undelayed) if one is not None]
        stage = max(stage_of(trial.vehicle, one.measured, timestep) for one in laws)
        memory = tuple(one.law.states for one in laws) if any(one.law.states for one in laws) else ()
        key = stage, memory, how.sample_period is None, how.ideal and trial.undelayed is None
        alike.setdefault(key, []).append(i)
    batches: list[tuple[float, list[int]]] = []
    for group in alike.values():
        group.sort(key=lambda i: -_enough(trials[i], timestep))
        while group:
            first = trials[group[0]]
            samples = _duration(first, timestep, least) / timestep
            states = len(first.vehicle.linear_model.states) + first.controller.law.states
            most = max(1, min(TOGETHER, int(ENTRIES / (samples * states))))
            share = shared(len(group), max(cores(), math.ceil(len(group) / most)))[0]
            batches.append((samples, group[share]))
            del group[share]
    return [batch for _, batch in sorted(batches, key=lambda one: -one[0] * len(one[1]))]


def _settled(trials: Sequence[Trial], timestep: float, least: float, stopped: Callable[[], bool]) -> dict[int, Growth]:
    """Returns what becomes of the trials of a batch that settle in time.

    They are looked at soon, each time that it has doubled, and when each has gone on for as long as it takes at least.
    """
    loops = [late_loop(trial.vehicle, trial.controller, trial.undelayed, timestep) for trial in trials]
    duration = max(_duration(trial, timestep, least) for trial in trials)
    time = np.arange(round(duration / timestep) + 1) * timestep
    vehicles, controllers = [trial.vehicle for trial in trials], [trial.controller.feedback for trial in trials]
    undelayed = [trial.undelayed for trial in trials] if any(trial.undelayed for trial in trials) else None
    inputs = met_alike([RoadInput(trial.vehicle, BUMP, time) for trial in trials])
    now, midway = (np.stack([getattr(each, what) for each in inputs], axis=1) for what in ("heights", "midway"))
    ends = [1 + round(at / timestep) for at in (SOON, *(SHORTEST * k for k in range(1, round(duration / SHORTEST) + 1)))]
    doubled = [SOON * 2**k for k in range(1 + round(math.log2(LONGEST / SOON)))]
    own = [_least(trial, timestep) for trial in trials]
    looks = {1 + round(at / timestep): at for at in (*doubled, *own)}
    names = [signal.name for signal in vehicles[0].kind.signals]
    rows = [names.index(name) for name in vehicles[0].linear_model.states]
    kept = [np.zeros((0, len(time)))] * len(trials)
    for i, trial in enumerate(trials):
        if trial.controller.law.states and loops[i] is not None:
            kept[i] = np.zeros((trial.controller.law.states + len(trial.controller.law.D), len(time)))
    states, diverged, going = (
        np.empty((len(trials), len(rows), len(time))),
        np.full(len(trials), np.inf),
        np.full(len(trials), True),
    )
    growths: dict[int, Growth] = {}
    course = BatchInputs(vehicles, controllers, now, midway, timestep, (0, *ends), undelayed, going, held=held_on(inputs))
    for block in in_blocks(course):
        end = block.start + len(block.values)
        states[:, :, block.start : end] = block.values[:, rows].transpose(2, 1, 0)
        for i in [i for i, one in enumerate(kept) if len(one)]:
            k = trials[i].controller.law.states
            kept[i][:k, block.start : end] = block.kept[:, i, :k].T
            last = block.requested_force[: len(time) - 1 - block.start, i].T  # a step later it is the force that acted
            kept[i][k:, block.start + 1 : block.start + 1 + last.shape[1]] = last
        diverged = np.minimum(diverged, block.diverged(time))
        if end in looks:
            for i in [j for j in np.flatnonzero(going).tolist() if looks[end] in (*doubled, own[j])]:
                seen, peaks = _over_its_peak(states[i, :, :end], time[:end], diverged[i])
                growth = _confirmed(trials[i], loops[i], seen, peaks, kept[i][:, :end], timestep, looks[end])
                if growth is None and looks[end] >= SHORTEST:
                    growth = _growth(trials[i], loops[i], seen, timestep, looks[end])
                if growth is not None and _creeps(loops[i], growth):
                    growth = Growth(not growth.grows, growth.rate, decided=False) if looks[end] >= LONGEST else None
                if growth is not None:
                    going[i], growths[i] = False, growth
        if stopped() or not going.any():
            break
    return growths


def _creeps(loop: LateLoop | None, growth: Growth) -> bool:
    """Returns True if a run contradicts its loop, whose slowest mode moves too little to be identified in the longest run."""
    creeps = loop is not None and abs(loop.rate) * LONGEST < CREEPING and growth.grows != (loop.rate > 0)
    return creeps and (not growth.grows or abs(growth.rate) * LONGEST < CREEPING)


def _confirmed(
    trial: Trial, loop: LateLoop | None, states: Array, peaks: Array, kept: Array, timestep: float, duration: float
) -> Growth | None:
    """Returns the growth of a run's loop if the run confirms it, or None.

    Args:
        states: states of the vehicle, each over its peak, shape (n, T).
        peaks: peaks of the states, shape (n,).
        kept: states of the law, and the forces that have acted just before, shape (k + m, T); none of a static law.
        duration: duration of the run [s].
    """
    if loop is None or not np.all(np.isfinite(states)) or not np.all(np.isfinite(kept)):
        return None
    hold = _hold(trial, timestep)
    rate = _rate(states, timestep, round(hold / timestep))
    within = CONFIRMED if duration < LONGEST else SAME_SIGN  # a mode that creeps has hardly moved in the longest run
    if abs(rate - loop.rate) <= within * abs(loop.rate):
        return Growth(rate > 0, rate)
    # Some law's states are more than these rows, with an actuator's lag.
    kept = kept[: max(len(loop.Phi) - len(states), 0)]
    if duration < PASSES * hold or len(loop.Phi) != len(states) + len(kept):
        return None
    sizes = np.abs(kept).max(axis=1, initial=0.0)
    sizes = np.where(sizes > 0, sizes, 1.0)
    each = round(loop.timestep / timestep)
    whole = np.vstack([states, kept / sizes[:, None]])[:, ::each]
    mode = _mode_followed(whole, loop.scaled(np.concatenate([peaks, sizes])))
    if mode is not None and abs(loop.rate) * LONGEST < STANDS:
        return Growth(False, rate)
    return None if mode is None else Growth(mode > 0, mode)


def _mode_followed(states: Array, loop: LateLoop) -> float | None:
    """Returns the rate of the slowest mode in a run that continues as its loop predicts from its own past, or None.

    The rate is that of the run, and may be off from the loop's by less than makes its sign doubtful.
    """
    first = loop.held * math.ceil(FREE_FROM / (loop.held * loop.timestep))
    rate, off = loop.slowest_mode(states, first)
    if not off <= SAME_SIGN and abs(loop.rate) * LONGEST >= STANDS:
        return None
    last = max(1, states.shape[1] // 4)
    left, beside = states[:, -last:], (states - loop.goes_on(states, first))[:, -last:]
    return rate if np.linalg.norm(beside) <= FOLLOWS * np.linalg.norm(left) else None


def _growth(trial: Trial, loop: LateLoop | None, states: Array, timestep: float, duration: float) -> Growth | None:
    """Returns the growth of a run of this duration [s], or None if it is too short.

    A run with another rate than its loop may hide a slower mode of it, faint as the bump has left it, until faster ones are gone.
    """
    enough = _enough(trial, timestep)
    rate = _rate(states, timestep, round(_hold(trial, timestep) / timestep))
    if trial.controller.law.states:
        slowest = min(abs(rate), math.inf if loop is None else abs(loop.rate))
        enough = max(enough, min(CREEPS / slowest, LONGEST) if slowest else LONGEST)
    elif _still(states, round(STILL * _hold(trial, timestep) / timestep)):
        enough = duration
    if _escaped(states):
        return Growth(True, rate)
    grows = _grows(states, rate, last=duration >= max(LONGEST, enough))
    # Two modes of a few holds that beat grow for a while; a rate that is found tells growth from that, if the loop grows, too.
    sure = duration >= enough or (grows is True and not math.isnan(rate) and (loop is None or loop.rate > 0))
    return Growth(grows, rate) if grows is not None and sure else None


def _duration(trial: Trial, timestep: float, least: float) -> float:
    """Returns how long a run is at most [s]: so long, or until it settles, as what takes longer is not begun twice.

    First, a run that can be compared with its loop is long enough for that.
    """
    own = _least(trial, timestep)
    if own > least == SHORTEST and not trial.controller.law.states and trial.vehicle.limits.actuator_bandwidth is None:
        return SHORTEST * math.ceil(PASSES * _hold(trial, timestep) / SHORTEST)
    return least if own <= least else max(LONGEST, own)


def _least(trial: Trial, timestep: float) -> float:
    """Returns the shortest duration after which a run can be found to decay [s]."""
    return SHORTEST * math.ceil(_enough(trial, timestep) / SHORTEST)


def _enough(trial: Trial, timestep: float) -> float:
    return HOLDS * _hold(trial, timestep)


def _hold(trial: Trial, timestep: float) -> float:
    """Returns the time for which a measurement acts or is delayed [s]."""
    how = trial.vehicle.implementation
    return (how.sample_period or timestep) * (1 + how.delay)


def _over_its_peak(states: Array, time: Array, diverged: float) -> tuple[Array, Array]:
    """States over time, each over its peak in the first half second, shape (n, T), infinite once it diverged; and the peaks."""
    states = np.where(time >= diverged, np.nan, states)
    peaks = np.nanmax(np.abs(states[:, time < 0.5]), axis=-1)
    peaks = np.where(peaks > 0, peaks, 1.0)
    return np.nan_to_num(states / peaks[:, None], nan=np.inf), peaks


def _rate(states: Array, timestep: float, hold: int) -> float:
    """The rate of a run's slowest mode [1/s], see `slowest_mode`, from when the bump is over until a wheel may lift."""
    free = states[:, round(FREE * states.shape[1]) :]
    with np.errstate(over="ignore"):
        energy = (free**2).sum(axis=0)
    far = ~(energy < LINEAR * energy[: len(energy) // 4].max())
    return slowest_rate(free[:, : int(far.argmax())] if far.any() else free, timestep, hold)


def _still(states: Array, samples: int) -> bool:
    """Returns whether nothing of a run is left over its last so many samples, and over its last quarter."""
    length = states.shape[-1] // 4
    with np.errstate(over="ignore"):
        energy = (states**2).sum(axis=0)
    return bool(energy[-max(length, samples) :].max() <= GONE * energy[:length].max())


def _escaped(states: Array) -> bool:
    """Returns True if a run has diverged, or is so large in its last quarter as no decaying one becomes."""
    length = states.shape[-1] // 4
    with np.errstate(over="ignore"):
        energy = (states**2).sum(axis=0)
    return not np.all(np.isfinite(energy)) or bool(energy[-length:].max() > ESCAPED * energy[:length].max())


def _grows(states: Array, rate: float, last: bool) -> bool | None:
    """Returns True if a run grows, False if it decays, or None if it has not settled yet.

    The test compares its energy in three windows, without the first quarter. A Hann window suppresses the oscillation within it,
    so that a settled run is an exponential: the same ratio from window to window. Two kinds of growth the bump hardly excites, so
    that decaying modes hide them: to one side, and from one side to the other with every step. The mean over a window shows them,
    plain and with alternating sign; nothing decays while they grow. For a run that is still unsettled the rate of its slowest
    mode decides, if that is known. If that rate contradicts the windows, faster modes hide a mode that creeps, or turns but once
    in the run: a longer run decides, and at last the rate.
    """
    length = states.shape[-1] // 4
    energy = (states**2).sum(axis=0)
    gone, hann = GONE * energy[:length].max(), _hann(length)
    first, second, third = _windows(states)
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
        before, after = (float(((states[:, k * length : (k + 1) * length] @ (sign * hann)) ** 2).sum()) for k in (2, 3))
        if after >= max(before, gone):
            return True if rate > 0 else None
    if settled:
        return False
    return None if math.isnan(rate) else rate > 0


def _windows(states: Array) -> list[float]:
    """The energy of a run in the last three quarters of it, each seen through a Hann window."""
    length = states.shape[-1] // 4
    energy, hann = (states**2).sum(axis=0), _hann(length)
    return [float(hann @ energy[k * length : (k + 1) * length]) for k in (1, 2, 3)]


def _hann(length: int) -> Array:
    hann = np.hanning(length)
    return hann / hann.sum()
