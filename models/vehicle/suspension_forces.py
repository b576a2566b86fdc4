"""Forces of suspensions beyond the linear model, for runs side by side: the sum of their parts."""

from collections.abc import Sequence

import numpy as np

from models.common.arrays import Array
from models.parts.part import Stack
from models.vehicle.vehicle import Vehicle


class SuspensionForces:
    """Forces that pull suspensions together at the wheels, of N vehicles of one kind, beyond those of their linear models.

    The linear model has the line of each part, and the force of each actuator at its motion ratio at rest.

    Attributes:
        acts: True for each suspension that has a force beyond the linear model, shape (s,).
    """

    def __init__(self, vehicles: Sequence[Vehicle], by_motor: bool = False, whole: bool = True) -> None:
        """Takes N vehicles, or one for any number of runs.

        Args:
            by_motor: True for parts alone that have no form native to MuJoCo.
            whole: True adds the lines of parts that are no parameters, which linear models have, but not the kinds' equations.
        """
        first, inputs = vehicles[0], vehicles[0].linear_model.inputs
        places = {one.deflection: i for i, one in enumerate(first.kind.suspensions)}
        self.acts = np.zeros(len(places), dtype=bool)
        self._stacks: list[tuple[int, int | None, Stack, bool]] = []
        for k, one in enumerate(first.parts):
            line = whole and not one.parameter
            if not (one.part.acts or (line and one.acts)) or (by_motor and one.native):
                continue
            own = inputs.index(one.place.force) if one.part.inputs else None
            self._stacks.append((places[one.deflection], own, Stack([vehicle.parts[k].part for vehicle in vehicles]), line))
            self.acts[places[one.deflection]] = True

    def __call__(self, d: Array, v: Array, inputs: Array) -> Array:
        """Returns the forces [N], shape (..., N, s).

        Args:
            d, v: deflections [m] and their rates [m/s] at the wheels, shape (..., N, s).
            inputs: acting forces of actuators [N], and acting coefficients of adjustable dampers beyond the nominal ones
                [N s/m], shape (..., N, m).
        """
        pulls = np.zeros_like(d)
        for i, j, parts, line in self._stacks:
            pulls[..., i] += parts.beyond(d[..., i], v[..., i], None, 0.0 if j is None else inputs[..., j], line)
        return pulls
