"""Equations of motion of a linear vehicle with the nonlinear forces of its suspensions."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from models.kinds.at_wheels import force_effects, wheel_model
from models.vehicle.suspension_forces import SuspensionForces
from models.vehicle.vehicle import Vehicle

if TYPE_CHECKING:
    from models.kinds.motion import Pulls


@dataclass(frozen=True, eq=False)
class Suspensions:
    """Suspensions on a linear model of n states, p outputs and r wheels; rows and columns of those without forces are 0.

    Attributes:
        travel, travel_of_road: gains from states and road heights to their deflections, shapes (s, n) and (s, r).
        rate, rate_of_road: likewise to the rates of these.
        push: gain from forces that pull them together to the rates of the states, shape (n, s).
        shown: gain from these forces to the outputs, shape (p, s).
    """

    travel: Array
    travel_of_road: Array
    rate: Array
    rate_of_road: Array
    push: Array
    shown: Array


def suspensions_of(vehicle: Vehicle, acts: Array) -> Suspensions:
    """Returns the suspensions of a vehicle on its linear model.

    Args:
        acts: True for each suspension with forces beyond the linear model.

    Raises:
        ValueError: the effect of forces along a suspension is unknown.
    """
    model, parts = vehicle.linear_model, vehicle.kind.suspensions
    gains = [np.zeros((len(parts), width)) for width in (len(model.A), model.Br.shape[1]) * 2]
    push, shown = np.zeros((len(model.A), len(parts))), np.zeros((len(model.C), len(parts)))
    for i in np.flatnonzero(acts):
        part = parts[i]
        if part.deflection not in model.outputs or not (part.force or part.stiffness):
            raise ValueError(f"the effect of forces along {part.deflection} is unknown")
        row, velocity = model.outputs.index(part.deflection), part.velocity.name
        rates = [model.C[row] @ model.A, model.C[row] @ model.Br]
        if velocity in model.outputs:
            rates = [one[model.outputs.index(velocity)] for one in (model.C, model.Cr)]
        for gain, own in zip(gains, (model.C[row], model.Cr[row], *rates), strict=True):
            gain[i] = own
        push[:, [i]], shown[:, [i]] = force_effects(vehicle.kind, vehicle.parameters, [part.deflection])
    travel, travel_of_road, rate, rate_of_road = gains
    return Suspensions(travel, travel_of_road, rate, rate_of_road, push, shown)


class LinearMotion:
    """Equations of motion of a vehicle that is linear except for the forces of its suspensions, while no tyre leaves the road."""

    def __init__(self, vehicle: Vehicle) -> None:
        """Prepares the linear model and the effect of its suspensions.

        Raises:
            ValueError: a suspension with such forces is not a state of the linear model, or its effect is unknown.
        """
        self.model, self.names = wheel_model(vehicle.kind, vehicle.parameters), vehicle.linear_model.states
        self._jump, self._of_road = self.model.jump.T, (self.model.A @ self.model.jump + self.model.Br).T
        acts = SuspensionForces([vehicle]).acts
        if any(one.deflection not in self.names for one, act in zip(vehicle.kind.suspensions, acts, strict=True) if act):
            raise ValueError("forces act along a deflection that is not a state")
        self._suspensions = suspensions_of(vehicle, acts)

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
        still = heights @ self._of_road + inputs @ self.model.B.T + loads @ self.model.Bh.T
        return state @ self.model.A.T + still + self._pulled(state, heights, pulls) @ self._suspensions.push.T

    def outputs(self, state: Array, heights: Array, inputs: Array, pulls: "Pulls", loads: Array) -> Mapping[str, Array]:
        """See `Motion`."""
        model, x = self.model, state + heights @ self._jump
        values = x @ model.C.T + heights @ model.Cr.T + inputs @ model.D.T + loads @ model.Dh.T
        values = values + self._pulled(state, heights, pulls) @ self._suspensions.shown.T
        return {name: column for name, column in zip(model.outputs, values.T, strict=True) if name not in model.inputs}

    def _pulled(self, state: Array, heights: Array, pulls: "Pulls") -> Array:
        x, of = state + heights @ self._jump, self._suspensions
        return pulls(x @ of.travel.T + heights @ of.travel_of_road.T, x @ of.rate.T + heights @ of.rate_of_road.T)


def lag_rates(vehicle: Vehicle) -> Array:
    """Returns the bandwidth of every actuator [rad/s], shape (m,); 0 for one without lag."""
    inputs = vehicle.linear_model.inputs
    rates = np.full(len(inputs), vehicle.limits.actuator_bandwidth or 0.0)
    for one in vehicle.adjustable:
        rates[inputs.index(one.force)] = one.damper.bandwidth or 0.0
    return rates
