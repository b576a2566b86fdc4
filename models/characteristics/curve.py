"""Piecewise linear characteristics: a damper's force against velocity, or a spring's force against deflection.

Velocity and deflection are positive if the suspension extends. A force is positive if it pulls body and wheel together, so a
damper dissipates energy if force and velocity have the same sign. Outside the range of its points, a characteristic is
extrapolated linearly with the slopes of its first and last segments.

Linear analysis uses the slope s of the characteristic at 0; at a kink, s is the mean of the slopes on the two sides.
The deviation of the force F from the straight line s x is a sum of ramps, each clipped to a lower and an upper bound:

    F(x) - s x = sum over i of clip(a_i (x - k_i), low_i, high_i).

The sum has a term for every segment whose slope differs from the slope s at 0. In the term of segment i, k_i is the end of the
segment that is closer to 0. A straight characteristic has no terms. The sum is also valid for a characteristic in which the
force decreases in some segments.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from models.characteristics import LEAVES
from models.characteristics.curve_lines import lines_from_rest, slopes_at_rest
from models.common.arrays import Array
from models.common.errors import InputError

STRAIGHT = 1e-12  # slopes that differ by less than this share of the steepest slope count as equal, because of rounding errors


@dataclass(frozen=True, eq=False)
class Pieces:
    """Segments whose sum is the deviation of a characteristic from a straight line; P segments for each characteristic, shape
    (..., P).

    Attributes:
        slope: slope a of each segment, in N per unit of the argument (velocity or deflection), shape (..., P).
        start: end k of each segment that is closer to 0 [unit of the argument], shape (..., P).
        low: lower bound of the force [N], shape (..., P); infinite for a segment without end.
        high: upper bound of the force [N], shape (..., P); infinite for a segment without end.
    """

    slope: Array
    start: Array
    low: Array
    high: Array

    def force(self, x: Array) -> Array:
        """Returns the sum of the forces of all segments at the arguments x [N], shape (...)."""
        # This code runs in each stage of a time step, so it does not use NumPy's `clip` and `sum`, which would take twice as
        # long.
        return np.minimum(np.maximum(self.slope * (np.asarray(x)[..., None] - self.start), self.low), self.high).dot(self._ones)

    def __getitem__(self, which: Array | slice) -> "Pieces":
        """Returns the segments of selected characteristics."""
        return Pieces(self.slope[which], self.start[which], self.low[which], self.high[which])

    @staticmethod
    def stacked(each: "Sequence[Pieces | None]", shape: tuple[int, ...]) -> "Pieces":
        """Returns the segments of several characteristics, shape (*shape, P). If a characteristic is None, all values of its
        segments are 0.
        """
        stacked = np.zeros((4, len(each), max(len(one.slope) for one in each if one is not None)))
        for i, one in enumerate(each):
            if one is not None:
                stacked[:, i, : len(one.slope)] = one.slope, one.start, one.low, one.high
        return Pieces(*stacked.reshape(4, *shape, -1))

    @cached_property
    def _ones(self) -> Array:
        return np.ones(self.slope.shape[-1])


@dataclass(frozen=True, eq=False)
class ForceCurve:
    """Force against velocity or deflection.

    Attributes:
        x: velocities or deflections of the points [m/s or m], ascending, including 0 between the first and the last point,
            shape (n,).
        force: force at each point [N], 0 at x = 0, shape (n,).
        slope: slope of the straight line that linear analysis uses [N s/m or N/m].
        words: description of the characteristic, a phrase.
        at_rest: force of the user's table in equilibrium [N], which has been subtracted from `force`.
        note: remark about the table in the file, a phrase.
        whole: characteristic with all points of the table; None if `x` and `force` contain all points.
        error: largest difference between the forces of this characteristic and of the characteristic `whole` [N].
    """

    x: Array
    force: Array
    slope: float
    words: str
    at_rest: float = 0.0
    note: str = ""
    whole: "ForceCurve | None" = None
    error: float = 0.0

    @staticmethod
    def together(curves: "Sequence[ForceCurve]", shape: tuple[int, ...]) -> "StackedCurves":
        """Combines several characteristics into an object that evaluates all characteristics at once, at arguments of shape
        (..., *shape).
        """
        return StackedCurves(
            Pieces.stacked([one.pieces for one in curves], shape), np.reshape([one.slope for one in curves], shape)
        )

    def __call__(self, x: Array) -> Array:
        """Returns the force [N] at each velocity or deflection in x, shape (...)."""
        line = self.slope * np.asarray(x)
        return line + self.pieces.force(x) if self.is_nonlinear else line

    def scaled(self, factor: float) -> "ForceCurve":
        """Returns the characteristic with all forces multiplied by a factor."""
        if factor == 1:
            return self
        whole = self.whole and self.whole.scaled(factor)
        return replace(self, force=factor * self.force, slope=factor * self.slope, whole=whole, error=factor * self.error)

    def at_wheel(self, ratio: float) -> "ForceCurve":
        """Returns the characteristic at the wheel, r F(r x), of an element with motion ratio r and force F(x)."""
        return self if ratio == 1 else replace(self, x=self.x / ratio, force=ratio * self.force, slope=ratio**2 * self.slope)

    def about_load(self, more: float) -> "ForceCurve":
        """Returns the characteristic of a spring relative to the equilibrium at which the spring carries an additional load.

        Args:
            more: additional load [N].

        Raises:
            InputError: the forces in the table do not reach the additional load.
        """
        own = self.whole or self
        low, high = -float(own.force.max()), -float(own.force.min())
        if not low < more < high:
            raise InputError(
                f"the table covers changes of the static load from {low:.4g} to {high:.4g} N, but the static load "
                f"changes by {more:.4g} N; extend the table to include this change"
            )
        i = int(np.flatnonzero((own.force[:-1] <= -more) & (own.force[1:] >= -more))[0])
        rest = float(np.interp(-more, own.force[i : i + 2], own.x[i : i + 2]))
        x = np.unique([*(own.x - rest), 0.0])
        force = np.where(x == 0, 0.0, np.interp(x + rest, own.x, own.force) + more)
        moved = replace(self, x=x, force=force, slope=slope_at_rest(x, force), at_rest=self.at_rest - more)
        if self.whole is None:
            return moved
        x, force = lines_from_rest(x, force, slopes_at_rest(x, force, self.error), self.error)
        return replace(moved, x=x, force=force, slope=slope_at_rest(x, force), whole=replace(moved, whole=None))

    @cached_property
    def slopes(self) -> Array:
        """Slopes of all segments, including the two segments beyond the table, shape (n + 1,)."""
        within = np.diff(self.force) / np.diff(self.x)
        return np.concatenate([within[:1], within, within[-1:]])

    @cached_property
    def pieces(self) -> Pieces:
        """Segments whose sum is the deviation of the characteristic from the straight line that linear analysis uses."""
        edges, rows = np.concatenate([[-np.inf], self.x, [np.inf]]), []
        for left, right, slope in zip(edges[:-1], edges[1:], self.slopes - self.slope, strict=True):
            if abs(slope) > STRAIGHT * np.abs(self.slopes).max():
                near, far = (left, right) if left >= 0 else (right, left)
                end = slope * (far - near)
                rows.append((slope, near, min(end, 0.0), max(end, 0.0)))
        return Pieces(*np.array(rows).reshape(-1, 4).T)

    @cached_property
    def is_nonlinear(self) -> bool:
        """True if the characteristic differs from the straight line that linear analysis uses."""
        return len(self.pieces.slope) > 0

    @property
    def slope_range(self) -> tuple[float, float]:
        """The smallest and the largest slope of the characteristic."""
        return float(self.slopes.min()), float(self.slopes.max())

    def work(self, x: Array) -> Array:
        """Returns the integral of the characteristic's deviation from the straight line of linear analysis, from 0 to each
        argument in x, shape (...).
        """
        edges = np.concatenate([[-np.inf], self.x, [np.inf]])
        knots, x = self.pieces.force(self.x), np.asarray(x)
        to_knots = np.concatenate([[0.0], np.cumsum((knots[1:] + knots[:-1]) / 2 * np.diff(self.x))])
        to_knots -= to_knots[np.searchsorted(self.x, 0.0)]
        i = np.clip(np.searchsorted(edges, x) - 2, 0, len(self.x) - 1)
        return to_knots[i] + (knots[i] + self.pieces.force(x)) / 2 * (x - self.x[i])

    @cached_property
    def range(self) -> float:
        """Largest magnitude of the force at the points [N]."""
        return float(np.abs(self.force).max())

    @cached_property
    def departures_at(self) -> tuple[float, float]:
        """Arguments below and above 0 at which the deviation from the straight line first reaches `LEAVES` times the largest
        force.

        If the deviation on one side of 0 never reaches `LEAVES` times the largest force, the argument on that side is infinite.
        """
        limit, arguments = LEAVES * self.range, []
        for side in (-1.0, 1.0):
            points = np.flatnonzero(side * self.x >= 0)[:: int(side)]
            # This argument is far outside every possible range of motion
            beyond = 2 * max(abs(self.x[0]), abs(self.x[-1])) * 1e3
            x = np.append(self.x[points], side * beyond)
            apart = self.pieces.force(x)
            hit = np.flatnonzero(np.abs(apart) >= limit)
            if not len(hit):
                arguments.append(side * np.inf)
                continue
            i = int(hit[0])
            share = (np.sign(apart[i]) * limit - apart[i - 1]) / (apart[i] - apart[i - 1])
            arguments.append(float(x[i - 1] + share * (x[i] - x[i - 1])))
        return arguments[0], arguments[1]


@dataclass(frozen=True, eq=False)
class StackedCurves:
    """Several characteristics that are evaluated together.

    Attributes:
        pieces: segments of each characteristic, P segments for each, shape (..., P).
        slope: slope that linear analysis uses for each characteristic, shape (...).
    """

    pieces: Pieces
    slope: Array

    def __call__(self, x: Array) -> Array:
        """Returns the force of each characteristic at its argument [N], shape (...)."""
        return self.slope * x + self.pieces.force(x)


def slope_at_rest(x: Array, force: Array) -> float:
    """Returns the slope at 0 from the points of a characteristic: the mean of the slopes on the two sides of 0."""
    i = int(np.searchsorted(x, 0.0))
    slopes = np.diff(force[i - 1 : i + 2]) / np.diff(x[i - 1 : i + 2])
    return float(slopes[0] if np.isclose(*slopes, rtol=1e-12, atol=0) else slopes.mean())
