"""The MuJoCo response: one function for one run or ten thousand.

What makes it agree with the analysis to the integrator's own error (RK4's, to the fourth power of the step):

- the road is a mocap body that MuJoCo holds over a step, so it is put at its height midway through the step;
- but signals are read with the road where it is at the sample;
- the controller is sampled: it reads the signals once a step, and its force is held.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch

from models.arrays import Array
from models.mjcf import build_model, mocap_indices
from models.vehicle import Vehicle
from sim.response import Response
from sim.road import Road, under_wheels
from sim.sampler import Sampler
from synth.controller import Controller

DIVERGED = 1e8  # a signal beyond this, in SI units, is no vehicle any more


@dataclass(frozen=True, eq=False)
class PhysicsRuns:
    """What MuJoCo made of N runs.

    Attributes:
        response: every signal, values of shape (N, T, S). From where a run diverged on, its values are NaN.
        qpos: generalized positions, shape (N, T, nq), to draw a run.
        diverged: when each run diverged [s], shape (N,); infinite where it did not.
    """

    response: Response
    qpos: Array
    diverged: Array


def simulate(
    vehicles: Sequence[Vehicle],
    controllers: Sequence[Controller],
    roads: Sequence[Road],
    time: Array,
    threads: int = 1,
    at_once: Sequence[Controller | None] | None = None,
) -> PhysicsRuns:
    """Runs N vehicles of one kind, each with its own parameters, controller and road, from rest.

    Args:
        vehicles: N vehicles of the same kind. Where they differ in the controller's implementation only, one model serves them.
        controllers: N controllers.
        roads: N roads.
        time: equidistant sample times [s], shape (T,), from 0; their distance is the timestep.
        threads: how many threads share the runs; results do not depend on it. 0 takes every core.
        at_once: second controllers, whose forces come to those of the first and know no `[implementation]`; None for none.
    """
    vehicle, timestep = vehicles[0], float(time[1] - time[0])
    model, readout = _prepared(vehicle, timestep)
    batch = Batch(model, len(vehicles), threads)
    if any((other.parameters, other.limits) != (vehicle.parameters, vehicle.limits) for other in vehicles):
        batch.set_models([build_model(other, timestep) for other in vehicles])

    # Road heights, shape (T, N, r): at the samples, and midway through the steps, where MuJoCo holds them.
    pairs = list(zip(vehicles, roads, strict=True))
    now = np.stack([under_wheels(road.displacement, road, vehicle, time) for vehicle, road in pairs], axis=1)
    middle = time + timestep / 2
    midway = np.stack([under_wheels(road.displacement, road, vehicle, middle) for vehicle, road in pairs], axis=1)
    before = np.concatenate([np.zeros_like(now[:1]), midway[:-1]])  # where the last step has left the road

    # What a controller measures is read before a step: from the state where it is linear in it, else from its sensor. To it comes
    # what that reading has not seen of the road.
    K = np.stack(
        [_gain_on(readout.names, vehicle, controller) for vehicle, controller in zip(vehicles, controllers, strict=True)]
    )
    beside = np.zeros_like(K)
    for i, other in enumerate(at_once or ()):
        if other is not None:
            beside[i] = _gain_on(readout.names, vehicles[i], other)
    of_state, of_sensors = np.where(readout.linear, K, 0), np.where(readout.linear, 0, K)
    offset = _known(of_state, now, readout) + _known(of_sensors, now - before, readout)
    used = np.any((K != 0) | (beside != 0), axis=(0, 1)) & ~readout.linear
    stage = int(max(readout.stage[used], default=0))
    gain = of_state @ readout.of_state
    if stage:
        gain = np.concatenate([gain, of_sensors @ readout.of_sensors], axis=-1)
    law = None
    if at_once is not None or not all(other.implementation.ideal for other in vehicles):
        sampler = Sampler(vehicles, K, beside, readout.names, timestep, len(time))
        law = _law(sampler, readout, _unseen(now, readout, True) + _unseen(now - before, readout, False), stage)

    mujoco.set_mju_user_warning(lambda text: None)  # else it writes MUJOCO_LOG.TXT; `diverged` says the same
    try:
        sensed, qpos, asked = _step(batch, readout.mocap, gain, offset, midway, now if readout.felt else None, stage, law)
    finally:
        mujoco.set_mju_user_warning(None)

    # What is recorded was sensed inside the step, where the road was midway, or before it, where the last step had left it.
    signals, wheels = vehicle.kind.signals, vehicle.kind.wheels
    place = np.array([[signal.name == name for name in readout.names] for signal in signals], dtype=float)
    inside = readout.stage > stage
    recorded = sensed @ (place @ readout.of_sensors).T
    recorded -= place @ readout.rest
    if not readout.felt:
        recorded += (now - midway) @ (place[:, inside] @ readout.of_road[inside]).T
    if stage and not readout.felt:
        recorded += (now - before) @ (place[:, ~inside] @ readout.of_road[~inside]).T
    names = [signal.name for signal in signals]
    recorded[..., [names.index(wheel.road_displacement) for wheel in wheels]] = now
    velocity = np.stack([under_wheels(road.velocity, road, vehicle, time) for vehicle, road in pairs], axis=1)
    recorded[..., [names.index(wheel.road_velocity) for wheel in wheels]] = velocity

    # A force beyond 1e10 MuJoCo replaces by none at all, and runs on: what was asked for counts, not only what came of it.
    largest = [np.maximum(values.max(axis=-1), -values.min(axis=-1)) for values in (recorded, asked)]
    wild = ~(np.maximum(*largest) < DIVERGED)  # NaN compares as wild
    diverged = np.where(wild.any(axis=0), time[wild.argmax(axis=0)], np.inf)
    recorded[time[:, None] >= diverged] = np.nan
    return PhysicsRuns(Response(time, signals, recorded.swapaxes(0, 1)), qpos.swapaxes(0, 1), diverged)


@dataclass(frozen=True, eq=False)
class _Readout:
    """How signals come out of MuJoCo. A signal is its sensor, read along its `user` direction, from its value at rest.

    Attributes:
        names: of the S signals.
        stage: mjtStage that the sensor of each needs, shape (S,).
        linear: whether it is linear in (qpos, qvel), shape (S,). Such a signal can be read from the state before a step, where
            evaluating its sensor would cost a seventh of the step.
        of_state: signals from (qpos, qvel) where they are linear, shape (S, nq + nv).
        of_sensors: signals from `sensordata`, shape (S, nsensordata).
        of_road: their derivative in the road heights, shape (S, r). They are linear in those.
        rest: what `of_sensors` gives at rest, shape (S,).
        felt: whether an acceleration feels the road at once; then sensing it inside the step, road midway, is not enough.
        mocap: mocap index of every wheel's road.
    """

    names: tuple[str, ...]
    stage: Array
    linear: Array
    of_state: Array
    of_sensors: Array
    of_road: Array
    rest: Array
    felt: bool
    mocap: list[int]


@functools.lru_cache(maxsize=4)
def _prepared(vehicle: Vehicle, timestep: float) -> tuple[mujoco.MjModel, _Readout]:
    """Model and readout of a vehicle. A search runs one vehicle hundreds of times; `Batch` copies the model."""
    model = build_model(vehicle, timestep)
    return model, _readout(vehicle, model)


def _readout(vehicle: Vehicle, model: mujoco.MjModel) -> _Readout:
    data = mujoco.MjData(model)
    mocap = mocap_indices(vehicle, model)
    names = vehicle.linear_model.outputs
    stage = np.zeros(len(names), dtype=int)
    of_sensors = np.zeros((len(names), model.nsensordata))
    for i, name in enumerate(names):
        for part, factor in vehicle.kind.combined.get(name, {name: 1.0}).items():
            sensor = model.sensor(part)
            start, dim = int(sensor.adr[0]), int(sensor.dim[0])
            of_sensors[i, start : start + dim] = factor * sensor.user[:dim]
            stage[i] = max(stage[i], int(sensor.needstage[0]))

    def read(motion: Array, heights: Array) -> Array:
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = motion[: model.nq], motion[model.nq :]
        data.mocap_pos[mocap, 2] = heights
        mujoco.mj_forward(model, data)
        return of_sensors @ data.sensordata

    # qpos = 0 is the static equilibrium of every MJCF here.
    still, flat = np.zeros(model.nq + model.nv), np.zeros(len(mocap))
    rest = read(still, flat)
    small = 0.1  # of a metre, a radian: a tyre's length is linear only while its road stays below the hub
    of_road = np.stack([read(still, height) - rest for height in small * np.eye(len(flat))], axis=-1) / small
    of_state = np.stack([read(move, flat) - rest for move in small * np.eye(len(still))], axis=-1) / small

    late = stage > int(mujoco.mjtStage.mjSTAGE_VEL)
    felt = bool(np.any(np.abs(of_road[late]) > 1e-9 * (1 + np.abs(rest[late, None]))))
    linear = ~late
    rng = np.random.default_rng(0)
    for _ in range(3):  # linear, if a few states far from the axes say so
        move, height = rng.uniform(-0.1, 0.1, len(still)), rng.uniform(-0.1, 0.1, len(flat))
        linear &= np.abs(read(move, height) - rest - of_state @ move - of_road @ height) < 1e-12
    return _Readout(names, stage, linear, of_state, of_sensors, np.where(late[:, None], 0.0, of_road), rest, felt, mocap)


def _gain_on(signals: Sequence[str], vehicle: Vehicle, controller: Controller) -> Array:
    """The controller's gain on all of these signals, shape (m, S): zero on what it does not measure."""
    gain = np.zeros((len(vehicle.linear_model.inputs), len(signals)))
    gain[:, [signals.index(name) for name in controller.measured]] = controller.gain
    return gain


def _known(gain: Array, road: Array, readout: _Readout) -> Array:
    """What is known beforehand of the forces, shape (T, N, m): the gain (N, m, S) on what a reading has not seen of the road.

    A sensor's reading has its value at rest in it besides; that of the state has none.
    """
    return np.einsum("nms,tns->tnm", gain, road @ readout.of_road.T - np.where(readout.linear, 0.0, readout.rest))


def _unseen(road: Array, readout: _Readout, linear: bool) -> Array:
    """The same for the signals themselves, shape (T, N, S): of those that are read from the state, or those from sensors."""
    mine = readout.linear == linear
    return np.where(mine, road @ readout.of_road.T - np.where(linear, 0.0, readout.rest), 0.0)


def _law(sampler: Sampler, readout: _Readout, known: Array, stage: int) -> Callable[[int, Array], Array]:
    """The forces of step k from the reading, for controllers that are more than a gain."""
    of_reading = np.where(readout.linear[:, None], readout.of_state, 0.0)
    if stage:
        of_reading = np.concatenate([of_reading, np.where(readout.linear[:, None], 0.0, readout.of_sensors)], axis=-1)

    def forces(k: int, reading: Array) -> Array:
        return sampler(k, reading @ of_reading.T + known[k])

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
) -> tuple[Array, Array, Array]:
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

    Returns:
        `sensordata`, shape (T, N, nsensordata): that of the samples; else up to the stage from before the step, the rest from
        inside it.
        Then qpos, shape (T, N, nq), and the forces asked for, (T, N, m).
    """
    samples, count, m = offset.shape
    # The motors, in the order of the linear model's inputs, are all there is in ctrl.
    ctrl, heights, sensors = batch.bind("ctrl"), batch.bind("mocap_pos")[:, :, 2], batch.bind("sensordata")
    motion, width = _motion(batch), gain.shape[2]
    batch.forward(stage=stage)

    # A numpy call costs a tenth of a step, so there are few: the forces' known part lies beside the reading, with unit gain.
    gain = np.concatenate([gain, np.broadcast_to(np.eye(m), (count, m, m))], axis=-1)
    seen = np.empty((samples, count, width + m))
    seen[..., width:] = offset
    roads = np.zeros((samples, *heights.shape))
    roads[..., mocap] = midway
    sensed = np.empty((samples, *sensors.shape))
    moved = motion.shape[1]
    asked = np.empty((samples, count, m)) if law else None
    rows: Any = zip(range(samples), seen, seen[..., :moved], seen[..., moved:width], roads, sensed, strict=True)
    step = functools.partial(batch.step, stage=stage) if stage else batch.step
    roads_at_samples = iter(at_samples if at_samples is not None else ())
    for k, all_seen, moving, sensing, road, result in rows:
        moving[...] = motion
        if stage:
            sensing[...] = sensors
        if law is None or asked is None:
            np.matvec(gain, all_seen, ctrl)
        else:
            asked[k] = law(k, all_seen[:, :width])
            ctrl[...] = asked[k]
        if at_samples is not None:
            heights[:, mocap] = next(roads_at_samples)
            batch.forward()
            result[...] = sensors
        heights[...] = road
        step()
        if at_samples is None:
            result[...] = sensors
    if stage and at_samples is None:
        # The evaluation after a step has overwritten what the step itself had sensed.
        early = np.repeat(batch.model.sensor_needstage, batch.model.sensor_dim) <= stage
        sensed[..., early] = seen[..., moved:width][..., early]
    return sensed, seen[..., : batch.bind("qpos").shape[1]], np.matvec(gain, seen) if asked is None else asked


def _motion(batch: Batch) -> Array:
    """(qpos, qvel) of every run as one view, shape (N, nq + nv): they lie side by side in a state row."""
    qpos, qvel = batch.bind("qpos"), batch.bind("qvel")
    start = (qpos.ctypes.data - batch.state.ctypes.data) // batch.state.itemsize
    motion = batch.state[:, start : start + qpos.shape[1] + qvel.shape[1]]
    assert motion[0, qpos.shape[1] :].ctypes.data == qvel.ctypes.data, "mjSTATE_QVEL follows mjSTATE_QPOS"
    return motion
