"""N runs in MuJoCo, in blocks of samples: readings, commands, and recorded signals."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

import functools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from mujoco.batch import Batch

from models.common.arrays import Array
from models.common.errors import InputError
from models.laws.python_law import Programmed
from models.laws.semi_active import SemiActive
from models.vehicle.limits_and_implementation import Implementation, steps_per_sample
from models.vehicle.mjcf import build_model, quiet
from models.vehicle.vehicle import Vehicle
from sim.physics import RUNS_AT_ONCE, drivers
from sim.physics.sensor_readout import (
    AntiWindup,
    Laws,
    LinearLaws,
    Readout,
    Sampler,
    anti_windup_on,
    force_from_road,
    laws_on,
    measured_by,
    measurement_noise,
    mix,
    prepared,
    sensed_stage,
    signal_from_road,
)
from sim.physics.stepping import Alone, Push, Reading, step_batch
from synth.controller.controller import Controller, code_of

DIVERGED = 1e8  # of any signal, in SI units: beyond it the run has diverged

MOST_HEIGHTS = 5_200_000  # road heights of runs in blocks, 16 bytes each: 256 quarter-cars for 20 s at 1 ms


@dataclass(frozen=True, eq=False)
class Block:
    """Consecutive samples of N runs.

    Attributes:
        start: index of the first sample.
        values: every signal but the road's velocity, which is left 0, shape (B, S, N): runs lie side by side.
        qpos: generalized positions, shape (B, N, nq).
        qvel: generalized velocities, shape (B, N, nv).
        largest: largest magnitude of any signal but missing forces, and of any requested force that nothing clips, shape (B, N).
        overflowed: True where a requested force or a state of the law is not finite, shape (B, N).
        requested_force: requested forces [N], shape (B, N, m); for vehicles with adjustable dampers the commands, shape
            (B, N, 2 m), see `models.suspension.damper_range.CoefficientRange.commands`.
        kept: states of linear laws at their last sample, shape (B, N, k), with the largest k of any.
    """

    start: int
    values: Array
    qpos: Array
    qvel: Array
    largest: Array
    overflowed: Array
    requested_force: Array
    kept: Array

    def diverged(self, time: Array) -> Array:
        """Returns the time at which each run first diverged in the block [s], shape (N,), or infinity; from all the samples'
        times.
        """
        wild = self._wild
        return np.where(wild.any(axis=0), time[self.start + wild.argmax(axis=0)], np.inf)

    @property
    def ran_away(self) -> Array:
        """Returns True for each run that first diverged in the block by the states of its law alone, shape (N,): they overflowed,
        and every physical signal was still within `DIVERGED`.
        """
        wild, runs = self._wild, np.arange(self.largest.shape[1])
        return wild.any(axis=0) & (self.largest[wild.argmax(axis=0), runs] < DIVERGED)

    @property
    def _wild(self) -> Array:
        """Returns True at the samples that a run does not go beyond, shape (B, N)."""
        return ~(self.largest < DIVERGED) | self.overflowed  # NaN compares as wild

    def clip(self, runs: Array) -> None:
        """Replaces non-finite values of some runs, a mask of shape (N,), by 0, and clips theirs to `DIVERGED`, in place."""
        values = np.nan_to_num(self.values[..., runs], nan=0.0, posinf=0.0, neginf=0.0)
        self.values[..., runs] = np.clip(values, -DIVERGED, DIVERGED)


def runs_at_once(samples: int, wheels: int) -> int:
    """Returns the largest useful number of runs of so many samples in a batch of blocks, limited by memory."""
    return max(1, min(RUNS_AT_ONCE, MOST_HEIGHTS // (samples * wheels)))


@dataclass(frozen=True, eq=False)
class BatchInputs:
    """N runs from rest to be stepped, each over its road.

    Attributes:
        vehicles: N vehicles of the same kind that read out alike, see `reads_out`.
        controllers: N controllers, all linear, all in Python, all semi-active, or all played.
        now: road heights at the samples [m], shape (T, N, r).
        midway: heights at which MuJoCo holds them over the steps.
        timestep: timestep of the physics [s].
        edges: block k has the samples from `edges[k]` up to `edges[k + 1]`; the first is 0, the last at most T.
        undelayed: second controllers without `[implementation]`, whose forces are added to those of the first, or None.
        going: True for each run that is still wanted, shape (N,), or None for all. The caller may change it between blocks. An
            unwanted run is not stepped, and its part of later blocks is meaningless.
        beyond: road heights at the samples after the last [m], shape (E, N, r), for controllers that preview them, or None.
        failures: failures of laws in Python by run, for the caller to read: such a run continues without forces. None to raise
            the first failure.
        accelerations: True to record accelerations and forces of their sample. Otherwise, if an accelerometer is measured, they
            are those of the sample before, which saves an evaluation.
        held: effects other than the road's heights that MuJoCo holds over the steps, see `RoadInput.held`, shape (T, N, l) or
            (T, N, l + r); None if there are none.
    """

    vehicles: Sequence[Vehicle]
    controllers: Sequence[drivers.RunDriver]
    now: Array
    midway: Array
    timestep: float
    edges: Sequence[int]
    undelayed: Sequence[Controller | None] | None = None
    going: Array | None = None
    beyond: Array | None = None
    failures: dict[int, drivers.Failure] | None = None
    accelerations: bool = True
    held: Array | None = None


def in_blocks(course: BatchInputs) -> Iterator[Block]:
    """Yields the runs of `simulate` in blocks of samples: only the roads need be held whole."""
    (blocks,) = in_shares(course, [slice(None)])
    yield from blocks(lambda: False)


def in_shares(course: BatchInputs, shares: Sequence[slice]) -> list[Callable[[Callable[[], bool]], Iterator[Block]]]:
    """Returns the blocks of each share of the runs, to be stepped on a thread of its own until told to stop.

    The numbers of a run are bit for bit independent of other runs of its controller, of shares, and of blocks: sums over a
    run's few signals are taken one by one, never by a product of matrices whose order of summation depends on how many runs there
    are.

    Each share has its batch and thread. That is faster than one batch on all threads: those wait while Python has its turn, and
    on a busy machine for each other.
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
    before = np.concatenate([np.zeros_like(now[:1]), midway[:-1]])  # road heights at the end of the last step

    # A measurement is read before a step: from the state if it is linear in it, else from its sensor. The part of the road that
    # the reading lacks is added.
    coded = code_of(controllers[0]) is not None
    linear = [one if isinstance(one, Controller) and not coded else None for one in controllers]
    others = [one for one in controllers if not isinstance(one, Controller)]
    semi_active = [one for one in others if isinstance(one, SemiActive)]
    ways = [other.implementation for other in distinct.values()]
    ideal = undelayed is None and all(one.ideal for one in ways)
    if coded or (semi_active and ideal):
        K, memory = measured_by(readout.names, [one.measured for one in controllers])
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
    # An acceleration is read in a separate evaluation, with the present road and the force that has acted until now.
    fresh = stage > int(mujoco.mjtStage.mjSTAGE_VEL)
    unmoved = np.zeros_like(now) if fresh else now - before
    offset = force_from_road(of_state, now, readout) + force_from_road(of_sensors, unmoved, readout)
    gain = np.concatenate([of_state @ readout.of_state, of_sensors @ readout.of_sensors[:, sensors]], axis=-1)
    plain, periods = ideal and len(others) == len(semi_active), {steps_per_sample(one, timestep) for one in ways}
    if undelayed is None and going is None and not (others or vehicle.dampers) and len(periods) == 1:
        # Runs that may drop out hold forces for different times; all runs are read as if they did.
        plain = not any(one.delay or one.has_measurement_noise for one in ways)
    plain = plain or coded
    unseen = np.zeros(0) if plain else signal_from_road(now, readout, True) + signal_from_road(unmoved, readout, False)
    of_reading = _of_reading(readout, sensors)
    dampers = drivers.dampers_of(vehicles, readout)
    follows = None if undelayed is not None else anti_windup_on(vehicles, linear, timestep)
    if coded:
        if undelayed is not None or len(periods) > 1:
            raise InputError("exported code drives whole controllers of one sample period; omit --as")
        noise = measurement_noise([one.implementation for one in vehicles], _seen_names(readout, dampers), len(now))
        if len(noise):
            for i, one in enumerate(controllers):
                offset[:, i] += noise[:, i, [readout.names.index(name) for name in one.measured]]
    whole = now if course.beyond is None or not len(course.beyond) else np.concatenate([now, course.beyond])
    ahead = drivers.preview_forces(controllers, vehicles, whole, timestep, len(now))
    if ahead is not None:
        offset[..., : ahead.shape[2]] += ahead
    reads = (gain, memory, offset)
    if dampers is not None:
        reads = dampers.beside(gain, memory, offset)
        if not plain:
            of_reading, unseen = dampers.after(of_reading, unseen)

    # Recorded signals were sensed inside the step, with the road midway, or before the step, with the road of the last one.
    signals = vehicle.kind.signals
    place = np.array([[signal.name == name for name in readout.names] for signal in signals], dtype=float)
    names = [signal.name for signal in signals]
    acting = [i for i, name in enumerate(names) if name not in {one.missing for one in vehicle.adjustable}]
    unclipped = np.array([_unclipped(one) for one in vehicles])
    heights = [names.index(wheel.road_displacement) for wheel in vehicle.kind.wheels]
    inside, felt = readout.stage > stage, readout.felt or fresh

    def of(runs: slice, stopped: Callable[[], bool]) -> Iterator[Block]:
        """Yields the blocks of some of the runs."""
        driving = [models.get(hardware[id(one)], model) for one in vehicles[runs]]
        if len(driving) == 1 and going is None:
            batch = Alone(driving[0])
        else:
            batch = Batch(model, len(driving), 1)
            if models:
                batch.set_models(driving)
        law, mine = None, drivers.dampers_of(vehicles[runs], readout)
        anti_windup = drivers.anti_windup_of(vehicles[runs], None if follows is None else follows[runs])
        setting = (
            None if mine is None else drivers.SemiActiveLaws(semi_active[runs], mine) if semi_active else drivers.Clipped(mine.of)
        )
        code = None
        if coded:
            from sim.physics.exported_code import CodeInTheLoop

            code = CodeInTheLoop(controllers[runs], vehicles[runs], timestep, mine)
        if not plain:
            how = [drivers.implementation_around(*one) for one in zip(controllers[runs], vehicles[runs], strict=True)]
            laws = _laws_of(course, runs, readout.names, K, memory, mine, anti_windup, whole, ahead)
            seen = _seen_names(readout, mine)
            samplers = [Sampler(how, laws, seen, timestep, len(now))]
            if undelayed is not None:
                ideal = [Implementation()] * len(how)
                laws = LinearLaws(beside[runs], beside_memory[runs])
                samplers.append(Sampler(ideal, laws, readout.names, timestep, len(now)))
            played = [one.forces for one in controllers[runs] if isinstance(one, drivers.RecordedForces)]
            law = drivers.RepeatedForces(np.stack(played, axis=1)) if played else _Sampled(samplers, of_reading, unseen[:, runs])
        level, road, left = now[:, runs], midway[:, runs], before[:, runs]
        at_samples = level if felt else None
        wanted = going[runs] if going is not None else None
        reading = Reading(
            *(reads[0][runs], reads[1][runs], reads[2][:, runs]),
            *(sensors, stage, fresh, fresh and not course.accelerations),
            damped=code or setting,
            lagging=mine is not None and mine.lags,
            held=max(periods) if plain else 1,
            ramps=mine.ramps if mine is not None and len(mine.ramps) else None,
            anti_windup=anti_windup,
        )
        push = None if course.held is None else _push(course.held[:, runs], readout)
        steps = step_batch(batch, readout.mocap, reading, road, at_samples, law, edges, wanted, stopped, push)
        for start, sensed, qpos, qvel, requested, kept, acts in steps:
            kept = kept if code is None else code.kept
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
                mine.record(recorded, requested, acts)
            physical = recorded[:, acting] if mine is not None else recorded
            largest = np.maximum(physical.max(axis=1), -physical.min(axis=1))
            overflowed = np.asarray(~(np.isfinite(requested).all(axis=2) & np.isfinite(kept).all(axis=2)))
            # MuJoCo replaces a force beyond 1e10 by 0 and goes on, so requested forces are checked, unless they are clipped.
            for force, given in zip(np.moveaxis(requested, 2, 0), unclipped[runs].T, strict=False):
                largest = np.maximum(largest, np.where(given & ~overflowed, np.abs(force), 0.0))
            yield Block(start, recorded, qpos, qvel, largest, overflowed, requested, kept)

    def quietly(runs: slice, stopped: Callable[[], bool]) -> Iterator[Block]:
        blocks = of(runs, stopped)
        with quiet():
            while True:
                with np.errstate(over="ignore", invalid="ignore"):  # a law may overflow; its block says so
                    block = next(blocks, None)
                if block is None:
                    return
                yield block

    return [functools.partial(quietly, runs) for runs in shares]


def _seen_names(readout: Readout, dampers: drivers.Dampers | None) -> tuple[str, ...]:
    """Returns the names of the signals that a sampler reads; the dampers' closing velocities at their end have none."""
    return readout.names if dampers is None else (*readout.names, *("" for _ in dampers.closing))


def _push(held: Array, readout: Readout) -> Push:
    """Returns the loads and the road's velocities that are held over the steps of some runs."""
    count, (some, tyres) = len(readout.pushed), readout.damped_tyres
    return Push(readout.pushed, held[..., :count], tyres, held[..., [count + i for i in some]])


def _unclipped(vehicle: Vehicle) -> list[bool]:
    """Returns True for every input whose requested force acts without a limit."""
    most = vehicle.limits.actuator_force
    return [force not in vehicle.dampers and (most is None or most >= DIVERGED) for force in vehicle.linear_model.inputs]


def _span(of_sensors: Array) -> slice:
    """Returns the part of `sensordata` that signals come from, by their rows of `Readout.of_sensors`."""
    used = of_sensors.any(axis=0).nonzero()[0]
    return slice(int(used[0]), int(used[-1]) + 1)


def _of_reading(readout: Readout, sensors: slice) -> Array:
    """Returns the map from a reading with these sensors to every signal that it determines, shape (S, r)."""
    of_state = np.where(readout.linear[:, None], readout.of_state, 0.0)
    return np.concatenate([of_state, np.where(readout.linear[:, None], 0.0, readout.of_sensors[:, sensors])], axis=-1)


def _laws_of(
    course: BatchInputs,
    runs: slice,
    names: Sequence[str],
    gain: Array,
    memory: Array,
    dampers: drivers.Dampers | None,
    anti_windup: AntiWindup | None,
    whole: Array,
    ahead: Array | None,
) -> Laws:
    """Returns the laws of some of the runs, on signals of these names.

    Args:
        dampers: dampers of those runs, or None; with them the laws return commands.
        anti_windup: anti-windup of those runs, or None.
        whole: road heights at the samples, and beyond the last one [m], shape (.., N, r).
        ahead: forces of all runs from the road ahead, or None.
    """
    semi_active = [one for one in course.controllers[runs] if isinstance(one, SemiActive)]
    if semi_active:
        assert dampers is not None, "a vehicle file has such a law with adjustable dampers alone"
        return drivers.SemiActiveLaws(semi_active, dampers, names)
    programmed = [one for one in course.controllers[runs] if isinstance(one, Programmed)]
    if not programmed:
        linear = LinearLaws(gain[runs], memory[runs], anti_windup, None if ahead is None else ahead[:, runs])
        if dampers is not None:
            return drivers.Damped(linear, dampers.of)
        return linear if anti_windup is None else drivers.Limited(linear)
    numbers = range(len(course.vehicles))[runs]
    laws = drivers.PythonLaws(programmed, course.vehicles[runs], names, course.timestep, whole[:, runs], course.failures, numbers)
    return laws if dampers is None else drivers.Damped(laws, dampers.of)


class _Sampled:
    """Law of controllers that are not ideal: the sum of all samplers' forces of step k, from the reading."""

    def __init__(self, samplers: Sequence[Sampler], of_reading: Array, unseen_of_road: Array) -> None:
        """Takes the map from the reading to the samplers' signals, shape (S, r), and the parts it lacks, shape (T, N, S)."""
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
