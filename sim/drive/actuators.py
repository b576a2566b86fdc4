"""Actuators of N runs: they limit requests, turn them into MuJoCo's controls, and record what adjustable dampers did.

A controller works with the suspension velocity linearised at equilibrium. When a body turns, the damper's own velocity differs
by geometry.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from models.common.extensions import FEATURES
from models.vehicle.suspension_forces import MotionRatios
from models.vehicle.vehicle import Vehicle

if TYPE_CHECKING:
    from sim.drive.sensor_readout import Readout


def closing_names(vehicle: Vehicle) -> tuple[str, ...]:
    """Returns the names of the suspensions' closing velocities, one per input, and of travel and states of elements that are set.

    They are empty without adjustable dampers. See `CoefficientRange.closing`.
    """
    if not vehicle.dampers:
        return ()
    range_of = FEATURES.load("damper ranges").range_of
    closing = tuple(f"closing velocity of {force}" for force in vehicle.linear_model.inputs)
    more = (f"{name} of {closing[one.column]}" for one in range_of([vehicle]).elements for name in ("travel", *one.own))
    return (*closing, *more)


class Actuators:
    """Actuators of N vehicles of one kind, with adjustable dampers at the same places in each.

    Commands are forces [N], shape (N, m). With adjustable dampers they are coefficients beyond the nominal ones [N s/m], or
    forces of actuators that push, followed by the missing forces, shape (N, 2 m); see `CoefficientRange.commands`. MuJoCo applies
    the force limit and the lag of actuators that push.

    Attributes:
        forces: number m of forces.
        size: number of commands.
        closing: map from (qpos, qvel) to the closing velocity of every suspension, shape (m + c, nq + nv), 0 for actuators that
            push and for the travels and states of elements that are set; (0, nq + nv) without adjustable dampers.
        at_rest: offsets that keep the closing velocities from being 0, shape (m + c,) or (0,).
        lags: True if some coefficient lags behind its command.
        over_travel: True if motion ratios of adjustable dampers change with travel, or if elements are set.
    """

    def __init__(self, vehicles: Sequence[Vehicle], readout: "Readout") -> None:
        first, inputs = vehicles[0], vehicles[0].linear_model.inputs
        self.vehicles, self.forces, self._lagging = vehicles, len(inputs), readout.lagging
        self._ratios, self._of, self._ramps = MotionRatios(vehicles), None, np.zeros(0, dtype=int)
        self.size, self.lags, self.over_travel = self.forces, False, False
        self.closing, self.at_rest = np.zeros((0, readout.of_state.shape[1])), np.zeros(0)
        if not first.dampers:
            return

        self.size, self._of = 2 * self.forces, FEATURES.load("damper ranges").range_of(vehicles)
        adjustable, turning = self._of.adjustable, self._ratios.over_travel
        more = len(closing_names(first)) - self.forces
        self.closing = np.zeros((self.forces + more, readout.of_state.shape[1]))
        self.at_rest = np.pad(self._of.at_rest, (0, more))
        self.closing[: self.forces][adjustable, -readout.stretching_rates.shape[1] :] = -readout.stretching_rates[adjustable]
        self.lags, self.over_travel = bool(np.any(readout.lagging[adjustable] >= 0)), bool(turning or more)
        # Ramps of dampers' curves are the last actuators of the model, with the commands of their dampers.
        ramps = {
            one.force: one.damper.pair.ramps for one in first.parts.adjustable if one.damper.pair and one.force not in turning
        }
        if ramps:
            self._ramps = np.repeat([inputs.index(force) for force in ramps], [len(own) for own in ramps.values()])

    def turn(self, closing: Array, deflections: Array) -> None:
        """Multiplies the closing velocities of dampers, which are at the ratios at rest, shape (N, m), by r(d) / r(0), in place.

        Args:
            deflections: deflections of all suspensions [m], shape (N, s).
        """
        if self._of is not None:
            closing *= np.where(self._of.adjustable, self._ratios.turns(deflections), 1.0)

    def of_elements(self, deflections: Array, own: Array) -> Array:
        """Returns travels and states of the elements that are set, shape (N, c), from the own states of all parts, (N, k)."""
        assert self._of is not None, "a vehicle with adjustable dampers"
        return np.concatenate([np.zeros((len(own), 0)), *self._of.of_elements(deflections, own)], axis=-1)

    def commands(self, requested: Array, closing: Array, which: Array | slice, requests: str) -> Array:
        """Returns the commands of some of the runs, shape (d, size).

        Args:
            requested: requests of their driver, see `sim.drive.driver.Driver`.
            closing: closing velocities [m/s], shape (d, m) or (d, 0).
            which: indices of the runs.
        """
        if self._of is None or requests == "commands":
            return requested
        if requests == "coefficients":
            return self._of.clip_coefficients(requested, closing, which)
        return self._of.commands(np.concatenate([requested, closing], axis=-1), which)

    def apply(self, controls: Array, commands: Array) -> None:
        """Sets MuJoCo's controls, shape (N, nu), of which the actuators are the first."""
        controls[:, : self.forces] = commands[:, : self.forces]
        if len(self._ramps):
            controls[:, -len(self._ramps) :] = commands[:, self._ramps]

    def record(self, values: Array, commands: Array, activations: Array) -> None:
        """Writes the dampers' signals among those of some samples, shape (B, S, N).

        Args:
            commands: shape (B, N, size).
            activations: MuJoCo's, shape (B, N, na), or (0, N, na) if no coefficient lags.
        """
        if self._of is None:
            return
        first = self.vehicles[0]
        names, inputs = [signal.name for signal in first.kind.signals], first.linear_model.inputs
        parts = {part.force: (names.index(part.deflection), part.velocity.name) for part in first.kind.suspensions if part.force}
        for i, one in enumerate(first.parts.adjustable):
            j = inputs.index(one.force)
            beyond = commands[..., j] if self._lagging[j] < 0 else activations[..., self._lagging[j]]
            values[:, names.index(one.coefficient)] = self._of.nominal[:, j] + beyond
            values[:, names.index(one.missing)] = commands[..., self.forces + j]
            several = one.damper.pair is not None or one.force in self._ratios.over_travel  # actuators that give its force
            if several and one.damper.replaces:
                deflection, velocity = parts[one.force]
                speeds = self._ratios.of(one.force, values[:, deflection]) * values[:, names.index(velocity)]
                for n, (other, v) in enumerate(zip(self.vehicles, speeds.T, strict=True)):
                    values[:, names.index(one.force), n] = -beyond[:, n] * other.parts.adjustable[i].shape(v)
        for one in self._of.elements:
            j, motion = one.column, one.motion(lambda name: values[:, names.index(name)])
            beyond = commands[..., j] if self._lagging[j] < 0 else activations[..., self._lagging[j]]
            values[:, names.index(inputs[j])] = one.element.push(*motion, beyond)
