"""N runs in MuJoCo, some samples at a time: what is read, what is asked for, what is recorded."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

import functools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from mujoco.batch import Batch

from models.common.arrays import Array
from models.laws.python_law import Programmed
from models.laws.semi_active import SemiActive
from models.vehicle.limits_and_implementation import Implementation, steps_per_sample
from models.vehicle.mjcf import build_model, quiet
from models.vehicle.vehicle import Vehicle
from sim.physics import RUNS_AT_ONCE
from sim.physics.drivers import (
    Again,
    Clipped,
    Damped,
    Dampers,
    Failure,
    Played,
    PythonLaws,
    RunDriver,
    SemiActiveLaws,
    dampers_of,
)
from sim.physics.sensor_readout import (
    Laws,
    LinearLaws,
    Readout,
    Sampler,
    force_from_road,
    laws_on,
    measured_by,
    mix,
    prepared,
    sensed_stage,
    signal_from_road,
)
from sim.physics.stepping import Alone, Push, Reading, step_batch
from synth.controller.controller import Controller

DIVERGED = 1e8  # a signal beyond this, in SI units, is no vehicle any more

# Of runs that are not kept whole:
MOST_HEIGHTS = 5_200_000  # of roads, 16 bytes each: 256 quarter-cars for 20 s at 1 ms


@dataclass(frozen=True, eq=False)
class Block:
    """Some consecutive samples of N runs.

    Attributes:
        start: index of the first.
        values: every signal but the road's velocity, which is left 0, shape (B, S, N): runs lie side by side.
        qpos: generalized positions, shape (B, N, nq).
        qvel: generalized velocities, shape (B, N, nv).
        largest: largest magnitude of any signal, and of any force that was asked for, shape (B, N).
        asked: the forces that were asked for [N], shape (B, N, m); of vehicles with adjustable dampers the commands, shape
            (B, N, 2 m), see `models.suspension.damper_range.Range.commands`.
        kept: what the states of linear laws were at their last sample, shape (B, N, k), with the k of the one that has most.
    """

    start: int
    values: Array
    qpos: Array
    qvel: Array
    largest: Array
    asked: Array
    kept: Array

    def diverged(self, time: Array) -> Array:
        """When each run first diverged in it [s], shape (N,), infinite where it did not; from all the samples' times."""
        wild = ~(self.largest < DIVERGED)  # NaN compares as wild
        return np.where(wild.any(axis=0), time[self.start + wild.argmax(axis=0)], np.inf)

    def clip(self) -> None:
        """Makes numbers of what a diverged run left, none beyond `DIVERGED`, in place."""
        np.nan_to_num(self.values, copy=False, nan=0.0, posinf=0.0, neginf=0.0)
        np.clip(self.values, -DIVERGED, DIVERGED, out=self.values)


def runs_at_once(samples: int, wheels: int) -> int:
    """How many runs of so many samples a batch that is taken in blocks has at most: as many as save time and fit into memory."""
    return max(1, min(RUNS_AT_ONCE, MOST_HEIGHTS // (samples * wheels)))


@dataclass(frozen=True, eq=False)
class Course:
    """N runs from rest that are to be stepped, each over its road.

    Attributes:
        vehicles: N vehicles of the same kind that read out alike, see `reads_out`.
        controllers: N controllers, all linear, all in Python, all semi-active, or all played.
        now: road heights at the samples [m], shape (T, N, r).
        midway: the same half a step later, where MuJoCo holds them.
        timestep: [s].
        edges: block k has the samples from `edges[k]` up to `edges[k + 1]`; the first is 0, the last at most T.
        undelayed: second controllers, whose forces come to those of the first and know no `[implementation]`; None for none.
        going: whether each run is still wanted, shape (N,), for the caller to change between blocks: one that is not wanted stays
            where it is, and what later blocks have of it means nothing. None where all are, to the end.
        beyond: road heights at the samples after the last [m], shape (E, N, r), of which laws in Python may be told; None where
            none is.
        failures: by run, laws in Python that have failed, for the caller to read: such a run goes on without forces. None where
            the first failure ends them all.
        accelerations: whether they and forces are recorded as of their sample; else, where an accelerometer is measured, as of
            the one before, which saves an evaluation of it.
        loads: on the bodies half a step after the samples, where MuJoCo holds them [N, N m], shape (T, N, l); None for none.
    """

    vehicles: Sequence[Vehicle]
    controllers: Sequence[RunDriver]
    now: Array
    midway: Array
    timestep: float
    edges: Sequence[int]
    undelayed: Sequence[Controller | None] | None = None
    going: Array | None = None
    beyond: Array | None = None
    failures: dict[int, Failure] | None = None
    accelerations: bool = True
    loads: Array | None = None


def in_blocks(course: Course) -> Iterator[Block]:
    """The runs of `simulate`, some samples at a time: nothing but the roads need be held whole."""
    (blocks,) = in_shares(course, [slice(None)])
    yield from blocks(lambda: False)


def in_shares(course: Course, shares: Sequence[slice]) -> list[Callable[[Callable[[], bool]], Iterator[Block]]]:
    """The blocks of each of some shares of the runs, to be stepped on a thread of their own, until told to give up.

    A run's numbers do not depend, to the last bit, on the runs of its controller beside it, on shares, or on blocks: sums over a
    run's few signals are taken one by one, never by a product of matrices whose order of summation depends on how many runs there
    are.

    A batch to each share, and a thread: faster than one batch on all threads, which wait while Python has its turn, and on a busy
    machine for each other.
    """
    vehicles, controllers, timestep, edges = course.vehicles, course.controllers, course.timestep, course.edges
    now, midway, undelayed, going = course.now, course.midway, course.undelayed, course.going
    vehicle = vehicles[0]
    model, readout = prepared(vehicle, timestep)
    distinct = {id(other): other for other in vehicles}
    hardware = {
        key: (*other.parameters.values(), *other.curves.values(), other.limits, *other.dampers.values())
        for key, other in distinct.items()
    }
    one_of = {hardware[key]: other for key, other in distinct.items()}
    models = {}
    if len(one_of) > 1:
        models = {key: build_model(other, timestep, drawn=False) for key, other in one_of.items()}
    before = np.concatenate([np.zeros_like(now[:1]), midway[:-1]])  # where the last step has left the road

    # What a controller measures is read before a step: from the state where it is linear in it, else from its sensor. To it comes
    # what that reading has not seen of the road.
    linear = [one if isinstance(one, Controller) else None for one in controllers]
    others = [one for one in controllers if not isinstance(one, Controller)]
    semi_active = [one for one in others if isinstance(one, SemiActive)]
    ways = [other.implementation for other in distinct.values()]
    ideal = undelayed is None and all(one.ideal for one in ways)
    if semi_active and ideal:
        K, memory = measured_by(readout.names, [one.measured for one in semi_active])
    else:
        K, memory = laws_on(readout.names, vehicles, linear, timestep)
    beside, beside_memory = np.zeros((1, 1, len(readout.names))), np.zeros(0)
    if undelayed is not None:
        beside, beside_memory = laws_on(
            readout.names, [replace(one, implementation=Implementation()) for one in vehicles], undelayed, timestep
        )
    of_state, of_sensors = np.where(readout.linear, K, 0), np.where(readout.linear, 0, K)
    named = np.isin(readout.names, [name for one in others for name in one.measured])
    needed = np.any(K != 0, axis=(0, 1)) | np.any(beside != 0, axis=(0, 1)) | named
    stage = sensed_stage(readout, needed)
    sensors = _span(readout.of_sensors[needed & ~readout.linear]) if stage else slice(0, 0)
    # An acceleration is read in an evaluation of its own: the road where it is now, and the force that has acted until now.
    fresh = stage > int(mujoco.mjtStage.mjSTAGE_VEL)
    unmoved = np.zeros_like(now) if fresh else now - before
    offset = force_from_road(of_state, now, readout) + force_from_road(of_sensors, unmoved, readout)
    gain = np.concatenate([of_state @ readout.of_state, of_sensors @ readout.of_sensors[:, sensors]], axis=-1)
    plain, held = ideal and len(others) == len(semi_active), {steps_per_sample(one, timestep) for one in ways}
    if undelayed is None and going is None and not (others or vehicle.dampers) and len(held) == 1:
        # Runs that may drop out hold for different times, and are read as if they all did.
        plain = not any(one.delay or one.blurred for one in ways)
    unseen = np.zeros(0) if plain else signal_from_road(now, readout, True) + signal_from_road(unmoved, readout, False)
    of_reading = _of_reading(readout, sensors)
    dampers = dampers_of(vehicles, readout)
    reads = (gain, memory, offset)
    if dampers is not None:
        reads = dampers.beside(gain, memory, offset)
        if not plain:
            of_reading, unseen = dampers.after(of_reading, unseen)

    # What is recorded was sensed inside the step, where the road was midway, or before it, where the last step had left it.
    signals = vehicle.kind.signals
    place = np.array([[signal.name == name for name in readout.names] for signal in signals], dtype=float)
    names = [signal.name for signal in signals]
    heights = [names.index(wheel.road_displacement) for wheel in vehicle.kind.wheels]
    inside, felt = readout.stage > stage, readout.felt or fresh

    def of(runs: slice, stopped: Callable[[], bool]) -> Iterator[Block]:
        """The blocks of some of the runs."""
        driving = [models.get(hardware[id(one)], model) for one in vehicles[runs]]
        if len(driving) == 1 and going is None:
            batch = Alone(driving[0])
        else:
            batch = Batch(model, len(driving), 1)
            if models:
                batch.set_models(driving)
        law, mine = None, dampers_of(vehicles[runs], readout)
        setting = None if mine is None else SemiActiveLaws(semi_active[runs], mine) if semi_active else Clipped(mine.of)
        if not plain:
            how = [one.implementation for one in vehicles[runs]]
            laws = _laws_of(course, runs, readout.names, K, memory, mine)
            seen = readout.names if mine is None else (*readout.names, *("" for _ in mine.closing))
            samplers = [Sampler(how, laws, seen, timestep, len(now))]
            if undelayed is not None:
                ideal = [Implementation()] * len(how)
                laws = LinearLaws(beside[runs], beside_memory[runs])
                samplers.append(Sampler(ideal, laws, readout.names, timestep, len(now)))
            played = [one.forces for one in controllers[runs] if isinstance(one, Played)]
            law = Again(np.stack(played, axis=1)) if played else _Sampled(samplers, of_reading, unseen[:, runs])
        level, road, left = now[:, runs], midway[:, runs], before[:, runs]
        at_samples = level if felt else None
        wanted = going[runs] if going is not None else None
        reading = Reading(
            *(reads[0][runs], reads[1][runs], reads[2][:, runs]),
            *(sensors, stage, fresh, fresh and not course.accelerations),
            damped=setting,
            lagging=mine is not None and mine.lags,
            held=max(held) if plain else 1,
            ramps=mine.ramps if mine is not None and len(mine.ramps) else None,
        )
        push = None if course.loads is None else Push(readout.pushed, course.loads[:, runs])
        steps = step_batch(batch, readout.mocap, reading, road, at_samples, law, edges, wanted, stopped, push)
        for start, sensed, qpos, qvel, asked, kept, acts in steps:
            some = slice(start, start + len(sensed))
            recorded = np.zeros((len(sensed), len(signals), batch.nsim))
            mix(place @ readout.of_sensors, sensed, recorded)
            recorded -= (place @ readout.rest)[:, None]
            if not felt:
                mix(place[:, inside] @ readout.of_road[inside], np.moveaxis(level[some] - road[some], 1, 2), recorded)
            if stage and not felt:
                mix(place[:, ~inside] @ readout.of_road[~inside], np.moveaxis(level[some] - left[some], 1, 2), recorded)
            recorded[:, heights] = np.moveaxis(level[some], 1, 2)
            if mine is not None:
                mine.record(recorded, asked, acts)
            # A force beyond 1e10 MuJoCo replaces by none at all, and runs on: what was asked for counts, not only what came.
            largest = np.maximum(recorded.max(axis=1), -recorded.min(axis=1))
            for force in np.moveaxis(asked, 2, 0):
                largest = np.maximum(largest, np.abs(force))
            yield Block(start, recorded, qpos, qvel, largest, asked, kept)

    def quietly(runs: slice, stopped: Callable[[], bool]) -> Iterator[Block]:
        with quiet():
            yield from of(runs, stopped)

    return [functools.partial(quietly, runs) for runs in shares]


def _span(of_sensors: Array) -> slice:
    """Returns the part of `sensordata` that signals come from, by their rows of `Readout.of_sensors`."""
    used = of_sensors.any(axis=0).nonzero()[0]
    return slice(int(used[0]), int(used[-1]) + 1)


def _of_reading(readout: Readout, sensors: slice) -> Array:
    """Returns every signal that can be had from a reading with these sensors from it, shape (S, r)."""
    of_state = np.where(readout.linear[:, None], readout.of_state, 0.0)
    return np.concatenate([of_state, np.where(readout.linear[:, None], 0.0, readout.of_sensors[:, sensors])], axis=-1)


def _laws_of(course: Course, runs: slice, names: Sequence[str], gain: Array, memory: Array, dampers: Dampers | None) -> Laws:
    """What some of the runs make of what they measure, of signals of these names.

    Args:
        course: all runs.
        runs: which.
        names: of the signals.
        gain, memory: of all the linear laws, as for `LinearLaws`.
        dampers: of those runs, if they have any, which then are told what to be.
    """
    semi_active = [one for one in course.controllers[runs] if isinstance(one, SemiActive)]
    if semi_active:
        assert dampers is not None, "a vehicle file has such a law with adjustable dampers alone"
        return SemiActiveLaws(semi_active, dampers, names)
    programmed = [one for one in course.controllers[runs] if isinstance(one, Programmed)]
    if not programmed:
        linear = LinearLaws(gain[runs], memory[runs])
        return linear if dampers is None else Damped(linear, dampers.of)
    ahead = course.now if course.beyond is None else np.concatenate([course.now, course.beyond])
    numbers = range(len(course.vehicles))[runs]
    laws = PythonLaws(programmed, course.vehicles[runs], names, course.timestep, ahead[:, runs], course.failures, numbers)
    return laws if dampers is None else Damped(laws, dampers.of)


class _Sampled:
    """The forces of step k from the reading, the sum of all samplers', for controllers that are not ideal."""

    def __init__(self, samplers: Sequence[Sampler], of_reading: Array, unseen_of_road: Array) -> None:
        """From every signal that samplers take by the reading, shape (S, r), and what that has not seen, shape (T, N, S)."""
        self.samplers, self.unseen, self.of_reading = samplers, unseen_of_road, of_reading

    @property
    def used(self) -> Array:
        """See `sim.physics.stepping.Law`."""
        return self.samplers[0].laws.used

    def __call__(self, k: int, reading: Array) -> Array:
        """See `sim.physics.stepping.Law`."""
        signals = np.matvec(self.of_reading, reading) + self.unseen[k]
        first, *others = [sampler(k, signals) for sampler in self.samplers]
        return first + others[0] if others else first
