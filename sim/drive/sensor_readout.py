"""Computation of signals from MuJoCo's state and sensors."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco.batch import Batch

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.extensions import FEATURES
from models.vehicle.mjcf import build_model, damped_tyres, mocap_indices, pushed_dofs
from models.vehicle.vehicle import Vehicle

# pyright: reportAttributeAccessIssue=false
# MuJoCo's Python bindings have no type stubs.

CLOSEST = 1e-13  # m, rad and their rates: accuracy with which the given state is reached at the start of a run
MOST_TRIALS = 60  # largest number of iterations in the search for a given state at the start of a run


def hardware(vehicle: Vehicle) -> tuple[object, ...]:
    """Returns a key that is equal for vehicles with the same MuJoCo model, even if the implementations of the controllers
    differ.
    """
    curves, ratios, dampers = (one.values() for one in (vehicle.curves, vehicle.kind.ratios, vehicle.dampers))
    return (vehicle.kind.name, *vehicle.parameters.values(), *curves, *ratios, vehicle.limits, *dampers)


def reads_out(vehicle: Vehicle, timestep: float) -> bytes:
    """Returns a key that is equal for vehicles that can be simulated in one batch, because geometry and number of elements are
    the same.
    """
    model, readout = prepared_readout(vehicle, timestep)
    # A vehicle with a bump stop, an anti-roll bar or a characteristic needs a model that also contains this part.
    actuators = (*model.actuator_gaintype, *model.actuator_biastype, *model.actuator_trnid[:, 0])
    elements = np.array([model.ntendon, model.nwrap, model.nu, *actuators])
    used = np.where(readout.linear[:, None], readout.of_state, 0.0)
    closing = readout.stretching_rates if vehicle.dampers else np.zeros(0)
    return b"".join(
        part.tobytes()
        for part in (elements, closing, readout.linear, readout.stage, used, readout.of_sensors, readout.of_road, readout.rest)
    )


@dataclass(frozen=True, eq=False)
class Readout:
    """Matrices that map MuJoCo's state and sensors to signals.

    The value of a signal is the sensor's value along the sensor's `user` direction, minus this value in equilibrium.

    Attributes:
        names: names of the S signals. The last k signals are the internal states of the vehicle's suspension parts.
        stage: computation stage (`mjtStage`) that MuJoCo must reach to evaluate the sensor of each signal, shape (S,).
        linear: True for signals that are linear in (qpos, qvel), shape (S,). Signals that are linear in (qpos, qvel) are
            computed from the state before a step. Evaluating the sensors of the linear signals instead would take a seventh of
            the time that a step takes.
        of_state: matrix that maps (qpos, qvel) to the linear signals, shape (S, nq + nv).
        of_sensors: matrix that maps MuJoCo's `sensordata` to signals, shape (S, nsensordata).
        of_parts: matrix that maps the internal states of parts to signals, shape (S, k).
        of_road: derivatives of the signals with respect to the road heights, shape (S, r); the signals are linear in these
            heights.
        rest: product of `of_sensors` and MuJoCo's `sensordata` in equilibrium, shape (S,).
        has_road_feedthrough: True if an acceleration depends directly on the road height. An acceleration that depends on the
            road height has a different value during a MuJoCo step (road at mid-step) than at the sample.
        mocap: index of the mocap body that represents the road under each wheel.
        stretching_rates: matrix that maps qvel to the extension rate of each input's actuator, for the geometry in equilibrium,
            shape (m, nv).
        lagging: index of each input's activation in MuJoCo's model, shape (m,); -1 for an input without activation.
        load_dofs: index of the degree of freedom on which each external load acts.
        damped_tyres: indices of the wheels whose tyres have damping, and indices of the actuators that apply the damping
            forces.
    """

    names: tuple[str, ...]
    stage: Array
    linear: Array
    of_state: Array
    of_sensors: Array
    of_parts: Array
    of_road: Array
    rest: Array
    has_road_feedthrough: bool
    mocap: list[int]
    stretching_rates: Array
    lagging: Array
    load_dofs: list[int]
    damped_tyres: tuple[list[int], list[int]]


@functools.lru_cache(maxsize=16)
def prepared_readout(vehicle: Vehicle, timestep: float) -> tuple[mujoco.MjModel, Readout]:
    """Returns the MuJoCo model of a vehicle, and its `Readout`. Model and `Readout` are cached, because a search simulates the
    same vehicle hundreds of times.

    `Batch` copies the model.
    """
    model = build_model(vehicle, timestep, drawn=False)
    return model, _readout(vehicle, model)


def state_at_start(vehicle: Vehicle, model: mujoco.MjModel, readout: Readout) -> Array | None:
    """Returns positions, velocities, states of parts and activations at the start of a run; None if the run starts in
    equilibrium.

    Raises:
        InputError: no position of the vehicle has the requested initial deflections.
    """
    if (state := vehicle.start_state) is None:
        return None
    data, names, own = mujoco.MjData(model), vehicle.linear_model.states, len(vehicle.kind.of_parts)
    rows = [readout.names.index(name) for name in names[: len(names) - own]]
    moved, motion, inverse = state[: len(rows)], np.zeros(model.nq + model.nv), np.linalg.pinv(readout.of_state[rows])
    for _ in range(MOST_TRIALS):
        data.qpos[:], data.qvel[:] = motion[: model.nq], motion[model.nq :]
        mujoco.mj_forward(model, data)
        far = moved - (readout.of_sensors[rows] @ data.sensordata - readout.rest[rows])
        if np.abs(far).max(initial=0.0) < CLOSEST:
            return np.concatenate([motion, state[len(rows) :], np.zeros(model.na)])
        motion = motion + inverse @ far
    raise InputError("[start]: the vehicle has no position with all these deflections at the same time; give smaller deflections")


def batch_of(model: mujoco.MjModel, vehicles: Sequence[Vehicle], models: Sequence[mujoco.MjModel] = ()) -> Batch:
    """Returns a MuJoCo batch of N runs on one thread; each run has a separate model if several models are given."""
    if any(one.acts and not one.native for one in vehicles[0].parts):
        from models.vehicle.suspension_forces import SuspensionForces

        tendons = [part.tendon for part in vehicles[0].kind.suspensions]
        return FEATURES.load("parts in MuJoCo").PartBatch(
            model, tendons, SuspensionForces(vehicles, by_motor=True), len(vehicles), models
        )
    batch = Batch(model, len(vehicles), 1)
    if models:
        batch.set_models(models)
    return batch


def _readout(vehicle: Vehicle, model: mujoco.MjModel) -> Readout:
    data = mujoco.MjData(model)
    mocap = mocap_indices(vehicle, model)
    names, own = vehicle.linear_model.outputs, len(vehicle.kind.of_parts)
    stage = np.zeros(len(names), dtype=int)
    of_sensors = np.zeros((len(names), model.nsensordata))
    for i, name in enumerate(vehicle.sensed_signals):
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

    # In all models of this project, qpos = 0 is the static equilibrium.
    still, flat = np.zeros(model.nq + model.nv), np.zeros(len(mocap))
    # Values in SI units, rounded because the rounding errors of accelerations would otherwise depend on the masses
    rest = np.round(read(still, flat), 12)
    # displacement in metres or radians; it is small, because a tyre's length is linear only while the road stays below the hub
    small = 0.1
    of_road = np.stack([read(still, height) - rest for height in small * np.eye(len(flat))], axis=-1) / small
    of_state = np.stack([read(move, flat) - rest for move in small * np.eye(len(still))], axis=-1) / small

    late = stage > int(mujoco.mjtStage.mjSTAGE_VEL)
    felt = bool(np.any(np.abs(of_road[late]) > 1e-9 * (1 + np.abs(rest[late, None])))) or (vehicle.inertial and bool(late.any()))
    linear = ~late
    rng = np.random.default_rng(0)
    for _ in range(3):  # a signal counts as linear if its value agrees with the linear terms in three random states
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
        of_parts=np.eye(len(names), own, own - len(names)),
        of_road=np.where(late[:, None], 0.0, of_road),
        rest=rest,
        has_road_feedthrough=felt,
        mocap=mocap,
        stretching_rates=np.stack(stretching, axis=-1),
        lagging=np.array(model.actuator_actadr[:inputs]),
        load_dofs=pushed_dofs(vehicle, model),
        damped_tyres=damped_tyres(vehicle, model),
    )


def states_of_parts(batch: Batch) -> Array:
    """Returns the states of the vehicles' parts in a batch, initially 0, shape (N, k)."""
    return getattr(batch, "z", np.zeros((batch.nsim, 0)))


def sensed_stage(readout: Readout, used: Array) -> int:
    """Returns the computation stage (`mjtStage`) up to which MuJoCo must evaluate sensors before a step.

    Args:
        readout: matrices that map MuJoCo's state and sensors to signals.
        used: True for each signal that is needed, shape (S,).
    """
    return int(max(readout.stage[used & ~readout.linear], default=0))


def beside_reading(road: Array, readout: Readout, some: Sequence[int], linear: bool) -> Array:
    """Returns the contribution of road heights and equilibrium values to each signal, shape (T, N, s).

    Args:
        road: road heights whose contribution the signals do not contain yet [m], shape (T, N, r).
        readout: matrices that map MuJoCo's state and sensors to signals.
        some: indices of the s signals to which the contributions belong.
        linear: True for signals that are computed from the state, False for signals that are computed from sensors. The
            contribution is 0 for signals of the other kind.
    """
    beside = np.zeros((*road.shape[:2], len(some)))
    for i, s in enumerate(some):
        if readout.linear[s] == linear:
            beside[..., i] = 0.0 if linear else -readout.rest[s]
            for r in np.flatnonzero(readout.of_road[s]):
                beside[..., i] += readout.of_road[s, r] * road[..., r]
    return beside


def mix(matrix: Array, parts: Array, total: Array) -> None:
    """Adds a matrix product to totals term by term, so that the order of summation is fixed.

    Args:
        matrix: weights of the k terms in each sum, shape (S, k).
        parts: terms that are weighted and added, shape (B, k, N).
        total: array to which the weighted terms are added in place, shape (B, S, N).
    """
    for i, j in np.argwhere(matrix).tolist():
        total[:, i] += parts[:, j] if matrix[i, j] == 1 else matrix[i, j] * parts[:, j]
