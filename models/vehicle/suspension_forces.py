"""Forces of suspensions beyond the linear model, for runs side by side: the sum of their parts."""

from collections.abc import Sequence

import numpy as np

from models.common.arrays import Array
from models.parts.part import Stack, merged
from models.vehicle.vehicle import Vehicle


class SuspensionForces:
    """Forces that pull suspensions together at the wheels, of N vehicles of one kind, beyond those of their linear models.

    The linear model has the line of each part, and the force of each actuator at its motion ratio at rest.

    Attributes:
        acts: True for each suspension that has a force beyond the linear model, shape (s,).
    """

    def __init__(self, vehicles: Sequence[Vehicle], by_motor: bool = False, whole: bool = True, contacts: bool = True) -> None:
        """Takes N vehicles, or one for any number of runs.

        Args:
            by_motor: True for parts alone that have no form native to MuJoCo.
            contacts: False leaves out parts without effect before an end of the linear regime.
            whole: True adds the lines of parts that are no parameters, which linear models have, but not the kinds' equations.
        """
        first, inputs = vehicles[0], vehicles[0].linear_model.inputs
        places = {one.deflection: i for i, one in enumerate(first.kind.suspensions)}
        self.acts, groups = np.zeros(len(places), dtype=bool), list[tuple[list[int], bool]]()
        for k, one in enumerate(first.parts):
            line = whole and not one.parameter
            if not (one.part.acts or (line and one.acts)) or (by_motor and one.native) or (one.part.contact and not contacts):
                continue
            self.acts[places[one.deflection]] = True
            alike = (g for g, own in groups if own == line and merged([first.parts[g[0]].part, one.part], (2,)) is not None)
            if (group := next(alike, None)) is not None and places[one.deflection] not in [
                _place(first, j, places) for j in group
            ]:
                group.append(k)
            else:
                groups.append(([k], line))
        self._stacks: list[tuple[Array | slice, Array | None, Stack]] = []
        for some, line in groups:
            chosen = [first.parts[k] for k in some]
            own = np.array([inputs.index(one.place.force) for one in chosen]) if chosen[0].part.inputs else None
            columns = np.array([places[one.deflection] for one in chosen])
            every = slice(None) if len(columns) == len(places) and (np.diff(columns) == 1).all() else columns
            self._stacks.append((every, own, Stack([[vehicle.parts[k].part for k in some] for vehicle in vehicles], line)))

    def __call__(self, d: Array, v: Array, inputs: Array) -> Array:
        """Returns the forces [N], shape (..., N, s).

        Args:
            d, v: deflections [m] and their rates [m/s] at the wheels, shape (..., N, s).
            inputs: acting forces of actuators [N], and acting coefficients of adjustable dampers beyond the nominal ones
                [N s/m], shape (..., N, m).
        """
        pulls = None
        for columns, own, parts in self._stacks:
            u = 0.0 if own is None else inputs[..., own]
            if isinstance(columns, slice):
                pull = parts.beyond(d, v, None, u)
                pulls = pull if pulls is None else pulls + pull
            else:
                pulls = np.zeros(d.shape) if pulls is None else pulls
                pulls[..., columns] += parts.beyond(d[..., columns], v[..., columns], None, u)
        return np.zeros(d.shape) if pulls is None else pulls
