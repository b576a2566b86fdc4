"""Comparison of physics with the exact equations, step by step and signal by signal, also where no linear response applies.

The signals at one sample determine the state. RK4 on the equations of the vehicle file then gives the signals at the next sample.
Physics must have the same signals, to rounding: while bodies turn, beyond the lines of curves, at bump stops, with tyres in the
air and forces at their limits. Every step begins at physics' own state, so no error of one step hides in the next, and all steps
are computed at once. Forces are the controller's requests, with the limits and the lag of the vehicle file. If the requests are
not known, as in a log, the forces of physics are taken, within the same limits, and likewise the coefficients of dampers.

The state and the forces at a sample also determine every other output signal there: accelerations, as the forces and loads of the
step begin to act, velocities of points of the body, sums of signals, and the forces. Physics must have these, too.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.roads.road import RoadInput
from models.vehicle.mjcf import MOST_ASKED, has_geometry
from models.vehicle.vehicle import Vehicle
from sim.linear.sampled_response import roundings
from sim.response.recursion import SHARES, lag_stages, lagging, recursion
from sim.response.regime import AT
from sim.response.response import Response

if TYPE_CHECKING:
    from models.kinds.motion import Motion, Pulls

EXACT = 1e-10  # of a peak; up to 1e-12 per step was measured, and a force that is wrong by 1e-4 leaves 1e-8 and more
WEIGHTS = (1 / 6, 1 / 3, 1 / 3, 1 / 6)


@dataclass(frozen=True)
class StepAgreement:
    """Differences of the physics from the vehicle's exact equations over single steps, and at their starts.

    Attributes:
        error: the difference with the largest ratio to its allowed value, over the signal's peak.
        allowed: the allowed value of that signal, over its peak.
        signal: name of that signal.
        since: start of the first step that differs by more than is allowed [s], or infinity.
        until: steps that begin before this time are compared [s]; infinite for all.
        lost: True if the equations do not take the state at that time.
    """

    error: float
    allowed: float
    signal: str
    since: float
    until: float
    lost: bool = False

    @property
    def agrees(self) -> bool:
        """Returns True if every step is that of the equations."""
        return self.error <= self.allowed


class LinearMotion:
    """Equations of motion of a vehicle that is linear except for the limits of its file, while no tyre leaves the road."""

    def __init__(self, vehicle: Vehicle) -> None:
        """Prepares the linear model and the effect of its suspensions.

        Raises:
            ValueError: a suspension with a curve or a stop is not a state of the linear model, or its effect is unknown.
        """
        self.model, self.names = vehicle.linear_model, vehicle.linear_model.states
        self._jump, self._of_road = self.model.jump.T, (self.model.A @ self.model.jump + self.model.Br).T
        stops = vehicle.limits.stops(vehicle.kind.suspensions)
        needed = {fitted.deflection for fitted in vehicle.fitted} | {name for name, both in stops.items() if both.acts}
        needed |= {vehicle.kind.pushed(force) for force in vehicle.dampers}
        names = [part.deflection for part in vehicle.kind.suspensions]
        self._rows, self._push = np.zeros((len(names), len(self.names))), np.zeros((len(names), len(self.names)))
        self._shown = np.zeros((len(names), len(self.model.outputs)))
        for i, part in enumerate(vehicle.kind.suspensions):
            if part.deflection not in needed:
                continue
            if part.deflection not in self.names or not (part.force or part.stiffness):
                raise ValueError(f"the effect of forces along {part.deflection} is unknown")
            self._rows[i, self.names.index(part.deflection)] = 1.0
            push, shown = vehicle.pulls_on([part.deflection])
            self._push[i], self._shown[i] = push[:, 0], shown[:, 0]
        self._rates = self._rows @ self.model.A

    def state(self, signals: Mapping[str, Array], heights: Array) -> Array:
        """See `Motion`. The state is the part of the linear model's state that does not jump with the road."""
        return np.stack([signals[name] for name in self.names], axis=-1) - heights @ self._jump

    def usable(self, state: Array) -> Array:
        """See `Motion`."""
        return np.ones(len(state), dtype=bool)

    def read(self, state: Array, heights: Array) -> Array:
        """See `Motion`."""
        return state + heights @ self._jump

    def rate(self, state: Array, heights: Array, inputs: Array, pulls: "Pulls", loads: Array) -> Array:
        """See `Motion`."""
        x = state + heights @ self._jump
        still = heights @ self._of_road + inputs @ self.model.B.T + loads @ self.model.Bh.T
        return state @ self.model.A.T + still + pulls(x @ self._rows.T, x @ self._rates.T) @ self._push

    def outputs(self, state: Array, heights: Array, inputs: Array, pulls: "Pulls", loads: Array) -> Mapping[str, Array]:
        """See `Motion`."""
        model, x = self.model, state + heights @ self._jump
        values = x @ model.C.T + heights @ model.Cr.T + inputs @ model.D.T + loads @ model.Dh.T
        values = values + pulls(x @ self._rows.T, x @ self._rates.T) @ self._shown
        return {name: column for name, column in zip(model.outputs, values.T, strict=True) if name not in model.inputs}


def motion_of(vehicle: Vehicle) -> "Motion | None":
    """Returns the exact equations of a vehicle, or None if only its MJCF has them."""
    if vehicle.kind.motion is not None:
        return vehicle.kind.motion(vehicle.parameters)
    try:
        return None if has_geometry(vehicle) else LinearMotion(vehicle)
    except ValueError:
        return None


def from_steady(road: RoadInput, response: Response) -> Response:
    """Returns a response measured from the steady motion in which its vehicle starts; itself if that is rest."""
    steady = road.steady_signals(response.time)
    if steady is None:
        return response
    values = response.values.copy()
    values[..., : steady.shape[-1]] -= steady
    return Response(response.time, response.signals, values)


def compare_steps(
    motion: "Motion",
    road: RoadInput,
    physics: Response,
    requested_force: Array | None,
    until: float,
    rounding: Mapping[str, float],
) -> StepAgreement:
    """Returns the comparison of every step of physics that ends before a time [s] with the equations of motion.

    Args:
        requested_force: requested forces, or commands if there are adjustable dampers, shape (T, m) or (T, 2 m); None if unknown.
        rounding: rounding error of every output signal in the loop, see `sim.linear.sampled_response`.
    """
    physics = from_steady(road, physics.until(until))
    starts = _starts(motion, road, physics, requested_force)
    if not len(starts.state):
        return StepAgreement(0.0, EXACT, motion.names[0], np.inf, 0.0)
    ahead, there = _stepped(motion, starts)
    shown = _shown(motion, starts, physics)
    names = (*motion.names, *shown)
    held, combined = roundings(road.vehicle, None), road.vehicle.kind.combined
    # A signal is rounded, and so are those that tell it.
    rounded = [held[name] for name in motion.names]
    for name in shown:
        parts = combined.get(name, {name: 1.0})
        rounded.append(sum(abs(share) * rounding.get(part, 0.0) for part, share in parts.items()) + rounding.get(name, 0.0))
    scales = np.array([physics.scale(name) or 1.0 for name in names])
    # What a length of a metre rounds to is a hundred times as much at a height of a hundred metres.
    high = 1.0 + np.abs(road.heights).max(initial=0.0)
    allowed = EXACT + high * np.array(rounded) / scales
    further = [shown[name] - physics[name][: len(ahead)] for name in shown]
    apart = np.abs(
        np.concatenate([np.where(starts.known[:, None], ahead - there, 0.0), *(row[:, None] for row in further)], axis=1)
    )
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
        lost=len(ahead) < len(physics.time) - 1,
    )


def left_over(
    motion: "Motion", road: RoadInput, physics: Response, requested_force: Array | None, until: float
) -> dict[str, Array]:
    """Returns the response of the linear vehicle to the differences of single steps alone, by output signal.

    Args:
        requested_force: forces requested by the controller, as in `compare_steps`.
        until: physics is taken before this time [s].
    """
    model, physics = road.vehicle.linear_model, from_steady(road, physics.until(until))
    starts = _starts(motion, road, physics, requested_force)
    ahead, there = _stepped(motion, starts)
    apart = dict(zip(motion.names, np.where(starts.known[:, None], there - ahead, 0.0).T, strict=True))
    pushed = np.zeros((len(physics.time), len(model.states)))
    for i, name in enumerate(model.states):
        parts = road.vehicle.kind.combined.get(name, {name: 1.0})
        pushed[: len(ahead), i] = sum(share * apart[part] for part, share in parts.items())
    outputs = recursion(linalg.expm(model.A * road.timestep), pushed) @ model.C.T
    return dict(zip(model.outputs, outputs.T, strict=True))


@dataclass(frozen=True, eq=False)
class _Starts:
    """Starts of the K steps that are compared.

    Attributes:
        vehicle: vehicle with its limits.
        timestep: length of the steps [s].
        state: states as in `Motion`, shape (K, n).
        heights: road heights [m], including those after the last step, shape (K + 1, r).
        midway: heights at which the road is held during the steps, shape (K, r).
        loads: loads held during the steps, see `RoadInput.held`.
        there: signals of `Motion.names` at their ends, shape (K, p).
        stages: forces, or coefficients of dampers beyond the nominal ones, in RK4's stages, shape (K, m) each.
        known: True for each step within which these are known, shape (K,).
    """

    vehicle: Vehicle
    timestep: float
    state: Array
    heights: Array
    midway: Array
    loads: Array
    there: Array
    stages: list[Array]
    known: Array


def _starts(motion: "Motion", road: RoadInput, physics: Response, requested_force: Array | None) -> _Starts:
    """Returns the starts of all steps, up to the first whose state the equations cannot take."""
    vehicle, h, count = road.vehicle, road.timestep, max(len(physics.time), 1)
    heights, midway, loads = road.heights[:count], road.midway[: count - 1], road.held[: count - 1]
    names, m = motion.names, len(vehicle.linear_model.inputs)
    if count == 1:
        nothing = np.zeros((0, len(names)))
        return _Starts(vehicle, h, nothing, heights, midway, loads, nothing, [np.zeros((0, m))] * 4, np.zeros(0, dtype=bool))
    state = motion.state({name: physics[name] for name in names}, heights)[:-1]
    usable = motion.usable(state)
    end = len(state) if usable.all() else int(usable.argmin())
    ran = Response(physics.time[: end + 1], physics.signals, physics.values[: end + 1])
    stages, known = _given(vehicle, ran, requested_force, h)
    there = np.stack([physics[name][1 : end + 1] for name in names], axis=-1)
    return _Starts(vehicle, h, state[:end], heights[: end + 1], midway[:end], loads[:end], there, stages, known)


def _stepped(motion: "Motion", starts: _Starts) -> tuple[Array, Array]:
    """Returns signals after one step of RK4 from every start, and those of physics there, shapes (K, p)."""
    state, h = starts.state, starts.timestep
    if not len(state):
        return starts.there, starts.there
    total, at, rate = np.zeros_like(state), state, np.zeros_like(state)
    for given, share, weight in zip(starts.stages, SHARES, WEIGHTS, strict=True):
        at = state + share * h * rate
        forces, beyond = _parted(starts.vehicle, given)
        rate = motion.rate(at, starts.midway, forces, partial(_pulls, starts.vehicle, beyond), starts.loads)
        total += weight * rate
    return motion.read(state + h * total, starts.heights[1:]), starts.there


def _shown(motion: "Motion", starts: _Starts, physics: Response) -> dict[str, Array]:
    """Returns the vehicle's other signals at the starts by the equations, each of shape (K,)."""
    vehicle, count, seen = starts.vehicle, len(starts.state), list[Array]()
    kind, names = vehicle.kind, physics.names
    forces, beyond = _parted(vehicle, starts.stages[0])

    def pulls(d: Array, v: Array) -> Array:
        seen.append(v)
        return _pulls(vehicle, beyond, d, v)

    shown = dict(motion.outputs(starts.state, starts.heights[:-1], forces, pulls, starts.loads))
    for part, v in zip(kind.suspensions, seen[0].T, strict=True):
        shown.setdefault(part.velocity.name, v)
    places = {part.force: i for i, part in enumerate(kind.suspensions)}
    for j, name in enumerate(vehicle.linear_model.inputs):
        shown[name] = forces[:, j]
    for one in vehicle.adjustable:
        coefficient = beyond[:, vehicle.linear_model.inputs.index(one.force)]
        shown[one.force] = -coefficient * one.shape(seen[0][:, places[one.force]])
        shown[one.coefficient] = one.nominal + coefficient
    for name, parts in kind.combined.items():
        shown[name] = sum((share * physics[part][:count] for part, share in parts.items()), np.zeros(count))
    return {name: values for name, values in shown.items() if name in names and name not in motion.names}


def _parted(vehicle: Vehicle, given: Array) -> tuple[Array, Array]:
    """Returns forces [N] and coefficients of adjustable dampers beyond the nominal ones [N s/m], 0 at each other's inputs."""
    dampers = np.isin(vehicle.linear_model.inputs, list(vehicle.dampers))
    return np.where(dampers, 0.0, given), np.where(dampers, given, 0.0)


def _given(vehicle: Vehicle, physics: Response, requested_force: Array | None, h: float) -> tuple[list[Array], Array]:
    """Returns forces, or coefficients of dampers beyond the nominal ones, in RK4's stages of every step, shape (K, m) each.

    It also returns a mask of the steps in which they are known, shape (K,). If commands are unknown, a lagging force that
    is at its limit at only one end of a step is unknown within it.
    """
    inputs, limits, count = vehicle.linear_model.inputs, vehicle.limits, len(physics.time)
    now, most = np.stack([physics[name] for name in inputs], axis=-1), limits.actuator_force or np.inf
    rates = np.full(len(inputs), limits.actuator_bandwidth or 0.0)
    for one in vehicle.adjustable:
        j = inputs.index(one.force)
        now[:, j] = np.clip(physics[one.coefficient] - one.nominal, one.low, one.high)
        rates[j] = one.damper.bandwidth or 0.0
    pushing = ~np.isin(inputs, list(vehicle.dampers))
    z, asked = rates * h, MOST_ASKED if limits.actuator_force else np.inf
    if requested_force is not None:
        demand = requested_force[:count, : len(inputs)]
        now = lagging(np.where(pushing, np.clip(demand, -asked, asked), demand), z)
    else:
        now = np.where(pushing, np.clip(now, -most, most), now)
    stages = [np.where(pushing, np.clip(stage, -most, most), stage) for stage in lag_stages(now, z)]
    if requested_force is not None:
        return stages, np.ones(count - 1, dtype=bool)
    at_limit = np.where(z > 0, np.sign(now) * (np.abs(now) >= AT * most), 0.0)
    return stages, np.asarray(~np.diff(at_limit, axis=0).any(axis=1))


def _pulls(vehicle: Vehicle, beyond: Array, d: Array, v: Array) -> Array:
    """Returns the forces of suspensions beyond their linear springs and dampers [N], shape (K, s).

    Args:
        beyond: coefficients of adjustable dampers beyond the nominal ones [N s/m], shape (K, m).
        d, v: deflections [m] and their rates [m/s], shape (K, s).
    """
    pulls, inputs = np.zeros_like(d), vehicle.linear_model.inputs
    dampers = {adjustable.force: adjustable for adjustable in vehicle.adjustable}
    places = {part.deflection: i for i, part in enumerate(vehicle.kind.suspensions)}
    for fitted in vehicle.fitted:
        if len(fitted.curve.pieces.slope):
            i = places[fitted.deflection]
            pulls[:, i] += fitted.curve.pieces.force(v[:, i] if fitted.damps else d[:, i])
    for name, stops in vehicle.limits.stops(vehicle.kind.suspensions).items():
        pulls[:, places[name]] += stops.pull(d[:, places[name]])
    for part in vehicle.kind.suspensions:
        i = places[part.deflection]
        if part.force in dampers:
            pulls[:, i] += beyond[:, inputs.index(part.force)] * dampers[part.force].shape(v[:, i])
    return pulls
