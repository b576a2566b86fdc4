"""Equations of motion of a linear vehicle with the nonlinear forces of its suspensions."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from models.vehicle.vehicle import Vehicle

if TYPE_CHECKING:
    from models.kinds.motion import Pulls


class LinearMotion:
    """Equations of motion of a vehicle that is linear except for the limits of its file, while no tyre leaves the road."""

    def __init__(self, vehicle: Vehicle) -> None:
        """Prepares the linear model and the effect of its suspensions.

        Raises:
            ValueError: a suspension with a curve or a stop is not a state of the linear model, or its effect is unknown.
        """
        self.model, self.names = vehicle.wheel_model, vehicle.linear_model.states
        self._jump, self._of_road = self.model.jump.T, (self.model.A @ self.model.jump + self.model.Br).T
        needed = {one.deflection for one in vehicle.parts if one.part.acts}
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


def suspension_pulls(vehicle: Vehicle, beyond: Array, ratios: Array, d: Array, v: Array) -> Array:
    """Returns the forces of suspensions at the wheels beyond their linear springs and dampers [N], shape (K, s).

    Args:
        beyond: coefficients of adjustable dampers beyond the nominal ones [N s/m], shape (K, m).
        ratios: motion ratios that are held over the step, shape (K, m) or (m,).
        d, v: deflections [m] and their rates [m/s], shape (K, s).
    """
    pulls, inputs = np.zeros_like(d), vehicle.linear_model.inputs
    dampers = {adjustable.force: adjustable for adjustable in vehicle.adjustable}
    places = {part.deflection: i for i, part in enumerate(vehicle.kind.suspensions)}
    for fitted in vehicle.fitted:
        if fitted.curve.bent:
            i = places[fitted.deflection]
            pulls[:, i] += fitted.part.beyond(d[:, i], v[:, i])
    for one in vehicle.parts:
        if one.part.curve is None and not one.part.inputs:
            pulls[:, places[one.deflection]] += one.part.beyond(d[:, places[one.deflection]], v[:, places[one.deflection]])
    for part in vehicle.kind.suspensions:
        i = places[part.deflection]
        if part.force in dampers:
            j = inputs.index(part.force)
            pulls[:, i] += ratios[..., j] * beyond[:, j] * dampers[part.force].shape(ratios[..., j] * v[:, i])
    return pulls


def lag_rates(vehicle: Vehicle) -> Array:
    """Returns the bandwidth of every actuator [rad/s], shape (m,); 0 for one without lag."""
    inputs = vehicle.linear_model.inputs
    rates = np.full(len(inputs), vehicle.limits.actuator_bandwidth or 0.0)
    for one in vehicle.adjustable:
        rates[inputs.index(one.force)] = one.damper.bandwidth or 0.0
    return rates
