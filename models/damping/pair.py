"""An adjustable damper as it is measured: its force over velocity at its softest and at its firmest setting.

With F_min and F_max those curves (`models.curves`), and s the setting that a valve holds, from 0 to 1, the damper pulls with

    F = (1 - s) F_min(v) + s F_max(v) = F_min(v) + (c - c_min) h(v),    h = (F_max - F_min) / (c_max - c_min),

where c_min and c_max are the slopes of both at rest, and c = c_min + s (c_max - c_min) the coefficient at rest of a setting, by
which it is called. h is a velocity that bends as the curves do, of slope 1 at rest; of straight curves it is v, and F is c v.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.curves.curve import STRAIGHT, Curve

TOUCHING = 1e-9  # of the largest force: curves that are no further apart are as one


@dataclass(frozen=True, eq=False)
class Pair:
    """The curves of an adjustable damper.

    Attributes:
        soft, hard: at its softest and at its firmest setting.
    """

    soft: Curve
    hard: Curve

    @cached_property
    def knots(self) -> Array:
        """The points of both [m/s], shape (n,)."""
        return np.unique(np.concatenate([self.soft.x, self.hard.x]))

    @cached_property
    def shape(self) -> Curve:
        """h [m/s] over velocity [m/s]."""
        x = self.knots
        bent = (self.hard.pieces.force(x) - self.soft.pieces.force(x)) / (self.hard.slope - self.soft.slope)
        return Curve(x, x + bent, 1.0, "how its settings are apart")

    @property
    def line(self) -> float:
        """Slope of h at rest, of both sides that of the flatter one."""
        rest = int(np.searchsorted(self.knots, 0.0))
        return float(self.shape.slopes[rest : rest + 2].min())

    @property
    def ramps(self) -> tuple[tuple[float, float, int], ...]:
        """What h has beyond that line: knots [m/s], beyond which it is steeper by so much, and to which side, 1 or -1, of each.

        One from rest is never flatter: as an actuator that would have a bias in which MuJoCo sees a damping ratio.
        """
        x, slopes = self.knots, self.shape.slopes
        rest = int(np.searchsorted(x, 0.0))
        found = [(0.0, float(slopes[rest + 1]) - self.line, 1), (0.0, float(slopes[rest]) - self.line, -1)]
        found += [(float(x[i]), float(slopes[i + 1] - slopes[i]), 1) for i in range(rest + 1, len(x))]
        found += [(float(x[i]), float(slopes[i] - slopes[i + 1]), -1) for i in range(rest)]
        return tuple(one for one in found if abs(one[1]) > STRAIGHT * np.abs(slopes).max())

    @property
    def straight(self) -> bool:
        """Whether neither bends."""
        return not len(self.soft.pieces.slope) and not len(self.hard.pieces.slope)

    def same(self, other: "Pair | None") -> bool:
        """Whether another has the same curves."""
        if other is None:
            return False
        pairs = ((self.soft, other.soft), (self.hard, other.hard))
        return all(np.array_equal(a.x, b.x) and np.array_equal(a.force, b.force) for a, b in pairs)


def pair_of(soft: Curve, hard: Curve) -> Pair:
    """Two curves as limits.

    Raises:
        InputError: the firmer one is not above the softer one at every velocity.
    """
    found = Pair(soft, hard)
    x, largest = found.knots, max(soft.range, hard.range)
    low, high = (curve.slope * x + curve.pieces.force(x) for curve in (soft, hard))
    for i in np.flatnonzero((x != 0) & ((high - low) * np.sign(x) <= TOUCHING * largest))[:1].tolist():
        raise InputError(
            f"at {x[i]:g} m/s c_min pulls with {low[i]:g} N and c_max with {high[i]:g} N; give as c_max the firmest setting, "
            "which takes more than the softest at every velocity"
        )
    if not soft.slope < hard.slope:
        raise InputError(
            f"at rest c_min has a slope of {soft.slope:g} N s/m and c_max of {hard.slope:g} N s/m; give as c_max the firmest "
            "setting, which is the steeper one there"
        )
    for end, side in ((0, "below the first points"), (-1, "beyond the last points")):
        if hard.slopes[end] < soft.slopes[end] - TOUCHING * abs(soft.slopes[end]):
            raise InputError(
                f"{side} c_min and c_max go on with {soft.slopes[end]:g} and {hard.slopes[end]:g} N s/m, and meet there; give "
                "last points from which they do not"
            )
    return found
