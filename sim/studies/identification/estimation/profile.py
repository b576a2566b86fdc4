"""Confidence interval of a parameter by profile likelihood; such intervals may be wide, one-sided or asymmetric.

The profile is the deviance as a function of one parameter, minimised over all other unknowns. Points of the profile are computed
in steps from the estimate outwards. Each search starts at the previous point, moved along the tangent of the curve of minima.
The square root of the rise in deviance is almost linear in the parameter, so a few more points give the end of the interval.
"""

import math
from typing import Any

import numpy as np

from models.common.arrays import Array
from sim.studies.identification.estimation.estimate import Estimate
from sim.studies.identification.estimation.residuals import FURTHEST
from sim.studies.identification.estimation.search import CHI2, NORMAL, lower_limits, solve

STRIDE = 1.5  # largest step of a parameter's logarithm; it changes the parameter by a factor of 4.5
ROUNDS, MOST = 2, 8  # largest number of rounds of the search for a point, and of evaluations in each round
FINE = 1e-2  # tolerance for the end of a confidence interval, as a fraction of the last step
REFINED = 6  # largest number of points within the last step


def profile(of: Estimate, name: str) -> tuple[float | None, float | None]:
    """Returns the two ends of a parameter's 95 % confidence interval by profile likelihood; None for an open end.

    An end is open if the likelihood never falls to the level that defines the end of an interval. The search changes the
    parameter by a factor of up to 8000, or to zero if the parameter may be zero. If the residuals are coloured, the required
    fall is larger by the ratio of the parameter's robust variance to its variance for white residuals.
    """
    i, own = of.free.index(name), of.residuals
    from_zero, best = name in of.problem.from_zero, of.x[i]
    level = math.sqrt(CHI2 * (of.spread[i, i] / of.covariance[i, i]))
    size = own.sizes(of.values)[name]
    deviation = math.sqrt(of.spread[i, i]) * max(of.values[name], 1e-9 * size) / size  # standard deviation of the unknown
    least = lower_limits(own)[i]
    ends = list[float | None]()
    for last in (least if np.isfinite(least) else -FURTHEST, FURTHEST):
        step = min(NORMAL * deviation, abs(last - best), math.inf if from_zero else STRIDE)
        end = _end(of, i, last, step, level) if step else None
        ends.append(None if end is None else own.value(name, end))
    return ends[0], ends[1]


def _end(of: Estimate, i: int, last: float, step: float, level: float) -> float | None:
    """Returns the value of unknown i at which the square root of the rise in deviance reaches a level; None if this level is
    never reached.

    Args:
        last: value of the unknown at which the search stops.
        step: size of the first step of the unknown from the estimate.
        level: square root of the rise in deviance at the end of the interval.
    """
    from scipy.optimize import brentq

    own, others = of.residuals, [j for j in range(len(of.x)) if j != i]
    limits = lower_limits(own)
    points = {float(of.x[i]): of.x}

    def tangent(x: Array) -> Array:
        R, _ = own.reduced(x, own.noise(x))
        slope = np.ones(len(x))
        slope[others] = -np.linalg.lstsq(R[:, others], R[:, i])[0]
        return slope

    excesses = {float(of.x[i]): -level}

    def excess(at: float) -> float:
        if at not in excesses:
            nearest = min(points, key=lambda one: abs(one - at))
            near, along = points[nearest].copy(), np.maximum(points[nearest] + (at - nearest) * tangent(points[nearest]), limits)
            near[i] = along[i] = at
            start = min((near, along), key=lambda x: own.deviance(x, own.noise(x)))
            solution = solve(own, start, ROUNDS, MOST, others)
            points[at] = solution.x
            # a rise does not count if another parameter is at the limit of the search, because that limit may cause the rise
            limited = {*own.at_limit(solution.x)} - {of.free[i]}
            excesses[at] = -level if limited else math.sqrt(max(solution.deviance - of.deviance, 0.0)) - level
        return excesses[at]

    here = float(of.x[i])
    while here != last:
        ahead = last if abs(last - here) <= step else here + math.copysign(step, last - here)
        if excess(ahead) >= 0:
            end: Any = brentq(excess, here, ahead, xtol=FINE * step, maxiter=REFINED, disp=False)
            return end
        here, step = ahead, min(2 * step, max(step, STRIDE))
    return None
