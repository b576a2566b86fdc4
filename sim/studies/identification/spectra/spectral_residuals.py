"""Residuals of the spectra of logs from a random road (`random_road`), and derivatives of these residuals.

Whittle's likelihood treats the spectra at different frequencies as independent. Let P be the measured matrix at a frequency, E
its expected value, and n = segments / inflation the number of independent segments. Then

    -2 log L = 2 n sum (log det E + tr E^-1 P).

With E = L L*, the residuals sqrt(n) (I - L^-1 P L^-*) and the derivatives sqrt(n) L^-1 dE L^-* give J'J, which is the expected
information (Fisher), and 2 J'c, which is the gradient of the deviance.

All unknowns are in one vector x: free parameters of vehicle and road as in `residuals`, delays of sensors [s], and noise. The
noise of a signal is represented by the logarithm of the noise rms, relative to the rms of the signal.
"""

import math
from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np

from models.common.arrays import Array
from sim.studies.identification.estimation.problem import IdentificationProblem
from sim.studies.identification.estimation.residuals import FURTHEST, Residuals
from sim.studies.identification.spectra.random_road import ROUGHNESS, Periodograms, RoadResponse, periodograms, road_values

LEAST_NOISE = 1e-4  # smallest noise rms relative to the signal's rms
FIRST_NOISE = 0.3  # initial noise rms relative to the signal's rms
NEAR_ZERO = 1e-6  # smallest ratio to the initial value of a parameter that may be zero


class SpectralResiduals(Residuals):
    """Residuals of the logs' spectra for one choice of free parameters.

    Attributes:
        problem: parameters and experiments; all experiments must have random roads.
        free: names of the p free parameters.
        delayed: index in x of each estimated sensor delay, by signal.
        noisy: index in x of each estimated noise rms, by signal.
        size: number of unknowns in x.
        spectra: measured spectra of all experiments.
    """

    def __init__(self, problem: IdentificationProblem, free: Sequence[str]) -> None:  # the base class would predict signals
        """Computes the periodograms of all experiments, and prepares the indices of the unknowns in x."""
        (road, *_) = [one.random for one in problem.experiments if one.random is not None]
        given = {one.signal: one.noise for each in problem.experiments for one in each.channels}
        unknown = [name for name in problem.signals if given[name] is None]
        self.problem, self.free, self.road = problem, tuple(free), road_values(road)
        self.delayed = {name: len(self.free) + i for i, name in enumerate(problem.delayed)}
        self.noisy = {name: len(self.free) + len(self.delayed) + i for i, name in enumerate(unknown)}
        self.size = len(self.free) + len(self.delayed) + len(self.noisy)
        self.given = {name: noise for name, noise in given.items() if noise is not None}
        self.spectra = [each for one in problem.experiments for each in periodograms(one)]
        self._at, self._now = None, (list[Array](), list[tuple[Array, Array]]())

    def values(self, x: Array) -> dict[str, float]:
        """Returns the values of all parameters of vehicle and road."""
        return {**self.road, **super().values(x)}

    def value(self, name: str, unknown: float) -> float:
        """Returns a parameter's value. For a parameter that may be zero, only the magnitude of the unknown matters, not its
        sign.
        """
        return super().value(name, max(abs(unknown), NEAR_ZERO) if name in self.problem.from_zero else unknown)

    @cached_property
    def scale(self) -> dict[str, float]:
        """Rms of each measured signal, computed from the frequencies that are used for the estimate."""
        squares = dict.fromkeys(self.problem.signals, 1e-300)
        for each in self.spectra:
            for name, square in zip(each.experiment.signals, each.powers(each.measured).tolist(), strict=True):
                squares[name] += square
        return {name: math.sqrt(square) for name, square in squares.items()}

    def noise(self, x: Array) -> dict[str, float]:
        """Returns the noise rms of each signal."""
        logs = {name: min(float(x[i]), FURTHEST) for name, i in self.noisy.items()}
        own = {name: self.scale[name] * math.exp(log) for name, log in logs.items()} | self.given
        return {name: max(own[name], LEAST_NOISE * self.scale[name]) for name in self.problem.signals}

    def first(self) -> Array:
        """Returns the initial values of the unknowns."""
        x, given = np.zeros(self.size), {one.signal: one.delay for each in self.problem.experiments for one in each.channels}
        x[: len(self.free)] = [self.coordinate(name, self.problem.first[name]) for name in self.free]
        x[list(self.delayed.values())] = [given[name] for name in self.delayed]
        x[list(self.noisy.values())] = math.log(FIRST_NOISE)
        return x

    @property
    def levels(self) -> list[int]:
        """Indices in x of the unknowns for roughness and noise."""
        return [i for i, name in enumerate(self.free) if name == ROUGHNESS] + [*self.noisy.values()]

    def expected(self, x: Array) -> list[Array]:
        """Returns the expected periodograms of all experiments, each of shape (K, q, q)."""
        self._evaluate(x)
        return self._now[0]

    def whitened(self, x: Array) -> list[tuple[Array, Array]]:
        """Returns I - L^-1 P L^-*, shape (K, q, q), and L^-1 dE L^-*, shape (K, unknowns, q, q), for each group of
        periodograms.
        """
        self._evaluate(x)
        return self._now[1]

    def _evaluate(self, x: Array) -> None:
        if self._at is not None and np.array_equal(self._at, x):
            return
        self._at, self._now, values = x.copy(), (list[Array](), list[tuple[Array, Array]]()), self.values(x)
        responses = {one: RoadResponse(self.problem, one, values, self.free) for one in self.problem.experiments}
        for one in self.spectra:
            whole = self._expected(one, responses[one.experiment], x)
            E = whole[:, 0]
            inverse = np.linalg.inv(np.linalg.cholesky(E))
            both = inverse[:, None] @ np.concatenate([one.measured[:, None], whole[:, 1:]], axis=1)
            both = both @ np.swapaxes(inverse.conj(), 1, 2)[:, None]
            self._now[0].append(E)
            self._now[1].append((np.eye(E.shape[1]) - both[:, 0], both[:, 1:]))

    def _expected(self, each: Periodograms, response: RoadResponse, x: Array) -> Array:
        """Returns the expected periodograms, followed by their derivatives with respect to the unknowns, shape (K, 1 +
        unknowns, q, q).
        """
        one, noise = each.experiment, self.noise(x)
        omega = 2 * np.pi * each.grid[0]
        F, changes = response(omega)
        turn = np.exp(-1j * omega[:, None] * np.array(self.delays(x, one)))[:, :, None]
        F, moved = turn * F, dict[int, Array]()
        for i, (name, change) in enumerate(zip(self.free, changes, strict=True)):
            zero = name in self.problem.from_zero
            moved[i] = turn * change / (math.copysign(max(abs(x[i]), NEAR_ZERO), x[i]) if zero else 1.0)
        for name, i in self.delayed.items():
            moved[i] = -1j * omega[:, None, None] * F * np.array([[channel.signal == name] for channel in one.channels])
        stack = np.zeros((len(omega), 1 + self.size, F.shape[1], F.shape[1]), dtype=complex)
        stack[:, 0] = F @ np.swapaxes(F.conj(), 1, 2)
        for i, change in moved.items():
            half = change @ np.swapaxes(F.conj(), 1, 2)
            stack[:, 1 + i] = half + np.swapaxes(half.conj(), 1, 2)
        for i, channel in enumerate(one.channels):
            power = 2 * one.step * noise[channel.signal] ** 2
            stack[:, 0, i, i] += power
            if channel.signal in self.noisy:
                stack[:, 1 + self.noisy[channel.signal], i, i] += 2 * power
        return each.expected(stack)

    def reduced(self, x: Array, noise: Mapping[str, float]) -> tuple[Array, Array]:
        """Returns the derivatives of all residuals, shape (N, unknowns), and the residuals, shape (N,).

        Args:
            noise: argument that is not used, because x contains the noise.
        """
        R, c = [self.known_columns(x)], [self._known(self.values(x))]
        for each, (left, changes) in zip(self.spectra, self.whitened(x), strict=True):
            size = math.sqrt(each.weight)
            columns = np.moveaxis(changes, 1, -1).reshape(left.size, len(x))
            R += [size * np.real(columns), size * np.imag(columns)]
            c += [size * np.real(left).ravel(), size * np.imag(left).ravel()]
        return np.concatenate(R), np.concatenate(c)

    def scores(self, x: Array) -> Array:
        """Returns half the gradient of the deviance at each frequency of all periodograms, shape (number of frequencies,
        unknowns).

        The sum of the outer products of the rows estimates the covariance of the sum of the rows. The estimate of the
        covariance is also valid if the spectra differ from their expected values.
        """
        rows = list[Array]()
        for each, (left, changes) in zip(self.spectra, self.whitened(x), strict=True):
            own = np.einsum("kuij,kij->ku", changes.conj(), left).real
            rows.append(each.weight * math.sqrt(each.inflation) * own)
        return np.concatenate(rows)

    def deviance(self, x: Array, noise: Mapping[str, float]) -> float:
        """Returns -2 log likelihood, up to a constant; `noise` is not used."""
        known = self._known(self.values(x))
        total = float(known @ known)
        for each, E, (left, _) in zip(self.spectra, self.expected(x), self.whitened(x), strict=True):
            total += 2 * each.weight * float(np.linalg.slogdet(E)[1].sum() - np.einsum("kii->", left).real)
        return total

    def fits(self, x: Array) -> list[dict[str, float]]:
        """Returns, for each experiment, the fit of the spectrum of each signal.

        The fit is 1 minus the relative difference between the measured and the expected rms in bands of frequencies. The
        relative difference is the root mean square over all bands. The part of the difference that is due to the scatter of a
        random road is subtracted.
        """
        fits = list[dict[str, float]]()
        for one in self.problem.experiments:
            rows = list[Array]()
            for each, E in zip(self.spectra, self.expected(x), strict=True):
                for part in each.bands if each.experiment is one else ():
                    measured, expected = each.powers(each.measured[part]), each.powers(E[part])
                    # relative variance of the rms of independent periodograms
                    scatter = each.powers(np.abs(E[part]) ** 2) * each.width / (4 * each.weight * expected**2)
                    rows.append(np.square(np.sqrt(measured / expected) - 1) - scatter)
            shares = np.sqrt(np.maximum(np.mean(rows, axis=0), 0.0))
            fits.append({name: 1 - share for name, share in zip(one.signals, shares.tolist(), strict=True)})
        return fits
