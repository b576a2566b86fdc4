"""A damper's force over velocity, or a spring's over deflection, as straight lines from point to point.

Both arguments are positive where the suspension stretches, and a force is positive where it pulls body and wheel together: so a
damper takes energy where force and velocity have the same sign. Beyond its last points a curve goes on as straight as it ends.

Linear analysis knows one number of it, the slope s at rest; where there is a kink at rest, the mean of both sides. What the curve
F has beyond that line is a sum of straight pieces, each between its bounds,

    F(x) - s x = sum over i of clip(a_i (x - k_i), low_i, high_i),

one for every segment whose slope is not s, measured from its end nearer to rest. So a curve that is straight has none, and one
that falls again on its way is a sum of such pieces as well.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from models.common.arrays import Array
from models.suspension import LEAVES

STRAIGHT = 1e-12  # of the steepest slope: what slopes of one line differ by, to rounding


@dataclass(frozen=True, eq=False)
class Pieces:
    """The straight pieces, P of them, that make a curve of a line.

    Attributes:
        slope: a [N per unit of the argument], shape (P,).
        start: k, from where each acts [the argument's unit], shape (P,).
        low, high: between which forces each acts [N], shape (P,); infinite where it has no end.
    """

    slope: Array
    start: Array
    low: Array
    high: Array

    def force(self, x: Array) -> Array:
        """Their sum at some arguments [N], shape (...)."""
        return np.clip(self.slope * (np.asarray(x)[..., None] - self.start), self.low, self.high).sum(axis=-1)


@dataclass(frozen=True, eq=False)
class Curve:
    """Force over velocity or deflection.

    Attributes:
        x: its points [m/s or m], ascending, rest, 0, among them and neither first nor last, shape (n,).
        force: at those [N], 0 at rest, shape (n,).
        slope: of the line that linear analysis takes for it [N s/m or N/m].
        words: what it is, in a phrase.
    """

    x: Array
    force: Array
    slope: float
    words: str

    def __call__(self, x: Array) -> Array:
        """The force at some arguments [N], shape (...)."""
        return self.slope * np.asarray(x) + self.pieces.force(x)

    def scaled(self, factor: float) -> "Curve":
        """The same with all forces so many times as large."""
        return self if factor == 1 else replace(self, force=factor * self.force, slope=factor * self.slope)

    @cached_property
    def slopes(self) -> Array:
        """Below its first point, from point to point, and above the last, shape (n + 1,)."""
        within = np.diff(self.force) / np.diff(self.x)
        return np.concatenate([within[:1], within, within[-1:]])

    @cached_property
    def pieces(self) -> Pieces:
        """What it has beyond its line."""
        edges, rows = np.concatenate([[-np.inf], self.x, [np.inf]]), []
        for left, right, slope in zip(edges[:-1], edges[1:], self.slopes - self.slope, strict=True):
            if abs(slope) > STRAIGHT * np.abs(self.slopes).max():
                near, far = (left, right) if left >= 0 else (right, left)
                end = slope * (far - near)
                rows.append((slope, near, min(end, 0.0), max(end, 0.0)))
        return Pieces(*np.array(rows).reshape(-1, 4).T)

    def work(self, x: Array) -> Array:
        """What it has beyond its line, summed up from rest to some arguments, shape (...)."""
        edges = np.concatenate([[-np.inf], self.x, [np.inf]])
        knots, x = self.pieces.force(self.x), np.asarray(x)
        to_knots = np.concatenate([[0.0], np.cumsum((knots[1:] + knots[:-1]) / 2 * np.diff(self.x))])
        to_knots -= to_knots[np.searchsorted(self.x, 0.0)]
        i = np.clip(np.searchsorted(edges, x) - 2, 0, len(self.x) - 1)
        return to_knots[i] + (knots[i] + self.pieces.force(x)) / 2 * (x - self.x[i])

    @cached_property
    def range(self) -> float:
        """The largest force of its points, either way [N]."""
        return float(np.abs(self.force).max())

    @cached_property
    def left_at(self) -> tuple[float, float]:
        """Where, below rest and above it, it has first left its line by `LEAVES` of its range; infinite where it never does."""
        limit, found = LEAVES * self.range, []
        for side in (-1.0, 1.0):
            some = np.flatnonzero(side * self.x >= 0)[:: int(side)]
            beyond = 2 * max(abs(self.x[0]), abs(self.x[-1])) * 1e3  # as good as never
            x = np.append(self.x[some], side * beyond)
            apart = self.pieces.force(x)
            hit = np.flatnonzero(np.abs(apart) >= limit)
            if not len(hit):
                found.append(side * np.inf)
                continue
            i = int(hit[0])
            share = (np.sign(apart[i]) * limit - apart[i - 1]) / (apart[i] - apart[i - 1])
            found.append(float(x[i - 1] + share * (x[i] - x[i - 1])))
        return found[0], found[1]
