"""Actuators of N runs: they limit requests, turn them into MuJoCo's controls, and record what adjustable dampers did.

A controller works with the suspension velocity linearised at equilibrium. When a body turns, the damper's own velocity differs
by geometry.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from models.vehicle.suspension_forces import MotionRatios
from models.vehicle.vehicle import Vehicle

if TYPE_CHECKING:
    from sim.physics.sensor_readout import Readout


def closing_names(vehicle: Vehicle) -> tuple[str, ...]:
    """Returns the names of the suspensions' closing velocities, one per input; empty without adjustable dampers."""
    return tuple(f"closing velocity of {force}" for force in vehicle.linear_model.inputs) if vehicle.dampers else ()


class Actuators:
    """Actuators of N vehicles of one kind, with adjustable dampers at the same places in each.

    Commands are forces [N], shape (N, m). With adjustable dampers they are coefficients beyond the nominal ones [N s/m], or
    forces of actuators that push, followed by the missing forces, shape (N, 2 m); see `CoefficientRange.commands`. MuJoCo applies
    the force limit and the lag of actuators that push.

    Attributes:
        forces: number m of forces.
        size: number of commands.
        closing: map from (qpos, qvel) to the closing velocity of every suspension, shape (m, nq + nv), 0 for actuators that push;
            (0, nq + nv) without adjustable dampers.
        at_rest: offsets that keep the closing velocities from being 0, shape (m,) or (0,).
        lags: True if some coefficient lags behind its command.
        over_travel: True if motion ratios of adjustable dampers change with travel.
    """

    def __init__(self, vehicles: Sequence[Vehicle], readout: "Readout") -> None:
        first = vehicles[0]
        self.vehicles, self.forces, self._lagging = vehicles, len(first.linear_model.inputs), readout.lagging
        self.size, self.lags, self._of, self._ramps = self.forces, False, None, np.zeros(0, dtype=int)
        self.closing, self.at_rest = np.zeros((0, readout.of_state.shape[1])), np.zeros(0)
        self._ratios = MotionRatios(vehicles)
        self.over_travel = bool(first.dampers and self._ratios.over_travel)
        if not first.dampers:
            return
        from models.parts.damper_range import range_of

        self.size, self._of = 2 * self.forces, range_of([vehicle.adjustable for vehicle in vehicles], first.linear_model.inputs)
        self._nominal = np.zeros((len(vehicles), self.forces))
        for i, vehicle in enumerate(vehicles):
            for one in vehicle.adjustable:
                self._nominal[i, first.linear_model.inputs.index(one.force)] = one.nominal
        adjustable, speeds = self._of.adjustable, readout.stretching.shape[1]
        self.closing, self.at_rest = np.zeros((self.forces, readout.of_state.shape[1])), self._of.at_rest
        self.closing[adjustable, -speeds:] = -readout.stretching[adjustable]
        self.lags = bool(np.any(readout.lagging[adjustable] >= 0))
        suspended = [part.force for part in first.kind.suspensions]
        self._turning = [
            (j, name, suspended.index(name)) for j, name in enumerate(first.linear_model.inputs) if name in suspended
        ]
        # Ramps of dampers' curves are the last actuators of the model, with the commands of their dampers.
        counts = [0 if one.damper.pair is None or one.over_travel else len(one.damper.pair.ramps) for one in first.adjustable]
        self._ramps = np.repeat([first.linear_model.inputs.index(one.force) for one in first.adjustable], counts)

    def turn(self, closing: Array, deflections: Array) -> None:
        """Multiplies closing velocities, which are at the ratios at rest, shape (N, m), by r(d) / r(0), in place.

        Args:
            deflections: of all suspensions [m], shape (N, s).
        """
        for j, name, i in self._turning:
            closing[:, j] *= self._ratios.turn(name, deflections[:, i])

    def commands(self, requested: Array, closing: Array, which: Array | slice, requests: str) -> Array:
        """Returns the commands of some of the runs, shape (d, size).

        Args:
            requested: requests of their driver, see `sim.physics.driver.Driver`.
            closing: closing velocities [m/s], shape (d, m) or (d, 0).
            which: indices of the runs.
        """
        if self._of is None or requests == "commands":
            return requested
        if requests == "coefficients":
            return self._of.clip_coefficients(requested - self._nominal[which], closing, which)
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
        first = self.vehicles[0]
        names, inputs = [signal.name for signal in first.kind.signals], first.linear_model.inputs
        parts = {part.force: (names.index(part.deflection), part.velocity.name) for part in first.kind.suspensions if part.force}
        for i, one in enumerate(first.adjustable):
            j = inputs.index(one.force)
            beyond = commands[..., j] if self._lagging[j] < 0 else activations[..., self._lagging[j]]
            values[:, names.index(one.coefficient)] = self._nominal[:, j] + beyond
            values[:, names.index(one.missing)] = commands[..., self.forces + j]
            if one.damper.pair is not None or one.over_travel:  # its force is that of several actuators
                deflection, velocity = parts[one.force]
                speeds = self._ratios.of(one.force, values[:, deflection]) * values[:, names.index(velocity)]
                for n, (other, v) in enumerate(zip(self.vehicles, speeds.T, strict=True)):
                    values[:, names.index(one.force), n] = -beyond[:, n] * other.adjustable[i].shape(v)
