"""Compares a simulation with the exact equations of motion, step by step and signal by signal, even if the motion is not
linear.

The signals at one sample determine the state at this sample. A step of RK4 from the state at one sample, with the equations of
the vehicle file, gives the signals at the next sample. The simulated signals must equal the signals that the equations give, up
to rounding errors. The equations include rotating bodies, nonlinear characteristics, bump stops, tyres in the air and forces at
their limits. Every step begins at the simulated state, so an error in one step cannot hide an error in another step. Because
every step begins at a simulated state, all steps can be computed together. Forces and damper coefficients follow from the
commands of the controller, with the limits and the lag of the vehicle file.

The state and the forces at a sample also determine all other output signals. The other output signals are accelerations at the
beginning of the step, velocities of points of the body, sums of signals, and the forces. The simulated values of the other
output signals must also equal the computed values.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.extensions import FEATURES
from models.kinds.signals import names_of
from models.parts.part import STEP
from models.roads.road import RoadInput
from models.vehicle.mjcf import has_geometry
from models.vehicle.suspension_forces import MotionRatios, SuspensionForces
from models.vehicle.vehicle import Vehicle
from sim.drive.recursion import SHARES, WEIGHTS, lag_commands, lag_rates, lag_stages
from sim.drive.response import Response
from sim.linear.rounding import roundings
from sim.observers.recorder import Recording, from_steady
from sim.observers.results import StepAgreement

if TYPE_CHECKING:
    from models.kinds.motion import Motion, Pulls

# allowed difference of a signal per step, relative to the peak; at most 1e-12 was observed, and a force that is wrong by 1e-4
# causes at least 1e-8
EXACT = 1e-10
UNIT = 1024.0  # N; force that is applied to find how accelerations respond to a force; the response is linear


def motion_of(vehicle: Vehicle) -> "Motion | None":
    """Returns the exact equations of motion of a vehicle; None if only its MuJoCo model defines them."""
    if vehicle.kind.motion is not None:
        return vehicle.kind.motion(vehicle.kind.at_wheels(vehicle.parameters))
    from sim.linear.linear_motion import LinearMotion  # only vehicles without equations of their own need it

    try:
        return None if has_geometry(vehicle) else LinearMotion(vehicle)
    except ValueError:
        return None


def compare_steps(road: RoadInput, recording: Recording, until: float, rounding: Mapping[str, float]) -> StepAgreement | None:
    """Compares every step that ends before a time [s] with the vehicle's equations.

    Returns None if the vehicle has no equations of motion.

    Args:
        road: road input that the run should have; the road input includes the vehicle.
        recording: recording of the run.
        until: time before which the compared steps end [s].
        rounding: rounding error of every output signal in the control loop; see `sim.linear.rounding`.
    """
    if (motion := motion_of(road.vehicle)) is None:
        return None
    measured, physics = recording.measured, from_steady(road, recording.response.until(until))
    starts = _starts(motion, road, physics, recording.commands)
    if not len(starts.state):
        return StepAgreement(0.0, EXACT, motion.names[0], np.inf, 0.0)
    ahead, there = _step_signals(motion, starts)
    shown = _other_signals(motion, starts, physics, starts.stages[0], road.in_signals[: len(starts.state)])
    readings = _readings(motion, starts, physics, measured, road.in_readings[: len(starts.state)])
    told = (*motion.names, *(one.name for one in road.vehicle.kind.of_parts))
    names = (*told, *shown, *readings)
    held, combined = roundings(road.vehicle, None), road.vehicle.kind.combined
    # The signal has a rounding error, and so do the other signals from which it is computed.
    rounded = [held[name] for name in told]
    for name in (*shown, *readings):
        parts = combined.get(name, {name: 1.0})
        rounded.append(sum(abs(share) * rounding.get(part, 0.0) for part, share in parts.items()) + rounding.get(name, 0.0))
    scales = np.array([physics.scale(name) or 1.0 for name in names])
    # At a height of a hundred metres, the rounding error of a length is a hundred times as large as at one metre.
    high = 1.0 + np.abs(road.heights).max(initial=0.0)
    allowed = EXACT + high * np.array(rounded) / scales
    further = [shown[name] - physics[name][: len(ahead)] for name in shown]
    further += [expected - measured[name][: len(ahead)] for name, expected in readings.items()]
    apart = np.abs(np.concatenate([ahead - there, *(row[:, None] for row in further)], axis=1))
    between = np.isnan(np.stack([measured[name][: len(ahead)] for name in readings], 1)) if readings else None
    if between is not None:  # a NaN means that nothing was measured at this time step
        apart[:, -between.shape[1] :][between] = 0.0
    apart /= scales
    apart[~np.isfinite(apart)] = np.inf
    excess = apart / allowed
    step, which = np.unravel_index(excess.argmax(), excess.shape)
    beyond = excess.max(axis=1) > 1
    usable = len(ahead) == len(road.time) - 1
    return StepAgreement(
        error=float(apart[step, which]),
        allowed=float(allowed[which]),
        signal=names[which],
        since=float(physics.time[beyond.argmax()]) if beyond.any() else np.inf,
        until=np.inf if usable else float(physics.time[len(ahead)]),
        equations_invalid=len(ahead) < len(physics.time) - 1,
    )


@dataclass(frozen=True, eq=False)
class _Starts:
    """Starts of the K steps that are compared with the equations.

    Attributes:
        vehicle: vehicle with the limits of its actuators.
        timestep: duration of the steps [s].
        state: state of the vehicle's `Motion`, shape (K, n).
        own: internal states of the vehicle's parts, shape (K, k).
        heights: road heights at the starts of the steps and after the last step [m], shape (K + 1, r).
        midway: road heights that are held constant during each step [m], shape (K, r).
        loads: loads that are held constant during each step; see `RoadInput.held_inputs`.
        there: simulated values of the signals in `Motion.names`, and of the states of parts, at the ends of the steps, shape
            (K, p + k).
        stages: forces, or coefficients of dampers relative to the nominal coefficients, at RK4's four stages, shape (K, m)
            each.
    """

    vehicle: Vehicle
    timestep: float
    state: Array
    own: Array
    heights: Array
    midway: Array
    loads: Array
    there: Array
    stages: list[Array]


def _starts(motion: "Motion", road: RoadInput, physics: Response, commands: Array) -> _Starts:
    """Returns the starts of all steps, up to the first state for which the equations are not valid."""
    vehicle, h, count = road.vehicle, road.timestep, max(len(physics.time), 1)
    heights, midway, loads = road.heights[:count], road.midway[: count - 1], road.held_inputs[: count - 1]
    names, m, of_parts = motion.names, len(vehicle.linear_model.inputs), names_of(vehicle.kind.of_parts)
    if count == 1:
        nothing = np.zeros((0, len(names)))
        return _Starts(vehicle, h, nothing, nothing, heights, midway, loads, nothing, [np.zeros((0, m))] * 4)
    state = motion.state({name: physics[name] for name in names}, heights)[:-1]
    usable = motion.usable(state)
    end = len(state) if usable.all() else int(usable.argmin())
    stages = _stage_inputs(vehicle, physics.samples(slice(end + 1)), commands, h)
    there = np.stack([physics[name][1 : end + 1] for name in (*names, *of_parts)], axis=-1)
    own = np.stack([physics[name][:end] for name in of_parts], axis=-1) if of_parts else np.zeros((end, 0))
    return _Starts(vehicle, h, state[:end], own, heights[: end + 1], midway[:end], loads[:end], there, stages)


def _step_signals(motion: "Motion", starts: _Starts) -> tuple[Array, Array]:
    """Returns the signals after one RK4 step from every start, and the simulated signals at the end of the same step, shapes
    (K, p + k).
    """
    state, h, n = np.concatenate([starts.state, starts.own], axis=1), starts.timestep, starts.state.shape[1]
    if not len(state):
        return starts.there, starts.there
    total, at, rate, forces = np.zeros_like(state), state, np.zeros_like(state), SuspensionForces([starts.vehicle])
    for given, share, weight in zip(starts.stages, SHARES, WEIGHTS, strict=True):
        at, seen = state + share * h * rate, list[tuple[Array, Array]]()
        acting = starts.midway, _at_wheels(starts.vehicle, given)
        pulls = _pulls(motion, forces, given, at[:, n:], seen, at[:, :n], *acting, starts.loads)
        rate[:, :n] = motion.rate(at[:, :n], *acting, pulls, starts.loads)
        if forces.states:
            rate[:, n:] = forces.rates(*seen[0], given, at[:, n:])
        total += weight * rate
    end = state + h * total
    return np.concatenate([motion.read(end[:, :n], starts.heights[1:]), end[:, n:]], axis=1), starts.there


def _pulls(
    motion: "Motion",
    forces: SuspensionForces,
    given: Array,
    own: Array,
    seen: list[tuple[Array, Array]],
    state: Array,
    heights: Array,
    inputs: Array,
    loads: Array,
) -> "Pulls":
    """Returns a function that computes the suspension forces for the supplied states, including those of inertial parts.

    Let a be the second time derivatives of the deflections without the forces of inertial parts. The forces p of inertial parts
    change the second derivatives to a + R p, so p = b (a + R p). A complex step along a motion gives the second derivatives
    exactly.

    Args:
        given: commands that act during the RK4 stage.
        own: internal states of the vehicle's parts.
        seen: list to which the function appends deflections and their rates; the first entry belongs to the supplied states.
        state, heights, inputs, loads: arguments of `Motion.rate`.

    Raises:
        InputError: the equations of a custom vehicle type do not accept complex states.
    """

    def pulls(d: Array, v: Array) -> Array:
        seen.append((d, v))
        return forces(d, v, given, own)

    if not forces.inertial or not len(state):
        return pulls

    def along(d: Array, v: Array) -> Array:
        seen.append((d, v))
        return np.zeros(v.shape)

    def change(more: Array | float) -> Array:
        rates = motion.rate(state, heights, inputs, lambda d, v: pulls(d, v) + more, loads)
        motion.rate(state + STEP * 1j * rates, heights, inputs, along, loads)
        if not np.iscomplexobj(seen[-1][1]):
            raise InputError(
                "`motion` of this vehicle type discards the imaginary part of states, but the equations of an "
                "inerter need this part; keep the imaginary part in `motion`"
            )
        return np.imag(seen[-1][1]) / STEP

    free = change(0.0)
    response = np.stack([(change(UNIT * one) - free) / UNIT for one in np.eye(free.shape[1])], axis=-1)
    b = forces.inertance(seen[0][0])
    held = np.eye(free.shape[1]) - b[..., None] * response
    inertial = np.linalg.solve(held, (b * free)[..., None])[..., 0]
    return lambda d, v: pulls(d, v) + inertial


def _other_signals(motion: "Motion", starts: _Starts, physics: Response, given: Array, loads: Array) -> dict[str, Array]:
    """Computes, from the equations of motion, the signals that the state does not contain, for the supplied commands and loads,
    shape (K,) each.
    """
    vehicle, count, seen = starts.vehicle, len(starts.state), list[tuple[Array, Array]]()
    kind, names, forces, ratios = vehicle.kind, physics.names, SuspensionForces([vehicle]), MotionRatios([vehicle])

    at = starts.state, starts.heights[:-1], _at_wheels(vehicle, given)
    pulls = _pulls(motion, forces, given, starts.own, seen, *at, loads)
    shown = dict(motion.outputs(*at, pulls, loads))
    travels, speeds = seen[0]
    for part, v in zip(kind.suspensions, speeds.T, strict=True):
        shown.setdefault(part.velocity.name, v)
    places = {part.force: i for i, part in enumerate(kind.suspensions)}
    shown |= dict(zip(vehicle.linear_model.inputs, given.T, strict=True))
    for one in vehicle.parts.adjustable:
        coefficient, i = shown[one.force], places[one.force]
        shown[one.force] = -coefficient * one.shape(ratios.of(one.force, travels[:, i]) * speeds[:, i])
        shown[one.coefficient] = one.nominal + coefficient
    if vehicle.dampers:
        range_of = FEATURES.load("damper ranges").range_of
        for one in range_of([vehicle]).elements:
            own, force = one.own_motion(travels[:, one.place], speeds[:, one.place]), vehicle.linear_model.inputs[one.column]
            shown[force] = one.element.push(*own, starts.own[:, one.states], given[:, one.column])
    for name, parts in kind.combined.items():
        shown[name] = sum((share * physics[part][:count] for part, share in parts.items()), np.zeros(count))
    return {name: values for name, values in shown.items() if name in names and name not in motion.names}


def _readings(
    motion: "Motion", starts: _Starts, physics: Response, measured: Mapping[str, Array], loads: Array
) -> dict[str, Array]:
    """Computes, from the equations of motion, the measured accelerations at the starts of the steps, for the supplied loads,
    shape (K,) each.

    A measurement is taken before the new commands act.
    """
    model = starts.vehicle.linear_model
    some = [name for name in measured if name in model.outputs]
    some = [name for name in some if model.D[model.outputs.index(name)].any() or model.Dh[model.outputs.index(name)].any()]
    if not some:
        return {}
    now, lags = starts.stages[0], lag_rates(starts.vehicle) > 0
    before = np.concatenate([np.zeros_like(now[:1]), now[:-1]])
    shown = _other_signals(motion, starts, physics, np.where(lags, now, before), loads)
    return {name: shown[name] for name in some if name in shown}


def _at_wheels(vehicle: Vehicle, given: Array) -> Array:
    """Returns the actuator forces at the wheels, for the motion ratios in equilibrium [N], shape (K, m); 0 for dampers."""
    forces = vehicle.linear_model.inputs
    return np.where(np.isin(forces, list(vehicle.dampers)), 0.0, given) * [vehicle.motion_ratios[name] for name in forces]


def _stage_inputs(vehicle: Vehicle, physics: Response, commands: Array, h: float) -> list[Array]:
    """Returns the forces, or the damper coefficients relative to nominal, at RK4's stages of every step, shape (K, m) each."""
    inputs, (asked, most) = vehicle.linear_model.inputs, vehicle.limits.largest
    demand, z = commands[: len(physics.time), : len(inputs)], lag_rates(vehicle) * h
    pushing = ~np.isin(inputs, list(vehicle.dampers))
    now = lag_commands(np.where(pushing, np.clip(demand, -asked, asked), demand), z)
    return [np.where(pushing, np.clip(stage, -most, most), stage) for stage in lag_stages(now, z)]
