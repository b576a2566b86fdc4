"""Physics against the vehicle's exact equations, step by step: also where no linear response holds.

From the signals at one sample follows the state, and from this, by RK4's own arithmetic on the equations of the vehicle file, the
signals at the next sample. Physics must have these, to rounding: while bodies turn, beyond the lines of curves, at bump stops,
with tyres in the air and forces at their limits. Every step begins at physics' own state, so no error of one step hides in the
next, and all steps are computed at once. Forces are those that the controller has asked for, within the limits and behind the lag
of the vehicle file; where that is not known, as in a log, those of physics within these limits, as are coefficients of dampers.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.roads.road import RoadInput
from models.vehicle.mjcf import has_geometry
from models.vehicle.vehicle import Vehicle
from sim.linear.nonlinear_elements import pulls_on
from sim.linear.sampled_response import recursion, roundings
from sim.response.regime import AT
from sim.response.response import Response

if TYPE_CHECKING:
    from models.kinds.motion import Motion, Pulls

EXACT = 1e-10  # of a peak; measured up to 1e-12 per step, and a force that is off by a ten thousandth leaves 1e-8 and more
SHARES = (0.0, 0.5, 0.5, 1.0)  # of a step, at which RK4 looks at it
WEIGHTS = (1 / 6, 1 / 3, 1 / 3, 1 / 6)


@dataclass(frozen=True)
class StepAgreement:
    """Differences of the physics from the vehicle's exact equations over single steps.

    Attributes:
        error: the difference that comes nearest to its allowed value or exceeds it most, over the signal's peak.
        allowed: of that signal, over its peak.
        signal: its name.
        since: start of the first step that differs by more than is allowed [s], or infinity.
        until: steps that begin before this time are compared [s]; infinite for all.
    """

    error: float
    allowed: float
    signal: str
    since: float
    until: float

    @property
    def agrees(self) -> bool:
        """Returns True if every step is that of the equations."""
        return self.error <= self.allowed


class LinearMotion:
    """Equations of motion of a vehicle that is linear between the limits of its file, while no tyre leaves the road."""

    def __init__(self, vehicle: Vehicle) -> None:
        """Takes the linear model, and how its suspensions pull.

        Raises:
            ValueError: a suspension that has a curve or a stop is no state of the linear model, or its effect is unknown.
        """
        self.model, self.names = vehicle.linear_model, vehicle.linear_model.states
        self._jump, self._of_road = self.model.Bw.T, (self.model.A @ self.model.Bw + self.model.Br).T
        stops = vehicle.limits.stops(vehicle.kind.suspensions)
        needed = {fitted.deflection for fitted in vehicle.fitted} | {name for name, both in stops.items() if both.acts}
        needed |= {vehicle.kind.pushed(force) for force in vehicle.dampers}
        names = [part.deflection for part in vehicle.kind.suspensions]
        self._rows, self._push = np.zeros((len(names), len(self.names))), np.zeros((len(names), len(self.names)))
        for i, part in enumerate(vehicle.kind.suspensions):
            if part.deflection not in needed:
                continue
            if part.deflection not in self.names or not (part.force or part.stiffness):
                raise ValueError(f"the effect of forces along {part.deflection} is unknown")
            self._rows[i, self.names.index(part.deflection)] = 1.0
            self._push[i] = pulls_on(vehicle, [part.deflection])[0][:, 0]
        self._rates = self._rows @ self.model.A

    def state(self, signals: Mapping[str, Array], heights: Array) -> Array:
        """See `Motion`. It is the part of the linear model's state that does not jump with the road."""
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
        still = heights @ self._of_road + inputs @ self.model.B.T + loads @ self.model.Bl.T
        return state @ self.model.A.T + still + pulls(x @ self._rows.T, x @ self._rates.T) @ self._push


def motion_of(vehicle: Vehicle) -> "Motion | None":
    """Returns the exact equations of a vehicle, or None if only its MJCF has them."""
    if vehicle.kind.motion is not None:
        return vehicle.kind.motion(vehicle.parameters)
    try:
        return None if has_geometry(vehicle) else LinearMotion(vehicle)
    except ValueError:
        return None


def compare_steps(
    motion: "Motion", road: RoadInput, physics: Response, requested_force: Array | None, until: float
) -> StepAgreement:
    """Compares every step of physics that ends before a time [s] with the equations of motion.

    Args:
        requested_force: requested forces, or commands if there are adjustable dampers, shape (T, m) or (T, 2 m); None if unknown.
    """
    physics = physics.until(until)
    ahead, there, known = _stepped(motion, road, physics, requested_force)
    if not len(ahead):
        return StepAgreement(0.0, EXACT, motion.names[0], np.inf, 0.0)
    rounding = roundings(road.vehicle, None)
    scales = np.array([physics.scale(name) or 1.0 for name in motion.names])
    # What a length of a metre rounds to is a hundred times as much at a height of a hundred metres.
    high = 1.0 + np.abs(road.heights).max(initial=0.0)
    allowed = EXACT + high * np.array([rounding[name] for name in motion.names]) / scales
    apart = np.where(known[:, None], np.abs(ahead - there) / scales, 0.0)
    apart[~np.isfinite(apart)] = np.inf
    excess = apart / allowed
    step, which = np.unravel_index(excess.argmax(), excess.shape)
    beyond = excess.max(axis=1) > 1
    usable = len(ahead) == len(road.time) - 1
    return StepAgreement(
        error=float(apart[step, which]),
        allowed=float(allowed[which]),
        signal=motion.names[which],
        since=float(physics.time[beyond.argmax()]) if beyond.any() else np.inf,
        until=np.inf if usable else float(physics.time[len(ahead)]),
    )


def left_over(
    motion: "Motion", road: RoadInput, physics: Response, requested_force: Array | None, until: float
) -> dict[str, Array]:
    """Returns how the linear vehicle would move if only the differences of single steps pushed it, by output signal.

    Args:
        requested_force: as for `compare_steps`.
        until: physics is taken before this time [s].
    """
    model, physics = road.vehicle.linear_model, physics.until(until)
    ahead, there, known = _stepped(motion, road, physics, requested_force)
    apart = dict(zip(motion.names, np.where(known[:, None], there - ahead, 0.0).T, strict=True))
    pushed = np.zeros((len(physics.time), len(model.states)))
    for i, name in enumerate(model.states):
        parts = road.vehicle.kind.combined.get(name, {name: 1.0})
        pushed[: len(ahead), i] = sum(share * apart[part] for part, share in parts.items())
    outputs = recursion(linalg.expm(model.A * road.timestep), pushed) @ model.C.T
    return dict(zip(model.outputs, outputs.T, strict=True))


def _stepped(motion: "Motion", road: RoadInput, physics: Response, requested_force: Array | None) -> tuple[Array, Array, Array]:
    """Returns signals after one step of RK4 from every sample, those of physics there, shapes (K, p), and where both compare."""
    vehicle, h, count = road.vehicle, road.timestep, max(len(physics.time), 1)
    heights, midway, loads = road.heights[:count], road.midway[: count - 1], road.held_loads[: count - 1]
    if count == 1:
        return np.zeros((0, len(motion.names))), np.zeros((0, len(motion.names))), np.zeros(0, dtype=bool)
    state = motion.state({name: physics[name] for name in motion.names}, heights)[:-1]
    usable = motion.usable(state)
    end = len(state) if usable.all() else int(usable.argmin())
    state, heights, midway, loads = state[:end], heights[: end + 1], midway[:end], loads[:end]
    stages, known = _given(
        vehicle, Response(physics.time[: end + 1], physics.signals, physics.values[: end + 1]), requested_force, h
    )
    dampers = np.isin(vehicle.linear_model.inputs, list(vehicle.dampers))
    total, at, rate = np.zeros_like(state), state, np.zeros_like(state)
    for given, share, weight in zip(stages, SHARES, WEIGHTS, strict=True):
        at = state + share * h * rate
        pulls = partial(_pulls, vehicle, np.where(dampers, given, 0.0))
        rate = motion.rate(at, midway, np.where(dampers, 0.0, given), pulls, loads)
        total += weight * rate
    there = np.stack([physics[name][1 : end + 1] for name in motion.names], axis=-1)
    return motion.read(state + h * total, heights[1:]), there, known


def _given(vehicle: Vehicle, physics: Response, requested_force: Array | None, h: float) -> tuple[list[Array], Array]:
    """Returns forces, or coefficients of dampers beyond the nominal ones, in RK4's stages of every step, shape (K, m) each.

    Behind them is where they are known, shape (K,): a lagging force that is at its limit at one end of a step alone is not known
    within it, unless all commands are.
    """
    inputs, limits, count = vehicle.linear_model.inputs, vehicle.limits, len(physics.time)
    now, most = np.stack([physics[name] for name in inputs], axis=-1), limits.actuator_force or np.inf
    rates = np.full(len(inputs), limits.actuator_bandwidth or 0.0)
    for one in vehicle.adjustable:
        j = inputs.index(one.force)
        now[:, j] = np.clip(physics[one.coefficient] - one.nominal, one.low, one.high)
        rates[j] = one.damper.bandwidth or 0.0
    pushing = ~np.isin(inputs, list(vehicle.dampers))
    z = rates * h
    way = z * (1 - z / 2 * (1 - z / 3 * (1 - z / 4)))  # share of the way to its command that RK4 goes in a step
    if requested_force is not None and limits.actuator_bandwidth is None:
        now[:, pushing] = requested_force[:count, : len(inputs)][:, pushing]
    elif requested_force is not None:
        now[:, pushing] = recursion(np.diag(1 - way[pushing]), way[pushing] * requested_force[:count, : len(inputs)][:, pushing])
    else:
        now = np.where(pushing, np.clip(now, -most, most), now)
    before, change = now[:-1], np.diff(now, axis=0) / np.where(way > 0, way, 1.0)
    stages, gone = [], np.zeros_like(before)
    for share in SHARES:
        gone = share * z * (change - gone)
        stages.append(np.where(pushing, np.clip(before + gone, -most, most), before + gone))
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
