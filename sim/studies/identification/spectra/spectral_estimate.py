"""Estimate of a vehicle's parameters from logs of a random road, by maximum likelihood of the logs' spectra
(`spectral_residuals`).

The search uses Fisher's scoring: Newton's method in a trust region, where the expected information stands for half the second
derivative of the deviance.

Test. If the models of vehicle and road are right, the ratio of a signal's periodogram to its expected value has an exponential
distribution at each frequency. The ratio for the mean of several segments has a gamma distribution. The part of a signal that
cannot be predicted from the other signals has a ratio with the same distributions. Both ratios are tested twice: one test
compares the means of the ratio in bands with 1, and another test (Kolmogorov) checks the distribution. The smallest probability
of all tests is multiplied by the number of tests.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, list_names
from models.common.printed import rough
from models.document.document import Statement
from models.document.figure import Curve, Figure, Panel
from sim.studies.identification.estimation.estimate import Estimate
from sim.studies.identification.estimation.problem import IdentificationProblem
from sim.studies.identification.estimation.search import CHI2, SPREAD, STARTS
from sim.studies.identification.estimation.structure import information, structure_of
from sim.studies.identification.experiment import Experiment, signal_units
from sim.studies.identification.spectra.random_road import Periodograms
from sim.studies.identification.spectra.spectral_residuals import SpectralResiduals
from sim.studies.identification.whiteness import Whiteness

# The search ends if the derivatives of the deviance are smaller than this. An unknown with the standard deviation s then
# differs from the optimum by at most s^2 / 2 times this.
SETTLED, COARSE = 1e-2, 1.0
MOST, FEW = 40, 10  # largest number of iterations of a search, and of one from a further starting point
PARTS = 5  # number of parts of a log that are compared
UNSTEADY = 2.0  # a log counts as not steady if the rms values of two parts differ by a larger factor than this
POOR = 0.5  # if the fit of a signal's spectrum is smaller than this, other starting points are tried


def estimate_spectra(problem: IdentificationProblem, free: Sequence[str], seed: int = 0) -> Estimate:
    """Identifies parameters of a vehicle and of its random road. An estimate from spectra contains no predicted signals.

    Args:
        free: names of the parameters to estimate; all other parameters keep their initial values.
        seed: random seed for further starting points, which are tried if the first starting point leads to a poor fit.

    Raises:
        InputError: the spectra determine no parameter.
    """
    every = SpectralResiduals(problem, free)
    structure = structure_of(every.reduced(every.first(), {})[0], free)
    left = tuple(name for name in free if name not in (*structure.held, *structure.silent))
    if not left:
        raise InputError(
            "the spectra determine neither a parameter nor a combination of parameters; measure a signal that "
            "depends on the free parameters"
        )
    of, p = SpectralResiduals(problem, left), len(left)
    x, rng = search(of, with_levels(of, of.first())), np.random.default_rng(seed)
    for _ in range(STARTS if min(fit for each in of.fits(x) for fit in each.values()) < POOR else 0):
        with suppress(InputError, np.linalg.LinAlgError):  # parameters that no vehicle can have are skipped
            shift = np.concatenate([rng.uniform(-SPREAD, SPREAD, p), np.zeros(of.size - p)])
            other = search(of, with_levels(of, of.first() + shift), most=FEW)
            if of.deviance(other, {}) < of.deviance(x, {}) - CHI2:
                x = search(of, other)
    R, C = information(of.reduced(x, {})[0], p)
    inverse, values = np.linalg.pinv(R), of.values(x)
    covariance = inverse @ inverse.T
    middle = np.zeros((p, p))
    for rows in (of.scores(x), of.known_columns(x)):
        own = rows[:, :p] - rows[:, p:] @ C
        middle += own.T @ own
    slopes = np.array([size / values[name] for name, size in of.sizes(values).items()])
    return Estimate(
        problem,
        {name: values[name] for name in free},
        left,
        structure,
        {name: float(x[i]) for name, i in of.delayed.items()},
        of.noise(x),
        covariance * np.outer(slopes, slopes),
        covariance @ middle @ covariance * np.outer(slopes, slopes),
        tuple(spectral_tests(of, x)),
        (),
        (),
        of.deviance(x, {}),
        of,
        x,
    )


def nearby_spectra(problem: IdentificationProblem, free: Sequence[str], deviance: float) -> dict[str, float] | None:
    """Returns the parameter values found by a search from the initial values; None if the deviance of these values exceeds
    `deviance`.
    """
    of = SpectralResiduals(problem, free)
    x = search(of, with_levels(of, of.first()))
    return of.values(x) if of.deviance(x, {}) <= deviance else None


def fits_elsewhere(of: Estimate, experiments: Sequence[Experiment]) -> Iterator[tuple[Experiment, Mapping[str, float]]]:
    """Yields the fits of the signals in experiments that were not used for the estimate."""
    for one in experiments:
        channels = tuple(
            replace(each, noise=of.noise[each.signal], delay=of.delays.get(each.signal, each.delay), delay_estimated=False)
            for each in one.channels
            if each.signal in of.noise
        )
        if channels and one.random is not None:
            other = replace(one, channels=channels)
            residuals = SpectralResiduals(replace(of.problem, first=of.values, experiments=(other,), known=()), ())
            yield other, residuals.fits(residuals.first())[0]


def unsteady(experiments: Sequence[Experiment]) -> Iterator[str]:
    """Yields remarks on signals whose fast motion changes in the course of a log, because a random road requires a constant
    speed.
    """
    for one in experiments:
        for channel in one.channels:
            parts = np.array_split(np.diff(channel.values), PARTS)
            rms = [float(np.sqrt(np.mean(part**2))) for part in parts]
            if max(rms) > UNSTEADY * min(rms):
                factor = rough(max(rms) / min(rms))
                yield (
                    f"{one.name}: the rms of the rate of {channel.signal} changes by a factor of {factor} along the log, but the "
                    "spectra assume a constant speed and one road; choose a part with first and last in the map"
                )


def with_levels(of: SpectralResiduals, x: Array) -> Array:
    """Returns the unknowns after roughness and noise are replaced by the most likely values for the other unknowns."""
    return search(of, x, of.levels, COARSE) if of.levels else x


def search(of: SpectralResiduals, x: Array, among: Sequence[int] = (), enough: float = SETTLED, most: int = MOST) -> Array:
    """Returns the unknowns that maximise the likelihood, found by a search from x.

    Args:
        among: indices of the unknowns that the search may change; by default all unknowns.
        enough: limit on the derivatives of the deviance; the search ends if all derivatives are smaller than this limit.
        most: largest number of iterations of the search.
    """
    from scipy.optimize import minimize

    chosen, units = np.array(among or range(len(x))), np.ones(len(x))
    units[list(of.delayed.values())] = of.problem.experiments[0].step
    units = units[chosen]

    def point(y: Array) -> Array:
        moved = x.copy()
        moved[chosen] += units * y
        return moved

    def gradient(y: Array) -> Array:
        R, c = of.reduced(point(y), {})
        return 2 * units * (R[:, chosen].T @ c)

    def curvature(y: Array) -> Array:
        R = of.reduced(point(y), {})[0][:, chosen] * units
        return 2 * R.T @ R

    options: Any = {"gtol": enough, "maxiter": most, "initial_trust_radius": 0.5, "max_trust_radius": 2.0}
    methods: Any = {"method": "trust-exact", "jac": gradient, "hess": curvature, "options": options}
    return point(minimize(lambda y: of.deviance(point(y), {}), np.zeros(len(chosen)), **methods).x)


def spectral_tests(of: SpectralResiduals, x: Array) -> list[dict[str, Whiteness]]:
    """Returns, for each experiment, the test result of each signal; the module docstring describes the test."""
    each = list[dict[str, Whiteness]]()
    for one in of.problem.experiments:
        own = [(spectra, E) for spectra, E in zip(of.spectra, of.expected(x), strict=True) if spectra.experiment is one]
        tests = list[list[Whiteness]]()
        for spectra, E in own:
            inverse = np.linalg.inv(E)
            rest = inverse @ spectra.measured @ inverse
            ratios = [
                np.einsum("kii->ik", a).real / np.einsum("kii->ik", b).real for a, b in ((spectra.measured, E), (rest, inverse))
            ]
            tests.append(
                [gamma_test([ratio[i] for ratio in ratios[: len(one.signals)]], spectra) for i in range(len(one.signals))]
            )
        each.append({name: together([test[i] for test in tests]) for i, name in enumerate(one.signals)})
    return each


def together(tests: Sequence[Whiteness]) -> Whiteness:
    """Combines the tests of a signal's frequency bands into one test of the signal."""
    correlations = np.concatenate([one.correlations for one in tests])
    outside = float(np.mean(np.abs(correlations) > tests[0].bound))
    least = min(1.0, len(tests) * min(one.probability for one in tests))
    return Whiteness(correlations, tests[0].bound, outside, least, sum(one.samples for one in tests))


def spectral_statement(of: Estimate) -> Statement:
    """Returns a statement about the test result for the spectra."""
    if of.white:
        return Statement(
            "The spectra are as expected: vehicle, random road and noise explain all that the sensors show.", "holds"
        )
    names = {name for each in of.whiteness for name, one in each.items() if not one.white}
    return Statement(
        f"The spectra of {list_names(names)} are not as expected: the vehicle model lacks something, or the road has a different "
        "spectrum. The intervals account for spectra that scatter more or less than expected, but not for a bias.",
        "fails",
    )


def spectral_figure(of: Estimate) -> Figure:
    """Returns a figure of the measured and the expected spectra of the first experiment."""
    panels, first, residuals = list[Panel](), of.problem.experiments[0], of.residuals
    assert isinstance(residuals, SpectralResiduals)
    units = signal_units(of.problem.vehicle.kind)
    for i, name in enumerate(first.signals):
        curves = list[Curve]()
        for one, E in zip(residuals.spectra, residuals.expected(of.x), strict=True):
            if one.experiment is first:
                # The mean of a periodogram over a band has less scatter than the periodogram.
                middle, measured = (
                    np.array([values[part].mean() for part in one.bands])
                    for values in (one.frequencies, np.real(one.measured[:, i, i]))
                )
                curves += [
                    Curve(middle, measured, "measured", "#9a9a9a", "none", "o"),
                    Curve(one.frequencies, np.real(E[:, i, i]), "identified vehicle and road", "#0b5fa5"),
                ]
        unit = f"({units[name]})" if "/" in units[name] else units[name]
        panels.append(Panel(name, "frequency [Hz]", f"[{unit}²/Hz]", tuple(curves), xlog=True, ylog=True))
    return Figure("identification", f"Spectra of {first.name} and of the identified vehicle.", tuple(panels), columns=1)


def gamma_test(ratios: Sequence[Array], spectra: Periodograms) -> Whiteness:
    """Tests whether ratios of periodograms to their expected values have the distribution stated in the module docstring.

    Args:
        ratios: arrays of ratios of periodograms to expected values, for common frequencies, each of shape (K,).
    """
    from scipy.special import chdtrc, gammainc, kolmogorov

    count, deviations, least = len(spectra.frequencies), list[Array](), 1.0
    for ratio in ratios:
        means, sizes = (
            np.array(one) for one in zip(*((ratio[part].mean(), part.stop - part.start) for part in spectra.bands), strict=True)
        )
        shape = sizes * spectra.weight
        # the cube root of a gamma variable is almost normal (Wilson and Hilferty, 1931)
        deviations.append((np.cbrt(means) - (1 - 1 / (9 * shape))) * np.sqrt(9 * shape))
        uniform = np.sort(gammainc(spectra.segments, spectra.segments * ratio))
        ranks = np.arange(count + 1) / count
        distance = max(float((uniform - ranks[:-1]).max()), float((ranks[1:] - uniform).max()))
        least = min(least, float(chdtrc(len(shape), float(deviations[-1] @ deviations[-1]))))
        least = min(least, float(kolmogorov(math.sqrt(count / spectra.inflation) * distance)))
    each = np.concatenate(deviations)
    outside = float(np.mean(np.abs(each) > 1.96))
    return Whiteness(each, 1.96, outside, min(1.0, 2 * len(ratios) * least), count)
