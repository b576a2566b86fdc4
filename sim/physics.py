"""The MuJoCo response: one function for one run or ten thousand. The only file of `sim/` that knows MuJoCo.

What makes it agree with the analysis to the integrator's own error (RK4's, to the fourth power of the step):

- the road is a mocap body that MuJoCo holds over a step, so it is put at its height midway through the step;
- but signals are read with the road where it is at the sample;
- the controller is sampled: it reads the signals once a step, and its force is held.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch

from models.arrays import Array
from models.mjcf import build_model
from models.vehicle import Vehicle
from sim.response import Response
from sim.road import Road, under_wheels
from sim.scene import Motion, Scene, Shape
from synth.controller import Controller

DIVERGED = 1e8  # a signal beyond this, in SI units, is no vehicle any more
FORMS = {
    int(mujoco.mjtGeom.mjGEOM_BOX): "box",
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): "cylinder",
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): "capsule",
    int(mujoco.mjtGeom.mjGEOM_SPHERE): "sphere",
}


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
) -> PhysicsRuns:
    """Runs N vehicles of one kind, each with its own parameters, controller and road, from rest.

    Args:
        vehicles: N vehicles of the same kind. Where they are all the same object, one model serves them.
        controllers: N controllers.
        roads: N roads.
        time: equidistant sample times [s], shape (T,), from 0; their distance is the timestep.
        threads: how many threads share the runs; results do not depend on it. 0 takes every core.
    """
    vehicle, timestep = vehicles[0], float(time[1] - time[0])
    model, readout = _prepared(vehicle, timestep)
    batch = Batch(model, len(vehicles), threads)
    if any(other is not vehicle for other in vehicles):
        batch.set_models([build_model(other, timestep) for other in vehicles])

    # Road heights, shape (T, N, r): at the samples, and midway through the steps, where MuJoCo holds them.
    now = np.stack([under_wheels(road.displacement, road, vehicle, time) for road in roads], axis=1)
    midway = np.stack([under_wheels(road.displacement, road, vehicle, time + timestep / 2) for road in roads], axis=1)
    # What MuJoCo's reading has not seen of the road, as signals: all of it, or its move since the middle of the last step.
    seen = np.zeros_like(now) if readout.from_state else np.concatenate([np.zeros_like(now[:1]), midway[:-1]])
    unseen = (now - seen) @ readout.road.T - readout.rest

    K = np.stack([_gain_on(readout.early, vehicle, controller) for controller in controllers])  # (N, m, early signals)
    gain, offset = K @ readout.early_signals, np.einsum("nms,tns->tnm", K, unseen)

    mujoco.set_mju_user_warning(lambda text: None)  # else it writes MUJOCO_LOG.TXT; `diverged` says the same
    try:
        readings, late, qpos = _step(batch, readout, gain, offset, midway)
    finally:
        mujoco.set_mju_user_warning(None)

    early, late = readings @ readout.early_signals.T + unseen, late @ readout.late_signals.T - readout.late_rest
    values = dict(zip(readout.early, np.moveaxis(early, -1, 0), strict=True))
    values |= dict(zip(readout.late, np.moveaxis(late, -1, 0), strict=True))
    for i, wheel in enumerate(vehicle.kind.wheels):
        values[wheel.road_displacement] = now[..., i]
        values[wheel.road_velocity] = np.stack([under_wheels(road.velocity, road, vehicle, time)[:, i] for road in roads], axis=1)
    stacked = np.stack([values[signal.name] for signal in vehicle.kind.signals], axis=-1).swapaxes(0, 1)

    # A force beyond 1e10 MuJoCo replaces by none at all, and runs on: what was asked for counts, not only what came of it.
    asked = np.einsum("nms,tns->ntm", K, early)
    wild = ~(np.all(np.abs(stacked) < DIVERGED, axis=-1) & np.all(np.abs(asked) < DIVERGED, axis=-1))  # NaN compares as wild
    diverged = np.where(wild.any(axis=1), time[wild.argmax(axis=1)], np.inf)
    stacked[time >= diverged[:, None]] = np.nan
    return PhysicsRuns(Response(time, vehicle.kind.signals, stacked), qpos.swapaxes(0, 1), diverged)


@dataclass(frozen=True, eq=False)
class _Readout:
    """How signals come out of MuJoCo. A signal is its sensor, read along its `user` direction, from its value at rest.

    Signals of position and velocity (`early`) are needed before a step, for the controller. Evaluating their sensors there costs
    a fifth of a step. Where all of them are linear in qpos and qvel, as in a vehicle that only heaves, they are read from the
    state.

    Attributes:
        early: names of the signals of position and velocity.
        late: names of those of acceleration and force, which are read inside the step.
        from_state: whether `early` is read from (qpos, qvel), else from `sensordata`.
        early_signals: early signals from the reading, shape (e, nq + nv) or (e, nsensordata).
        road: their derivative in the road heights, shape (e, r).
        rest: the reading's part of them at rest, shape (e,).
        late_signals: late signals from `sensordata`, shape (l, nsensordata).
        late_rest: shape (l,).
        mocap: mocap index of every wheel's road.
    """

    early: tuple[str, ...]
    late: tuple[str, ...]
    from_state: bool
    early_signals: Array
    road: Array
    rest: Array
    late_signals: Array
    late_rest: Array
    mocap: list[int]


@functools.lru_cache(maxsize=4)
def _prepared(vehicle: Vehicle, timestep: float) -> tuple[mujoco.MjModel, _Readout]:
    """Model and readout of a vehicle. A search runs one vehicle hundreds of times; `Batch` copies the model."""
    model = build_model(vehicle, timestep)
    return model, _readout(vehicle, model)


def _readout(vehicle: Vehicle, model: mujoco.MjModel) -> _Readout:
    data = mujoco.MjData(model)
    mocap = _mocap(vehicle, model)
    names = vehicle.linear_model.outputs
    stage = np.zeros(len(names), dtype=int)
    rows = np.zeros((len(names), model.nsensordata))
    for i, name in enumerate(names):
        for part, factor in vehicle.kind.combined.get(name, {name: 1.0}).items():
            sensor = model.sensor(part)
            start, dim = int(sensor.adr[0]), int(sensor.dim[0])
            rows[i, start : start + dim] = factor * sensor.user[:dim]
            stage[i] = max(stage[i], int(sensor.needstage[0]))

    def read(qpos: Array, qvel: Array, heights: Array) -> Array:
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = qpos, qvel
        data.mocap_pos[mocap, 2] = heights
        mujoco.mj_forward(model, data)
        return rows @ data.sensordata

    nq, nv, r = model.nq, model.nv, len(mocap)
    qpos, qvel, flat = model.qpos0.copy(), np.zeros(nv), np.zeros(r)
    rest = read(qpos, qvel, flat)
    early = stage <= int(mujoco.mjtStage.mjSTAGE_VEL)
    small = 0.1  # of a metre, a radian: a tyre's length is linear only while its road stays below the hub
    road = np.stack([read(qpos, qvel, height) - rest for height in small * np.eye(r)], axis=-1) / small
    if np.any(np.abs(road[~early]) > 1e-9 * (1 + np.abs(rest[~early, None]))):
        raise ValueError(
            f"{vehicle.kind.mjcf.name}: an acceleration sensor feels the road within a step, so it cannot be read there"
        )

    derivative = (
        np.stack(
            [read(qpos + dq, qvel, flat) - rest for dq in small * np.eye(nq)]
            + [read(qpos, qvel + dv, flat) - rest for dv in small * np.eye(nv)],
            axis=-1,
        )
        / small
    )
    rng = np.random.default_rng(0)
    from_state = True
    for _ in range(3):  # linear, if a few states far from the axes say so
        dq, dv, height = rng.uniform(-0.1, 0.1, nq), rng.uniform(-1, 1, nv), rng.uniform(-0.1, 0.1, r)
        predicted = derivative @ np.concatenate([dq, dv]) + road @ height
        error = read(qpos + dq, qvel + dv, height) - rest - predicted
        from_state &= bool(np.all(np.abs(error[early]) < 1e-12))

    return _Readout(
        early=tuple(name for name, is_early in zip(names, early, strict=True) if is_early),
        late=tuple(name for name, is_early in zip(names, early, strict=True) if not is_early),
        from_state=from_state,
        early_signals=derivative[early] if from_state else rows[early],
        road=road[early],
        rest=derivative[early] @ np.concatenate([qpos, qvel]) if from_state else rest[early],
        late_signals=rows[~early],
        late_rest=rest[~early],
        mocap=mocap,
    )


def _gain_on(signals: Sequence[str], vehicle: Vehicle, controller: Controller) -> Array:
    """The controller's gain on all of these signals, shape (m, signals): zero on what it does not measure."""
    gain = np.zeros((len(vehicle.linear_model.inputs), len(signals)))
    gain[:, [signals.index(name) for name in controller.measured]] = controller.gain
    return gain


def _step(batch: Batch, readout: _Readout, gain: Array, offset: Array, midway: Array) -> tuple[Array, Array, Array]:
    """The loop: read, control, move the road, step.

    Args:
        gain: from the reading to the forces, shape (N, m, reading).
        offset: the forces' other part, shape (T, N, m).
        midway: road heights during the steps, shape (T, N, r).

    Returns:
        The readings (T, N, reading), `sensordata` inside the steps (T, N, nsensordata) and qpos (T, N, nq).
    """
    samples, count, m = offset.shape
    # The motors, in the order of the linear model's inputs, are all there is in ctrl.
    ctrl, heights, sensors = batch.bind("ctrl"), batch.bind("mocap_pos")[:, :, 2], batch.bind("sensordata")
    qpos, motion = batch.bind("qpos"), _motion(batch)
    stage = int(mujoco.mjtStage.mjSTAGE_NONE if readout.from_state else mujoco.mjtStage.mjSTAGE_VEL)
    batch.forward(stage=stage)
    reading = motion if readout.from_state else sensors
    width = reading.shape[1]

    # A numpy call costs a tenth of a step, so there are few: the forces' known part lies beside the reading, with unit gain.
    gain = np.concatenate([gain, np.broadcast_to(np.eye(m), (count, m, m))], axis=-1)
    seen = np.empty((samples, count, width + m))
    seen[..., width:] = offset
    roads = np.zeros((samples, *heights.shape))
    roads[..., readout.mocap] = midway
    late = np.empty((samples, *sensors.shape))
    positions = seen[..., : qpos.shape[1]] if readout.from_state else np.empty((samples, *qpos.shape))
    rows: Any = zip(seen, seen[..., :width], positions, roads, late, strict=True)
    step = batch.step if readout.from_state else functools.partial(batch.step, stage=stage)
    for all_seen, read, position, road, sensed in rows:
        read[...] = reading
        if not readout.from_state:
            position[...] = qpos
        np.matvec(gain, all_seen, ctrl)
        heights[...] = road
        step()
        sensed[...] = sensors
    return seen[..., :width], late, positions


def _motion(batch: Batch) -> Array:
    """(qpos, qvel) of every run as one view, shape (N, nq + nv): they lie side by side in a state row."""
    qpos, qvel = batch.bind("qpos"), batch.bind("qvel")
    start = (qpos.ctypes.data - batch.state.ctypes.data) // batch.state.itemsize
    motion = batch.state[:, start : start + qpos.shape[1] + qvel.shape[1]]
    assert motion[0, qpos.shape[1] :].ctypes.data == qvel.ctypes.data, "mjSTATE_QVEL follows mjSTATE_QPOS"
    return motion


def draw(vehicle: Vehicle, road: Road, time: Array, qpos: Array) -> Scene:
    """One run as a scene of 60 frames a second. Springs are drawn from every site `NAME_bottom` to its `NAME_top`.

    Args:
        vehicle: the vehicle.
        road: its road.
        time: equidistant sample times [s], shape (T,), from 0.
        qpos: generalized positions, shape (T, nq).
    """
    timestep = float(time[1] - time[0])
    model, _ = _prepared(vehicle, timestep)
    data = mujoco.MjData(model)
    frames = np.unique(np.round(np.arange(0, time[-1], 1 / 60) / timestep).astype(int))
    frames = frames[np.all(np.abs(qpos[frames]) < DIVERGED, axis=-1)]
    heights = under_wheels(road.displacement, road, vehicle, time[frames])
    mocap = _mocap(vehicle, model)
    sites = [model.site(i).name for i in range(model.nsite)]
    springs = [name.removesuffix("_bottom") for name in sites if name.endswith("_bottom")]
    ends = [[model.site(f"{name}_{end}").id for end in ("bottom", "top")] for name in springs]

    positions, quaternions = np.empty((len(frames), model.nbody, 3)), np.empty((len(frames), model.nbody, 4))
    coils = np.empty((len(frames), len(springs), 2, 3))
    for f, frame in enumerate(frames):
        data.qpos[:] = qpos[frame]
        data.mocap_pos[mocap, 2] = heights[f]
        mujoco.mj_kinematics(model, data)
        positions[f], quaternions[f], coils[f] = data.xpos, data.xquat, data.site_xpos[ends]
    return Scene(
        time=time[frames],
        shapes=tuple(_shape(model, i) for i in range(model.ngeom) if int(model.geom_type[i]) in FORMS),
        bodies={model.body(i).name: Motion(positions[:, i], quaternions[:, i]) for i in range(1, model.nbody)},
        springs={name: coils[:, i] for i, name in enumerate(springs)},
    )


def _mocap(vehicle: Vehicle, model: mujoco.MjModel) -> list[int]:
    """Mocap index of every wheel's road."""
    return [int(model.body(wheel.road_body).mocapid[0]) for wheel in vehicle.kind.wheels]


def _shape(model: mujoco.MjModel, i: int) -> Shape:
    geom = model.geom(i)
    form = FORMS[int(model.geom_type[i])]
    material = int(model.geom_matid[i])
    return Shape(
        name=geom.name,
        body=model.body(int(geom.bodyid[0])).name,
        form=form,
        half_size=geom.size.copy(),
        position=geom.pos.copy(),
        quaternion=geom.quat.copy(),
        rgba=(model.mat_rgba[material] if material >= 0 else geom.rgba).copy(),
    )
