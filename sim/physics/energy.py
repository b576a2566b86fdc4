"""Energy balance of a run: work of road and actuators against stored and dissipated energy. A check without a reference.

Within a step MuJoCo holds the road, so the road does its work between steps: the jump of its height changes the energy of the
tyres' springs. Within a step the stored energy changes by the actuators' work less the dampers':

    E[k+1, road k] - E[k, road k] = sum of integral f_a l_a' dt + work of loads - sum of integral c_j l_j'^2 dt,

with E the kinetic and potential energy (gravity, springs, tyres, bump stops), all of it MuJoCo's own. The residual is the error
of the integrator and of the integrals. These use Simpson's rule; the middle of a step follows from lengths l and speeds l' at
both its ends by Hermite's cubic, whose slope there is right to the fourth power of the step. So the residual is of RK4's order,
4, while every spring is linear in its length. If a spring begins or ends to act within a step (a tyre leaves the road, a bump
stop is touched), RK4 itself has a kink in its step, and the residual is only of about second order. The same holds at the knots
of curves. Beyond their lines, the energy of a spring's curve is the curve's integral, and a damper's is Simpson's rule of its
power.

Nothing else may do work: a force that is neither spring, weight, damper, load nor one of the vehicle's actuators is residual.

An actuator should push along the deflection of its suspension, and its work is counted along that signal. An actuator that acts
on one end only, or through a gear, therefore leaves a residual, too. An actuator without a suspension (it pushes against the
world) has its work counted along MuJoCo's actuator itself; such a fault is left to the comparison with the linear model. An
adjustable damper only takes energy: beyond the nominal one its force is -d l', with d held over a step, or following its command
by a lag. Its work is taken by Simpson's rule, too. A separate check of the force and speed at every sample confirms that it takes
energy, whatever the commanded coefficient.

Masses, springs and dampers are those of the MJCF: the comparison checks that they are the vehicle's.

The residual is relative to the turnover: energy taken by the dampers, moved by the actuators either way, and the largest kinetic
energy. Lifting the weight is excluded: it would hide small residuals.
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

# Largest residual, relative to the turnover. RK4 leaves 2e-7 at 1 ms and 4e-5 at 4 ms, with kinks 5e-5 and 6e-4 (every vehicle
# and controller that ships, over two bumps); a damper that is 1 % off leaves 3e-3 and more.
BALANCED = 1e-3
ROUNDING = 1e-8  # smallest turnover, relative to the energy at rest: below it the residual is rounding
AT_ONCE = 4096  # states that are evaluated together


@dataclass(frozen=True)
class Energy:
    """Energy balance of a run, from its start to its end or to the time at which it broke off.

    Attributes:
        road: work of the road [J].
        actuators: work of the actuators [J].
        stored: change of the kinetic and potential energy [J].
        dissipated: by the dampers [J].
        turnover: energy taken by the dampers, moved by the actuators either way, and the largest kinetic energy [J].
        loads: work of the loads on the body [J], or None if there are no loads.
        residual: largest sum at any time of works less stored and dissipated energy, over `turnover`.
        least: least power taken by an adjustable damper at any sample, over its largest; below 0 if it gave energy. None if the
            vehicle has no adjustable dampers.
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
        """Returns True if the residual is within the integrator's error, and no damper gave energy."""
        return self.residual <= BALANCED and (self.least is None or self.least >= -ROUNDING)


def energy(runs: PhysicsRuns, index: int, road: RoadInput, until: float = np.inf) -> Energy:
    """Returns the energy balance of one run.

    Args:
        runs: N runs of MuJoCo.
        until: time at which the vehicle broke off [s], if before it diverged.
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
    for i, fitted in enumerate(curves, dampers.stop):
        if fitted.damps:
            power = [v * fitted.curve.pieces.force(v) for v in (speeds[:-1, i], middle[:, i], speeds[1:, i])]
            in_dampers += (power[0] + 4 * power[1] + power[2]) * h / 6
        else:
            in_springs += fitted.curve.work(lengths[:, i] - rest[0, 2 + 2 * i])

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
    road_did, forces_did, changed, taken = (float(sums[-1]) for sums in (by_road, by_actuators, change, lost))
    return Energy(road_did, forces_did, changed, taken, turnover, residual, least, loads)


def _by_dampers(vehicle: Vehicle, response: Response, speeds: Array, middle: Array, work: Array) -> float:
    """Writes the work of adjustable dampers beyond the nominal ones, shape (T - 1, m). Returns `Energy.least`.

    Args:
        response: its signals, of T samples.
        speeds: of the suspensions at the samples [m/s], shape (T, m).
        middle: of the suspensions amid the steps, shape (T - 1, m).
        work: receives the works [J].
    """
    h, least = float(response.time[1]), np.inf
    for adjustable in vehicle.adjustable:
        j = vehicle.linear_model.inputs.index(adjustable.force)
        beyond, v, amid = response[adjustable.coefficient] - adjustable.nominal, speeds[:, j], middle[:, j]
        power = v * adjustable.shape(v)
        before, after, bandwidth = beyond[:-1], beyond[1:], adjustable.damper.bandwidth
        share = 1 / (1 + np.exp(-bandwidth * h / 2)) if bandwidth else 0.0
        between, end = before + share * (after - before), after if bandwidth else before
        work[:, j] = -(before * power[:-1] + 4 * between * amid * adjustable.shape(amid) + end * power[1:]) * h / 6
        power = (adjustable.pull(v, 0.0) - response[adjustable.force]) * v
        least = min(least, float(power.min()) / (float(np.abs(power).max()) or 1.0))
    return least


@functools.lru_cache(maxsize=16)
def _observed(vehicle: Vehicle, timestep: float) -> tuple[mujoco.MjModel, Array]:
    """Returns the vehicle's model with the sensors of its energy alone, and the sign of every force along its length.

    The sensors, in order: potential and kinetic energy; then length and speed of every actuator's direction, of every damped
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
    pairs += [(kind.mjSENS_TENDONPOS, kind.mjSENS_TENDONVEL, of.mjOBJ_TENDON, fitted.tendon) for fitted in vehicle.fitted]
    for number, (length, speed, what, name) in enumerate(pairs):
        for sensor in (length, speed):
            spec.add_sensor(name=f"{sensor.name}_{number}", type=sensor, objtype=what, objname=name)
    spec.compiler.discardvisual = True
    return spec.compile(), np.array(along)


def _damping(model: mujoco.MjModel) -> Array:
    """Returns the coefficients of the dampers that `_observed` has, in its order [N s/m]."""
    return np.concatenate([model.tendon_damping[model.tendon_damping > 0], model.dof_damping[model.dof_damping > 0]])


def _look(vehicle: Vehicle, model: mujoco.MjModel, qpos: Array, qvel: Array, roads: Array) -> Array:
    """Returns the sensor values in these states over these roads, shape (T, nsensordata)."""
    values = np.empty((len(qpos), model.nsensordata))
    if len(qpos) == 0:
        return values
    batch = Batch(model, min(AT_ONCE, len(qpos)), 0)
    positions, velocities, heights, sensors = (batch.bind(name) for name in ("qpos", "qvel", "mocap_pos", "sensordata"))
    mocap = mocap_indices(vehicle, model)
    for first in range(0, len(qpos), batch.nsim):
        some = slice(max(0, min(first, len(qpos) - batch.nsim)), min(first + batch.nsim, len(qpos)))
        positions[:], velocities[:] = qpos[some], qvel[some]
        heights[:, mocap, 2] = roads[some]
        batch.forward(stage=int(mujoco.mjtStage.mjSTAGE_VEL))
        values[some] = sensors
    return values


def _forces(vehicle: Vehicle, forces: Array, h: float) -> tuple[Array, Array, Array]:
    """Returns the actuators' forces [N] at beginning, middle and end of every step, shape (T - 1, m), from those at the samples.

    A lagging force approaches its command exponentially, so its ends determine its middle.
    """
    bandwidth = vehicle.limits.actuator_bandwidth
    before, after = forces[:-1], forces[1:]
    share = 1 / (1 + np.exp(-bandwidth * h / 2)) if bandwidth else 0.0
    return before, before + share * (after - before), after
