"""Equations of motion of a vehicle that is linear except for its suspension forces."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from models.kinds.at_wheels import force_effects, wheel_model
from models.kinds.linear_model import LinearModel
from models.vehicle.suspension_forces import SuspensionForces
from models.vehicle.vehicle import Vehicle

if TYPE_CHECKING:
    from models.kinds.motion import Pulls


Effects = Callable[[Sequence[str]], tuple[Array, Array]]


def suspensions_of(vehicle: Vehicle, model: LinearModel, effects: Effects, acts: Array) -> tuple[Array, Array, Array, Array]:
    """Returns the gains from states and road heights to suspension motions, and from suspension forces to state derivatives and
    outputs.

    Rows and columns that belong to suspensions without nonlinear forces are 0.

    Args:
        model: linear model of the vehicle, or its `wheel_model`, which does not contain the states of parts.
        effects: function that returns the effects of suspension forces on the states and outputs of this model, see
            `Vehicle.force_effects`.
        acts: True for each suspension that has forces outside the linear model.

    Returns:
        The first two arrays are the gains from states, shape (2 s, n), and from road heights, shape (2 s, r), to s deflections
        and their s rates. The last two arrays are the gains from suspension forces (positive if contracting) to state
        derivatives, shape (n, s), and to outputs, shape (p, s).

    Raises:
        ValueError: the model does not define the effect of a force along a suspension.
    """
    parts = vehicle.kind.suspensions
    count = len(parts)
    rows, of_road = np.zeros((2 * count, len(model.A))), np.zeros((2 * count, model.Br.shape[1]))
    push, shown = np.zeros((len(model.A), count)), np.zeros((len(model.C), count))
    for i in np.flatnonzero(acts):
        part = parts[i]
        if part.deflection not in model.outputs or not (part.force or part.stiffness):
            raise ValueError(f"the effect of forces along {part.deflection} is unknown")
        own, velocity = model.outputs.index(part.deflection), part.velocity.name
        rows[i], of_road[i] = model.C[own], model.Cr[own]
        rows[count + i], of_road[count + i] = model.C[own] @ model.A, model.C[own] @ model.Br
        if velocity in model.outputs:
            speed = model.outputs.index(velocity)
            rows[count + i], of_road[count + i] = model.C[speed], model.Cr[speed]
        push[:, [i]], shown[:, [i]] = effects([part.deflection])
    return rows, of_road, push, shown


class LinearMotion:
    """Equations of motion of a vehicle that is linear except for its suspension forces, as long as all tyres are in contact."""

    def __init__(self, vehicle: Vehicle) -> None:
        """Prepares the linear model and the effect of the suspension forces.

        Raises:
            ValueError: the deflection of a suspension with nonlinear forces is not a state of the linear model, or the effect
                of these forces is unknown.
        """
        self.model = wheel_model(vehicle.kind, vehicle.parameters)
        self.names = self.model.states
        self._jump, self._of_road = self.model.jump.T, (self.model.A @ self.model.jump + self.model.Br).T
        acts = SuspensionForces([vehicle]).acts
        if any(one.deflection not in self.names for one, act in zip(vehicle.kind.suspensions, acts, strict=True) if act):
            raise ValueError("forces act along a deflection that is not a state")
        effects = partial(force_effects, vehicle.kind, vehicle.parameters)
        self._rows, self._of_heights, self._push, self._shown = suspensions_of(vehicle, self.model, effects, acts)

    def state(self, signals: Mapping[str, Array], heights: Array) -> Array:
        """Returns the state in a form that does not jump when the road jumps. See `Motion`."""
        return np.stack([signals[name] for name in self.names], axis=-1) - heights @ self._jump

    def usable(self, state: Array) -> Array:
        return np.ones(len(state), dtype=bool)

    def read(self, state: Array, heights: Array) -> Array:
        return state + heights @ self._jump

    def rate(self, state: Array, heights: Array, inputs: Array, pulls: "Pulls", loads: Array) -> Array:
        still = heights @ self._of_road + inputs @ self.model.B.T + loads @ self.model.Bh.T
        return state @ self.model.A.T + still + self._pulled(state, heights, pulls) @ self._push.T

    def outputs(self, state: Array, heights: Array, inputs: Array, pulls: "Pulls", loads: Array) -> Mapping[str, Array]:
        model, x = self.model, state + heights @ self._jump
        values = x @ model.C.T + heights @ model.Cr.T + inputs @ model.D.T + loads @ model.Dh.T
        values = values + self._pulled(state, heights, pulls) @ self._shown.T
        return {name: column for name, column in zip(model.outputs, values.T, strict=True) if name not in model.inputs}

    def _pulled(self, state: Array, heights: Array, pulls: "Pulls") -> Array:
        moved = (state + heights @ self._jump) @ self._rows.T + heights @ self._of_heights.T
        return pulls(*np.split(moved, 2, axis=-1))
