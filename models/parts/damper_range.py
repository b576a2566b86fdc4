"""Setting range of adjustable dampers, and the requested force that it leaves out."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from models.characteristics.curve import Pieces
from models.common.arrays import Array

STILL = 1e-150  # m/s, in place of a velocity of 0


@dataclass(frozen=True, eq=False)
class CoefficientRange:
    """Limits of the coefficients relative to the nominal ones, for N runs with m actuators each.

    An actuator that pushes is included with infinite limits. Its closing velocity counts as 1, so its coefficient is its force.

    Attributes:
        low, high: the smallest and the largest coefficient beyond the nominal one [N s/m], shape (N, m).
        nominal: the nominal coefficient [N s/m], 0 for an actuator that pushes, shape (N, m).
        adjustable: True for adjustable dampers, the same in every run, shape (m,).
        bent: deviations from their lines of h (`models.characteristics.adjustable_range`) and of the softest settings, each in P
            pieces, shape (N, m, P); None if all are straight.
    """

    low: Array
    high: Array
    nominal: Array
    adjustable: Array
    bent: tuple[Pieces, Pieces] | None = None

    def effective_velocity(self, closing: Array, which: Array | slice = slice(None)) -> Array:
        """Returns the factor from coefficient to force, shape (..., N, m): the closing velocity [m/s], bent as the curves are."""
        return closing if self.bent is None else closing - self.bent[0][which].force(-closing)

    def secant_limits(self, c_min: Array, c_max: Array, closing: Array, which: Array | slice) -> tuple[Array, Array]:
        """Returns the least and the largest force over velocity at a velocity, from the coefficients at rest, shapes (N, m).

        Args:
            c_min, c_max: limits at rest [N s/m], shapes (N, m).
            closing: closing velocity of each suspension [m/s], not 0, shape (N, m).
        """
        if self.bent is None:
            return c_min, c_max
        least = c_min - self.bent[1][which].force(-closing) / closing
        return least, least + (c_max - c_min) * self.effective_velocity(closing, which) / closing

    def commands(self, requested_force: Array, which: Array | slice = slice(None)) -> Array:
        """Returns the settings of the actuators and the missing forces, shape (..., N, 2 m).

        The first half are coefficients beyond the nominal ones [N s/m], and forces of actuators that push [N]. The second half
        are the requested forces [N] minus the ones at these settings.

        Args:
            requested_force: the requested forces, and the closing velocity of each suspension, shape (..., N, 2 m).
        """
        m = self.low.shape[1]
        forces, closing = requested_force[..., :m], self.effective_velocity(requested_force[..., m:], which)
        beyond = self._clip(forces / closing, which)
        return np.concatenate([beyond, forces - beyond * closing], axis=-1)

    def clip_coefficients(self, coefficients: Array, closing: Array, which: Array | slice = slice(None)) -> Array:
        """Returns the same for requested coefficients, as force over velocity, shape (..., N, 2 m).

        Args:
            coefficients: coefficients of the dampers [N s/m], shape (..., N, m).
            closing: closing velocity of each suspension [m/s], shape (..., N, m).
        """
        coefficients, turned = coefficients - self.nominal[which], self.effective_velocity(closing, which)
        if self.bent is not None:  # the coefficients at rest of these settings
            low, soft = self.low[which], self.bent[1][which].force(-closing)
            coefficients = low + (coefficients - low + soft / closing) * (closing / turned)
        beyond = self._clip(coefficients, which)
        return np.concatenate([beyond, (coefficients - beyond) * turned], axis=-1)

    def _clip(self, coefficients: Array, which: Array | slice) -> Array:
        return np.minimum(np.maximum(coefficients, self.low[which]), self.high[which])

    def clipped_off(self, forces: Array, closing: Array | None, which: Array | slice = slice(None)) -> Array:
        """Returns the forces at the settings less the requested ones [N], shape (N, m): exactly 0 where nothing is clipped.

        Args:
            forces: requested forces [N], shape (N, m).
            closing: velocity of each suspension, see `commands`, shape (N, m); None if all actuators push.
        """
        turned = 1.0 if closing is None else self.effective_velocity(closing, which)
        coefficients = forces / turned
        return (self._clip(coefficients, which) - coefficients) * turned

    @property
    def at_rest(self) -> Array:
        """Offsets that keep the closing velocities of `commands` from being 0, shape (m,)."""
        return np.where(self.adjustable, STILL, 1.0)


def range_of(vehicles: Sequence[Any], most: Sequence[float | None] = ()) -> CoefficientRange:
    """Returns the range of the actuators of N vehicles of one kind.

    Args:
        most: largest force of the force actuators of each vehicle [N]; None for no limit.
    """
    forces = vehicles[0].linear_model.inputs
    largest = np.array([np.inf if force is None else force for force in most or [None] * len(vehicles)])
    high = np.repeat(largest[:, None], len(forces), axis=1)
    low, nominal, adjustable = -high, np.zeros(high.shape), np.zeros(high.shape, dtype=bool)
    pairs = [[None] * len(forces) for _ in vehicles]
    for i, vehicle in enumerate(vehicles):
        for damper in vehicle.parts.adjustable:
            j = forces.index(damper.force)
            low[i, j], high[i, j], nominal[i, j], adjustable[i, j] = damper.low, damper.high, damper.nominal, True
            pairs[i][j] = damper.damper.pair
    assert np.all(adjustable == adjustable[0]), "vehicles side by side have their dampers at the same places"
    curved, every = CoefficientRange(low, high, nominal, adjustable[0]), [pair for row in pairs for pair in row]
    if not any(every):
        return curved
    shape = [pair and pair.shape.pieces for pair in every]
    soft = [pair and pair.soft.pieces for pair in every]
    return replace(curved, bent=(Pieces.stacked(shape, high.shape), Pieces.stacked(soft, high.shape)))
