"""How a vehicle's signals come out of MuJoCo: from its state, from its sensors, and what neither has seen of the road."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from models.common.arrays import Array
from models.mjcf import build_model, mocap_indices, pushed_dofs
from models.reality import steps_per_sample
from models.vehicle import Vehicle
from synth.controller import Controller


def reads_out(vehicle: Vehicle, timestep: float) -> bytes:
    """A key that is the same for vehicles that can be stepped side by side: of the same geometry, and of as many elements."""
    model, readout = prepared(vehicle, timestep)
    # One without a stop, a bar or a ramp has no place for that of another.
    elements = np.array([model.ntendon, model.nwrap, model.nu, *model.actuator_gaintype, *model.actuator_trnid[:, 0]])
    used = np.where(readout.linear[:, None], readout.of_state, 0.0)
    return b"".join(
        part.tobytes()
        for part in (elements, readout.linear, readout.stage, used, readout.of_sensors, readout.of_road, readout.rest)
    )


@dataclass(frozen=True, eq=False)
class Readout:
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
        stretching: how fast the inputs' actuators move out, from qvel, shape (m, nv); as at rest.
        lagging: of every input's actuator, where its activation lies among those of the model, -1 for none, shape (m,).
        pushed: along which degree of freedom each load pushes the body.
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
    stretching: Array
    lagging: Array
    pushed: list[int]


@functools.lru_cache(maxsize=16)
def prepared(vehicle: Vehicle, timestep: float) -> tuple[mujoco.MjModel, Readout]:
    """Model and readout of a vehicle. A search runs one vehicle hundreds of times; `Batch` copies the model."""
    model = build_model(vehicle, timestep)
    return model, _readout(vehicle, model)


def _readout(vehicle: Vehicle, model: mujoco.MjModel) -> Readout:
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
    rest = np.round(read(still, flat), 12)  # in SI; an acceleration's rounding would differ with the masses
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
    inputs, stretching = len(vehicle.linear_model.inputs), []
    mujoco.mj_resetData(model, data)
    for speeds in np.eye(model.nv):
        data.qvel[:] = speeds
        mujoco.mj_forward(model, data)
        stretching.append(np.array(data.actuator_velocity[:inputs]))
    return Readout(
        names=names,
        stage=stage,
        linear=linear,
        of_state=of_state,
        of_sensors=of_sensors,
        of_road=np.where(late[:, None], 0.0, of_road),
        rest=rest,
        felt=felt,
        mocap=mocap,
        stretching=np.stack(stretching, axis=-1),
        lagging=np.array(model.actuator_actadr[:inputs]),
        pushed=pushed_dofs(vehicle, model),
    )


def laws_on(
    signals: Sequence[str], vehicles: Sequence[Vehicle], controllers: Sequence[Controller | None], timestep: float
) -> tuple[Array, Array]:
    """N controllers as they are run, [u; next x_c] from these signals and x_c, each sampled as its vehicle says.

    Args:
        signals: names of S of them; a controller has no gain on what it does not measure.
        vehicles: N of them.
        controllers: N of them; None for no force.
        timestep: at which one without a sample period of its own is sampled [s].

    Returns:
        From the signals, shape (N, m + k, S), and from x_c, shape (N, m + k, k), with the k of the one that has most states.
    """
    periods = [steps_per_sample(vehicle.implementation, timestep) * timestep for vehicle in vehicles]
    pairs = list(zip(controllers, periods, strict=True))
    once = {(id(one), period): one.law.sampled(period) for one, period in dict.fromkeys(pairs) if one is not None}
    m, k = len(vehicles[0].linear_model.inputs), max((law.states for law in once.values()), default=0)
    of_signals, of_states = np.zeros((len(pairs), m + k, len(signals))), np.zeros((len(pairs), m + k, k))
    for i, (one, period) in enumerate(pairs):
        if one is not None:
            law, seen = once[id(one), period], [signals.index(name) for name in one.measured]
            end = m + law.states
            of_signals[i, :m, seen], of_signals[i, m:end, seen] = law.D.T, law.B.T
            of_states[i, :m, : law.states], of_states[i, m:end, : law.states] = law.C, law.A
    return of_signals, of_states


def measured_by(signals: Sequence[str], measured: Sequence[Sequence[str]]) -> tuple[Array, Array]:
    """What picks what N controllers measure out of these signals, shape (N, q, S), with the q of the one that measures most.

    Its rows are in the order of each; beside it the (N, q, 0) that `laws_on` gives of laws without states.
    """
    picked = np.zeros((len(measured), max(map(len, measured)), len(signals)))
    for rows, names in zip(picked, measured, strict=True):
        rows[range(len(names)), [signals.index(name) for name in names]] = 1.0
    return picked, np.zeros((*picked.shape[:2], 0))


def stage_of(vehicle: Vehicle, controller: Controller, timestep: float) -> int:
    """The mjtStage up to which sensors are evaluated before a step, for what the controller measures; 0 where none is needed."""
    readout = prepared(vehicle, timestep)[1]
    of_signals, _ = laws_on(readout.names, [vehicle], [controller], timestep)
    return sensed_stage(readout, np.any(of_signals, axis=(0, 1)))


def sensed_stage(readout: Readout, used: Array) -> int:
    """The mjtStage up to which sensors are evaluated before a step, for the signals that are used, shape (S,)."""
    return int(max(readout.stage[used & ~readout.linear], default=0))


def force_from_road(gain: Array, road: Array, readout: Readout) -> Array:
    """What is known beforehand of the forces, shape (T, N, m): a gain (N, m, S) on what a reading has not seen of the road.

    A sensor's reading has its value at rest in it, too; what is read from the state has none.
    """
    known = np.zeros((*road.shape[:2], gain.shape[1]))
    for m, s in np.argwhere(gain.any(axis=0)).tolist():
        unseen = np.full(road.shape[:2], 0.0 if readout.linear[s] else -readout.rest[s])
        for r in np.flatnonzero(readout.of_road[s]):
            unseen += readout.of_road[s, r] * road[..., r]
        known[..., m] += gain[:, m, s] * unseen
    return known


def signal_from_road(road: Array, readout: Readout, linear: bool) -> Array:
    """The same for the signals themselves, shape (T, N, S): of those that are read from the state, or those from sensors."""
    unseen = np.zeros((*road.shape[:2], len(readout.names)))
    for s in np.flatnonzero(readout.linear == linear):
        unseen[..., s] = 0.0 if linear else -readout.rest[s]
        for r in np.flatnonzero(readout.of_road[s]):
            unseen[..., s] += readout.of_road[s, r] * road[..., r]
    return unseen


def mix(matrix: Array, parts: Array, total: Array) -> None:
    """Adds sums of parts, shape (B, k, N), to totals, shape (B, S, N), by a matrix of shape (S, k), one by one."""
    for i, j in np.argwhere(matrix).tolist():
        total[:, i] += parts[:, j] if matrix[i, j] == 1 else matrix[i, j] * parts[:, j]
