"""Search for the parameters that maximise the likelihood, from one or several starting points."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from sim.studies.identification.estimation.residuals import Residuals
from sim.studies.identification.whiteness import whiteness

NORMAL = 1.959963984540054  # half the width of a 95 % confidence interval, in standard deviations
CHI2 = NORMAL**2  # amount by which -2 log likelihood is larger at the ends of a 95 % confidence interval
SETTLED = 1e-4  # the noise rms has converged if its relative change is smaller than this
ROUNDS = 30  # largest number of times that noise and parameters are estimated in turn
SPREAD = 1.2  # half the range of logarithms from which further starting points are taken: a factor of 3 up or down
STARTS = 6
TOLERANCES: Any = {"method": "trf", "x_scale": "jac", "ftol": 1e-10, "xtol": 1e-9, "gtol": 1e-12}
# largest number of evaluations in the first search, and in a search from a further starting point or near a solution
MOST, FEW = 60, 10
POOR = 0.5  # if the fit explains a smaller share of a signal's mean square than this, other starting points are tried


@dataclass(frozen=True, eq=False)
class Solution:
    """Result of a search: the values of the unknowns, the noise rms of each signal, and the deviance (-2 log likelihood +
    constant).
    """

    x: Array
    noise: Mapping[str, float]
    deviance: float


def first_unknowns(of: Residuals, shift: Array | None = None) -> Array:
    """Returns the initial unknowns: the initial parameter values, and the starting states and offsets that fit best for these
    values.

    Args:
        shift: change that is added to the unknowns of the free parameters, shape (p,).
    """
    x, p = np.zeros(of.size), len(of.free)
    x[:p] = [of.coordinate(name, of.problem.first[name]) for name in of.free]
    if shift is not None:
        x[:p] += shift
    given = {one.signal: one.delay for each in of.problem.experiments for one in each.channels}
    for name, i in of.delayed.items():
        x[i] = given[name]
    linear = p + len(of.delayed)
    if of.size > linear:
        R, c = of.reduced(x, of.scale)
        x[linear:] -= np.linalg.lstsq(R[:, linear:], c)[0]
    return x


def solve(of: Residuals, x: Array, rounds: int = ROUNDS, most: int = MOST, among: Sequence[int] | None = None) -> Solution:
    """Returns the solution with the largest likelihood, found by a search that starts at x. Unknowns and noise are estimated
    alternately.

    Args:
        rounds: largest number of rounds; each round estimates the unknowns and then the noise.
        most: largest number of evaluations of the residuals in each round.
        among: indices of the unknowns that the search may change; by default all unknowns.
    """
    noise = of.noise(x)
    for _ in range(rounds):
        x = of.within(least_squares(of, x, noise, most, among))
        before, noise = noise, of.noise(x)
        if all(abs(noise[name] - before[name]) <= SETTLED * noise[name] for name in noise):
            break
    return Solution(x, noise, of.deviance(x, noise))


def solve_from_several(of: Residuals, seed: int) -> Solution:
    """Returns the best solution of the searches from the initial values and, if the fit is poor, from random starting points.

    Raises:
        InputError: no vehicle can have the initial values.
    """
    best, rng = solve(of, first_unknowns(of)), np.random.default_rng(seed)
    for _ in range(STARTS if _poor(of, best.x) else 0):
        with suppress(InputError, np.linalg.LinAlgError):  # parameters that no vehicle can have are skipped
            x = least_squares(of, first_unknowns(of, rng.uniform(-SPREAD, SPREAD, len(of.free))), best.noise, FEW)
            if of.deviance(x, of.noise(x)) < best.deviance - CHI2:
                best = min(best, solve(of, x), key=lambda one: one.deviance)
    return best


def least_squares(of: Residuals, x: Array, noise: Mapping[str, float], most: int, among: Sequence[int] | None = None) -> Array:
    """Returns the unknowns with the smallest sum of squared residuals, each divided by the noise, after at most `most`
    evaluations.

    Args:
        among: indices of the unknowns that the search may change; by default all unknowns.
    """
    from scipy import optimize

    chosen = slice(None) if among is None else list(among)

    def point(y: Array) -> Array:
        moved = x.copy()
        moved[chosen] = y
        return moved

    def jacobian(y: Array) -> Array:
        return of.reduced(point(y), noise)[0][:, chosen]

    least = lower_limits(of)[chosen]
    bounds: Any = {"bounds": (least, np.inf)} if np.isfinite(least).any() else {}
    inside = np.maximum(x[chosen], least + 1e-3)  # the search does not start on a bound, because it would not move from there
    by_unknown: Any = jacobian
    result = optimize.least_squares(
        lambda y: of.reduced(point(y), noise)[1], inside, by_unknown, max_nfev=most, **bounds, **TOLERANCES
    )
    return point(result.x)


def lower_limits(of: Residuals) -> Array:
    """Returns the smallest allowed value of each unknown, shape (unknowns,)."""
    least = np.full(of.size, -np.inf)
    for i, name in enumerate(of.free):
        if name in of.problem.from_zero:
            least[i] = 0.0
        elif name in of.problem.lowest:
            least[i] = of.coordinate(name, of.problem.lowest[name])
    return least


def _poor(of: Residuals, x: Array) -> bool:
    """Returns True if a signal's residuals are not white and the fit explains less than the share `POOR` of the signal's mean
    square.
    """
    each = zip(of.problem.experiments, of.differences(x), strict=True)
    return any(
        np.nanmean(values**2) > (1 - POOR) * of.scale[name] ** 2 and not whiteness(values).white
        for one, difference in each
        for name, values in zip(one.signals, difference.T, strict=True)
    )
