"""Approximation of a characteristic that has many points by fewer straight segments.

The algorithm is that of H. Imai and M. Iri (1986), An optimal algorithm for approximating a piecewise linear function, J. Inf.
Process. 9, 159-162. The ends of the approximation's segments are points of the characteristic. The characteristic and its
approximation are straight between points, so the largest error is at a point. The segments next to 0 keep the slopes of the
characteristic, because linear analysis uses these slopes.
"""

import numpy as np

from models.common.arrays import Array

# Factor that converts the third quartile of the deviations in `slopes_at_rest` to a limit of four standard deviations, if the
# noise is normally distributed
NOISE = 4 / 2.4


def point_indices(x: Array, force: Array, error: float) -> Array:
    """Returns the indices of the points that an approximation keeps, shape (k,).

    The approximation consists of the first point, the last point, the point at 0, and as few other points as possible.

    Args:
        x: argument (such as velocity) of each point of the characteristic, ascending, including 0, shape (n,).
        force: force at each point, shape (n,).
        error: largest allowed error of the approximation, in the unit of the force.
    """
    rest = int(np.searchsorted(x, 0.0))
    indices, first = [], 0
    for last in (rest, len(x) - 1):
        while first < last:
            indices.append(first)
            first = _farthest(x, force, first, last, error)
    return np.array([*indices, len(x) - 1])


def _farthest(x: Array, force: Array, first: int, last: int, error: float) -> int:
    """Returns the last point to which a straight line from the point `first` can lead without exceeding the allowed error at
    any point in between.
    """
    run, rise = x[first + 1 : last + 1] - x[first], force[first + 1 : last + 1] - force[first]
    # Every point between the two ends limits the slope of the line from above and from below.
    steepest = np.minimum.accumulate((rise + error) / run)
    flattest = np.maximum.accumulate((rise - error) / run)
    slope = rise / run
    fits = np.ones(len(run), dtype=bool)
    fits[1:] = (slope[1:] <= steepest[:-1]) & (slope[1:] >= flattest[:-1])
    return first + 1 + int(np.flatnonzero(fits)[-1])


def lines_from_rest(x: Array, force: Array, slopes: tuple[float, float], error: float) -> tuple[Array, Array]:
    """Returns the end points of as few straight segments as possible, shapes (k,). The two segments next to 0 have the slopes
    in `slopes`.

    Args:
        x: argument (such as velocity) of each point of the characteristic, ascending, shape (n,).
        force: force at each point, 0 at x = 0, shape (n,).
        slopes: slopes of the two segments next to 0, below and above 0.
        error: largest allowed error of the approximation, in the unit of the force.
    """
    at = [(0.0, 0.0)]
    for side, slope in zip((-1.0, 1.0), slopes, strict=True):
        s, f = (one[side * x > 0][:: int(side)] for one in (side * x, force))
        if len(s):
            near = np.abs(f - slope * side * s) <= error
            k = max(1, len(s) if near.all() else int(near.argmin()))
            s, f = s[k - 1 :], np.append(slope * side * s[k - 1], f[k:])
            chosen = point_indices(s - s[0], f, error)
            at += zip((side * s[chosen]).tolist(), f[chosen].tolist(), strict=True)
    ends, forces = np.array(sorted(at)).T
    return ends, forces


def slopes_at_rest(x: Array, force: Array, error: float) -> tuple[float, float]:
    """Returns the slopes of a table just below and just above the argument 0.

    If the table has no noise, the function returns the slopes of the two segments next to 0. Noise is the deviation of the
    points from smooth curves through their neighbours. With noise, the function fits least-squares lines through 0, and uses
    the longest line from which no point deviates by more than the noise.

    Args:
        x: argument of each point of the table, ascending, shape (n,).
        force: force at each point, shape (n,).
        error: largest allowed deviation, in the unit of the force.
    """
    step = np.diff(x)
    bend = np.diff(np.diff(force) / step) * step[1:] * step[:-1] / (step[1:] + step[:-1])
    waver, noise = bend[1:-1] - (bend[:-2] + bend[2:]) / 2, 0.0
    if len(waver) and (most := np.quantile(np.abs(waver), 0.75)) > np.quantile(np.abs(bend), 0.75):
        noise = min(NOISE * float(most), error)
    slopes = [0.0, 0.0]
    for i, side in enumerate((-1, 1)):
        s, f = (one[side * x > 0][::side] for one in (x, force))
        lines = np.cumsum(s * f) / np.cumsum(s * s)
        fits = (k for k in range(1, len(s)) if not (np.abs(f[: k + 1] - lines[k] * s[: k + 1]) <= noise).all())
        if len(s):
            slopes[i] = float(lines[next(fits, len(s)) - 1])
    return slopes[0], slopes[1]
