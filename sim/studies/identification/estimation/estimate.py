"""Maximum-likelihood estimate of a vehicle's parameters, with confidence intervals and the parameter combinations that the logs
do not determine.

The residuals of each sensor are divided by the rms of the sensor's noise. If the noise rms is not supplied, it is estimated
from the residuals, alternately with the parameters. `scipy.optimize.least_squares` minimises the sum of squares of the
residuals.

Intervals. J is the matrix of the derivatives of all residuals. The covariance of the parameters' logarithms is (J'J)^-1. If the
residuals of a sensor are coloured, (J'J)^-1 underestimates the true covariance. For coloured residuals, (J'J)^-1 J'RJ (J'J)^-1
is used, where R is the autocovariance of an autoregressive model of each sensor's residuals.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, list_names
from sim.studies.identification.estimation.problem import IdentificationProblem
from sim.studies.identification.estimation.residuals import Residuals
from sim.studies.identification.estimation.search import NORMAL, Solution, first_unknowns, solve, solve_from_several
from sim.studies.identification.estimation.structure import Structure, information, structure_of
from sim.studies.identification.whiteness import Whiteness, autoregressive, whiteness

# a parameter counts as not determined if the standard deviation of its logarithm is larger than this; its interval then reaches
# a factor of 7 up and down
WIDE = 1.0
FAR = 100.0  # a search is skipped if the deviance at its starting point exceeds that of a known solution by more than this
# if the rms of the residuals is a smaller share of the signal's rms than this, the residuals contain no noise that could be
# tested
NOISELESS = 1e-3


@dataclass(frozen=True, eq=False)
class Estimate:
    """Result of an identification: the estimate with its covariance and tests.

    Attributes:
        problem: parameters to identify, and the experiments whose logs are used for the estimate.
        values: values of all free parameters [SI], by name; parameters that were not estimated keep their initial values.
        free: names of the p parameters that were estimated.
        structure: parameters, and combinations of parameters, that the logs do not determine.
        delays: estimated delays of the sensors [s], by signal.
        noise: rms of the sensor noise, by signal.
        covariance: covariance of the logarithms of the free parameters if the residuals are white, shape (p, p).
        robust: covariance of the logarithms of the free parameters, computed from the autocovariance of the residuals, shape
            (p, p).
        whiteness: results of the whiteness tests of each experiment, by signal.
        differences: predicted minus measured signals of each experiment, shape (T, q).
        predicted: predicted signals of each experiment, shape (T, q).
        deviance: -2 log likelihood of the estimate, up to a constant.
        residuals: object that computes the residuals, for further analysis.
        x: values of all unknowns at the estimate; `residuals` describes their order.
    """

    problem: IdentificationProblem
    values: Mapping[str, float]
    free: tuple[str, ...]
    structure: Structure
    delays: Mapping[str, float]
    noise: Mapping[str, float]
    covariance: Array
    robust: Array
    whiteness: tuple[Mapping[str, Whiteness], ...]
    differences: tuple[Array, ...]
    predicted: tuple[Array, ...]
    deviance: float
    residuals: Residuals = field(repr=False)
    x: Array = field(repr=False)

    @cached_property
    def noiseless(self) -> dict[str, float]:
        """Signals that are fitted almost exactly, by name, with the largest ratio of the residuals' rms to the signal's rms.

        Fits to spectra have no such signals, because periodograms scatter.
        """
        shares = {name: max(1 - each[name] for each in self.fits if name in each) for name in self.problem.signals}
        return {name: share for name, share in shares.items() if share < NOISELESS and self.predicted}

    @property
    def white(self) -> bool:
        """True if the residuals of all signals are white; signals without noise are ignored."""
        return all(one.white or name in self.noiseless for each in self.whiteness for name, one in each.items())

    @property
    def coloured(self) -> bool:
        """True if the residuals of at least one signal are not white."""
        return not all(one.white for each in self.whiteness for one in each.values())

    @property
    def spread(self) -> Array:
        """Covariance from which confidence intervals are computed: `robust` if residuals are coloured, otherwise `covariance`."""
        return self.robust if self.coloured else self.covariance

    @cached_property
    def deviations(self) -> dict[str, float]:
        """Standard deviation of the logarithm of each free parameter."""
        return dict(zip(self.free, np.sqrt(np.diag(self.spread)).tolist(), strict=True))

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Free parameters whose confidence interval is so wide that the logs do not determine them in practice."""
        return tuple(name for name, deviation in self.deviations.items() if not deviation < WIDE)

    def interval(self, name: str) -> tuple[float, float]:
        """Returns the 95 % confidence interval of a free parameter."""
        value, width = self.values[name], NORMAL * self.deviations[name]
        return value * float(np.exp(-width)), value * float(np.exp(width))

    def combination(self, powers: Mapping[str, float]) -> tuple[float, float]:
        """Returns the value of a product of parameter powers, and the standard deviation of the logarithm of this product.

        Args:
            powers: exponent of each parameter in the product, by name. Parameters that are held at their initial values count
                as known, because the product does not depend on these values.
        """
        weights = np.array([powers.get(name, 0.0) for name in self.free])
        value = float(np.exp(sum(power * np.log(self.values[name]) for name, power in powers.items())))
        return value, float(np.sqrt(weights @ self.spread @ weights))

    @property
    def fits(self) -> list[dict[str, float]]:
        """For each experiment, the fit of each signal, defined as 1 - rms of the residuals / standard deviation of the signal."""
        return self.residuals.fits(self.x)

    @cached_property
    def ratios(self) -> dict[str, dict[str, float]]:
        """For each free parameter, the exponents of the product of this parameter and powers of held parameters that the logs
        determine.
        """
        return self.structure.determined(self.free)


def estimate(problem: IdentificationProblem, free: Sequence[str], seed: int = 0, several: bool = True) -> Estimate:
    """Identifies parameters.

    Args:
        free: names of the parameters to estimate; all other parameters keep their initial values.
        seed: random seed for further starting points, which are tried if the first starting point leads to a poor fit.
        several: False to search only from the initial values.

    Raises:
        InputError: there is nothing to estimate, or the searches from all starting points fail.
    """
    if not free:
        raise InputError(
            f"no parameter is free, so there is nothing to estimate; free one of {list_names(problem.first)} with --free"
        )
    every = Residuals(problem, free)
    structure = structure_of(every.reduced(first_unknowns(every), every.scale)[0], free)
    left = tuple(name for name in free if name not in (*structure.held, *structure.silent))
    if not left:
        raise InputError(
            "the signals determine neither a parameter nor a combination of parameters; measure a signal that "
            "depends on the free parameters"
        )
    some = Residuals(problem, left)
    solution = solve_from_several(some, seed) if several else solve(some, first_unknowns(some))
    return _estimate(some, solution, structure)


def nearby(problem: IdentificationProblem, free: Sequence[str], deviance: float) -> dict[str, float] | None:
    """Returns the parameter values found by a search from the initial values; None if the deviance of these values is larger
    than `deviance`.

    If the starting point is far from a solution, no search is run.
    """
    of = Residuals(problem, free)
    x = first_unknowns(of)
    if of.deviance(x, of.noise(x)) > deviance + FAR:
        return None
    solution = solve(of, x)
    return of.values(solution.x) if solution.deviance <= deviance else None


def _estimate(of: Residuals, solution: Solution, structure: Structure) -> Estimate:
    """Returns the estimate that belongs to a solution of the search, with its covariances and whiteness tests."""
    x, noise, p = solution.x, solution.noise, len(of.free)
    R, C = information(of.reduced(x, noise)[0], p)
    inverse, values = np.linalg.pinv(R), of.values(x)
    covariance, tests = inverse @ inverse.T, list[dict[str, Whiteness]]()
    exact = of.known_columns(x)
    exact = exact[:, :p] - exact[:, p:] @ C
    middle = np.zeros((p, p))
    for i, (each, one) in enumerate(zip(of.differences(x), of.problem.experiments, strict=True)):
        tests.append({})
        for channel, name in enumerate(one.signals):
            scaled = each[:, channel] / noise[name]
            tests[-1][name] = whiteness(scaled)
            columns = of.channel_columns(x, noise, i, channel) * np.isfinite(scaled)[:, None]
            middle += autoregressive(scaled).sandwich(np.nan_to_num(columns[:, :p] - columns[:, p:] @ C))
    middle += exact.T @ exact
    # derivative of the logarithm of each parameter with respect to the unknown that represents it
    slopes = np.array([size / max(values[name], 1e-9 * size) for name, size in of.sizes(values).items()])
    return Estimate(
        of.problem,
        {name: values[name] for name in (*structure.held, *structure.silent, *of.free)},
        of.free,
        structure,
        {name: float(x[i]) for name, i in of.delayed.items()},
        noise,
        covariance * np.outer(slopes, slopes),
        covariance @ middle @ covariance * np.outer(slopes, slopes),
        tuple(tests),
        tuple(of.differences(x)),
        tuple(one.values for one in of.predicted(x)),
        solution.deviance,
        of,
        x,
    )
