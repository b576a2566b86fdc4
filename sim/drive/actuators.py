"""Actuators of N runs: they limit requested forces, set MuJoCo's controls, and record the signals of semi-active dampers.

A controller receives the suspension velocity computed with the geometry in equilibrium. If the body pitches or rolls, the
damper's actual velocity is slightly different.
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
    """Returns the names of the suspensions' closing velocities, and of the travels and states of voltage-controlled elements.

    A voltage-controlled element is a force element whose voltage the controller commands. The result is empty if the vehicle has
    no semi-active dampers. See `CoefficientRange.closing`.
    """
    if not vehicle.dampers:
        return ()
    range_of = FEATURES.load("damper ranges").range_of
    closing = tuple(f"closing velocity of {force}" for force in vehicle.linear_model.inputs)
    more = (f"{name} of {closing[one.column]}" for one in range_of([vehicle]).elements for name in ("travel", *one.own))
    return (*closing, *more)


class Actuators:
    """Actuators of N vehicles of one type, all with semi-active dampers at the same suspensions.

    Without semi-active dampers, commands are forces [N], shape (N, m). With semi-active dampers, commands have the shape (N, 2
    m). The first m columns are forces of active actuators [N], or, for semi-active dampers, damping coefficients minus the
    nominal coefficients [N s/m]. The last m columns are the missing forces, that is, the parts of the requested forces that the
    dampers cannot produce. See `CoefficientRange.commands`. MuJoCo itself applies the force limit and the lag of active
    actuators.

    Attributes:
        forces: number m of forces per run.
        size: number of commands per run: m, or 2 m with semi-active dampers.
        closing: matrix that maps (qpos, qvel) to the closing velocity of each suspension, shape (m + c, nq + nv). Rows that
            belong to active actuators, or to travels and states of voltage-controlled elements, are 0. Without semi-active
            dampers, the shape of this matrix is (0, nq + nv).
        at_rest: small offsets that keep the closing velocities different from 0, shape (m + c,) or (0,).
        lags: True if the damping coefficient of a semi-active damper lags behind its command.
        over_travel: True if the motion ratios of semi-active dampers change with travel, or if there are voltage-controlled
            elements.
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
        # The last actuators of the model are the ramps of damper characteristics. Each ramp receives the command of its damper.
        ramps = {
            one.force: one.damper.pair.ramps for one in first.parts.adjustable if one.damper.pair and one.force not in turning
        }
        if ramps:
            self._ramps = np.repeat([inputs.index(force) for force in ramps], [len(own) for own in ramps.values()])

    def turn(self, closing: Array, deflections: Array) -> None:
        """Multiplies the closing velocities of dampers by the relative motion ratio r(d) / r(0). The array of velocities is
        changed in place.

        Args:
            closing: closing velocities of the suspensions [m/s], computed with the motion ratios in equilibrium, shape (N, m).
            deflections: deflections of all suspensions [m], shape (N, s).
        """
        if self._of is not None:
            closing *= np.where(self._of.adjustable, self._ratios.turns(deflections), 1.0)

    def of_elements(self, deflections: Array, own: Array) -> Array:
        """Returns the travels [m] and internal states of the voltage-controlled elements, shape (N, c).

        Args:
            deflections: deflections of all suspensions [m], shape (N, s).
            own: internal states of the suspension parts of each vehicle, shape (N, k).
        """
        assert self._of is not None, "a vehicle with adjustable dampers"
        return np.concatenate([np.zeros((len(own), 0)), *self._of.of_elements(deflections, own)], axis=-1)

    def commands(self, requested: Array, closing: Array, which: Array | slice, requests: str) -> Array:
        """Returns the actuator commands for the runs with the indices `which`, shape (d, size).

        Args:
            requested: forces, damping coefficients or commands that the driver requests, see `sim.drive.driver.Driver`.
            requests: meaning of the values in `requested`: "forces", "coefficients" or "commands".
            closing: closing velocities of the suspensions [m/s], shape (d, m), or (d, 0) without semi-active dampers.
            which: indices in the batch of the d runs that receive commands.
        """
        if self._of is None or requests == "commands":
            return requested
        if requests == "coefficients":
            return self._of.clip_coefficients(requested, closing, which)
        return self._of.commands(np.concatenate([requested, closing], axis=-1), which)

    def apply(self, controls: Array, commands: Array) -> None:
        """Sets MuJoCo's controls, shape (N, nu). The first controls belong to the actuators that receive the commands."""
        controls[:, : self.forces] = commands[:, : self.forces]
        if len(self._ramps):
            controls[:, -len(self._ramps) :] = commands[:, self._ramps]

    def record(self, values: Array, commands: Array, activations: Array) -> None:
        """Writes the signals of semi-active dampers into the signal array of several samples.

        Args:
            values: signals at the samples, shape (B, S, N); this array is changed in place.
            commands: actuator commands that act from each sample on, shape (B, N, size).
            activations: states of MuJoCo's actuators (activations), shape (B, N, na), or (0, N, na) if no damping coefficient
                lags behind its command.
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
            # several actuators of the model together produce the damper's force
            several = one.damper.pair is not None or one.force in self._ratios.over_travel
            if several and one.damper.replaces:
                deflection, velocity = parts[one.force]
                speeds = self._ratios.of(one.force, values[:, deflection]) * values[:, names.index(velocity)]
                for n, (other, v) in enumerate(zip(self.vehicles, speeds.T, strict=True)):
                    values[:, names.index(one.force), n] = -beyond[:, n] * other.parts.adjustable[i].shape(v)
        for one in self._of.elements:
            j, motion = one.column, one.motion(lambda name: values[:, names.index(name)])
            beyond = commands[..., j] if self._lagging[j] < 0 else activations[..., self._lagging[j]]
            values[:, names.index(inputs[j])] = one.element.push(*motion, beyond)
