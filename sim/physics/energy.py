"""Energy balance of a run: work of road and actuators against stored and dissipated energy. It needs no reference.

Within a step MuJoCo holds the road, so the road does its work between steps: the jump of its height changes the energy of the
tyres' springs. Within a step the stored energy changes by the work of actuators and loads, less the dampers' dissipation:

    E[k+1, road k] - E[k, road k] = sum of integral f_a l_a' dt + work of loads - sum of integral c_j l_j'^2 dt,

with E the kinetic and potential energy (gravity, springs, tyres, bump stops), as MuJoCo computes it. The residual is the error of
the integrator and of the integrals. The integrals use Simpson's rule. The middle of a step follows from lengths l and speeds l'
at both its ends by Hermite's cubic, whose slope there has an error of the fourth power of the step. So the residual is of RK4's
order, 4, while every spring is linear in its length. If a spring starts or stops acting within a step (a tyre leaves the road, a
bump stop is touched), the force has a kink there, and the residual is only of about second order. The same holds at the knots of
curves. The deviation of a spring's curve from its line has the curve's integral as energy. For a damper's curve it is Simpson's
rule of the power.

The work of any other force, one of no spring, weight, damper, load or actuator of the vehicle, appears in the residual.

An actuator should push along the deflection of its suspension, and its work is counted along that signal. An actuator that acts
on one end only, or through a gear, therefore leaves a residual, too. The work of an actuator without a suspension (it pushes
against the world) is counted along MuJoCo's actuator itself. There such a fault only shows in the comparison with the linear
model. The force of an adjustable damper beyond the nominal one is -d l', with d held over a step, or behind its command by a lag.
Its work is taken by Simpson's rule, too. A separate check of force and speed at every sample confirms that it takes energy,
whatever the commanded coefficient.

Masses, springs and dampers are those of the MJCF; the comparison with the linear model checks them against the vehicle. Bump
stops and the largest force of an actuator are those of the vehicle file.

The residual is relative to the turnover: energy taken by the dampers, moved by the actuators either way, and the largest kinetic
energy. Lifting the weight is excluded: it would hide small residuals.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

import functools
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from mujoco.batch import Batch

from models.common.arrays import Array
from models.common.printed import difference
from models.document.document import Document
from models.document.field import Field
from models.document.text import Shown, facts
from models.kinds.strut_and_tyre import DAMPER, STATIC_LOAD
from models.roads.road import RoadInput
from models.vehicle.mjcf import build_spec, damped_tyres, mocap_indices, pushed_dofs
from models.vehicle.vehicle import Vehicle
from sim.physics.simulate import PhysicsRuns
from sim.response.recursion import lag_stages, lagging
from sim.response.regime import AT, BUMP_STOP, LIFT_OFF, REGIME_ENDS, SATURATION, utilisation
from sim.response.response import Response

if TYPE_CHECKING:
    from models.characteristics.stops import Stops

# Largest residual if a force has a kink, relative to the turnover. There RK4 leaves 5e-5 at 1 ms and 6e-4 at 4 ms (every
# vehicle and controller that ships, over two bumps); a damper that is 1 % off leaves 3e-3 and more.
BALANCED = 1e-3
JOULES = Field[float]("energy", float, ".5g", unit="J")
# The same without kinks, over the fourth power of the step times the vehicle's fastest rate. Random vehicles of every
# kind leave up to 0.02 over bumps and random roads from 0.5 to 4 ms, and 0.07 at 8 ms.
SMOOTH, SMALLEST = 0.2, 1e-7
# A fault leaves as much at any step, and what RK4 leaves falls with the second power of the step, or a higher one. So a run that
# leaves more is driven at half the step, too, and this times the fall is allowed on top: 4 / 3 of it is the error of the second
# power. A wheel of 7 kg on a tyre of 430 kN/m, often in the air, leaves 2.6e-3 at 1 ms and 5.7e-4 at half of it.
FALLS, COARSEST = 1.5, 0.1  # and the largest residual that confirms a balance; a larger one is not evaluated
NEAR = 0.95  # share of a tyre's or a suspension's distance to a kink at which it may reach the kink within a step
ROUNDING = 1e-8  # smallest turnover, relative to the energy at rest: below it the residual is rounding
AT_ONCE = 4096  # states that are evaluated together


@dataclass(frozen=True, repr=False)
class Energy(Shown):
    """Energy balance of a run, from its start to its end or to the time at which it broke off.

    Attributes:
        road: work of the road [J].
        actuators: work of the actuators [J].
        stored: change of the kinetic and potential energy [J].
        dissipated: energy taken by the dampers [J].
        turnover: energy taken by the dampers, moved by the actuators either way, and the largest kinetic energy [J].
        loads: work of the loads on the body [J], or None if there are no loads.
        allowed: largest residual that the integrator explains: RK4's own if no force has a kink, else `BALANCED`; more if half
            the step leaves less.
        residual: largest magnitude at any time of works less stored and dissipated energy, over `turnover`.
        least: least power taken by an adjustable damper at any sample, over the largest; below 0 if it gave energy. None if the
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
    allowed: float = BALANCED

    @property
    def shown(self) -> Document:
        """Returns whether it balances, and the energies."""
        parts = {name: getattr(self, name) for name in ("road", "actuators", "loads", "stored", "dissipated")}
        title = (
            f"energy {self.verdict}: the residual is {difference(self.residual)} of the {JOULES.text(self.turnover)} exchanged"
        )
        return facts(title, {name: JOULES.text(one) for name, one in parts.items() if one is not None})

    @property
    def fails(self) -> bool:
        """Returns True if the residual is more than the integrator's error, or a damper gave energy."""
        return not self.residual <= self.allowed or (self.least is not None and self.least < -ROUNDING)

    @property
    def judged(self) -> bool:
        """Returns False if the integrator's error explains the residual, but is too large to confirm a balance."""
        return self.fails or self.allowed <= COARSEST

    @property
    def balances(self) -> bool:
        """Returns True if the residual is within the integrator's error, and no damper gave energy."""
        return self.judged and not self.fails

    @property
    def verdict(self) -> str:
        """The verdict, in words."""
        return "DOES NOT BALANCE" if self.fails else "balances" if self.judged else "is not evaluated"

    @property
    def doubtful(self) -> bool:
        """Returns True if more is left over than is usual: half the step tells an error of RK4 from a fault."""
        return self.residual > self.allowed

    def beside(self, finer: "Energy") -> "Energy":
        """Returns the balance with its allowed residual, given the same run at half the step."""
        falls = max(0.0, self.residual - finer.residual)
        return replace(self, allowed=min(self.allowed + FALLS * falls, max(self.allowed, self.residual, COARSEST)))


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
    # The road moves between steps, so every state is evaluated twice: with the road of the step that ends and of the next.
    starts = _look(vehicle, model, qpos, qvel, midway)
    ends, moved = starts[1:].copy(), np.any(midway[1:] != midway[:-1], axis=1)
    ends[moved] = _look(vehicle, model, qpos[1:][moved], qvel[1:][moved], midway[:-1][moved])
    rest = _look(vehicle, model, np.zeros_like(qpos[:1]), np.zeros_like(qvel[:1]), np.zeros_like(midway[:1]))
    rubber = _FittedForces(vehicle, model)
    of_road, of_rubber = rubber.powers(starts, ends, road)
    starts, ends, rest = (rubber.taken_out(each) for each in (starts, ends, rest))

    actuators, curves, stops = len(vehicle.linear_model.inputs), vehicle.fitted, _pushing_stops(vehicle)
    stored = starts[:, 0] + starts[:, 1]
    lengths, speeds = (starts[:, 2 + k :: 2] for k in (0, 1))
    grown = ends[:, 2::2] - lengths[:-1]  # within a step, over its road, which may carry a damper or an actuator
    middle = 1.5 * grown / h - (speeds[:-1] + speeds[1:]) / 4
    forces = np.stack([runs.response[name][index, :count] for name in vehicle.linear_model.inputs], axis=-1)
    ratios = vehicle.ratios_along(runs.response.run(index).samples(slice(count)).__getitem__)
    along = np.broadcast_to(along * ratios, forces.shape)
    first, *inner, last = along[:-1] * _acting(vehicle, forces, runs.requested_force[index, :count], h)
    if vehicle.limits.actuator_bandwidth is None:
        work = first * grown[:, :actuators]  # the work of a held force is exact
    else:
        amid = 2 * (inner[0] + inner[1]) * middle[:, :actuators]
        work = (first * speeds[:-1, :actuators] + amid + last * speeds[1:, :actuators]) * h / 6
    least = None
    if vehicle.dampers:
        response = runs.response.run(index).until(float(time[count - 1]) + h / 2)
        least = _by_dampers(vehicle, response, along, speeds, middle, work)
    dampers, damping = slice(actuators, speeds.shape[1] - len(curves) - len(stops)), _damping(model)
    losses = (speeds[:-1, dampers] ** 2 + 4 * middle[:, dampers] ** 2 + speeds[1:, dampers] ** 2) * damping * h / 6
    in_springs, in_dampers = np.zeros(count), np.zeros(count - 1)
    for i, fitted in enumerate(curves, dampers.stop):
        if fitted.damps:
            d = lengths[:-1, i] - rest[0, 2 + 2 * i]
            amid = d + grown[:, i] / 2 + h / 8 * (speeds[:-1, i] - speeds[1:, i])
            at = (d, speeds[:-1, i]), (amid, middle[:, i]), (d + grown[:, i], speeds[1:, i])
            power = [v * fitted.beyond(d, v) for d, v in at]
            in_dampers += (power[0] + 4 * power[1] + power[2]) * h / 6
        else:
            in_springs += fitted.curve.work(lengths[:, i] - rest[0, 2 + 2 * i])
    for i, both in enumerate(stops.values(), dampers.stop + len(curves)):
        in_springs += both.work(lengths[:, i] - rest[0, 2 + 2 * i])

    by_road = np.cumsum(np.concatenate([[stored[0] - rest[0, :2].sum()], stored[1:] - ends[:, :2].sum(axis=1) + of_road]))
    by_actuators = np.concatenate([[0.0], np.cumsum(work.sum(axis=1))])
    by_loads, pushed = np.zeros(count), 0.0
    if road.loaded:  # loads are held and act along joints, so their work is exact
        pushes = road.held_loads[: count - 1] * np.diff(qpos[:, pushed_dofs(vehicle, model)], axis=0)
        by_loads, pushed = np.concatenate([[0.0], np.cumsum(pushes.sum(axis=1))]), float(np.abs(pushes).sum())
    lost = np.concatenate([[0.0], np.cumsum(losses.sum(axis=1) + in_dampers + of_rubber)])
    change = stored + in_springs - rest[0, :2].sum()
    turnover = float(lost[-1] + np.abs(work).sum() + starts[:, 1].max()) + pushed
    scale = max(turnover, ROUNDING * abs(float(rest[0, :2].sum()))) or 1.0
    residual = float(np.max(np.abs(by_road + by_actuators + by_loads - change - lost))) / scale
    if _has_kinks(vehicle, runs.response.run(index).until(float(time[count - 1]) + h / 2)):
        allowed = BALANCED
    else:
        rounding = float(np.finfo(float).eps) * count * float(np.abs(starts[:, :2]).max())
        allowed = min(BALANCED, max(SMALLEST, SMOOTH * (h * _fastest(vehicle)) ** 4) + rounding / scale)
    loads = float(by_loads[-1]) if road.loaded else None
    road_did, forces_did, changed, taken = (float(sums[-1]) for sums in (by_road, by_actuators, change, lost))
    return Energy(road_did, forces_did, changed, taken, turnover, residual, least, loads, allowed)


class _FittedForces:
    """Energy of actuators other than the inputs: damping tyres, and constant forces of struts without springs.

    A tyre's spring has the energy k s^2 / 2 at the squeeze s. The rest R of the force acts between the road, at its velocity w,
    and the hub, at l'. The road's power is R w, that on the hub R l', and the difference is lost.
    """

    def __init__(self, vehicle: Vehicle, model: mujoco.MjModel) -> None:
        """Finds these actuators in the model of `_observed`, whose last sensors are their lengths and speeds."""
        self.wheels, actuators = damped_tyres(vehicle, model)
        self.c, bias = model.actuator_gainprm[actuators, 0], model.actuator_biasprm[actuators]
        self.k = -bias[:, 1]
        self.rest = bias[:, 0] / self.k
        names = [model.actuator(i).name for i in range(model.nu)]
        self.loads = model.actuator_biasprm[[i for i, name in enumerate(names) if name.startswith(STATIC_LOAD)], 0]
        self.count = len(self.wheels) + len(self.loads)

    def taken_out(self, seen: Array) -> Array:
        """Returns the sensors of `_look` without theirs, with the energy of springs and constant forces as potential energy."""
        if not self.count:
            return seen
        left = seen[:, : -2 * self.count].copy()
        left[:, 0] += (self.k * np.maximum(self.rest - self._parts(seen)[0], 0.0) ** 2 / 2).sum(axis=1)
        left[:, 0] -= seen[:, seen.shape[1] - 2 * len(self.loads) :: 2] @ self.loads
        return left

    def powers(self, starts: Array, ends: Array, road: RoadInput) -> tuple[Array | float, Array | float]:
        """Returns the work of the road beyond the springs', and what is lost, over every step [J], shapes (T - 1,).

        Args:
            starts, ends: sensors of `_look` at the starts of T steps, and at the ends of the first T - 1.
            road: road whose velocities are held over the steps.
        """
        if not self.wheels:
            return 0.0, 0.0
        h, w = road.timestep, road.held_velocities[: len(ends), self.wheels]
        first, last = [self._parts(each) for each in (starts[:-1], ends)]
        (length, v), (l_end, v_end) = first, last
        middle = (length + l_end) / 2 + h / 8 * (v - v_end), 1.5 * (l_end - length) / h - (v + v_end) / 4
        by_road, lost = np.zeros(len(w)), np.zeros(len(w))
        for weight, (length, speed) in ((1, first), (4, middle), (1, last)):
            squeeze = self.rest - length
            beyond = np.maximum(self.k * squeeze + self.c * (w - speed), 0.0) - self.k * np.maximum(squeeze, 0.0)
            by_road += weight * h / 6 * (beyond * w).sum(axis=1)
            lost += weight * h / 6 * (beyond * (w - speed)).sum(axis=1)
        return by_road, lost

    def _parts(self, seen: Array) -> tuple[Array, Array]:
        """Returns their lengths and speeds, shapes (T, t)."""
        first = seen.shape[1] - 2 * self.count
        own = seen[:, first : first + 2 * len(self.wheels)]
        return own[:, ::2], own[:, 1::2]


def _has_kinks(vehicle: Vehicle, response: Response) -> bool:
    """Returns True if a force may have had a kink: a tyre in the air, a bump stop, a curve, or a lagging force at its limit.

    A command that is limited before the lag is held over a step, so that its force has no kink within the step.
    """
    reached, limits = utilisation(vehicle, response), vehicle.limits
    ends = [LIFT_OFF, BUMP_STOP] + ([] if limits.actuator_bandwidth is None or limits.limits_commands else [SATURATION])
    bent = any(fitted.curve.bent for fitted in vehicle.fitted)
    bent = bent or any(one.damper.pair is not None for one in vehicle.adjustable)
    return bent or any(reached[REGIME_ENDS.index(end)] >= NEAR for end in ends)


def _fastest(vehicle: Vehicle) -> float:
    """Returns the fastest rate of the vehicle, its actuators and its dampers' valves, at any setting [rad/s]."""
    model = vehicle.linear_model
    firm = {one.force: one.steepest_slope / one.nominal for one in vehicle.adjustable if one.nominal}
    rate = float(np.abs(np.linalg.eigvals(model.A)).max()) * max([1.0, *firm.values()])
    lags = [damper.bandwidth for damper in vehicle.dampers.values() if damper.bandwidth is not None]
    return max([rate, vehicle.limits.actuator_bandwidth or 0.0, *lags])


def _by_dampers(vehicle: Vehicle, response: Response, along: Array, speeds: Array, middle: Array, work: Array) -> float:
    """Writes the work of adjustable dampers beyond the nominal ones, shape (T - 1, m). Returns `Energy.least`.

    Args:
        response: signals at T samples.
        along: velocities of the dampers over those of the suspensions, held over the steps, shape (T, m).
        speeds, middle: velocities of the suspensions at the samples [m/s], and in the middle of the steps; the first m columns.
        work: array that receives the work of each damper [J].
    """
    h, least = float(response.time[1]), np.inf
    for adjustable in vehicle.adjustable:
        j = vehicle.linear_model.inputs.index(adjustable.force)
        beyond, v = response[adjustable.coefficient] - adjustable.nominal, along[:, j] * speeds[:, j]
        amid, after_step = along[:-1, j] * middle[:, j], along[:-1, j] * speeds[1:, j]
        power, last = v * adjustable.shape(v), after_step * adjustable.shape(after_step)
        before, after, bandwidth = beyond[:-1], beyond[1:], adjustable.damper.bandwidth
        share = 1 / (1 + np.exp(-bandwidth * h / 2)) if bandwidth else 0.0
        between, end = before + share * (after - before), after if bandwidth else before
        work[:, j] = -(before * power[:-1] + 4 * between * amid * adjustable.shape(amid) + end * last) * h / 6
        power = (adjustable.ramp(v, 0.0) - response[adjustable.force]) * v
        least = min(least, float(power.min()) / (float(np.abs(power).max()) or 1.0))
    return least


@functools.lru_cache(maxsize=16)
def _observed(vehicle: Vehicle, timestep: float) -> tuple[mujoco.MjModel, Array]:
    """Returns the vehicle's model with the sensors of its energy alone, and every suspension's deflection per length.

    The sensors, in order: potential and kinetic energy; then length and speed of every actuator's direction, of every damped
    tendon and joint, of the tendon of every curve, of every one that has stops, of every tyre that damps, and of every strut
    without a spring.
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
            along.append(1.0 / vehicle.motion_ratios[name])  # its length is that of the actuator itself
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
    stops = _pushing_stops(vehicle)
    tendons = [fitted.tendon for fitted in vehicle.fitted] + list(stops)
    pairs += [(kind.mjSENS_TENDONPOS, kind.mjSENS_TENDONVEL, of.mjOBJ_TENDON, tendon) for tendon in tendons]
    rubber = [actuator.target for actuator in spec.actuators if actuator.name.startswith(DAMPER)]
    rubber += [actuator.target for actuator in spec.actuators if actuator.name.startswith(STATIC_LOAD)]
    pairs += [(kind.mjSENS_TENDONPOS, kind.mjSENS_TENDONVEL, of.mjOBJ_TENDON, tendon) for tendon in rubber]
    for name, both in stops.items():
        for spring in both.springs(0.0):
            spec.tendon(f"{spring}_{name}").stiffness[:] = 0.0  # stops are counted by the vehicle file
    for number, (length, speed, what, name) in enumerate(pairs):
        for sensor in (length, speed):
            spec.add_sensor(name=f"{sensor.name}_{number}", type=sensor, objtype=what, objname=name)
    spec.compiler.discardvisual = True
    return spec.compile(), np.array(along)


def _pushing_stops(vehicle: Vehicle) -> "dict[str, Stops]":
    """Returns the bump stops that push back, by their suspension's tendon."""
    stops = vehicle.stops
    by_tendon = {part.tendon: stops[part.deflection] for part in vehicle.kind.suspensions if part.deflection in stops}
    return {tendon: both for tendon, both in by_tendon.items() if both.acts}


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


def _acting(vehicle: Vehicle, forces: Array, requested: Array, h: float) -> Array:
    """Returns the actuators' forces [N] in RK4's stages of every step, shape (4, T - 1, m).

    What lags behind a request beyond the largest force may change its sign within a step.

    Args:
        forces: forces of physics at the samples [N], shape (T, m).
        requested: forces requested by the controller, see `PhysicsRuns`.
    """
    limits, z = vehicle.limits, np.full(forces.shape[1], (vehicle.limits.actuator_bandwidth or 0.0) * h)
    if limits.actuator_force is None or limits.limits_commands:
        return np.stack(lag_stages(forces, z))
    largest, most = limits.largest
    asked = np.clip(requested[:, : forces.shape[1]], -largest, largest)
    stages = lag_stages(np.where(np.abs(forces) < AT * most, forces, lagging(asked, z)), z)
    return np.clip(stages, -most, most)
