"""Estimate of a vehicle's parameters from logs of a random road, by maximum likelihood of their spectra (`random_road`).

Fit. The measured and the expected rms of a signal are compared in bands of equal numbers of frequencies. The fit is 1 minus the
rms of the differences, relative to the rms of the signal.

Test. If vehicle and road are right, the periodogram of a signal divided by its expected value has an exponential distribution at
each frequency (a gamma distribution for the mean of several segments). The same is true for the part of a signal that cannot be
predicted from the other signals. For both ratios, one test compares the means in bands with 1, and another one (Kolmogorov)
compares the distribution. The smallest of the probabilities is multiplied by the number of tests.
"""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, list_names
from models.document.document import Statement
from models.document.figure import Curve, Figure, Panel
from sim.studies.identification.estimate import SPREAD, STARTS, Estimate, IdentificationProblem
from sim.studies.identification.estimate import _information as information
from sim.studies.identification.estimate import _structure as structure
from sim.studies.identification.experiment import Experiment, signal_units
from sim.studies.identification.random_road import ROUGHNESS, Periodograms, SpectralResiduals
from sim.studies.identification.whiteness import LAGS, Whiteness

# The search ends if the derivatives of the deviance are smaller. An unknown with the standard deviation s is then off by at most
# s^2 / 2 times this.
SETTLED, COARSE = 1e-2, 1.0
MOST = 40  # largest number of iterations of a search
POOR = 0.8  # if the fit of a signal's spectrum is smaller, other starting points are tried


@dataclass(frozen=True, eq=False)
class SpectralEstimate(Estimate):
    """Result of an identification from spectra; `differences` and `predicted` are empty."""

    residuals: SpectralResiduals  # pyright: ignore[reportIncompatibleVariableOverride]

    @property
    def fits(self) -> list[dict[str, float]]:
        """For each experiment, the fit of each signal's spectrum; see the module docstring."""
        return spectral_fits(self.residuals, self.x)

    @cached_property
    def noiseless(self) -> dict[str, float]:
        """No signal is fitted exactly, because the road is random."""
        return {}


def estimate_spectra(problem: IdentificationProblem, free: Sequence[str], seed: int = 0) -> SpectralEstimate:
    """Identifies parameters of a vehicle and its road.

    Args:
        free: names of the parameters to estimate; the others keep their initial values.
        seed: random seed of further starting points, which are tried if the spectra of the first result are not as expected.

    Raises:
        InputError: the spectra determine no parameter.
    """
    every = SpectralResiduals(problem, free)
    held, silent, directions = structure(every, every.first())
    left = tuple(name for name in free if name not in (*held, *silent))
    if not left:
        raise InputError(
            "the spectra determine neither a parameter nor a combination of parameters; measure a signal that depends on them"
        )
    of = SpectralResiduals(problem, left)
    best = search(of, with_levels(of))
    if min(fit for each in spectral_fits(of, best) for fit in each.values()) < POOR:
        rng = np.random.default_rng(seed)
        for _ in range(STARTS):
            shift = np.concatenate([rng.uniform(-SPREAD, SPREAD, len(left)), np.zeros(len(best) - len(left))])
            with suppress(InputError, np.linalg.LinAlgError):  # parameters that no vehicle can have are skipped
                best = min(best, search(of, with_levels(of, shift)), key=of.deviance)
    R, C = information(of.reduced(best)[0], len(left))
    inverse, values = np.linalg.pinv(R), of.values(best)
    covariance = inverse @ inverse.T
    scores = np.concatenate(of.scores(best))
    own = np.concatenate([scores[:, : len(left)] - scores[:, len(left) :] @ C])
    known = of.known_columns(best)
    known = known[:, : len(left)] - known[:, len(left) :] @ C
    return SpectralEstimate(
        problem, values, left, held, directions, silent, of.delays(best), of.noise(best), covariance,
        covariance @ (own.T @ own + known.T @ known) @ covariance, tuple(spectral_tests(of, best)), (), (), of.deviance(best), of,
        best,
    )  # fmt: skip


def nearby_spectra(problem: IdentificationProblem, free: Sequence[str], deviance: float) -> dict[str, float] | None:
    """Returns the solution of a search from the initial values; None if its deviance is larger than the given one."""
    of = SpectralResiduals(problem, free)
    x = search(of, with_levels(of))
    return of.values(x) if of.deviance(x) <= deviance else None


def fits_elsewhere(of: SpectralEstimate, experiments: Sequence[Experiment]) -> Iterator[tuple[Experiment, Mapping[str, float]]]:
    """Yields the fits of experiments that were not used for the estimate."""
    for one in experiments:
        channels = tuple(
            replace(each, noise=of.noise[each.signal], delay=of.delays.get(each.signal, each.delay), delay_estimated=False)
            for each in one.channels
            if each.signal in of.noise
        )
        if channels and one.random is not None:
            other = replace(one, channels=channels)
            residuals = SpectralResiduals(replace(of.problem, first=of.values, experiments=(other,), known=()), ())
            yield other, spectral_fits(residuals, residuals.first())[0]


def with_levels(of: SpectralResiduals, shift: Array | None = None) -> Array:
    """Returns initial unknowns, after a search for the noise and the roughness alone.

    Args:
        shift: change of the initial unknowns.
    """
    x = of.first() if shift is None else of.first() + shift
    u = of.unknowns
    return search(of, x, [i for i in range(u.size) if u.free[i : i + 1] == (ROUGHNESS,) or i >= u.size - len(u.noisy)])


def search(of: SpectralResiduals, x: Array, among: Sequence[int] | None = None) -> Array:
    """Returns the unknowns with the largest likelihood near x.

    Args:
        among: indices of the unknowns that change; all by default.
    """
    from scipy.optimize import minimize

    chosen = np.arange(len(x)) if among is None else np.array(among, dtype=int)
    if not len(chosen):
        return x
    u = of.unknowns
    delays = np.arange(len(u.free), len(u.free) + len(u.delayed))
    units = np.where(np.isin(np.arange(len(x)), delays), of.problem.experiments[0].step, 1.0)[chosen]

    def point(y: Array) -> Array:
        moved = x.copy()
        moved[chosen] += units * y
        return moved

    def slopes(y: Array) -> tuple[Array, Array]:
        R, c = of.reduced(point(y))
        return R[:, chosen] * units, c

    def gradient(y: Array) -> Array:
        R, c = slopes(y)
        return 2 * R.T @ c

    def curvature(y: Array) -> Array:
        R, _ = slopes(y)
        return 2 * R.T @ R

    options: Any = {"gtol": SETTLED if among is None else COARSE, "maxiter": MOST, "initial_trust_radius": 0.5, "max_trust_radius": 2.0}
    result = minimize(
        lambda y: of.deviance(point(y)),
        np.zeros(len(chosen)),
        method="trust-exact",
        jac=gradient,
        hess=curvature,
        options=options,
    )
    return point(result.x)


def bands(count: int) -> list[slice]:
    """Returns at most `LAGS` bands of about equal numbers of frequencies."""
    edges = np.linspace(0, count, min(LAGS, max(1, count // 4)) + 1).astype(int).tolist()
    return [slice(a, b) for a, b in itertools.pairwise(edges)]


def spectral_fits(of: SpectralResiduals, x: Array) -> list[dict[str, float]]:
    """Returns for each experiment the fit of each signal; see the module docstring."""
    each = list[dict[str, float]]()
    for one in of.problem.experiments:
        rms = np.concatenate(
            [
                np.sqrt([[spectra.powers(matrices[part]) for part in bands(len(E))] for matrices in (spectra.measured, E)])
                for spectra, E in zip(of.spectra, of.expected(x), strict=True)
                if spectra.experiment is one
            ],
            axis=1,
        )  # of the measured and the expected signals in all bands, shape (2, bands, q)
        shares = np.linalg.norm(rms[0] - rms[1], axis=0) / np.linalg.norm(rms[0], axis=0)
        each.append({name: 1 - share for name, share in zip(one.signals, shares.tolist(), strict=True)})
    return each


def spectral_tests(of: SpectralResiduals, x: Array) -> list[dict[str, Whiteness]]:
    """Returns for each experiment the test of each signal; see the module docstring."""
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
    """Returns the test of a signal from the tests of its bands of frequencies."""
    correlations = np.concatenate([one.correlations for one in tests])
    outside = float(np.mean(np.abs(correlations) > tests[0].bound))
    least = min(1.0, len(tests) * min(one.probability for one in tests))
    return Whiteness(correlations, tests[0].bound, outside, least, sum(one.samples for one in tests))


def spectral_statement(of: SpectralEstimate) -> Statement:
    """Returns the statement on the test of the spectra."""
    if of.white:
        return Statement(
            "The spectra are as expected: vehicle, random road and noise explain all that the sensors show.", "holds"
        )
    names = {name for each in of.whiteness for name, one in each.items() if not one.white}
    return Statement(
        f"The spectra of {list_names(names)} are not as expected: the vehicle lacks something, or the road has another spectrum. "
        "The intervals account for a wrong scatter of the spectra, but they cannot account for a bias.",
        "fails",
    )


def spectral_figure(of: SpectralEstimate) -> Figure:
    """Returns a figure of the measured and the expected spectra of the first experiment."""
    panels, first = list[Panel](), of.problem.experiments[0]
    units = signal_units(of.problem.vehicle.kind)
    for i, name in enumerate(first.signals):
        curves = list[Curve]()
        for one, E in zip(of.residuals.spectra, of.residuals.expected(of.x), strict=True):
            if one.experiment is first:
                # The mean of a periodogram over a band has less scatter than the periodogram.
                parts = bands(len(E))
                middle, measured = (
                    np.array([values[part].mean() for part in parts]) for values in (one.frequencies, one.measured[:, i, i].real)
                )
                curves += [
                    Curve(middle, measured, "measured", "#9a9a9a", "none", "o"),
                    Curve(one.frequencies, E[:, i, i].real, "identified vehicle and road", "#0b5fa5"),
                ]
        panels.append(Panel(name, "frequency [Hz]", f"[({units[name]})²/Hz]", tuple(curves), xlog=True, ylog=True))
    return Figure("identification", f"Spectra of {first.name} and of the identified vehicle.", tuple(panels), columns=1)


def gamma_test(ratios: Sequence[Array], spectra: Periodograms) -> Whiteness:
    """Tests whether ratios of periodograms to their expected values have the distribution of the module docstring.

    Args:
        ratios: ratios of the same frequencies, each of shape (K,).
    """
    from scipy.special import chdtrc, gammainc, kolmogorov

    count, deviations, least = len(spectra.frequencies), list[Array](), 1.0
    for ratio in ratios:
        means, sizes = (
            np.array(one) for one in zip(*((ratio[part].mean(), part.stop - part.start) for part in bands(count)), strict=True)
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
