"""The MuJoCo response: one function for one run or ten thousand.

What makes it agree with the analysis to the integrator's own error (RK4's, to the fourth power of the step):

- the road is a mocap body that MuJoCo holds over a step, so it is put at its height midway through the step;
- but signals are read with the road where it is at the sample;
- the controller is sampled: it reads the signals once a step, and its force is held.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

import functools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from mujoco.batch import Batch

from models.common.arrays import Array
from models.mjcf import build_model, quiet
from models.vehicle import Vehicle
from sim.physics.readout import Readout, force_from_road, gain_on, mix, prepared, signal_from_road
from sim.physics.sampler import Sampler
from sim.response.response import Response
from sim.roads.road import Road, under_wheels
from synth.controller import Controller

DIVERGED = 1e8  # a signal beyond this, in SI units, is no vehicle any more

# Of runs that are not kept whole:
RUNS_AT_ONCE = 256  # more hardly save time
MOST_HEIGHTS = 5_200_000  # of roads, 16 bytes each: 256 quarter-cars for 20 s at 1 ms


@dataclass(frozen=True, eq=False)
class PhysicsRuns:
    """What MuJoCo made of N runs.

    Attributes:
        response: every signal, values of shape (N, T, S). From where a run diverged on, its values are NaN.
        qpos: generalized positions, shape (N, T, nq), to draw a run.
        qvel: generalized velocities, shape (N, T, nv).
        diverged: when each run diverged [s], shape (N,); infinite where it did not.
    """

    response: Response
    qpos: Array
    qvel: Array
    diverged: Array


def simulate(
    vehicles: Sequence[Vehicle],
    controllers: Sequence[Controller],
    roads: Sequence[Road],
    time: Array,
    threads: int = 1,
    undelayed: Sequence[Controller | None] | None = None,
) -> PhysicsRuns:
    """Runs N vehicles of one kind, each with its own parameters, controller and road, from rest.

    Args:
        vehicles: N vehicles of the same kind. Where they differ in the controller's implementation only, one model serves them.
        controllers: N controllers.
        roads: N roads.
        time: equidistant sample times [s], shape (T,), from 0; their distance is the timestep.
        threads: how many threads share the runs; results do not depend on it. 0 takes every core.
        undelayed: second controllers, whose forces come to those of the first and know no `[implementation]`; None for none.
    """
    timestep, signals, wheels = float(time[1] - time[0]), vehicles[0].kind.signals, vehicles[0].kind.wheels
    now = _on_each(vehicles, roads, "displacement", time)
    midway = _on_each(vehicles, roads, "displacement", time + timestep / 2)
    (block,) = in_blocks(vehicles, controllers, now, midway, timestep, threads, len(time), undelayed)

    recorded, names = block.values, [signal.name for signal in signals]
    velocity = _on_each(vehicles, roads, "velocity", time)
    recorded[:, [names.index(wheel.road_velocity) for wheel in wheels]] = np.moveaxis(velocity, 1, 2)
    diverged = block.diverged(time)
    recorded[np.broadcast_to((time[:, None] >= diverged)[:, None], recorded.shape)] = np.nan
    qpos, qvel = block.qpos.swapaxes(0, 1), block.qvel.swapaxes(0, 1)
    return PhysicsRuns(Response(time, signals, np.moveaxis(recorded, 2, 0)), qpos, qvel, diverged)


def _on_each(vehicles: Sequence[Vehicle], roads: Sequence[Road], what: str, time: Array) -> Array:
    """Heights of the roads [m], or their rates, under the wheels of all runs, shape (T, N, r); of runs that share both, once."""
    once: dict[tuple[int, int], Array] = {}
    for vehicle, road in zip(vehicles, roads, strict=True):
        if (id(vehicle), id(road)) not in once:
            once[id(vehicle), id(road)] = under_wheels(getattr(road, what), road, vehicle, time)
    return np.stack([once[id(vehicle), id(road)] for vehicle, road in zip(vehicles, roads, strict=True)], axis=1)


@dataclass(frozen=True, eq=False)
class Block:
    """Some consecutive samples of N runs.

    Attributes:
        start: index of the first.
        values: every signal but the road's velocity, which is left 0, shape (B, S, N): runs lie side by side.
        qpos: generalized positions, shape (B, N, nq).
        qvel: generalized velocities, shape (B, N, nv).
        largest: largest magnitude of any signal, and of any force that was asked for, shape (B, N).
    """

    start: int
    values: Array
    qpos: Array
    qvel: Array
    largest: Array

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


def in_blocks(
    vehicles: Sequence[Vehicle],
    controllers: Sequence[Controller],
    now: Array,
    midway: Array,
    timestep: float,
    threads: int,
    size: int,
    undelayed: Sequence[Controller | None] | None = None,
) -> Iterator[Block]:
    """The runs of `simulate`, some samples at a time: nothing but the roads need be held whole.

    A run's numbers do not depend, to the last bit, on the runs of its controller beside it, on threads, or on blocks: sums over a
    run's few signals are taken one by one, never by a product of matrices whose order of summation depends on how many runs there
    are.

    Args:
        vehicles: N vehicles of the same kind that read out alike, see `reads_out`.
        controllers: N controllers.
        now: road heights at the samples [m], shape (T, N, r).
        midway: the same half a step later, where MuJoCo holds them.
        timestep: [s].
        threads: as for `simulate`.
        size: B, samples in a block.
        undelayed: as for `simulate`.
    """
    vehicle = vehicles[0]
    model, readout = prepared(vehicle, timestep)
    batch = Batch(model, len(vehicles), threads)
    hardware = [(*other.parameters.values(), other.limits) for other in vehicles]
    if len(set(hardware)) > 1:
        models = {key: build_model(other, timestep) for key, other in dict(zip(hardware, vehicles, strict=True)).items()}
        batch.set_models([models[key] for key in hardware])
    before = np.concatenate([np.zeros_like(now[:1]), midway[:-1]])  # where the last step has left the road

    # What a controller measures is read before a step: from the state where it is linear in it, else from its sensor. To it comes
    # what that reading has not seen of the road.
    K = np.stack([gain_on(readout.names, vehicle, controller) for vehicle, controller in zip(vehicles, controllers, strict=True)])
    beside = np.zeros_like(K)
    for i, other in enumerate(undelayed or ()):
        if other is not None:
            beside[i] = gain_on(readout.names, vehicles[i], other)
    of_state, of_sensors = np.where(readout.linear, K, 0), np.where(readout.linear, 0, K)
    offset = force_from_road(of_state, now, readout) + force_from_road(of_sensors, now - before, readout)
    used = np.any((K != 0) | (beside != 0), axis=(0, 1)) & ~readout.linear
    stage = int(max(readout.stage[used], default=0))
    gain = of_state @ readout.of_state
    if stage:
        gain = np.concatenate([gain, of_sensors @ readout.of_sensors], axis=-1)
    law = None
    if undelayed is not None or not all(other.implementation.ideal for other in vehicles):
        sampler = Sampler(vehicles, K, beside, readout.names, timestep, len(now))
        law = _law(sampler, readout, signal_from_road(now, readout, True) + signal_from_road(now - before, readout, False), stage)

    # What is recorded was sensed inside the step, where the road was midway, or before it, where the last step had left it.
    signals = vehicle.kind.signals
    place = np.array([[signal.name == name for name in readout.names] for signal in signals], dtype=float)
    names = [signal.name for signal in signals]
    heights = [names.index(wheel.road_displacement) for wheel in vehicle.kind.wheels]
    inside = readout.stage > stage
    with quiet():
        steps = _step(batch, readout.mocap, gain, offset, midway, now if readout.felt else None, stage, law, size)
        for start, sensed, qpos, qvel, asked in steps:
            some = slice(start, start + len(sensed))
            recorded = np.zeros((len(sensed), len(signals), len(vehicles)))
            mix(place @ readout.of_sensors, sensed, recorded)
            recorded -= (place @ readout.rest)[:, None]
            if not readout.felt:
                mix(place[:, inside] @ readout.of_road[inside], np.moveaxis(now[some] - midway[some], 1, 2), recorded)
            if stage and not readout.felt:
                mix(place[:, ~inside] @ readout.of_road[~inside], np.moveaxis(now[some] - before[some], 1, 2), recorded)
            recorded[:, heights] = np.moveaxis(now[some], 1, 2)
            # A force beyond 1e10 MuJoCo replaces by none at all, and runs on: what was asked for counts, not only what came.
            largest = np.maximum(recorded.max(axis=1), -recorded.min(axis=1))
            for force in np.moveaxis(asked, 2, 0):
                largest = np.maximum(largest, np.abs(force))
            yield Block(start, recorded, qpos, qvel, largest)


def _law(sampler: Sampler, readout: Readout, unseen_of_road: Array, stage: int) -> Callable[[int, Array], Array]:
    """The forces of step k from the reading, for controllers that are more than a gain."""
    of_reading = np.where(readout.linear[:, None], readout.of_state, 0.0)
    if stage:
        of_reading = np.concatenate([of_reading, np.where(readout.linear[:, None], 0.0, readout.of_sensors)], axis=-1)

    def forces(k: int, reading: Array) -> Array:
        return sampler(k, np.matvec(of_reading, reading) + unseen_of_road[k])

    return forces


def _step(
    batch: Batch,
    mocap: list[int],
    gain: Array,
    offset: Array,
    midway: Array,
    at_samples: Array | None,
    stage: int,
    law: Callable[[int, Array], Array] | None,
    size: int,
) -> Iterator[tuple[int, Array, Array, Array, Array]]:
    """The loop: read, control, move the road, step.

    Args:
        batch: N runs.
        mocap: mocap index of every wheel's road.
        gain: from the reading to the forces, shape (N, m, k). The reading is (qpos, qvel), and `sensordata` if there is a stage.
        offset: the forces' other part, shape (T, N, m).
        midway: road heights during the steps, shape (T, N, r).
        at_samples: road heights at the samples, shape (T, N, r), if sensors are to be evaluated there on top; else None.
        stage: mjtStage up to which sensors are evaluated before a step.
        law: forces (N, m) of step k from the reading (N, k), instead of the gain; None for controllers that are a gain.
        size: B, samples in a block.

    Yields:
        Of every block its first sample, and `sensordata`, shape (B, nsensordata, N): that of the samples; else up to the stage
        from before the step, the rest from inside it. Then qpos, shape (B, N, nq), qvel, shape
        (B, N, nv), and the forces asked for, shape (B, N, m).
    """
    samples, count, m = offset.shape
    # The motors, in the order of the linear model's inputs, are all there is in ctrl.
    ctrl, heights, sensors = batch.bind("ctrl"), batch.bind("mocap_pos")[:, :, 2], batch.bind("sensordata").T
    motion, width = _motion(batch), gain.shape[2]
    moved, positions = motion.shape[1], batch.bind("qpos").shape[1]
    early = np.repeat(batch.model.sensor_needstage, batch.model.sensor_dim) <= stage
    step = functools.partial(batch.step, stage=stage) if stage else batch.step
    batch.forward(stage=stage)

    # A numpy call costs a tenth of a step, so there are few: the forces' known part lies beside the reading, with unit gain.
    gain = np.concatenate([gain, np.broadcast_to(np.eye(m), (count, m, m))], axis=-1)
    for start in range(0, samples, size):
        block = slice(start, min(start + size, samples))
        length = block.stop - start
        seen = np.empty((length, count, width + m))
        seen[..., width:] = offset[block]
        roads = np.zeros((length, *heights.shape))
        roads[..., mocap] = midway[block]
        sensed, asked = np.empty((length, *sensors.shape)), np.empty((length, count, m))
        rows: Any = zip(seen, seen[..., :moved], seen[..., moved:width], roads, sensed, asked, strict=True)
        for k, (all_seen, moving, sensing, road, result, forces) in enumerate(rows, start):
            moving[...] = motion
            if stage:
                sensing[...] = sensors.T
            if law is None:
                np.matvec(gain, all_seen, forces)
            else:
                forces[...] = law(k, all_seen[:, :width])
            ctrl[...] = forces
            if at_samples is not None:
                heights[:, mocap] = at_samples[k]
                batch.forward()
                result[...] = sensors
            heights[...] = road
            step()
            if at_samples is None:
                result[...] = sensors
        if stage and at_samples is None:
            # The evaluation after a step has overwritten what the step itself had sensed.
            sensed[:, early] = np.moveaxis(seen[..., moved:width][..., early], 1, 2)
        yield start, sensed, seen[..., :positions], seen[..., positions:moved], asked


def _motion(batch: Batch) -> Array:
    """(qpos, qvel) of every run as one view, shape (N, nq + nv): they lie side by side in a state row."""
    qpos, qvel = batch.bind("qpos"), batch.bind("qvel")
    start = (qpos.ctypes.data - batch.state.ctypes.data) // batch.state.itemsize
    motion = batch.state[:, start : start + qpos.shape[1] + qvel.shape[1]]
    assert motion[0, qpos.shape[1] :].ctypes.data == qvel.ctypes.data, "mjSTATE_QVEL follows mjSTATE_QPOS"
    return motion
