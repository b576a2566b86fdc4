"""N runs in MuJoCo, in blocks of samples: measurements, commands, steps, and recorded signals."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

import functools
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, cast

import mujoco
import numpy as np

from models.common.arrays import Array
from models.vehicle.limits_and_implementation import Implementation, steps_per_sample
from models.vehicle.mjcf import build_model, quiet
from models.vehicle.vehicle import Vehicle
from sim.physics import RUNS_AT_ONCE
from sim.physics.actuators import Actuators, closing_names
from sim.physics.computer import Computer, InitialState, driver_of, implementation_around, kind_of
from sim.physics.driver import Failure, RunDriver
from sim.physics.sensor_readout import batch_of, beside_reading, mix, prepared, sensed_stage, states_of_parts
from synth.controller.controller import Controller

if TYPE_CHECKING:
    from sim.physics.part_steps import PartBatch

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
        requested_force: commands of the actuators, see `sim.physics.actuators`, shape (B, N, m) or (B, N, 2 m).
        kept: states of linear laws at their last sample, shape (B, N, k), with the largest k of any.
        measured: signals at the controllers' samples as they are read, without noise and quantisation, then closing velocities,
            shape (B, N, s); NaN at the other timesteps.
        names: names of `measured`.
        others: signals on the other side of vertical edges of the road, shape (S, N), by sample.
    """

    start: int
    values: Array
    qpos: Array
    qvel: Array
    largest: Array
    overflowed: Array
    requested_force: Array
    kept: Array
    measured: Array
    names: tuple[str, ...]
    others: Mapping[int, Array] = field(default_factory=dict[int, Array])

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
        controllers: N controllers, or known commands.
        now: road heights at the samples [m], shape (T, N, r).
        midway: heights at which MuJoCo holds them over the steps.
        timestep: [s].
        edges: block k has the samples from `edges[k]` up to `edges[k + 1]`; the first is 0, the last at most T.
        undelayed: second controllers without `[implementation]`, whose forces are added to those of the first, or None.
        start: state of each run at its start, or None for rest.
        beyond: road heights at the samples after the last [m], shape (E, N, r), for controllers that preview them, or None.
        failures: failures of laws in Python by run, for the caller to read: such a run continues without forces. None to raise
            the first failure.
        held: effects other than the road's heights that MuJoCo holds over the steps, see `RoadInput.held`, shape (T, N, l) or
            (T, N, l + r); None if there are none.
        effects: loads in the signals of the samples and in the measurements, see `RoadInput.in_signals`, each as `held`; None
            without loads.
        beyond_edges: road heights on the other side of vertical edges [m], shape (N, r), by sample.
    """

    vehicles: Sequence[Vehicle]
    controllers: Sequence[RunDriver]
    now: Array
    midway: Array
    timestep: float
    edges: Sequence[int]
    undelayed: Sequence[Controller | None] | None = None
    start: Sequence[InitialState] | None = None
    beyond: Array | None = None
    failures: dict[int, Failure] | None = None
    held: Array | None = None
    effects: tuple[Array, Array] | None = None
    beyond_edges: Mapping[int, Array] = field(default_factory=dict[int, Array])


def in_blocks(course: BatchInputs) -> Iterator[Block]:
    """Yields the runs of `simulate` in blocks of samples: only the roads need be held whole."""
    (blocks,) = in_shares(course, [slice(None)])
    yield from blocks(lambda: False)


def in_shares(course: BatchInputs, shares: Sequence[slice]) -> list[Callable[[Callable[[], bool]], Iterator[Block]]]:
    """Returns the blocks of each share of the runs, to be stepped on a thread of its own until told to stop.

    The numbers of a run are the same bit for bit, whatever runs of its controller are beside it, and however they are shared or
    cut into blocks: no product of matrices has an order of summation that depends on the number of runs.

    Each share has its batch and thread. That is faster than one batch on all threads: those wait while Python has its turn, and
    on a busy machine for each other.
    """
    loop = _Loop(course)
    return [functools.partial(_quietly, loop, runs) for runs in shares]


def _quietly(loop: "_Loop", runs: slice, stopped: Callable[[], bool]) -> Iterator[Block]:
    """Yields the blocks of some runs without warnings of MuJoCo or numpy."""
    blocks = loop.blocks(runs, stopped)
    with quiet():
        while True:
            with np.errstate(over="ignore", invalid="ignore"):  # a law may overflow; its block says so
                block = next(blocks, None)
            if block is None:
                return
            yield block


class _Loop:
    """The simulation loop: read, compute, apply, move the road, step."""

    def __init__(self, course: BatchInputs) -> None:
        """Prepares what all shares of the runs have in common."""
        self.course, self.vehicles = course, course.vehicles
        first, timestep = self.vehicles[0], course.timestep
        self.model, self.readout = prepared(first, timestep)
        distinct = {id(other): other for other in self.vehicles}
        self.hardware = {
            key: (
                *other.parameters.values(),
                *other.curves.values(),
                *other.kind.ratios.values(),
                other.limits,
                *other.dampers.values(),
            )
            for key, other in distinct.items()
        }
        one_of = {self.hardware[key]: other for key, other in distinct.items()}
        self.models = {}
        if len(one_of) > 1:
            self.models = {key: build_model(other, timestep, drawn=False) for key, other in one_of.items()}
        now, beyond = course.now, course.beyond
        self.heights = now if beyond is None or not len(beyond) else np.concatenate([now, beyond])
        # A measurement is read before a step: from the state if it is linear in it, else from its sensor. The part of the road
        # that the reading lacks is added.
        readout = self.readout
        named = {name for one in (*course.controllers, *(course.undelayed or ())) if one is not None for name in one.measured}
        self.seen = [i for i, name in enumerate(readout.names) if name in named]
        self.stage = sensed_stage(readout, np.isin(readout.names, [*named]))
        of_sensors = [i for i in self.seen if not readout.linear[i]]
        self.sensors = _span(readout.of_sensors[of_sensors]) if self.stage else slice(0, 0)
        # An acceleration is read in a separate evaluation, with the present road and the force that has acted until now.
        self.fresh = self.stage > int(mujoco.mjtStage.mjSTAGE_VEL)
        self.after = 0 if self.fresh else self.stage  # what is evaluated after a step for the next reading

    def _computers(self, runs: slice, actuators: Actuators) -> tuple[list[Computer], list[Computer]]:
        """Returns the started computers of some of the runs, and those of their second controllers without implementation."""
        course, vehicles = self.course, self.vehicles[runs]
        how = [implementation_around(*one) for one in zip(course.controllers[runs], vehicles, strict=True)]
        numbers = range(len(self.vehicles))[runs]
        first = self._group(course.controllers[runs], vehicles, how, runs, actuators, numbers)
        if course.undelayed is None:
            return first, []
        ideal = [replace(vehicle, implementation=Implementation()) for vehicle in vehicles]
        return first, self._group(course.undelayed[runs], ideal, [Implementation()] * len(ideal), runs, actuators, numbers)

    def _group(
        self,
        controllers: Sequence[RunDriver | None],
        vehicles: Sequence[Vehicle],
        how: Sequence[Implementation],
        share: slice,
        actuators: Actuators,
        numbers: Sequence[int],
    ) -> list[Computer]:
        """Returns the started computers of some runs: one per kind of driver and sample period."""
        course, timestep = self.course, self.course.timestep
        groups: dict[tuple[tuple[object, ...], int], list[int]] = {}
        for i, (one, implementation) in enumerate(zip(controllers, how, strict=True)):
            if one is not None:
                groups.setdefault((kind_of(one), steps_per_sample(implementation, timestep)), []).append(i)
        computers, names = [], [self.readout.names[i] for i in self.seen]
        for some in groups.values():
            mine = [one for i in some if (one := controllers[i]) is not None]
            cars, around = [vehicles[i] for i in some], [how[i] for i in some]
            if mine[0].code is not None:
                around = [replace(one, delay=0.0, quantisation={}) for one in around]  # the code has its own
            driver = driver_of(mine, course.failures, [numbers[i] for i in some])
            heights = self.heights[:, share][:, some]
            runs = slice(None) if len(some) == len(vehicles) else np.array(some)
            computers.append(Computer(driver, runs, cars, around, actuators, names, heights, timestep, len(course.now)))
        return computers

    def _map(self, actuators: Actuators) -> Array:
        """Returns the map from a reading, (qpos, qvel), part of `sensordata` and the parts' own states, to measured signals and
        closing velocities.
        """
        readout, some = self.readout, self.seen
        linear = readout.linear[some][:, None]
        signals = np.concatenate(
            [
                np.where(linear, readout.of_state[some], 0.0),
                np.where(linear, 0.0, readout.of_sensors[some][:, self.sensors]),
                readout.of_parts[some],
            ],
            axis=1,
        )
        closing = np.zeros((len(actuators.closing), signals.shape[1]))
        closing[:, : actuators.closing.shape[1]] = actuators.closing
        return np.concatenate([signals, closing])[None]

    def _unread(self, block: slice, runs: slice, before: Array, actuators: Actuators) -> Array:
        """Returns what the measured signals and closing velocities contain beside a reading, shape (B, N, s + m)."""
        level = self.course.now[block, runs]
        unmoved = np.zeros_like(level) if self.fresh else level - before
        signals = beside_reading(level, self.readout, self.seen, True) + beside_reading(unmoved, self.readout, self.seen, False)
        still = np.broadcast_to(actuators.at_rest, (*signals.shape[:2], len(actuators.at_rest)))
        return np.concatenate([signals, still], axis=-1)

    def blocks(self, runs: slice, stopped: Callable[[], bool]) -> Iterator[Block]:
        """Yields the blocks of some of the runs."""
        course, readout, vehicles, stage, fresh = self.course, self.readout, self.vehicles[runs], self.stage, self.fresh
        count = len(vehicles)
        batch = batch_of(self.model, vehicles, [self.models[self.hardware[id(one)]] for one in vehicles] if self.models else ())
        actuators = Actuators(vehicles, readout)
        over_travel = cast("PartBatch", batch) if actuators.over_travel else None
        computers, undelayed = self._computers(runs, actuators)
        recorder = _Recorder(self, vehicles, actuators)
        now, midway = course.now[:, runs], course.midway[:, runs]
        in_signals, in_readings = (None, None) if course.effects is None else (one[:, runs] for one in course.effects)
        felt, of_reading = readout.felt, self._map(actuators)
        controls, heights, sensors = batch.bind("ctrl"), batch.bind("mocap_pos")[:, :, 2], batch.bind("sensordata").T
        nq, moved, width = self.model.nq, self.model.nq + self.model.nv, of_reading.shape[2]
        motion, activations = batch.state[:, 1 : 1 + moved], batch.bind("act")  # (qpos, qvel) after the time
        own, sensed_to = states_of_parts(batch), width - readout.of_parts.shape[1]
        measured, held = batch.bind("sensordata")[:, self.sensors], None if course.held is None else course.held[:, runs]
        pushed, loads, (wheels, tyres) = batch.bind("qfrc_applied"), len(readout.pushed), readout.damped_tyres
        speeds = [loads + wheel for wheel in wheels]  # columns of the road's velocities among what is held
        early = np.repeat(self.model.sensor_needstage, self.model.sensor_dim) <= stage
        # Accelerations of runs with loads are others inside the step, under another load.
        late = np.repeat(self.model.sensor_needstage, self.model.sensor_dim) > int(mujoco.mjtStage.mjSTAGE_VEL)
        loaded = np.zeros(count, dtype=bool) if held is None else held[..., :loads].any(axis=(0, 2))
        at_sample = np.ix_(late, loaded)
        under_load = sensors[at_sample]
        commands, more = np.zeros((count, actuators.size)), np.zeros((count, actuators.size))
        if course.start is not None:
            starts = course.start[runs]
            for i, one in enumerate(starts):
                motion[i], own[i], activations[i] = np.split(one.motion, [moved, moved + own.shape[1]])
                actuators.apply(controls[i : i + 1], one.acting[None])
            for computer in computers:
                mine = [starts[i] for i in np.arange(count)[computer.runs]]
                computer.resume([one.law for one in mine], [one.pending for one in mine], commands)
            for computer in undelayed:
                mine = [starts[i] for i in np.arange(count)[computer.runs]]
                computer.resume([one.undelayed for one in mine], [()] * len(mine), more)
        batch.forward(stage=stage)
        sampled = {k for one in (*computers, *undelayed) for k in range(0, course.edges[-1], one.period)}
        names = (*(readout.names[i] for i in self.seen), *closing_names(vehicles[0]))
        states = max((one.used.shape[1] for one in computers), default=0)
        for start, end in itertools.pairwise(course.edges):
            block, length = slice(start, end), end - start
            before = midway[start - 1 : end - 1] if start else np.concatenate([np.zeros_like(now[:1]), midway[: end - 1]])
            unread, level = self._unread(block, runs, before, actuators), now[block]
            readings, requested = np.empty((length, count, width)), np.empty((length, count, actuators.size))
            roads, sensed = np.zeros((length, *heights.shape)), np.empty((length + 1, *sensors.shape))
            roads[..., readout.mocap], sensed[0] = midway[block], sensors
            kept, seen = np.zeros((length, count, states)), np.full((length, count, of_reading.shape[1]), np.nan)
            acts, others = np.empty((length if actuators.lags else 0, *activations.shape)), dict[int, Array]()
            for i in range(length):
                if stopped():
                    return
                k, reading, signals = start + i, readings[i], seen[i]
                reading[:, :moved], reading[:, sensed_to:] = motion, own
                if k in sampled:
                    if fresh:
                        if in_readings is not None:
                            pushed[:, readout.pushed] = in_readings[k, :, :loads]
                        heights[:, readout.mocap] = level[i]
                        batch.forward()
                    if stage:
                        reading[:, moved:sensed_to] = measured
                    np.matvec(of_reading, reading, out=signals)
                    signals += unread[i]
                    if over_travel is not None:
                        moved_by, forces = over_travel.deflections(), actuators.forces
                        closing = signals[:, -len(actuators.at_rest) :]
                        actuators.turn(closing[:, :forces], moved_by)
                        closing[:, forces:] = actuators.of_elements(moved_by, own)
                for computer in computers:
                    computer.step(k, signals, commands)
                acting = commands
                if undelayed:
                    for computer in undelayed:
                        computer.step(k, signals, more)
                    acting = commands + more
                requested[i] = acting
                actuators.apply(controls, acting)
                if states:
                    for computer in computers:
                        kept[i, computer.runs, : computer.used.shape[1]] = computer.used
                if actuators.lags:
                    acts[i] = activations
                if held is not None:
                    pushed[:, readout.pushed] = (held if in_signals is None else in_signals)[k, :, :loads]
                    if tyres:
                        controls[:, tyres] = held[k][:, speeds]
                if felt or in_signals is not None:
                    heights[:, readout.mocap] = level[i]
                    batch.forward()
                    sensed[i + 1] = sensors
                    under_load = sensors[at_sample]
                if k in course.beyond_edges:
                    side = course.beyond_edges[k][runs][None]
                    heights[:, readout.mocap] = side[0]
                    batch.forward()
                    others[k] = recorder.signals(sensors[None], reading[None], side, side, side, requested[[i]], acts[i : i + 1])[
                        0
                    ]
                if in_signals is not None and held is not None:
                    pushed[:, readout.pushed] = held[k, :, :loads]
                heights[...] = roads[i]
                batch.step(stage=self.after)
                if not felt:
                    sensed[i + 1] = sensors
                    if in_signals is not None:
                        sensed[i + 1][at_sample] = under_load
            if self.after and not felt:
                # The evaluation after a step has overwritten the step's own readings with those before the next step.
                sensed[1:, early] = sensed[:-1, early]
            values = recorder.signals(sensed[1:], readings, level, midway[block], before, requested, acts)
            largest, overflowed = recorder.extremes(values, requested, kept)
            positions, velocities = readings[..., :nq], readings[..., nq:moved]
            yield Block(start, values, positions, velocities, largest, overflowed, requested, kept, seen, names, others)


class _Recorder:
    """Signals of the samples, from what MuJoCo sensed: inside the step with the road midway, or before it with the last road."""

    def __init__(self, loop: _Loop, vehicles: Sequence[Vehicle], actuators: Actuators) -> None:
        readout, first = loop.readout, vehicles[0]
        names = [signal.name for signal in first.kind.signals]
        self.readout, self.after, self.actuators = readout, loop.after, actuators
        self.place = np.array([[name == one for one in readout.names] for name in names], dtype=float)
        missing = {one.missing for one in first.parts.adjustable}
        self.physical = [i for i, name in enumerate(names) if name not in missing]
        self.of_parts = self.place @ readout.of_parts
        self.wheels = [names.index(wheel.road_displacement) for wheel in first.kind.wheels]
        self.inside = readout.stage > loop.after
        self.unclipped = np.array([_unclipped(one) for one in vehicles]).T

    def signals(
        self, sensed: Array, readings: Array, level: Array, midway: Array, before: Array, commands: Array, activations: Array
    ) -> Array:
        """Returns the signals of a block, shape (B, S, N).

        Args:
            sensed: MuJoCo's `sensordata`, shape (B, nsensordata, N).
            readings: what measurements are mapped from, shape (B, N, w); its last k columns are the own states of parts.
            level, midway, before: road heights at the samples, during the steps from them and the steps to them, shape (B, N, r).
        """
        readout, place, inside = self.readout, self.place, self.inside
        values = np.zeros((len(sensed), len(place), sensed.shape[2]))
        mix(place @ readout.of_sensors, sensed, values)
        values -= (place @ readout.rest)[:, None]
        mix(self.of_parts, np.moveaxis(readings[..., readings.shape[2] - self.of_parts.shape[1] :], 1, 2), values)
        if not readout.felt:
            mix(place[:, inside] @ readout.of_road[inside], np.moveaxis(level - midway, 1, 2), values)
            if self.after:
                mix(place[:, ~inside] @ readout.of_road[~inside], np.moveaxis(level - before, 1, 2), values)
        values[:, self.wheels] = np.moveaxis(level, 1, 2)
        self.actuators.record(values, commands, activations)
        return values

    def extremes(self, values: Array, commands: Array, kept: Array) -> tuple[Array, Array]:
        """Returns `Block.largest` and `Block.overflowed`."""
        physical = values[:, self.physical]
        largest = np.maximum(physical.max(axis=1), -physical.min(axis=1))
        overflowed = np.asarray(~(np.isfinite(commands).all(axis=2) & np.isfinite(kept).all(axis=2)))
        # MuJoCo replaces a force beyond 1e10 by 0 and goes on, so requested forces are checked, unless they are clipped.
        for force, given in zip(np.moveaxis(commands, 2, 0), self.unclipped, strict=False):
            largest = np.maximum(largest, np.where(given & ~overflowed, np.abs(force), 0.0))
        return largest, overflowed


def _unclipped(vehicle: Vehicle) -> list[bool]:
    """Returns True for every input whose requested force acts without a limit."""
    most = vehicle.limits.actuator_force
    return [force not in vehicle.dampers and (most is None or most >= DIVERGED) for force in vehicle.linear_model.inputs]


def _span(of_sensors: Array) -> slice:
    """Returns the part of `sensordata` that signals come from, by their rows of `Readout.of_sensors`."""
    used = of_sensors.any(axis=0).nonzero()[0]
    return slice(int(used[0]), int(used[-1]) + 1) if len(used) else slice(0, 0)
