"""The energy of a run: what road and actuators put in, and where it is found again. A check that needs no reference.

Within a step MuJoCo holds the road, so what it does to the vehicle it does between two steps: its work is what the jump of its
height adds to the tyres' springs. Within a step, then, what is stored changes by the actuators' work less what the dampers take:

    E[k+1, road k] - E[k, road k] = sum of integral f_a l_a' dt - sum of integral c_j l_j'^2 dt,

with E the kinetic and potential energy (gravity, springs, tyres, bump stops), all of it MuJoCo's own. What is left over is the
error of the integrator, and of the integrals: Simpson's rule, the middle of a step from lengths l and speeds l' at both its ends
by Hermite's cubic, whose slope there is right to the fourth power of the step. So the residual is of RK4's order, 4, while every
spring is linear in its length. Where one begins or ends to act within a step (a tyre leaves the road, a bump stop is touched),
RK4 itself has a kink in its step, and the residual is only of about second order.

Nothing else may do work: a force that is neither spring, weight, damper nor one of the vehicle's actuators is left over.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

import functools
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco.batch import Batch

from models.arrays import Array
from models.mjcf import build_spec, mocap_indices
from models.vehicle import Vehicle
from sim.physics import PhysicsRuns
from sim.road import Road, under_wheels

BALANCED = 1e-3  # of what is put in; far above what RK4 and its kinks make at any usual step, and far below a force forgotten
ROUNDING = 1e-6  # of the energy at rest; where less is put in, rounding decides what is left over
AT_ONCE = 4096  # states that are looked at together


@dataclass(frozen=True)
class Energy:
    """Where a run's energy came from and went to, from its start to its end or to where it diverged.

    Attributes:
        road: work of the road [J].
        actuators: work of the actuators [J].
        stored: change of the kinetic and potential energy [J].
        dissipated: by the dampers [J].
        put_in: the largest sum of both works at any time [J].
        residual: the largest sum of works less what is stored and dissipated at any time, over `put_in`.
    """

    road: float
    actuators: float
    stored: float
    dissipated: float
    put_in: float
    residual: float

    @property
    def balances(self) -> bool:
        """Whether no more is left over than integration makes."""
        return self.residual <= BALANCED


def energy(vehicle: Vehicle, runs: PhysicsRuns, index: int, road: Road) -> Energy:
    """The energy balance of one run.

    Args:
        vehicle: the vehicle.
        runs: what MuJoCo made of it, among others.
        index: which of them.
        road: the road.
    """
    time, model = runs.response.time, _observed(vehicle, float(runs.response.time[1]))
    h, count = float(time[1]), int(np.searchsorted(time, runs.diverged[index]))
    if count < 2:
        return Energy(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    qpos, qvel = runs.qpos[index, :count], runs.qvel[index, :count]
    midway = under_wheels(road.displacement, road, vehicle, time[:count] + h / 2)
    # A step ends with the road where it held it, and the next begins with it elsewhere: every state is looked at twice.
    starts = _look(vehicle, model, qpos, qvel, midway)
    ends, moved = starts[1:].copy(), np.any(midway[1:] != midway[:-1], axis=1)
    ends[moved] = _look(vehicle, model, qpos[1:][moved], qvel[1:][moved], midway[:-1][moved])
    rest = _look(vehicle, model, np.zeros_like(qpos[:1]), np.zeros_like(qvel[:1]), np.zeros_like(midway[:1]))

    actuators = len(vehicle.linear_model.inputs)
    stored = starts[:, 0] + starts[:, 1]
    lengths, speeds = (starts[:, 2 + k :: 2] for k in (0, 1))
    middle = 1.5 * np.diff(lengths, axis=0) / h - (speeds[:-1] + speeds[1:]) / 4
    forces = np.stack([runs.response[name][index, :count] for name in vehicle.linear_model.inputs], axis=-1)
    before, between, after = _forces(vehicle, forces, h)
    work = (before * speeds[:-1, :actuators] + 4 * between * middle[:, :actuators] + after * speeds[1:, :actuators]) * h / 6
    if vehicle.limits.actuator_bandwidth is None:
        work = forces[:-1] * np.diff(lengths[:, :actuators], axis=0)  # a held force's is exact
    damping = _damping(model)
    losses = (speeds[:-1, actuators:] ** 2 + 4 * middle[:, actuators:] ** 2 + speeds[1:, actuators:] ** 2) * damping * h / 6

    by_road = np.cumsum(np.concatenate([[stored[0] - rest[0, :2].sum()], stored[1:] - ends[:, :2].sum(axis=1)]))
    by_actuators = np.concatenate([[0.0], np.cumsum(work.sum(axis=1))])
    lost = np.concatenate([[0.0], np.cumsum(losses.sum(axis=1))])
    change = stored - rest[0, :2].sum()
    put_in = float(np.max(by_road + by_actuators))
    scale = max(put_in, ROUNDING * abs(float(rest[0, :2].sum()))) or 1.0
    residual = float(np.max(np.abs(by_road + by_actuators - change - lost))) / scale
    return Energy(float(by_road[-1]), float(by_actuators[-1]), float(change[-1]), float(lost[-1]), put_in, residual)


@functools.lru_cache(maxsize=16)
def _observed(vehicle: Vehicle, timestep: float) -> mujoco.MjModel:
    """The vehicle's model with sensors of all that makes its energy, and no others.

    In this order: potential and kinetic energy; then length and speed of every actuator, and of every damped tendon and joint.
    """
    spec = build_spec(vehicle, timestep)
    for sensor in list(spec.sensors):
        spec.delete(sensor)
    kind, of = mujoco.mjtSensor, mujoco.mjtObj
    spec.add_sensor(name="potential", type=kind.mjSENS_E_POTENTIAL)
    spec.add_sensor(name="kinetic", type=kind.mjSENS_E_KINETIC)
    pairs = [(kind.mjSENS_ACTUATORPOS, kind.mjSENS_ACTUATORVEL, of.mjOBJ_ACTUATOR, name) for name in vehicle.linear_model.inputs]
    for tendon in spec.tendons:
        if tendon.damping[0] > 0:
            pairs.append((kind.mjSENS_TENDONPOS, kind.mjSENS_TENDONVEL, of.mjOBJ_TENDON, tendon.name))
    for joint in spec.joints:
        if joint.damping[0] > 0:
            pairs.append((kind.mjSENS_JOINTPOS, kind.mjSENS_JOINTVEL, of.mjOBJ_JOINT, joint.name))
    for length, speed, what, name in pairs:
        for sensor in (length, speed):
            spec.add_sensor(name=f"{sensor.name}_{name}", type=sensor, objtype=what, objname=name)
    return spec.compile()


def _damping(model: mujoco.MjModel) -> Array:
    """Of every damper that `_observed` looks at, in its order [N s/m]."""
    return np.concatenate([model.tendon_damping[model.tendon_damping > 0], model.dof_damping[model.dof_damping > 0]])


def _look(vehicle: Vehicle, model: mujoco.MjModel, qpos: Array, qvel: Array, roads: Array) -> Array:
    """What the sensors say in these states over these roads, shape (T, nsensordata)."""
    found = np.empty((len(qpos), model.nsensordata))
    if len(qpos) == 0:
        return found
    batch = Batch(model, min(AT_ONCE, len(qpos)), 0)
    positions, velocities, heights, sensors = (batch.bind(name) for name in ("qpos", "qvel", "mocap_pos", "sensordata"))
    mocap = mocap_indices(vehicle, model)
    for first in range(0, len(qpos), batch.nsim):
        some = slice(max(0, min(first, len(qpos) - batch.nsim)), min(first + batch.nsim, len(qpos)))
        positions[:], velocities[:] = qpos[some], qvel[some]
        heights[:, mocap, 2] = roads[some]
        batch.forward(stage=int(mujoco.mjtStage.mjSTAGE_VEL))
        found[some] = sensors
    return found


def _forces(vehicle: Vehicle, forces: Array, h: float) -> tuple[Array, Array, Array]:
    """The actuators' forces [N] at beginning, middle and end of every step, shape (T - 1, m), from those at the samples.

    A lagging force goes to the one asked for exponentially, so from its ends its middle is known.
    """
    bandwidth = vehicle.limits.actuator_bandwidth
    before, after = forces[:-1], forces[1:]
    share = 1 / (1 + np.exp(-bandwidth * h / 2)) if bandwidth else 0.0
    return before, before + share * (after - before), after
