"""How far adjustable dampers can be set, and what of what is asked for that leaves out."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.damping.adjustable import Adjustable

STILL = 1e-150  # m/s; a velocity of 0 counts as this one, inwards


@dataclass(frozen=True, eq=False)
class Range:
    """How far coefficients can be from their nominal ones, of N runs with m actuators each.

    An actuator that pushes counts among them: its suspension closes at 1, and it has no ends, so that what it is to be is its
    force.

    Attributes:
        low, high: the smallest and the largest coefficient beyond the nominal one [N s/m], shape (N, m).
        adjustable: which of the actuators are adjustable dampers, of every run the same, shape (m,).
    """

    low: Array
    high: Array
    adjustable: Array

    def commands(self, asked: Array, which: Array | slice = slice(None)) -> Array:
        """What is asked of every actuator, and which forces that leaves out, shape (..., N, 2 m).

        The first half are coefficients beyond the nominal ones [N s/m], and forces of actuators that push [N]; the second half
        what is missing of the forces that were asked for [N].

        Args:
            asked: those forces, and how fast each suspension closes, see `closing`, shape (..., N, 2 m).
            which: of the N.
        """
        m = self.low.shape[1]
        forces, closing = asked[..., :m], asked[..., m:]
        beyond = np.minimum(np.maximum(forces / closing, self.low[which]), self.high[which])
        return np.concatenate([beyond, forces - beyond * closing], axis=-1)

    def set_to(self, asked: Array, closing: Array, which: Array | slice = slice(None)) -> Array:
        """The same where coefficients are asked for, shape (..., N, 2 m).

        Args:
            asked: coefficients beyond the nominal ones [N s/m], shape (..., N, m).
            closing: how fast each suspension closes [m/s], shape (..., N, m).
            which: of the N.
        """
        beyond = np.minimum(np.maximum(asked, self.low[which]), self.high[which])
        return np.concatenate([beyond, (asked - beyond) * closing], axis=-1)

    @property
    def at_rest(self) -> Array:
        """What to add to -v, so that there is no 0 among what `commands` takes, shape (m,)."""
        return np.where(self.adjustable, STILL, 1.0)


def range_of(vehicles: Sequence[Sequence[Adjustable]], forces: Sequence[str]) -> Range:
    """What the actuators of N vehicles can be.

    Args:
        vehicles: the adjustable dampers of each.
        forces: of each, m of them.
    """
    low, high = np.full((len(vehicles), len(forces)), -np.inf), np.full((len(vehicles), len(forces)), np.inf)
    for i, some in enumerate(vehicles):
        for one in some:
            j = forces.index(one.force)
            low[i, j], high[i, j] = one.damper.c_min - one.nominal, one.damper.c_max - one.nominal
    adjustable = np.isfinite(low)
    assert np.all(adjustable == adjustable[0]), "vehicles side by side have their dampers at the same places"
    return Range(low, high, adjustable[0])
