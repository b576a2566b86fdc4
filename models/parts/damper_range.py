"""Setting range of adjustable dampers, and the requested force that it leaves out."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from models.parts.part import SettablePart

if TYPE_CHECKING:
    from models.characteristics.curve import Pieces

STILL = 1e-150  # m/s, in place of a velocity of 0


@dataclass(frozen=True, eq=False)
class Bent:
    """Deviations of the curves of N runs with m actuators each from their lines, as P pieces (`models.characteristics.curve`).

    Attributes:
        shape: shape of h, see `models.characteristics.adjustable_range`: slopes, starts, lower and upper bounds, shape
            (4, N, m, P).
        soft: shape of the softest settings, likewise.
    """

    shape: Array
    soft: Array


@dataclass(frozen=True, eq=False)
class CoefficientRange:
    """Limits of the coefficients relative to the nominal ones, for N runs with m actuators each.

    An actuator that pushes is included with infinite limits. Its closing velocity counts as 1, so its coefficient is its force.

    Attributes:
        low, high: the smallest and the largest coefficient beyond the nominal one [N s/m], shape (N, m).
        adjustable: True for adjustable dampers, the same in every run, shape (m,).
        bent: deviations of their curves; None if all are straight.
    """

    low: Array
    high: Array
    adjustable: Array
    bent: Bent | None = None

    def effective_velocity(self, closing: Array, which: Array | slice = slice(None)) -> Array:
        """Returns the factor from coefficient to force, shape (..., N, m): the closing velocity [m/s], bent as the curves are."""
        return closing if self.bent is None else closing - _pieces(self.bent.shape[:, which], -closing)

    def secant_limits(self, c_min: Array, c_max: Array, closing: Array, which: Array | slice) -> tuple[Array, Array]:
        """Returns the least and the largest force over velocity at a velocity, from the coefficients at rest, shapes (N, m).

        Args:
            c_min, c_max: limits at rest [N s/m], shapes (N, m).
            closing: closing velocity of each suspension [m/s], not 0, shape (N, m).
        """
        if self.bent is None:
            return c_min, c_max
        least = c_min - _pieces(self.bent.soft[:, which], -closing) / closing
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
        beyond = np.minimum(np.maximum(forces / closing, self.low[which]), self.high[which])
        return np.concatenate([beyond, forces - beyond * closing], axis=-1)

    def clip_coefficients(self, coefficients: Array, closing: Array, which: Array | slice = slice(None)) -> Array:
        """Returns the same for requested coefficients, as force over velocity, shape (..., N, 2 m).

        Args:
            coefficients: coefficients of the dampers beyond the nominal ones [N s/m], shape (..., N, m).
            closing: closing velocity of each suspension [m/s], shape (..., N, m).
        """
        coefficients = self.coefficient_for(coefficients, closing, which)
        beyond = np.minimum(np.maximum(coefficients, self.low[which]), self.high[which])
        return np.concatenate([beyond, (coefficients - beyond) * self.effective_velocity(closing, which)], axis=-1)

    def coefficient_for(self, coefficients: Array, closing: Array, which: Array | slice = slice(None)) -> Array:
        """Returns the coefficient whose force over velocity is `requested_force`, not clipped to the limits."""
        if self.bent is None:
            return coefficients
        low, soft = self.low[which], _pieces(self.bent.soft[:, which], -closing)
        return low + (coefficients - low + soft / closing) * (closing / self.effective_velocity(closing, which))

    def clipped_off(self, forces: Array, closing: Array | None, which: Array | slice = slice(None)) -> Array:
        """Returns the forces at the settings less the requested ones [N], shape (N, m): exactly 0 where nothing is clipped.

        Args:
            forces: requested forces [N], shape (N, m).
            closing: velocity of each suspension, see `commands`, shape (N, m); None if all actuators push.
        """
        turned = 1.0 if closing is None else self.effective_velocity(closing, which)
        coefficients = forces / turned
        return (np.minimum(np.maximum(coefficients, self.low[which]), self.high[which]) - coefficients) * turned

    @property
    def at_rest(self) -> Array:
        """Offsets that keep the closing velocities of `commands` from being 0, shape (m,)."""
        return np.where(self.adjustable, STILL, 1.0)


def _pieces(pieces: Array, v: Array) -> Array:
    """Returns the sum of pieces, shape (4, ..., P), at velocities, shape (...)."""
    slope, start, low, high = pieces
    # As `Pieces.force`, without numpy's slower functions, as this runs between any two steps.
    return np.add.reduce(np.minimum(np.maximum(slope * (v[..., None] - start), low), high), axis=-1)


def range_of(
    vehicles: Sequence[Sequence[SettablePart]], forces: Sequence[str], most: Sequence[float | None] = ()
) -> CoefficientRange:
    """Returns the range of the actuators of N vehicles.

    Args:
        vehicles: the adjustable dampers of each.
        forces: names of the m forces of each.
        most: largest force of the force actuators of each vehicle [N]; None for no limit.
    """
    largest = np.array([np.inf if force is None else force for force in most or [None] * len(vehicles)])
    high = np.repeat(largest[:, None], len(forces), axis=1)
    low, adjustable = -high, np.zeros(high.shape, dtype=bool)
    for i, dampers in enumerate(vehicles):
        for damper in dampers:
            j = forces.index(damper.force)
            low[i, j], high[i, j], adjustable[i, j] = damper.low, damper.high, True
    assert np.all(adjustable == adjustable[0]), "vehicles side by side have their dampers at the same places"
    if all(damper.damper.pair is None for dampers in vehicles for damper in dampers):
        return CoefficientRange(low, high, adjustable[0])
    shapes, softs = [], []
    for dampers in vehicles:
        pairs = {damper.force: damper.damper.pair for damper in dampers}
        curves = [pairs.get(force) for force in forces]
        shapes.append([None if damper is None else damper.shape.pieces for damper in curves])
        softs.append([None if damper is None else damper.soft.pieces for damper in curves])
    return CoefficientRange(low, high, adjustable[0], Bent(_stacked(shapes), _stacked(softs)))


def _stacked(pieces: "Sequence[Sequence[Pieces | None]]") -> Array:
    """Stacks the pieces of N runs with m actuators, padded to one width, shape (4, N, m, P)."""
    most = max(len(part.slope) for row in pieces for part in row if part is not None)
    stacked = np.zeros((4, len(pieces), len(pieces[0]), most))
    for i, row in enumerate(pieces):
        for j, part in enumerate(row):
            if part is not None:
                stacked[:, i, j, : len(part.slope)] = part.slope, part.start, part.low, part.high
    return stacked
