"""Forces of suspensions beyond their linear springs and dampers, for runs side by side."""

from collections.abc import Sequence

import numpy as np

from models.common.arrays import Array
from models.vehicle.vehicle import Vehicle


class SuspensionForces:
    """Forces that pull suspensions together at the wheels, of N vehicles of one kind, beyond those of their linear models.

    The linear model has the line of each spring and damper, and the force of each actuator at its motion ratio at rest.
    """

    def __init__(self, vehicles: Sequence[Vehicle]) -> None:
        """Takes N vehicles, or one for any number of runs."""
        self._vehicles = vehicles
        first = vehicles[0]
        self._inputs = first.linear_model.inputs
        self._suspensions = first.kind.suspensions
        self.acts = [
            any(
                (
                    any(one.deflection == part.deflection and one.curve.bent for one in first.fitted),
                    part.deflection in first.stops,
                    part.force in first.dampers,
                    part.deflection in first.ratio_tables,
                )
            )
            for part in self._suspensions
        ]

    def __call__(self, d: Array, v: Array, inputs: Array) -> Array:
        """Returns the forces [N], shape (..., N, s).

        Args:
            d, v: deflections [m] and their rates [m/s] at the wheels, shape (..., N, s).
            inputs: acting forces of actuators [N], and acting coefficients of adjustable dampers beyond the nominal ones
                [N s/m], shape (..., N, m).
        """
        if len(self._vehicles) == 1:
            return self._of(self._vehicles[0], d, v, inputs)
        rows = [self._of(one, d[..., i, :], v[..., i, :], inputs[..., i, :]) for i, one in enumerate(self._vehicles)]
        return np.stack(rows, axis=-2)

    def _of(self, vehicle: Vehicle, d: Array, v: Array, inputs: Array) -> Array:
        pulls, dampers = np.zeros_like(d), {one.force: one for one in vehicle.adjustable}
        places = {part.deflection: i for i, part in enumerate(self._suspensions)}
        for fitted in vehicle.fitted:
            if fitted.curve.bent:
                i = places[fitted.deflection]
                pulls[..., i] += fitted.beyond(d[..., i], v[..., i])
        for name, stops in vehicle.stops.items():
            pulls[..., places[name]] += stops.pull(d[..., places[name]])
        for i, part in enumerate(self._suspensions):
            if part.force not in self._inputs:
                continue
            table, at_rest = vehicle.ratio_tables.get(part.deflection), vehicle.motion_ratios[part.force]
            ratio, u = at_rest if table is None else table(d[..., i]), inputs[..., self._inputs.index(part.force)]
            if part.force in dampers:
                pulls[..., i] += ratio * u * dampers[part.force].shape(ratio * v[..., i])
            elif table is not None:
                pulls[..., i] -= (ratio - at_rest) * u
        return pulls
