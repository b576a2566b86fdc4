"""Simulation loop of N runs in MuJoCo, which computes measurements, commands, steps and recorded signals in blocks of samples."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's Python bindings have no type stubs.

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
from sim.drive import RUNS_AT_ONCE
from sim.drive.actuators import Actuators, closing_names
from sim.drive.case import Batch, Case, State
from sim.drive.computer import Computer, implementation_around
from sim.drive.driver import RunDriver
from sim.drive.drivers.registry import driver_of
from sim.drive.sensor_readout import (
    batch_of,
    beside_reading,
    hardware,
    mix,
    prepared_readout,
    sensed_stage,
    state_at_start,
    states_of_parts,
)

if TYPE_CHECKING:
    from sim.drive.part_steps import PartBatch

DIVERGENCE_LIMIT = 1e8  # largest absolute value of a signal, in SI units; a run with a larger value has diverged

# largest number of road heights that a batch stores (16 bytes each), enough for 256 quarter-cars over 20 s at 1 ms
MOST_HEIGHTS = 5_200_000


@dataclass(frozen=True, eq=False)
class Block:
    """Simulated signals of N runs at consecutive samples (a block).

    Attributes:
        start: index of the first sample in the block.
        values: values of all signals, shape (B, S, N), except that the road velocity remains 0. The last axis of the array
            corresponds to the runs.
        qpos: MuJoCo's generalised positions, shape (B, N, nq).
        qvel: MuJoCo's generalised velocities, shape (B, N, nv).
        largest: largest magnitude among all signals (except missing forces) and all requested forces that have no limit, shape
            (B, N).
        overflowed: True where a requested force or a state of the control law is not finite, shape (B, N).
        requested_force: commands of the actuators, see `sim.drive.actuators`, shape (B, N, m) or (B, N, 2 m).
        law_states: states of linear control laws, each at the law's last sample, shape (B, N, k), where k is the largest number
            of states.
        measured: signals at the controllers' samples before noise and quantisation, then the closing velocities, shape (B, N,
            s); NaN at time steps without a controller sample.
        names: names of the signals and closing velocities in `measured`, in the order of the last axis of `measured`.
        others: signals at each vertical edge of the road, on the side that `values` does not contain, by index of the sample,
            shape (S, N) each.
    """

    start: int
    values: Array
    qpos: Array
    qvel: Array
    largest: Array
    overflowed: Array
    requested_force: Array
    law_states: Array
    measured: Array
    names: tuple[str, ...]
    others: Mapping[int, Array] = field(default_factory=dict[int, Array])

    def diverged(self, time: Array) -> Array:
        """Returns the time at which each run first diverged in this block [s], shape (N,); infinity for a run that did not
        diverge.

        Args:
            time: sample times of the whole run [s], shape (T,).
        """
        wild = self._beyond_limits
        return np.where(wild.any(axis=0), time[self.start + wild.argmax(axis=0)], np.inf)

    @property
    def law_diverged(self) -> Array:
        """True for each run that diverged in this block only because the states of its control law overflowed, shape (N,).

        The states of the law overflowed while all physical signals of the run were still within `DIVERGENCE_LIMIT`.
        """
        wild, runs = self._beyond_limits, np.arange(self.largest.shape[1])
        return wild.any(axis=0) & (self.largest[wild.argmax(axis=0), runs] < DIVERGENCE_LIMIT)

    @property
    def _beyond_limits(self) -> Array:
        """True at the samples at which signals of a run are not finite or exceed `DIVERGENCE_LIMIT`, shape (B, N)."""
        # the comparison is negated, so that NaN also counts as above the limit
        return ~(self.largest < DIVERGENCE_LIMIT) | self.overflowed

    def clip(self, gone: Array) -> None:
        """Clips the signal values at some samples in place to magnitudes of at most `DIVERGENCE_LIMIT`, and replaces NaN by 0.

        Args:
            gone: True at the samples whose values are clipped, shape (B, N).
        """
        runs = gone.any(axis=0)
        values = self.values[..., runs]
        finite = np.clip(np.nan_to_num(values, nan=0.0, posinf=0.0, neginf=0.0), -DIVERGENCE_LIMIT, DIVERGENCE_LIMIT)
        self.values[..., runs] = np.where(gone[:, None, runs], finite, values)


def runs_at_once(samples: int, wheels: int) -> int:
    """Returns the number of runs to simulate together: `RUNS_AT_ONCE`, or fewer if the road heights of so many runs would not
    fit into memory.

    Args:
        samples: number of samples per run.
        wheels: number of wheels per vehicle.
    """
    return max(1, min(RUNS_AT_ONCE, MOST_HEIGHTS // (samples * wheels)))


class Loop:
    """Simulation loop, with five tasks per step: measure, compute commands, apply commands, move the road, and step MuJoCo.

    The results of a run are reproducible bit for bit. The results of a run do not depend on which other runs the batch
    contains, on the number of threads, or on the block size. For reproducible results, the order of summation in a matrix
    product must not depend on the number of runs.
    """

    def __init__(self, cases: Sequence[Case], timestep: float) -> None:
        """Prepares the data that all batches of the simulated cases share."""
        self.timestep = timestep
        self.model, self.readout = prepared_readout(cases[0].vehicle, timestep)
        distinct = {id(one.vehicle): one.vehicle for one in cases}
        self.hardware, self.models = dict[int, tuple[object, ...]](), dict[tuple[object, ...], mujoco.MjModel]()
        if len(distinct) > 1:
            self.hardware = {key: hardware(other) for key, other in distinct.items()}
            one_of = {self.hardware[key]: other for key, other in distinct.items()}
            if len(one_of) > 1:
                self.models = {key: build_model(other, timestep, drawn=False) for key, other in one_of.items()}
        # A signal is measured before a step. A signal that is linear in the state is computed from the state; any other signal
        # is read from its sensor. The contribution of the road is added where the state or the sensor does not include it.
        readout = self.readout
        controllers = [one for case in cases for one in (case.driver, case.undelayed_controller) if one is not None]
        named = {name for one in controllers for name in one.measured}
        self.seen = [i for i, name in enumerate(readout.names) if name in named]
        self.stage = sensed_stage(readout, np.isin(readout.names, [*named]))
        of_sensors = [i for i in self.seen if not readout.linear[i]]
        self.sensors = _span(readout.of_sensors[of_sensors]) if self.stage else slice(0, 0)
        # Accelerations are measured in a separate evaluation of MuJoCo, with the present road height and the force that has
        # acted until now.
        self.fresh = self.stage > int(mujoco.mjtStage.mjSTAGE_VEL)
        # After a step, MuJoCo is evaluated up to this stage for the next measurement
        self.after = 0 if self.fresh else self.stage

    def _computers(self, batch: Batch, actuators: Actuators) -> tuple[list[Computer], list[Computer]]:
        """Starts and returns the computers of a batch: those of the controllers, and those of the second controllers, which
        have no implementation.
        """
        vehicles, seconds = batch.vehicles, [one.undelayed_controller for one in batch.cases]
        how = [implementation_around(*one) for one in zip(batch.drivers, vehicles, strict=True)]
        first = self._group(batch, batch.drivers, vehicles, how, actuators)
        if not any(seconds):
            return first, []
        ideal = [replace(vehicle, implementation=Implementation()) for vehicle in vehicles]
        return first, self._group(batch, seconds, ideal, [Implementation()] * len(ideal), actuators)

    def _group(
        self,
        batch: Batch,
        controllers: Sequence[RunDriver | None],
        vehicles: Sequence[Vehicle],
        how: Sequence[Implementation],
        actuators: Actuators,
    ) -> list[Computer]:
        """Starts the computers of runs: one computer for each combination of driver type and sample period, and no computer for
        passive runs.
        """
        timestep, roads = batch.timestep, np.concatenate([batch.now, batch.beyond]) if len(batch.beyond) else batch.now
        groups: dict[tuple[tuple[object, ...], int], list[int]] = {}
        for i, (one, implementation) in enumerate(zip(controllers, how, strict=True)):
            if one is not None and (actuators.size > actuators.forces or not _is_passive(one, timestep)):
                groups.setdefault((one.driver_key, steps_per_sample(implementation, timestep)), []).append(i)
        computers, names = [], [self.readout.names[i] for i in self.seen]
        for some in groups.values():
            mine = [one for i in some if (one := controllers[i]) is not None]
            cars, around = [vehicles[i] for i in some], [how[i] for i in some]
            driver = driver_of(mine, failures=batch.failures, numbers=[batch.numbers[i] for i in some])
            runs = slice(None) if len(some) == len(vehicles) else np.array(some)
            computers.append(Computer(driver, runs, cars, around, actuators, names, roads[:, some], timestep, len(batch.now)))
        return computers

    def _start(self, case: Case, vehicle: Vehicle) -> State | None:
        """Returns the state in which a run starts; None if the run starts in equilibrium."""
        if case.start is not None or not vehicle.start:
            return case.start
        model, readout = self.model, self.readout
        if self.models:
            model, readout = prepared_readout(vehicle, self.timestep)
        motion = state_at_start(vehicle, model, readout)
        assert motion is not None, "it has a start"
        none = np.zeros(0)
        return State(motion, np.zeros(len(vehicle.linear_model.inputs)), none, none, np.zeros((0, 0)))

    def _map(self, actuators: Actuators) -> Array:
        """Returns the matrix that maps MuJoCo's state to measured signals and closing velocities.

        The columns of the matrix belong to (qpos, qvel), to the used part of `sensordata`, and to the states of the vehicle's
        parts.
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

    def _unread(self, level: Array, before: Array, actuators: Actuators) -> Array:
        """Returns the contributions to measured signals and closing velocities that `_map` omits, shape (B, N, s + m)."""
        unmoved = np.zeros_like(level) if self.fresh else level - before
        signals = beside_reading(level, self.readout, self.seen, True) + beside_reading(unmoved, self.readout, self.seen, False)
        still = np.broadcast_to(actuators.at_rest, (*signals.shape[:2], len(actuators.at_rest)))
        return np.concatenate([signals, still], axis=-1)

    def blocks(self, batch: Batch, edges: Sequence[int], stopped: Callable[[], bool]) -> Iterator[Block]:
        """Yields the blocks of samples of a batch, or of some runs of a batch, until `stopped` returns True. Warnings of MuJoCo
        and numpy are suppressed.

        Args:
            edges: sample indices at which the blocks begin and end; block k has the samples from `edges[k]` up to `edges[k +
                1]`. The first index in `edges` is 0, and the last is at most T.
            stopped: function that returns True to stop the simulation of the runs.
        """
        blocks = self._blocks(batch, edges, stopped)
        with quiet():
            while True:
                with np.errstate(over="ignore", invalid="ignore"):  # a control law may overflow; the block records the overflow
                    block = next(blocks, None)
                if block is None:
                    return
                yield block

    def _blocks(self, batch: Batch, edges: Sequence[int], stopped: Callable[[], bool]) -> Iterator[Block]:
        readout, vehicles, stage, fresh, count = self.readout, batch.vehicles, self.stage, self.fresh, len(batch.cases)
        physics = batch_of(self.model, vehicles, [self.models[self.hardware[id(one)]] for one in vehicles] if self.models else ())
        actuators = Actuators(vehicles, readout)
        over_travel = cast("PartBatch", physics) if actuators.over_travel else None
        computers, undelayed = self._computers(batch, actuators)
        signals_of, now, midway = _Signals(self, vehicles, actuators), batch.now, batch.midway
        in_signals, in_readings = (None, None) if batch.effects is None else batch.effects
        felt, of_reading = readout.has_road_feedthrough, self._map(actuators)
        controls, heights, sensors = physics.bind("ctrl"), physics.bind("mocap_pos")[:, :, 2], physics.bind("sensordata").T
        nq, moved, width = self.model.nq, self.model.nq + self.model.nv, of_reading.shape[2]
        # MuJoCo's state contains the time, followed by the states (qpos, qvel)
        motion, activations = physics.state[:, 1 : 1 + moved], physics.bind("act")
        own, sensed_to = states_of_parts(physics), width - readout.of_parts.shape[1]
        measured, held = physics.bind("sensordata")[:, self.sensors], batch.held_inputs
        pushed, loads, (wheels, tyres) = physics.bind("qfrc_applied"), len(readout.load_dofs), readout.damped_tyres
        speeds = [loads + wheel for wheel in wheels]  # columns of `held_inputs` that contain road velocities
        early = np.repeat(self.model.sensor_needstage, self.model.sensor_dim) <= stage
        # In runs with loads, the load within a step differs from the load at the sample, so the accelerations also differ.
        late = np.repeat(self.model.sensor_needstage, self.model.sensor_dim) > int(mujoco.mjtStage.mjSTAGE_VEL)
        loaded = np.zeros(count, dtype=bool) if held is None else held[..., :loads].any(axis=(0, 2))
        at_sample = np.ix_(late, loaded)
        under_load = sensors[at_sample]
        commands, more = np.zeros((count, actuators.size)), np.zeros((count, actuators.size))
        starts = {i: start for i in range(count) if (start := self._start(batch.cases[i], vehicles[i])) is not None}
        if starts:
            for i, one in starts.items():
                motion[i], own[i], activations[i] = np.split(one.motion, [moved, moved + own.shape[1]])
                actuators.apply(controls[i : i + 1], one.acting_forces[None])
            for computer in computers:
                computer.resume({i: (one.law, one.pending_forces) for i, one in starts.items()}, commands)
            for computer in undelayed:
                computer.resume({i: (one.undelayed_forces, ()) for i, one in starts.items()}, more)
        physics.forward(stage=stage)
        sampled = {k for one in (*computers, *undelayed) for k in range(0, edges[-1], one.period)}
        names = (*(readout.names[i] for i in self.seen), *closing_names(vehicles[0]))
        states = max((one.used.shape[1] for one in computers), default=0)
        for start, end in itertools.pairwise(edges):
            block, length = slice(start, end), end - start
            before = midway[start - 1 : end - 1] if start else np.concatenate([np.zeros_like(now[:1]), midway[: end - 1]])
            unread, level = self._unread(now[block], before, actuators), now[block]
            readings, requested = np.empty((length, count, width)), np.empty((length, count, actuators.size))
            roads, sensed = np.zeros((length, *heights.shape)), np.empty((length + 1, *sensors.shape))
            roads[..., readout.mocap], sensed[0] = midway[block], sensors
            law_states, seen = np.zeros((length, count, states)), np.full((length, count, of_reading.shape[1]), np.nan)
            acts, others = np.empty((length if actuators.lags else 0, *activations.shape)), dict[int, Array]()
            moving, with_own = readings[..., :moved], readings[..., sensed_to:] if sensed_to < width else None
            for i in range(length):
                if stopped():
                    return
                k = start + i
                moving[i] = motion
                if with_own is not None:
                    with_own[i] = own
                signals = seen[i]
                if k in sampled:
                    reading = readings[i]
                    if fresh:
                        if in_readings is not None:
                            pushed[:, readout.load_dofs] = in_readings[k, :, :loads]
                        heights[:, readout.mocap] = level[i]
                        physics.forward()
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
                        law_states[i, computer.runs, : computer.used.shape[1]] = computer.used
                if actuators.lags:
                    acts[i] = activations
                if held is not None:
                    pushed[:, readout.load_dofs] = (held if in_signals is None else in_signals)[k, :, :loads]
                    if tyres:
                        controls[:, tyres] = held[k][:, speeds]
                if felt or in_signals is not None:
                    heights[:, readout.mocap] = level[i]
                    physics.forward()
                    sensed[i + 1] = sensors
                    under_load = sensors[at_sample]
                if k in batch.sides:
                    side = batch.sides[k][None]
                    heights[:, readout.mocap] = side[0]
                    physics.forward()
                    others[k] = signals_of(sensors[None], readings[[i]], side, side, side, requested[[i]], acts[i : i + 1])[0]
                if in_signals is not None and held is not None:
                    pushed[:, readout.load_dofs] = held[k, :, :loads]
                heights[...] = roads[i]
                physics.step(stage=self.after)
                if not felt:
                    sensed[i + 1] = sensors
                    if in_signals is not None:
                        sensed[i + 1][at_sample] = under_load
            if self.after and not felt:
                # The evaluation after a step has overwritten the sensor values with the values before the next step.
                sensed[1:, early] = sensed[:-1, early]
            values = signals_of(sensed[1:], readings, level, midway[block], before, requested, acts)
            largest, overflowed = signals_of.extremes(values, requested, law_states)
            positions, velocities = readings[..., :nq], readings[..., nq:moved]
            yield Block(start, values, positions, velocities, largest, overflowed, requested, law_states, seen, names, others)


class _Signals:
    """Computes the signals at the samples from MuJoCo's sensors, which MuJoCo evaluates during a step or before it."""

    def __init__(self, loop: Loop, vehicles: Sequence[Vehicle], actuators: Actuators) -> None:
        readout, first = loop.readout, vehicles[0]
        names = [signal.name for signal in first.kind.signals]
        self.readout, self.after, self.actuators = readout, loop.after, actuators
        self.place = (np.array(names)[:, None] == np.array(readout.names)).astype(float)
        missing = {one.missing for one in first.parts.adjustable}
        self.physical = [i for i, name in enumerate(names) if name not in missing]
        self.of_parts = self.place @ readout.of_parts
        self.wheels = [names.index(wheel.road_displacement) for wheel in first.kind.wheels]
        self.inside = readout.stage > loop.after
        self.unclipped = np.array([_acts_without_limit(one) for one in vehicles]).T

    def __call__(
        self, sensed: Array, readings: Array, level: Array, midway: Array, before: Array, commands: Array, activations: Array
    ) -> Array:
        """Returns the signals of a block, shape (B, S, N).

        Args:
            sensed: values of MuJoCo's sensors (`sensordata`), shape (B, nsensordata, N).
            readings: values that the matrix from `_map` multiplies, shape (B, N, w). The last k columns are the internal states
                of the suspension parts.
            level, midway, before: road heights at each sample, during the step after the sample, and during the step before the
                sample [m], shape (B, N, r).
            commands: actuator commands that act from each sample on, shape (B, N, size).
            activations: states of MuJoCo's actuators, see `Actuators.record`.
        """
        readout, place, inside = self.readout, self.place, self.inside
        values = np.zeros((len(sensed), len(place), sensed.shape[2]))
        mix(place @ readout.of_sensors, sensed, values)
        values -= (place @ readout.rest)[:, None]
        mix(self.of_parts, np.moveaxis(readings[..., readings.shape[2] - self.of_parts.shape[1] :], 1, 2), values)
        if not readout.has_road_feedthrough:
            mix(place[:, inside] @ readout.of_road[inside], np.moveaxis(level - midway, 1, 2), values)
            if self.after:
                mix(place[:, ~inside] @ readout.of_road[~inside], np.moveaxis(level - before, 1, 2), values)
        values[:, self.wheels] = np.moveaxis(level, 1, 2)
        self.actuators.record(values, commands, activations)
        return values

    def extremes(self, values: Array, commands: Array, law_states: Array) -> tuple[Array, Array]:
        """Returns the values of `Block.largest` and `Block.overflowed` for a block."""
        physical = values[:, self.physical]
        largest = np.maximum(physical.max(axis=1), -physical.min(axis=1))
        overflowed = np.asarray(~(np.isfinite(commands).all(axis=2) & np.isfinite(law_states).all(axis=2)))
        # MuJoCo replaces a force above 1e10 by 0 and continues. Requested forces are therefore checked, unless a limit clips
        # them.
        for force, given in zip(np.moveaxis(commands, 2, 0), self.unclipped, strict=False):
            largest = np.maximum(largest, np.where(given & ~overflowed, np.abs(force), 0.0))
        return largest, overflowed


def _is_passive(controller: RunDriver, timestep: float) -> bool:
    """Returns True for a linear control law without measurements, states and preview, because its forces are always 0."""
    return controller.linear is True and not (
        controller.measured or controller.states or controller.preview_samples(timestep) or controller.code
    )


def _acts_without_limit(vehicle: Vehicle) -> list[bool]:
    """Returns, for each input of the vehicle, True if no limit applies to the requested force."""
    most = vehicle.limits.actuator_force
    return [force not in vehicle.dampers and (most is None or most >= DIVERGENCE_LIMIT) for force in vehicle.linear_model.inputs]


def _span(of_sensors: Array) -> slice:
    """Returns the part of MuJoCo's `sensordata` on which signals depend.

    Args:
        of_sensors: rows of the matrix `Readout.of_sensors` for the signals to compute.
    """
    used = of_sensors.any(axis=0).nonzero()[0]
    return slice(int(used[0]), int(used[-1]) + 1) if len(used) else slice(0, 0)
