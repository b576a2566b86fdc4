"""Energy balance of a run: work of road and actuators compared with stored and dissipated energy.

The energy balance needs no reference response. MuJoCo keeps the road height constant within a step, so the road does work only
between the steps. Between two steps, the road height jumps, which changes the energy of the tyre springs. Within a step, the
stored energy changes by the work of actuators and loads, minus the energy that the dampers dissipate:

    E[k+1, road k] - E[k, road k] = sum of integral f_a l_a' dt + work of loads - sum of integral c_j l_j'^2 dt,

The symbol E denotes the kinetic and potential energy. The residual of the energy balance is caused by errors of the integrator
and of the numerical integrals. The integrals are computed with Simpson's rule. The values in the middle of a step are those of
the cubic Hermite polynomial through the lengths l and rates l' at both ends of the step. The slope of the cubic polynomial in
the middle of the step has an error of fourth order in the step. If every spring is linear in its length, the residual is
therefore of fourth order in the step, as for RK4. A spring may start or stop acting within a step, for example if a tyre leaves
the road. If a spring starts or stops acting, its force has a kink, and the residual is only of about second order. Knots of
characteristics also cause kinks in the force.

The energy E is computed with the vehicle's own equations (`StoredEnergy`), with the masses, inertias, weights and linear
springs of the vehicle file. The states for the energy come from MuJoCo. A wrong mass or spring of the MuJoCo model therefore
causes a residual. A force in MuJoCo that is not in the vehicle's equations also causes a residual. If the equations of a
vehicle type do not include energy, MuJoCo computes E, and only the comparison with the linear model checks the masses.
Nonlinear suspension forces, bump stops and the largest force of an actuator always come from the vehicle file. The coefficients
of linear dampers come from the MuJoCo model.

The work of an actuator is computed along the deflection of its suspension. If an actuator of the MuJoCo model acts on one end
only, or through a gear, the energy balance has a residual, too. The work of an actuator without a suspension, which acts
against the ground, is computed along MuJoCo's actuator. For an actuator without a suspension, only the comparison with the
linear model shows whether it acts correctly in the MuJoCo model. The force that a semi-active damper adds to its nominal force
is -d l', where l' is the rate of the damper's length. The coefficient d of the added force is held constant during a step, or
lags behind its command. The work of the added damper force is also computed with Simpson's rule. If a controller sets the
voltage of an element of `[parts]`, the energy stored in the element depends on the present voltage. A change of the voltage
therefore does work. The work of the coil that sets the voltage is counted as work of the actuator. A separate check of force
and speed at every sample confirms that a damper dissipates energy for every commanded coefficient or voltage.

The residual is given relative to the turnover of energy. The turnover is the sum of the energy that the dampers dissipate, the
energy that the actuators supply and absorb, and the largest kinetic energy. The turnover excludes the work of lifting the
weight, because this work would hide small residuals.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's Python bindings have no type stubs.

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from mujoco.batch import Batch

from models.common.arrays import Array
from models.common.extensions import FEATURES
from models.kinds.signals import names_of
from models.kinds.strut_and_tyre import DAMPER, STATIC_LOAD
from models.roads.road import RoadInput
from models.vehicle.limits_and_implementation import Limits
from models.vehicle.mjcf import build_spec, damped_tyres, mocap_indices, pushed_dofs
from models.vehicle.suspension_forces import MotionRatios
from models.vehicle.vehicle import Vehicle
from sim.drive.recursion import lag_commands, lag_stages
from sim.drive.regime import AT, BUMP_STOP, LIFT_OFF, REGIME_ENDS, SATURATION, utilisation
from sim.drive.response import Response
from sim.observers.recorder import Recording
from sim.observers.results import BALANCE_TOLERANCE, ROUNDING, Energy

if TYPE_CHECKING:
    from models.parts.damper_range import SetColumn
    from models.parts.part import SettablePart, SuspensionPart
    from models.parts.settable import SetElement

# Largest residual if no force has a kink, divided by (step times the vehicle's fastest rate)^4. Random vehicles of every type
# reach 0.02 over bumps and random roads with steps from 0.5 to 4 ms, and 0.07 with 8 ms.
SMOOTH, SMALLEST = 0.2, 1e-7
# if a tyre or a suspension has covered more than this fraction of the distance to a kink, it may reach the kink within a step
NEAR = 0.95
AT_ONCE = 4096  # largest number of states that MuJoCo evaluates in one batch


def energy(run: Recording, until: float = np.inf) -> Energy:
    """Computes the energy balance of one run.

    Args:
        run: recording of the MuJoCo run whose energy is balanced.
        until: time at which the run becomes invalid [s], if the run becomes invalid before it diverges.
    """
    vehicle, road = run.vehicle, run.input
    count = int(np.searchsorted(road.time, min(until, run.diverged)))
    if count < 2:
        return Energy(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0 if vehicle.dampers else None, 0.0 if road.loaded else None)
    path = _Path(run.qpos[:count], run.qvel[:count], road)
    response = run.response.samples(slice(count))
    work, least = _by_inputs(vehicle, path, response, run.commands[:count])
    by_loads = np.zeros((count - 1, 1))
    if road.loaded:  # loads are held within a step and act along joints, so their work is exactly load times joint motion
        moved = np.diff(run.qpos[:count, pushed_dofs(vehicle, path.model)], axis=0)
        by_loads = road.held_loads[: count - 1] * moved
    by_road, lost = _by_tyres(path, road)
    damping = np.concatenate([path.model.tendon_damping, path.model.dof_damping])
    for number in np.flatnonzero(damping).tolist():
        length = path.length(number)
        lost += length.integral(damping[number] * v**2 for _, v in length.stages)
    start, end, rest = (one[..., :2].sum(axis=-1) for one in (path.starts, path.ends, path.rest))
    elements = {one.own: one for one in _elements(vehicle)}
    for one in vehicle.parts:
        length = path.length(path.model.tendon(one.tendon).id)
        z = np.stack([response[signal.name] for signal in one.states], axis=-1) if one.states else None
        start += _stored_energy(one, length.d, z) + _kinetic(one, length.d, length.v)
        # The states of the vehicle's parts do not change suddenly if the road height does.
        end += _stored_energy(one, length.after, None if z is None else z[1:]) + _kinetic(one, length.after, length.v[1:])
        if z is None or (column := elements.get(names_of(one.states))) is None:
            lost += _lost_energy(one, length, z)
            continue
        by_coil, jumps, beyond = _by_coil(column.element, response, z)
        work[:, column.column] = by_coil + jumps
        start += beyond
        end += beyond[1:] - jumps
        by_road -= jumps
        lost += _lost_energy(one, length, z, _settings(column.element, response, length.h)) + by_coil + jumps - np.diff(beyond)

    steps, stored = np.stack([start[1:] - end + by_road, work.sum(axis=1), by_loads.sum(axis=1), lost]), start - rest
    if vehicle.start:  # the energy stored at the start is subtracted, because no force supplied it during the run
        stored -= stored[0]
    sums = np.cumsum(np.insert(steps, 0, [stored[0], 0.0, 0.0, 0.0], axis=1), axis=1)
    turnover = float(sums[3, -1] + np.abs(work).sum() + path.starts[:, 1].max() + np.abs(by_loads).sum())
    scale = max(turnover, ROUNDING * abs(float(rest))) or 1.0
    residual, allowed = float(np.max(np.abs(sums[:3].sum(axis=0) - sums[3] - stored))) / scale, BALANCE_TOLERANCE
    if not _has_kinks(vehicle, response):
        rounding = float(np.finfo(float).eps) * count * float(np.abs(path.starts[:, :2]).max())
        allowed = min(BALANCE_TOLERANCE, max(SMALLEST, SMOOTH * (path.h * _fastest(vehicle)) ** 4) + rounding / scale)
    of_road, of_inputs, of_loads, taken = sums[:, -1].tolist()
    loads = of_loads if road.loaded else None
    return Energy(of_road, of_inputs, float(stored[-1]), taken, turnover, residual, least, loads, allowed)


def _elements(vehicle: Vehicle) -> "Sequence[SetColumn]":
    """Returns the force elements whose voltages a controller sets."""
    if not vehicle.dampers:
        return ()

    return FEATURES.load("damper ranges").range_of([vehicle]).elements


def _stored_energy(one: "SuspensionPart", deflection: Array, z: Array | None) -> Array:
    """Returns the energy stored in a part at the supplied deflections and states [J], shape (...), without the vehicle's linear
    spring.
    """
    return one.part.stored_beyond(deflection, z) + one.added_line.stiffness * np.square(deflection) / 2


def _kinetic(one: "SuspensionPart", deflection: Array, speed: Array) -> Array | float:
    """Returns the kinetic energy of a part [J], shape (...)."""
    return one.part.inertance_at(deflection) * np.square(speed) / 2 if one.added_line.inertance else 0.0


def _by_coil(one: "SetElement", response: Response, z: Array) -> tuple[Array, Array, Array]:
    """Returns the work of an element's coil, and the energy that is stored because the element's voltage is not nominal.

    The work is that during each step and at the end of each step [J], shapes (T - 1,); the energy is that at the samples [J],
    shape (T,).

    A change of the voltage changes the energy that the hysteresis stores.
    """
    u, none = response[one.coefficient] - one.nominal, np.zeros(len(z))

    def stored(some: slice, u: Array) -> Array:
        return one.element.stored(none[some], z[some], u) - one.element.stored(none[some], z[some])

    early, late, held = slice(-1), slice(1, None), u[1:] if one.damper.bandwidth else u[:-1]
    changes = [stored(some, held) - stored(some, u[:-1]) for some in (early, late)]
    return (changes[0] + changes[1]) / 2, stored(late, u[1:]) - stored(late, held), stored(slice(None), u)


def _lost_energy(
    one: "SuspensionPart", length: "_Length", z: Array | None, inputs: Sequence[Array | float] = (0.0,) * 3
) -> Array | float:
    """Returns the energy that a part dissipates in every step [J], shape (T - 1,).

    The vehicle's linear damper and the force of an input are excluded, because their work is computed separately.

    Args:
        inputs: setting of a voltage-controlled element minus its nominal setting, at the start, in the middle and at the end of
            every step.
    """
    if one.part.stores:
        return 0.0
    own = (None,) * 3
    if z is not None:
        (d, v), _, (after, w) = length.stages
        turned = length.h / 8 * (one.part.rate(d, v, z[:-1], inputs[0]) - one.part.rate(after, w, z[1:], inputs[2]))
        # cubic polynomial through the values and rates at both ends of the step, as for the lengths
        own = z[:-1], (z[:-1] + z[1:]) / 2 + turned, z[1:]
    stages = [(d, v, z, u) for (d, v), z, u in zip(length.stages, own, inputs, strict=True)]
    pulls = [one.part.beyond(d, v, z, u) + one.added_line(d, v, 0.0, z) - one.part.centrifugal(d, v) for d, v, z, u in stages]
    taken = length.integral(v * pull for (_, v, _, _), pull in zip(stages, pulls, strict=True))
    return taken - (_stored_energy(one, length.after, own[2]) - _stored_energy(one, length.d[:-1], own[0]))


@dataclass(frozen=True, eq=False)
class _Length:
    """A length in the model, such as that of a tendon, during the T - 1 steps of a run.

    Attributes:
        d: deflection from equilibrium at each sample, for the road height in the step that begins at the sample [m], shape
            (T,).
        v: rate of the deflection [m/s], shape (T,).
        after: deflection at the end of every step, for the road height in the same step [m], shape (T - 1,).
        h: duration of a step [s].
    """

    d: Array
    v: Array
    after: Array
    h: float

    @cached_property
    def stages(self) -> tuple[tuple[Array, Array], ...]:
        """Deflection and its rate at the start, in the middle and at the end of every step, shapes (T - 1,)."""
        (d, v), w, h = (self.d[:-1], self.v[:-1]), self.v[1:], self.h
        grown = self.after - d
        return (d, v), (d + grown / 2 + h / 8 * (v - w), 1.5 * grown / h - (v + w) / 4), (self.after, w)

    def integral(self, powers: Iterable[Array]) -> Array:
        """Returns the integral of a power over each step [J], shape (T - 1,), by Simpson's rule from three values [W]."""
        first, middle, last = powers
        return (first + 4 * middle + last) * self.h / 6


def _by_inputs(vehicle: Vehicle, path: "_Path", response: Response, requested: Array) -> tuple[Array, float | None]:
    """Returns the work of every input in every step [J], shape (T - 1, m), and the value of `Energy.least`.

    Args:
        response: simulated signals at the T samples of the run.
        requested: forces that the controller requested; see `Recording.commands`.
    """
    inputs, dampers, least = vehicle.linear_model.inputs, {one.force: one for one in vehicle.parts.adjustable}, []
    forces = np.stack([response[name] for name in inputs], axis=-1)
    elements = {inputs[one.column]: one for one in _elements(vehicle)}
    acting, work, ratios = _acting_forces(vehicle, forces, requested, path.h), np.empty_like(forces[1:]), MotionRatios([vehicle])
    for j, name in enumerate(inputs):
        length, ratio = path.stroke(vehicle, name), partial(ratios.of, name)
        speeds, (first, *inner, last) = [ratio(d) * v for d, v in length.stages], acting[..., j]
        if name in elements:
            one = elements[name]
            d, v, z = one.motion(lambda signal: response[signal])
            u = response[dampers[name].coefficient] - dampers[name].nominal
            power = (one.element.pull(d, v, z) - response[name]) * v - one.element.element.storing(d, v, z, u)
            least.append(float(power.min()) / (float(np.abs(power).max()) or 1.0))
        elif name in dampers:
            work[:, j] = length.integral(_powers(dampers[name], response, speeds, length.h))
            own = ratio(length.d) * length.v
            power = (dampers[name].force_at(own, 0.0) - response[name]) * own
            least.append(float(power.min()) / (float(np.abs(power).max()) or 1.0))
        elif vehicle.limits.actuator_bandwidth is None:  # work of a held force: force times change of length
            travel = partial(ratios.travel, name)
            work[:, j] = first * (travel(length.after) - travel(length.d[:-1]))
        else:
            middle = (inner[0] + inner[1]) / 2
            work[:, j] = length.integral(f * v for f, v in zip((first, middle, last), speeds, strict=True))
    return work, min(least, default=None)


def _powers(one: "SettablePart", response: Response, speeds: Sequence[Array], h: float) -> list[Array]:
    """Returns a damper's power minus its nominal power at the start, in the middle and at the end of each step [W], shape (T -
    1,) each.
    """
    settings = _settings(one, response, h)
    return [-c * v * one.shape(v) for c, v in zip(settings, speeds, strict=True)]


def _settings(one: "SettablePart", response: Response, h: float) -> tuple[Array, Array, Array]:
    """Returns a damper's setting minus its nominal setting at the start, in the middle and at the end of each step, shape (T -
    1,) each.
    """
    beyond, bandwidth = response[one.coefficient] - one.nominal, one.damper.bandwidth
    before, after = beyond[:-1], beyond[1:] if bandwidth else beyond[:-1]
    share = 1 / (1 + np.exp(-bandwidth * h / 2)) if bandwidth else 0.0
    return before, before + share * (after - before), after


def _by_tyres(path: "_Path", road: RoadInput) -> tuple[Array, Array]:
    """Returns the road's work in each step, except its work on the tyre springs, and the energy that tyres dissipate [J].

    Both the work and the energy have the shape (T - 1,).

    If a tyre has damping, the nonelastic part R of its force acts between road and hub. The power of the road is R w at the
    road velocity w, the power on the hub is R l', and the tyre dissipates the difference.
    """
    model, by_road, lost = path.model, np.zeros(len(path.ends)), np.zeros(len(path.ends))
    for wheel, i in zip(*damped_tyres(road.vehicle, model), strict=True):
        number, c, (force, slope) = model.ntendon + model.nv + i, model.actuator_gainprm[i, 0], model.actuator_biasprm[i, :2]
        length, w, k, squeeze = path.length(number), road.held_velocities[: len(lost), wheel], -slope, -force / slope
        near = [(squeeze - path.rest[2 + number] - d, w - v) for d, v in length.stages]
        beyond = [np.maximum(k * s + c * closing, 0.0) - k * np.maximum(s, 0.0) for s, closing in near]
        by_road += length.integral(force * w for force in beyond)
        lost += length.integral(force * closing for force, (_, closing) in zip(beyond, near, strict=True))
    return by_road, lost


def _has_kinks(vehicle: Vehicle, response: Response) -> bool:
    """Returns True if a force may have a kink due to a tyre in the air, a bump stop, a characteristic, or a lagging force at
    its limit.

    A command that is limited before the lag is held constant during a step, so its force has no kink within the step.
    """
    reached, limits = utilisation(vehicle, response), vehicle.limits
    ends = [LIFT_OFF, BUMP_STOP] + ([] if limits.actuator_bandwidth is None or limits.limits_commands else [SATURATION])
    bent = vehicle.parts.nonlinear or any(one.damper.pair is not None for one in vehicle.parts.adjustable)
    return bent or any(reached[REGIME_ENDS.index(end)] >= NEAR for end in ends)


def _fastest(vehicle: Vehicle) -> float:
    """Returns the fastest rate of the vehicle, its actuators and its dampers' valves, at any setting [rad/s]."""
    model = vehicle.linear_model
    firm = {one.force: one.steepest_slope / one.nominal for one in vehicle.parts.adjustable if one.nominal}
    rate = float(np.abs(np.linalg.eigvals(model.A)).max()) * max([1.0, *firm.values()])
    lags = [damper.bandwidth for damper in vehicle.dampers.values() if damper.bandwidth is not None]
    return max([rate, vehicle.limits.actuator_bandwidth or 0.0, *lags])


class _Path:
    """Stored energies and lengths of a run at T samples. The lengths are those of tendons, joints and actuators, in this order.

    Attributes:
        model: compiled model of the vehicle.
        h: duration of a step [s].
        starts: potential and kinetic energy, lengths, and rates of the lengths at the samples, shape (T, n). The road height at
            a sample is that in the step that begins at the sample.
        ends, rest: quantities of `starts` at the end of every step (with the road height in the step), shape (T - 1, n), and in
            equilibrium, shape (n,).
    """

    def __init__(self, qpos: Array, qvel: Array, road: RoadInput) -> None:
        """Evaluates T states for the road height in the step that begins at each state. If the road height changes at a state,
        this state is also evaluated for the height in the step before.
        """
        midway, self.h = road.midway[: len(qpos)], road.timestep
        self.model, moved = _energy_model(road.vehicle, self.h), np.flatnonzero(np.any(midway[1:] != midway[:-1], axis=1))
        again = ((qpos, qpos[1 + moved]), (qvel, qvel[1 + moved]), (midway, midway[moved]))
        q, v, roads = (np.concatenate([one, other, np.zeros_like(one[:1])]) for one, other in again)
        seen = _evaluate_states(road.vehicle, self.model, q, v, roads)
        self.starts, self.ends, self.rest = seen[: len(qpos)], seen[1 : len(qpos)].copy(), seen[-1]
        self.ends[moved] = seen[len(qpos) : -1]

    def length(self, number: int, factor: float = 1.0) -> "_Length":
        """Returns a length of the model by its index, after multiplication by a factor."""
        d, after = (factor * (one[:, 2 + number] - self.rest[2 + number]) for one in (self.starts, self.ends))
        return _Length(d, factor * self.starts[:, len(self.rest) // 2 + 1 + number], after, self.h)

    def stroke(self, vehicle: Vehicle, force: str) -> "_Length":
        """Returns the deflection along which an input acts: the deflection of its suspension or, if it has no suspension, of
        its actuator.
        """
        model, i = self.model, mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_SENSOR, vehicle.kind.deflection_of(force))
        firsts = {int(mujoco.mjtSensor.mjSENS_TENDONPOS): 0, int(mujoco.mjtSensor.mjSENS_JOINTPOS): model.ntendon}
        first = firsts.get(int(model.sensor_type[i])) if i >= 0 else None
        if first is not None:
            return self.length(first + model.sensor_objid[i], model.sensor_user[i, 0])
        return self.length(model.ntendon + model.nv + model.actuator(force).id, 1.0 / vehicle.motion_ratios[force])


@lru_cache(maxsize=16)
def _energy_model(vehicle: Vehicle, timestep: float) -> mujoco.MjModel:
    """Returns the MuJoCo model that computes the energy of the vehicle.

    The model for the energy has no bump stops, and its tyres with damping have ordinary springs.
    """
    spec = build_spec(replace(vehicle, limits=Limits()), timestep)
    for actuator in spec.actuators:
        if actuator.name.startswith(DAMPER):
            spec.tendon(actuator.target).stiffness[0] = -actuator.biasprm[1]
    spec.compiler.discardvisual = True
    model = spec.compile()
    model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
    return model


def _evaluate_states(vehicle: Vehicle, model: mujoco.MjModel, qpos: Array, qvel: Array, roads: Array) -> Array:
    """Returns the energies, lengths and rates of `_Path` for T states with the supplied road heights, shape (T, n)."""
    names = ("energy", "ten_length", "qpos", "actuator_length", "ten_velocity", "qvel", "actuator_velocity")
    batch = Batch(model, min(AT_ONCE, max(1, len(qpos))), 0)
    columns, heights, mocap = [batch.bind(name) for name in names], batch.bind("mocap_pos"), mocap_indices(vehicle, model)
    values = np.empty((len(qpos), sum(one.shape[1] for one in columns)))
    for first in range(0, len(qpos), batch.nsim):
        some = slice(max(0, min(first, len(qpos) - batch.nsim)), min(first + batch.nsim, len(qpos)))
        columns[2][:], columns[5][:] = qpos[some], qvel[some]
        heights[:, mocap, 2] = roads[some]
        batch.forward(stage=int(mujoco.mjtStage.mjSTAGE_VEL))
        values[some] = np.concatenate(columns, axis=1)
    motion: Any = vehicle.kind.motion and vehicle.kind.motion(vehicle.kind.at_wheels(vehicle.parameters))
    joints, actuators = ([one(i).name for i in range(n)] for one, n in ((model.joint, model.njnt), (model.actuator, model.nu)))
    if hasattr(motion, "energy") and {*motion.joints} <= {*joints}:
        own = [joints.index(name) for name in motion.joints]
        values[:, :2] = motion.energy(np.concatenate([qpos[:, own], qvel[:, own]], axis=1), roads)
    else:
        loads = [name.startswith(STATIC_LOAD) for name in actuators] * model.actuator_biasprm[:, 0]
        values[:, 0] -= values[:, 2 + model.ntendon + model.nq :][:, : model.nu] @ loads
    return values


def _acting_forces(vehicle: Vehicle, forces: Array, requested: Array, h: float) -> Array:
    """Returns the forces of the actuators at RK4's stages of every step [N], shape (4, T - 1, m).

    If a requested force exceeds the largest force, the lagging force may change its sign within a step.

    Args:
        forces: simulated forces at the samples [N], shape (T, m).
        requested: forces that the controller requested; see `Recording.commands`.
    """
    limits, z = vehicle.limits, np.full(forces.shape[1], (vehicle.limits.actuator_bandwidth or 0.0) * h)
    if limits.actuator_force is None or limits.limits_commands:
        return np.stack(lag_stages(forces, z))
    largest, most = limits.largest
    asked = np.clip(requested[:, : forces.shape[1]], -largest, largest)
    stages = lag_stages(np.where(np.abs(forces) < AT * most, forces, lag_commands(asked, z)), z)
    return np.clip(stages, -most, most)
