"""Confidence interval of a parameter by profile likelihood, for intervals that are wide, one-sided or not symmetric."""

from dataclasses import replace
from typing import Any

import numpy as np

from sim.studies.identification.estimate import Estimate
from sim.studies.identification.residuals import FURTHEST, Residuals
from sim.studies.identification.search import CHI2, FEW, NORMAL, solve

WARM = 4  # number of rounds in a search that starts near a solution


def profile(of: Estimate, name: str) -> tuple[float | None, float | None]:
    """Returns the 95 % interval of a parameter by profile likelihood; None for a side that is open.

    A side is open if the likelihood never falls to the level of an interval's end. The parameter is changed by a factor of up to
    8000, or to zero if it may be zero. If residuals are coloured, the required fall is larger, as in the robust covariance.
    """
    from scipy.optimize import brentq

    i, own = of.free.index(name), of.residuals
    others, warm = tuple(one for one in of.free if one != name), {0.0: np.delete(of.x, i)}
    rise = CHI2 * (of.spread[i, i] / of.covariance[i, i])
    levels = {0.0: -rise}
    size = own.sizes(of.values)[name]
    deviation = float(np.sqrt(of.spread[i, i])) * max(of.values[name], 1e-9 * size) / size  # standard deviation of the unknown
    from_zero, best = name in of.problem.from_zero, own.coordinate(name, of.values[name])

    def excess(shift: float) -> float:
        if shift in levels:
            return levels[shift]
        # The initial values are not replaced, because the unknowns of the other parameters are relative to them.
        fixed = Residuals(replace(of.problem, first={**own.problem.first, name: own.value(name, best + shift)}), others)
        solution = solve(fixed, warm[min(warm, key=lambda one: abs(one - shift))], WARM, FEW)
        warm[shift] = solution.x
        levels[shift] = solution.deviance - of.deviance - rise
        return levels[shift]

    ends = list[float | None]()
    for sign in (-1, 1):
        low, high = 0.0, sign * min(NORMAL * deviation, FURTHEST)
        least = own.coordinate(name, of.problem.lowest[name]) if name in of.problem.lowest else -FURTHEST
        last = FURTHEST - best if sign > 0 else (0.0 if from_zero else least) - best
        high = high if abs(high) < abs(last) else last
        while (above := excess(high)) < 0 and high != last:
            low, high = high, sign * min(2 * abs(high), abs(last))
        if above < 0:
            ends.append(None)
            continue
        shift: Any = brentq(excess, low, high, xtol=1e-2 * deviation, rtol=np.float64(1e-4))
        ends.append(own.value(name, best + shift))
    return ends[0], ends[1]
