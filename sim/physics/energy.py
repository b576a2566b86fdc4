"""The energy of a run: what road and actuators put in, and where it is found again. A check that needs no reference.

Within a step MuJoCo holds the road, so what it does to the vehicle it does between two steps: its work is what the jump of its
height adds to the tyres' springs. Within a step, then, what is stored changes by the actuators' work less what the dampers take:

    E[k+1, road k] - E[k, road k] = sum of integral f_a l_a' dt + work of loads - sum of integral c_j l_j'^2 dt,

with E the kinetic and potential energy (gravity, springs, tyres, bump stops), all of it MuJoCo's own. What is left over is the
error of the integrator, and of the integrals: Simpson's rule, the middle of a step from lengths l and speeds l' at both its ends
by Hermite's cubic, whose slope there is right to the fourth power of the step. So the residual is of RK4's order, 4, while every
spring is linear in its length. Where one begins or ends to act within a step (a tyre leaves the road, a bump stop is touched),
RK4 itself has a kink in its step, and the residual is only of about second order; so it is at the knots of curves. What a
spring's curve stores, and a damper's takes, beyond their lines, is the integral of the curve, and Simpson's rule of its power.

Nothing else may do work: a force that is neither spring, weight, damper, load nor one of the vehicle's actuators is left over.

An actuator is to push along the deflection of its suspension, so its work is counted along that signal: that of one that acts on
one end only, or through a gear, is left over too. Where it has no suspension (nothing to push against but the world), work is
counted along MuJoCo's actuator itself, and such a fault is for the comparison with the linear model.
An adjustable damper takes energy and gives none: beyond the nominal one its force is -d l', with d held over a step, or
following what is asked of it as a lag does; its work is taken by Simpson's rule, too. That it takes energy is looked at by
itself, from the force and the speed at every sample, whatever coefficient was asked for.

Masses, springs and dampers are those of the MJCF: whether they are the vehicle's is the comparison's too.

What is left over is a share of what was turned over: taken by the dampers, moved by the actuators either way, and the largest
kinetic energy. Lifting the weight is no part of it: it would hide what is small beside it.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

import functools
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco.batch import Batch

from models.common.arrays import Array
from models.roads.road import RoadInput
from models.vehicle.mjcf import build_spec, mocap_indices, pushed_dofs
from models.vehicle.vehicle import Vehicle
from sim.physics.simulate import PhysicsRuns
from sim.response.response import Response

# Of what is turned over. RK4 leaves 2e-7 at 1 ms and 4e-5 at 4 ms, with kinks 5e-5 and 6e-4 (every vehicle and controller that
# ships, over two bumps); a damper that is 1 % off leaves 3e-3 and more.
BALANCED = 1e-3
ROUNDING = 1e-8  # of the energy at rest; where less is turned over, rounding decides what is left over
AT_ONCE = 4096  # states that are looked at together


@dataclass(frozen=True)
class Energy:
    """Where a run's energy came from and went to, from its start to its end or to where it broke off.

    Attributes:
        road: work of the road [J].
        actuators: work of the actuators [J].
        stored: change of the kinetic and potential energy [J].
        dissipated: by the dampers [J].
        turnover: what the dampers took, the actuators moved either way, and the largest kinetic energy [J].
        loads: work of the loads on the body [J]; None where there are none.
        residual: the largest sum of works less what is stored and dissipated at any time, over `turnover`.
        least: the least power that an adjustable damper took at any sample, over the most, below 0 where it gave some; None where
            there are none.
    """

    road: float
    actuators: float
    stored: float
    dissipated: float
    turnover: float
    residual: float
    least: float | None = None
    loads: float | None = None

    @property
    def balances(self) -> bool:
        """Whether no more is left over than integration makes, and no damper gave energy."""
        return self.residual <= BALANCED and (self.least is None or self.least >= -ROUNDING)


def energy(runs: PhysicsRuns, index: int, road: RoadInput, until: float = np.inf) -> Energy:
    """The energy balance of one run.

    Args:
        runs: what MuJoCo made of N vehicles.
        index: which of them.
        road: what this one met.
        until: when the vehicle broke off [s], if before it diverged: no number means anything from there.
    """
    vehicle, time, (model, along) = road.vehicle, road.time, _observed(road.vehicle, float(road.time[1]))
    h, count = float(time[1]), int(np.searchsorted(time, min(until, runs.diverged[index])))
    if count < 2:
        least, loads = 0.0 if vehicle.dampers else None, 0.0 if road.loaded else None
        return Energy(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, least, loads)
    qpos, qvel = runs.qpos[index, :count], runs.qvel[index, :count]
    midway = road.midway[:count]
    # A step ends with the road where it held it, and the next begins with it elsewhere: every state is looked at twice.
    starts = _look(vehicle, model, qpos, qvel, midway)
    ends, moved = starts[1:].copy(), np.any(midway[1:] != midway[:-1], axis=1)
    ends[moved] = _look(vehicle, model, qpos[1:][moved], qvel[1:][moved], midway[:-1][moved])
    rest = _look(vehicle, model, np.zeros_like(qpos[:1]), np.zeros_like(qvel[:1]), np.zeros_like(midway[:1]))

    actuators, curves = len(vehicle.linear_model.inputs), vehicle.fitted
    stored = starts[:, 0] + starts[:, 1]
    lengths, speeds = (starts[:, 2 + k :: 2] for k in (0, 1))
    middle = 1.5 * np.diff(lengths, axis=0) / h - (speeds[:-1] + speeds[1:]) / 4
    forces = along * np.stack([runs.response[name][index, :count] for name in vehicle.linear_model.inputs], axis=-1)
    before, between, after = _forces(vehicle, forces, h)
    work = (before * speeds[:-1, :actuators] + 4 * between * middle[:, :actuators] + after * speeds[1:, :actuators]) * h / 6
    if vehicle.limits.actuator_bandwidth is None:
        work = forces[:-1] * np.diff(lengths[:, :actuators], axis=0)  # a held force's is exact
    least = None
    if vehicle.dampers:
        response = runs.response.run(index).until(float(time[count - 1]) + h / 2)
        least = _by_dampers(vehicle, response, along * speeds[:, :actuators], along * middle[:, :actuators], work)
    dampers, damping = slice(actuators, speeds.shape[1] - len(curves)), _damping(model)
    losses = (speeds[:-1, dampers] ** 2 + 4 * middle[:, dampers] ** 2 + speeds[1:, dampers] ** 2) * damping * h / 6
    in_springs, in_dampers = np.zeros(count), np.zeros(count - 1)
    for i, one in enumerate(curves, dampers.stop):
        if one.damps:
            power = [v * one.curve.pieces.force(v) for v in (speeds[:-1, i], middle[:, i], speeds[1:, i])]
            in_dampers += (power[0] + 4 * power[1] + power[2]) * h / 6
        else:
            in_springs += one.curve.work(lengths[:, i] - rest[0, 2 + 2 * i])

    by_road = np.cumsum(np.concatenate([[stored[0] - rest[0, :2].sum()], stored[1:] - ends[:, :2].sum(axis=1)]))
    by_actuators = np.concatenate([[0.0], np.cumsum(work.sum(axis=1))])
    by_loads, pushed = np.zeros(count), 0.0
    if road.loaded:  # held, and along joints, so that their work is exact
        pushes = road.held_loads[: count - 1] * np.diff(qpos[:, pushed_dofs(vehicle, model)], axis=0)
        by_loads, pushed = np.concatenate([[0.0], np.cumsum(pushes.sum(axis=1))]), float(np.abs(pushes).sum())
    lost = np.concatenate([[0.0], np.cumsum(losses.sum(axis=1) + in_dampers)])
    change = stored + in_springs - rest[0, :2].sum()
    turnover = float(lost[-1] + np.abs(work).sum() + starts[:, 1].max()) + pushed
    scale = max(turnover, ROUNDING * abs(float(rest[0, :2].sum()))) or 1.0
    residual = float(np.max(np.abs(by_road + by_actuators + by_loads - change - lost))) / scale
    loads = float(by_loads[-1]) if road.loaded else None
    road_did, forces_did, changed, taken = (float(one[-1]) for one in (by_road, by_actuators, change, lost))
    return Energy(road_did, forces_did, changed, taken, turnover, residual, least, loads)


def _by_dampers(vehicle: Vehicle, response: Response, speeds: Array, middle: Array, work: Array) -> float:
    """Writes the work of adjustable dampers beyond the nominal ones, shape (T - 1, m); see `Energy.least`.

    Args:
        vehicle: the vehicle.
        response: its signals, of T samples.
        speeds: of the suspensions at the samples [m/s], shape (T, m).
        middle: of them amid the steps, shape (T - 1, m).
        work: takes theirs [J].
    """
    h, least = float(response.time[1]), np.inf
    for one in vehicle.adjustable:
        j = vehicle.linear_model.inputs.index(one.force)
        beyond, v, amid = response[one.coefficient] - one.nominal, speeds[:, j], middle[:, j]
        power = v * one.shape(v)
        before, after, bandwidth = beyond[:-1], beyond[1:], one.damper.bandwidth
        share = 1 / (1 + np.exp(-bandwidth * h / 2)) if bandwidth else 0.0
        between, end = before + share * (after - before), after if bandwidth else before
        work[:, j] = -(before * power[:-1] + 4 * between * amid * one.shape(amid) + end * power[1:]) * h / 6
        power = (one.pull(v, 0.0) - response[one.force]) * v
        least = min(least, float(power.min()) / (float(np.abs(power).max()) or 1.0))
    return least


@functools.lru_cache(maxsize=16)
def _observed(vehicle: Vehicle, timestep: float) -> tuple[mujoco.MjModel, Array]:
    """The vehicle's model with sensors of all that makes its energy, and no others; and how every force counts along its length.

    In this order: potential and kinetic energy; then length and speed that every actuator is to push along, of every damped
    tendon and joint, and of the tendon of every curve.
    """
    spec = build_spec(vehicle, timestep)
    kind, of = mujoco.mjtSensor, mujoco.mjtObj
    speeds = {kind.mjSENS_TENDONPOS: kind.mjSENS_TENDONVEL, kind.mjSENS_JOINTPOS: kind.mjSENS_JOINTVEL}
    sensors = {sensor.name: sensor for sensor in spec.sensors}
    pairs, along = [], []
    for name in vehicle.linear_model.inputs:
        stroke = sensors.get(vehicle.kind.pushed(name))
        if stroke is not None and stroke.type in speeds:
            pairs.append((stroke.type, speeds[stroke.type], stroke.objtype, stroke.objname))
            along.append(float(stroke.userdata[0]))
        else:
            pairs.append((kind.mjSENS_ACTUATORPOS, kind.mjSENS_ACTUATORVEL, of.mjOBJ_ACTUATOR, name))
            along.append(1.0)
    for sensor in list(spec.sensors):
        spec.delete(sensor)
    spec.add_sensor(name="potential", type=kind.mjSENS_E_POTENTIAL)
    spec.add_sensor(name="kinetic", type=kind.mjSENS_E_KINETIC)
    for tendon in spec.tendons:
        if tendon.damping[0] > 0:
            pairs.append((kind.mjSENS_TENDONPOS, kind.mjSENS_TENDONVEL, of.mjOBJ_TENDON, tendon.name))
    for joint in spec.joints:
        if joint.damping[0] > 0:
            pairs.append((kind.mjSENS_JOINTPOS, kind.mjSENS_JOINTVEL, of.mjOBJ_JOINT, joint.name))
    pairs += [(kind.mjSENS_TENDONPOS, kind.mjSENS_TENDONVEL, of.mjOBJ_TENDON, one.tendon) for one in vehicle.fitted]
    for number, (length, speed, what, name) in enumerate(pairs):
        for sensor in (length, speed):
            spec.add_sensor(name=f"{sensor.name}_{number}", type=sensor, objtype=what, objname=name)
    spec.compiler.discardvisual = True
    return spec.compile(), np.array(along)


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
