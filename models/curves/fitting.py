"""Fewer straight lines for many: of those that start and end at points of a curve, and miss none by more than asked, the longest.

After H. Imai and M. Iri (1986), An optimal algorithm for approximating a piecewise linear function, J. Inf. Process. 9, 159-162,
with points of the curve as ends. Between points both are straight, so the error at the points is the error everywhere.
"""

import numpy as np

from models.common.arrays import Array

FRICTION_ERROR = 0.02  # of a friction's force: how far its lines may be from the smooth curve
FRICTION_ENDS = 3.0  # times its velocity, from where it is flat, with its full force
FRICTION_POINTS = 601  # of the smooth curve, from which the lines are taken; what lies between them adds 1e-5


def thinned(x: Array, force: Array, error: float) -> Array:
    """Which points of a curve remain, as indices, shape (k,): the first, the last, rest, and as few as will do between.

    Args:
        x: ascending, with rest, 0, among them, shape (n,).
        force: shape (n,).
        error: that is allowed, in the force's unit.
    """
    rest = int(np.searchsorted(x, 0.0))
    kept, first = [], 0
    for last in (rest, len(x) - 1):
        while first < last:
            kept.append(first)
            first = _farthest(x, force, first, last, error)
    return np.array([*kept, len(x) - 1])


def _farthest(x: Array, force: Array, first: int, last: int, error: float) -> int:
    """The last point that a straight line from the first reaches while it misses none between by more than the error."""
    run, rise = x[first + 1 : last + 1] - x[first], force[first + 1 : last + 1] - force[first]
    # A line's slope has to lie between what every point on the way leaves open.
    steepest = np.minimum.accumulate((rise + error) / run)
    flattest = np.maximum.accumulate((rise - error) / run)
    slope = rise / run
    fits = np.ones(len(run), dtype=bool)
    fits[1:] = (slope[1:] <= steepest[:-1]) & (slope[1:] >= flattest[:-1])
    return first + 1 + int(np.flatnonzero(fits)[-1])


def friction_points(force: float, velocity: float) -> tuple[Array, Array]:
    """Points of a friction F tanh(v / v0) that are no farther from it than `FRICTION_ERROR` of F, shapes (k,).

    Args:
        force: F [N].
        velocity: v0 [m/s].
    """
    v = np.linspace(0.0, FRICTION_ENDS, FRICTION_POINTS)
    smooth = np.append(np.tanh(v[:-1]), 1.0)
    some = thinned(v, smooth, FRICTION_ERROR - 1e-4)
    half = np.append(v[some], 2 * FRICTION_ENDS), np.append(smooth[some], 1.0)
    v, smooth = (np.concatenate([-part[:0:-1], part]) for part in half)
    return velocity * v, force * smooth
