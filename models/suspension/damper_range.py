"""How far adjustable dampers can be set, and what of what is asked for that leaves out."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.laws.semi_active import STILL
from models.suspension.adjustable_dampers import Adjustable
from models.suspension.curve import Pieces


@dataclass(frozen=True, eq=False)
class Bent:
    """What curves of N runs with m actuators each have beyond their lines, as pieces (`models.suspension`), P of each.

    Attributes:
        shape: of h, see `models.suspension.damper`, their slopes, starts, lower and upper bounds, shape (4, N, m, P).
        soft: of the softest settings, likewise.
    """

    shape: Array
    soft: Array


@dataclass(frozen=True, eq=False)
class Range:
    """How far coefficients can be from their nominal ones, of N runs with m actuators each.

    An actuator that pushes counts among them: its suspension closes at 1, and it has no ends, so that what it is to be is its
    force.

    Attributes:
        low, high: the smallest and the largest coefficient beyond the nominal one [N s/m], shape (N, m).
        adjustable: which of the actuators are adjustable dampers, of every run the same, shape (m,).
        bent: what their curves have; None where all are straight.
    """

    low: Array
    high: Array
    adjustable: Array
    bent: Bent | None = None

    def felt(self, closing: Array, which: Array | slice = slice(None)) -> Array:
        """What a coefficient is times, to be a force: how fast each suspension closes, bent as the curves are, shape (..., N, m).

        Args:
            closing: [m/s], shape (..., N, m).
            which: of the N.
        """
        return closing if self.bent is None else closing - _pieces(self.bent.shape[:, which], -closing)

    def seen(self, c_min: Array, c_max: Array, closing: Array, which: Array | slice = slice(None)) -> tuple[Array, Array]:
        """The least and the largest coefficient at a velocity, as force over velocity, from those at rest, shapes (N, m).

        Args:
            c_min, c_max: at rest [N s/m], shapes (N, m).
            closing: how fast each suspension closes [m/s], not 0, shape (N, m).
            which: of the N.
        """
        if self.bent is None:
            return c_min, c_max
        least = c_min - _pieces(self.bent.soft[:, which], -closing) / closing
        return least, least + (c_max - c_min) * self.felt(closing, which) / closing

    def commands(self, asked: Array, which: Array | slice = slice(None)) -> Array:
        """What is asked of every actuator, and which forces that leaves out, shape (..., N, 2 m).

        The first half are coefficients beyond the nominal ones [N s/m], and forces of actuators that push [N]; the second half
        what is missing of the forces that were asked for [N].

        Args:
            asked: those forces, and how fast each suspension closes, see `closing`, shape (..., N, 2 m).
            which: of the N.
        """
        m = self.low.shape[1]
        forces, closing = asked[..., :m], self.felt(asked[..., m:], which)
        beyond = np.minimum(np.maximum(forces / closing, self.low[which]), self.high[which])
        return np.concatenate([beyond, forces - beyond * closing], axis=-1)

    def set_to(self, asked: Array, closing: Array, which: Array | slice = slice(None)) -> Array:
        """The same where coefficients are asked for, as force over velocity, shape (..., N, 2 m).

        Args:
            asked: coefficients beyond the nominal ones [N s/m], shape (..., N, m).
            closing: how fast each suspension closes [m/s], shape (..., N, m).
            which: of the N.
        """
        asked = self.setting(asked, closing, which)
        beyond = np.minimum(np.maximum(asked, self.low[which]), self.high[which])
        return np.concatenate([beyond, (asked - beyond) * self.felt(closing, which)], axis=-1)

    def setting(self, asked: Array, closing: Array, which: Array | slice = slice(None)) -> Array:
        """What has the force over velocity that is asked for, whether there is such a setting or not; see `set_to`."""
        if self.bent is None:
            return asked
        low, soft = self.low[which], _pieces(self.bent.soft[:, which], -closing)
        return low + (asked - low + soft / closing) * (closing / self.felt(closing, which))

    @property
    def at_rest(self) -> Array:
        """What to add to -v, so that there is no 0 among what `commands` takes, shape (m,)."""
        return np.where(self.adjustable, STILL, 1.0)


def _pieces(pieces: Array, v: Array) -> Array:
    """The sum of pieces, shape (4, ..., P), at velocities, shape (...)."""
    slope, start, low, high = pieces
    # As `Pieces.force`; between two steps, where every call counts, without numpy's dearer ones.
    return np.add.reduce(np.minimum(np.maximum(slope * (v[..., None] - start), low), high), axis=-1)


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
            low[i, j], high[i, j] = one.low, one.high
    adjustable = np.isfinite(low)
    assert np.all(adjustable == adjustable[0]), "vehicles side by side have their dampers at the same places"
    if all(one.damper.pair is None for some in vehicles for one in some):
        return Range(low, high, adjustable[0])
    shapes, softs = [], []
    for some in vehicles:
        pairs = {one.force: one.damper.pair for one in some}
        curves = [pairs.get(force) for force in forces]
        shapes.append([None if one is None else one.shape.pieces for one in curves])
        softs.append([None if one is None else one.soft.pieces for one in curves])
    return Range(low, high, adjustable[0], Bent(_stacked(shapes), _stacked(softs)))


def _stacked(pieces: Sequence[Sequence[Pieces | None]]) -> Array:
    """Pieces of N runs with m actuators, all of one width, shape (4, N, m, P)."""
    most = max(len(one.slope) for some in pieces for one in some if one is not None)
    found = np.zeros((4, len(pieces), len(pieces[0]), most))
    for i, some in enumerate(pieces):
        for j, one in enumerate(some):
            if one is not None:
                found[:, i, j, : len(one.slope)] = one.slope, one.start, one.low, one.high
    return found
