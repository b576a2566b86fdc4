"""Likelihood of logs from a random road: spectra of all sensors, compared with the spectra that the vehicle predicts.

The road is not measured; only its spectrum has a known form (ISO 8608). A vehicle with the frequency response F from the random
sources of the road to the q sensors has measurements with the one-sided spectral matrix

    S(f) = F F* + 2 h diag(noise^2),

for the sample time h. F contains the delays of the wheels, so front and rear wheels share a road.

Periodograms. Each log is divided into segments of equal length, which is shorter for high frequencies. A segment is multiplied
by a taper w that rises from 0 to 1 and falls back to 0. The periodogram of the segment, averaged over the segments, has the
expected value E, which is the convolution of S with the spectrum of the taper. Whittle's likelihood treats the spectra at
different frequencies as independent,

    -2 log L = 2 n sum (log det E + tr E^-1 P),    n = segments / inflation,

where P is the measured matrix. Tapers reduce the information by the factor inflation = N sum w^4 / (sum w^2)^2 (R. Dahlhaus
(1988), J. Multivariate Anal. 27, 55-83). The expected value E instead of S removes the bias of leakage (A. M. Sykulski et al.
(2019), Biometrika 106, 251-266).

Least squares. With E = L L*, the residuals sqrt(n) (I - L^-1 P L^-*) and the derivatives sqrt(n) L^-1 dE L^-* give J'J, which
is the expected information (Fisher), and 2 J'c, which is the gradient of the deviance. The search for the maximum is Fisher's
scoring in a trust region.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.printed import rough
from models.roads.iso8608 import Iso8608
from models.roads.spectrum import N0, as_met, tracks
from models.vehicle.vehicle import Vehicle
from sim.studies.identification.estimate import IdentificationProblem
from sim.studies.identification.experiment import Experiment
from sim.studies.identification.prediction import LogPrediction, continuous_model

ROUGHNESS, WAVINESS = "roughness", "waviness"  # parameters of the road, in addition to those of the vehicle
ROAD_UNITS: Mapping[str, str] = {ROUGHNESS: "m3", WAVINESS: ""}
RAMP = 0.1  # share of a segment over which the taper rises, and over which it falls
# Each band of frequencies has its own length of segments, because resonances at high frequencies are wider: the lower end of the
# band [Hz], and the longest segment [s]
BANDS = ((0.0, 60.0), (3.0, 12.0))
USABLE = 0.39  # largest usable frequency relative to the sampling rate; filters against aliasing act above it
FIRST = 3  # lowest frequency that is used, in units of 1 / length of a segment
REACH = 16  # half-width of the taper's spectrum in half-bins
FEWEST = 20  # smallest number of frequencies
FURTHEST = 9.0  # largest change of a logarithm: a factor of 8000
DIFFERENCE = 1e-5  # relative step of finite differences of matrices
LEAST_NOISE = 1e-4  # smallest noise rms relative to the signal's rms


@dataclass(frozen=True, eq=False)
class Periodograms:
    """Measured spectra of the segments of an experiment, which all have the same length.

    Attributes:
        experiment: the experiment.
        frequencies: frequencies that are used [Hz], shape (K,).
        measured: mean of the periodograms, shape (K, q, q); complex, one-sided.
        segments: number of segments.
        inflation: factor by which the taper reduces the information.
        kernel: spectrum of the taper at offsets of half a bin, shape (2 REACH + 1,); the sum is 1.
        first: index of the first frequency; the spacing of the indices is one bin.
    """

    experiment: Experiment
    frequencies: Array
    measured: Array
    segments: int
    inflation: float
    kernel: Array
    first: int

    @property
    def weight(self) -> float:
        """Number of independent segments, n in the module docstring."""
        return self.segments / self.inflation

    def powers(self, spectra: Array) -> Array:
        """Returns the mean squares of the q signals with spectra at some of the frequencies, shape (q,)."""
        return np.einsum("kii->i", spectra).real * self.frequencies[0] / self.first

    @cached_property
    def grid(self) -> tuple[Array, Array]:
        """Frequencies of the convolution [Hz], half a bin apart, shape (J,), and True for those below 0, which are mirrored."""
        places = np.arange(2 * self.first - REACH, 2 * (self.first + len(self.frequencies) - 1) + REACH + 1)
        bin_width = self.frequencies[0] / self.first
        return np.maximum(np.abs(places), 1) * bin_width / 2, places < 0

    def expected(self, spectra: Array) -> Array:
        """Returns the expected periodograms, shape (K, ...), of spectra on the grid, shape (J, ...)."""
        below = self.grid[1]
        spectra[below] = spectra[below].conj()
        last = 2 * len(self.frequencies) - 1
        return sum((share * spectra[i : i + last : 2] for i, share in enumerate(self.kernel)), np.zeros(1))


def free_road(experiments: Sequence[Experiment], fix: Sequence[str], free: Sequence[str]) -> dict[str, float] | None:
    """Returns the initial values of the free parameters of a random road; None if the road of no experiment is random.

    The roughness is free, and the waviness is fixed, by default.

    Args:
        fix: names of parameters that keep their values; parameters of the vehicle are ignored, as in `free`.
        free: names of additional free parameters.

    Raises:
        InputError: only some of the roads are random, or the roads have different initial values.
    """
    roads = [one.random for one in experiments if one.random is not None]
    if not roads:
        return None
    if len(roads) < len(experiments):
        raise InputError("some logs have a random road, and others do not; identify them separately")
    if len({(one.roughness, one.waviness) for one in roads}) > 1:
        raise InputError("the random roads of the logs have different classes; give the same road for all logs")
    names = [name for name in ROAD_UNITS if name not in fix and (name == ROUGHNESS or name in free)]
    return {name: value for name, value in road_values(roads[0]).items() if name in names}


def road_values(road: Iso8608) -> dict[str, float]:
    """Returns the parameters of a random road by name."""
    return {ROUGHNESS: road.roughness * road.factor**2, WAVINESS: road.waviness}


def taper(count: int) -> Array:
    """Returns a taper with cosine ramps at both ends, shape (count,)."""
    ramp = max(1, round(RAMP * count))
    rise = np.sin(np.pi / 2 * (np.arange(ramp) + 0.5) / ramp) ** 2
    return np.concatenate([rise, np.ones(count - 2 * ramp), rise[::-1]])


def periodograms(experiment: Experiment) -> Iterator[Periodograms]:
    """Yields the measured spectra of an experiment in each band.

    Raises:
        InputError: the log is too short for the frequencies of the road.
    """
    road = experiment.random
    assert road is not None
    values = np.stack([one.values for one in experiment.channels], axis=-1)
    low, high = road.lowest * road.speed, min(road.highest * road.speed, USABLE / experiment.step)
    bands = [one for one in BANDS if one[0] < high]
    total = 0
    for (start, longest), (end, _) in zip(bands, [*bands[1:], (high, 0.0)], strict=True):
        segments = max(1, round(len(values) * experiment.step / longest))
        count = len(values) // segments
        window, duration = taper(count), count * experiment.step
        first, last = max(math.ceil(max(low, start) * duration), FIRST), math.ceil(end * duration) - 1
        total += max(0, last + 1 - first)
        if last <= first:
            continue
        measured = np.zeros((last - first + 1, values.shape[1], values.shape[1]), dtype=complex)
        for each in values[: segments * count].reshape(segments, count, -1):
            centred = each - window @ each / window.sum()
            Y = np.fft.rfft(window[:, None] * centred, axis=0)[first : last + 1]
            measured += Y[:, :, None] * Y[:, None].conj() * (2 * experiment.step / (window @ window) / segments)
        whole = np.abs(np.fft.fft(window, 2 * count)) ** 2
        kernel = whole[np.abs(np.arange(-REACH, REACH + 1))]
        inflation = count * float(np.sum(window**4)) / float(window @ window) ** 2
        yield Periodograms(
            experiment, np.arange(first, last + 1) / duration, measured, segments, inflation, kernel / kernel.sum(), first
        )
    if total < FEWEST:
        raise InputError(
            f"{experiment.name}: the log has only {total} frequencies between {rough(low)} and {rough(high)} Hz; give a longer "
            "log, or a wider band of the road"
        )


class RoadResponse:
    """Frequency responses of an experiment's sensors to the road, and their derivatives, for one choice of parameters.

    The road has two independent sources with the one-sided spectral density 1.

    Args:
        problem: the problem.
        one: the experiment.
        values: values of all parameters, including the road's.
        free: names of the p parameters for the derivatives.
    """

    def __init__(self, problem: IdentificationProblem, one: Experiment, values: Mapping[str, float], free: Sequence[str]) -> None:
        assert one.random is not None
        self.road, self.values, self.free = one.random, values, free
        prediction = LogPrediction(one, lambda values: problem.change(problem.vehicle, values))
        moved = {
            name: [{**values, name: values[name] * (1 + sign * DIFFERENCE)} for sign in (1, -1)]
            for name in free
            if name not in ROAD_UNITS
        }
        self._vehicle = prediction.vehicle(values)
        self._moved = {name: [prediction.vehicle(one) for one in ends] for name, ends in moved.items()}
        self._model = _matrices(self._vehicle, one)
        self._changes = {
            name: [(a - b) / (2 * DIFFERENCE) for a, b in zip(*(_matrices(end, one) for end in ends), strict=True)]
            for name, ends in self._moved.items()
        }

    def __call__(self, omega: Array) -> tuple[Array, list[Array]]:
        """Returns the responses, shape (J, q, 2), and the derivative by the logarithm of each free parameter, of the same shape.

        Args:
            omega: angular frequencies [rad/s], shape (J,).
        """
        (A, Bv, Bd, C, Dv, Dd), values, speed = self._model, self.values, self.road.speed
        s = 1j * omega[:, None, None]
        through = np.linalg.inv(s * np.eye(len(A)) - A)
        X, Z = through @ (Bv + s * Bd), C @ through
        amplitude = math.sqrt((2 * np.pi * N0) ** 2 * values[ROUGHNESS] * speed)
        met, shares = as_met(self._vehicle, omega, speed)[:, None], self._tracks(omega, values[WAVINESS])
        G = (C @ X + Dv + s * Dd) / s * amplitude
        F, changes = (G * met) @ shares, list[Array]()
        for name in self.free:
            if name == ROUGHNESS:
                changes.append(F / 2)
            elif name == WAVINESS:
                ends = (self._tracks(omega, values[name] * (1 + sign * DIFFERENCE)) for sign in (1, -1))
                changes.append((G * met) @ ((next(ends) - next(ends)) / (2 * DIFFERENCE)))
            else:
                dA, dBv, dBd, dC, dDv, dDd = self._changes[name]
                dG = (Z @ (dA @ X + dBv + s * dBd) + dC @ X + dDv + s * dDd) / s * amplitude
                ends = (as_met(end, omega, speed) for end in self._moved[name])
                dmet = (next(ends) - next(ends))[:, None] / (2 * DIFFERENCE)
                changes.append((dG * met + G * dmet) @ shares)
        return F, changes

    def _tracks(self, omega: Array, waviness: float) -> Array:
        return tracks(self._vehicle, replace(self.road.spectrum, waviness=waviness), omega)


def _matrices(vehicle: Vehicle, one: Experiment) -> list[Array]:
    """Returns A, Bv, Bd, C, Dv and Dd of `continuous_model` for the road alone."""
    A, Bv, Bd, C, Dv, Dd = continuous_model(vehicle, one)
    r = one.road.shape[1]
    return [A, Bv[:, :r], Bd[:, :r], C, Dv[:, :r], Dd[:, :r]]


@dataclass(frozen=True, eq=False)
class SpectralUnknowns:
    """Names of all unknowns: logarithms of parameters of vehicle and road, delays of sensors, and logarithms of noise rms."""

    free: tuple[str, ...]
    delayed: tuple[str, ...]
    noisy: tuple[str, ...]

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return len(self.free) + len(self.delayed) + len(self.noisy)


class SpectralResiduals:
    """Residuals of the spectra of all experiments, and their derivatives, for one choice of free parameters.

    Args:
        problem: the problem, in which the roads of all experiments are random.
        free: names of the free parameters.
    """

    def __init__(self, problem: IdentificationProblem, free: Sequence[str]) -> None:
        (road, *_) = [one.random for one in problem.experiments if one.random is not None]
        self.problem, self.fixed = problem, {**road_values(road), **problem.first}
        given = {one.signal: one.noise for each in problem.experiments for one in each.channels}
        noisy = tuple(name for name in problem.signals if given[name] is None)
        self.given = {name: noise for name, noise in given.items() if noise is not None}
        self.unknowns = SpectralUnknowns(tuple(free), problem.delayed, noisy)
        self.spectra = [each for one in problem.experiments for each in periodograms(one)]
        self._at, self._now = None, (list[Array](), list[tuple[Array, Array]]())

    @cached_property
    def scale(self) -> dict[str, float]:
        """Rms of each signal in the band that is used."""
        squares = dict.fromkeys(self.problem.signals, 1e-300)
        for each in self.spectra:
            for name, square in zip(each.experiment.signals, each.powers(each.measured).tolist(), strict=True):
                squares[name] += square
        return {name: math.sqrt(square) for name, square in squares.items()}

    def values(self, x: Array) -> dict[str, float]:
        """Returns the values of all parameters."""
        logs = np.clip(x, -FURTHEST, FURTHEST)
        changes = dict(zip(self.unknowns.free, logs.tolist(), strict=False))
        return {name: value * math.exp(changes.get(name, 0.0)) for name, value in self.fixed.items()}

    def delays(self, x: Array) -> dict[str, float]:
        """Returns the estimated delays [s]."""
        return dict(zip(self.unknowns.delayed, x[len(self.unknowns.free) :].tolist(), strict=False))

    def noise(self, x: Array) -> dict[str, float]:
        """Returns the noise rms of each signal."""
        logs = x[self.unknowns.size - len(self.unknowns.noisy) :].tolist()
        own = {name: self.scale[name] * math.exp(min(log, FURTHEST)) for name, log in zip(self.unknowns.noisy, logs, strict=True)}
        return {name: max({**own, **self.given}[name], LEAST_NOISE * self.scale[name]) for name in self.problem.signals}

    def first(self) -> Array:
        """Returns initial unknowns: the given parameters, the given delays, and a noise of a third of each signal."""
        u = self.unknowns
        given = {one.signal: one.delay for each in self.problem.experiments for one in each.channels}
        return np.array([0.0] * len(u.free) + [given[name] for name in u.delayed] + [math.log(0.3)] * len(u.noisy))

    def expected(self, x: Array) -> list[Array]:
        """Returns the expected periodograms, shape (K, q, q)."""
        self._evaluate(x)
        return self._now[0]

    def whitened(self, x: Array) -> list[tuple[Array, Array]]:
        """Returns I - L^-1 P L^-*, shape (K, q, q), and L^-1 dE L^-*, shape (K, unknowns, q, q), of all periodograms."""
        self._evaluate(x)
        return self._now[1]

    def _evaluate(self, x: Array) -> None:
        if self._at is not None and np.array_equal(self._at, x):
            return
        self._at, self._now = x.copy(), (list[Array](), list[tuple[Array, Array]]())
        values = self.values(x)
        responses = {one: RoadResponse(self.problem, one, values, self.unknowns.free) for one in self.problem.experiments}
        for one in self.spectra:
            whole = self._expected(one, responses[one.experiment], x)
            E = whole[:, 0]
            inverse = np.linalg.inv(np.linalg.cholesky(E))
            both = inverse[:, None] @ np.concatenate([one.measured[:, None], whole[:, 1:]], axis=1)
            both = both @ np.swapaxes(inverse.conj(), 1, 2)[:, None]
            self._now[0].append(E)
            self._now[1].append((np.eye(E.shape[1]) - both[:, 0], both[:, 1:]))

    def _expected(self, each: Periodograms, response: RoadResponse, x: Array) -> Array:
        """Returns the expected periodograms, followed by their derivatives, shape (K, 1 + unknowns, q, q)."""
        u, one, noise, own = self.unknowns, each.experiment, self.noise(x), self.delays(x)
        omega = 2 * np.pi * each.grid[0]
        F, changes = response(omega)
        late = np.array([own.get(channel.signal, channel.delay) for channel in one.channels])
        turn = np.exp(-1j * omega[:, None] * late)[:, :, None]
        F, changes = turn * F, [turn * change for change in changes]
        for name in u.delayed:
            delayed = np.array([channel.signal == name for channel in one.channels])
            changes.append(-1j * omega[:, None, None] * F * delayed[:, None])
        S = F @ np.swapaxes(F.conj(), 1, 2)
        stack = np.zeros((len(omega), 1 + u.size, *S.shape[1:]), dtype=complex)
        stack[:, 0] = S
        for i, change in enumerate(changes):
            half = change @ np.swapaxes(F.conj(), 1, 2)
            stack[:, 1 + i] = half + np.swapaxes(half.conj(), 1, 2)
        for i, channel in enumerate(one.channels):
            stack[:, 0, i, i] += 2 * one.step * noise[channel.signal] ** 2
            if channel.signal in u.noisy:
                place = 1 + u.size - len(u.noisy) + u.noisy.index(channel.signal)
                stack[:, place, i, i] += 4 * one.step * noise[channel.signal] ** 2
        return each.expected(stack)

    def reduced(self, x: Array, noise: Mapping[str, float] | None = None) -> tuple[Array, Array]:
        """Returns R and c of the least-squares problem, shapes (N, unknowns) and (N,). The noise is contained in x."""
        R, c = [self.known_columns(x)], [self._known(self.values(x))]
        for each, (left, changes) in zip(self.spectra, self.whitened(x), strict=True):
            size = math.sqrt(each.weight)
            columns = np.moveaxis(changes, 1, -1).reshape(left.size, len(x))
            R += [size * columns.real, size * columns.imag]
            c += [size * left.real.ravel(), size * left.imag.ravel()]
        return np.concatenate(R), np.concatenate(c)

    def scores(self, x: Array) -> list[Array]:
        """Returns the gradients of -log L at each frequency of all periodograms, shape (K, unknowns), scaled to be independent.

        The sum of their outer products estimates the covariance of the gradient, even if the spectra are not as expected.
        """
        rows = list[Array]()
        for each, (left, changes) in zip(self.spectra, self.whitened(x), strict=True):
            own = np.einsum("kuij,kij->ku", changes.conj(), left).real
            rows.append(each.weight * math.sqrt(each.inflation) * own)
        return rows

    def deviance(self, x: Array) -> float:
        """Returns -2 log L, up to a constant."""
        known = self._known(self.values(x))
        total = float(known @ known)
        for each, E, (left, _) in zip(self.spectra, self.expected(x), self.whitened(x), strict=True):
            total += 2 * each.weight * float(np.linalg.slogdet(E)[1].sum() - np.einsum("kii->", left).real)
        return total

    def _known(self, values: Mapping[str, float]) -> Array:
        if not self.problem.known:
            return np.zeros(0)
        vehicle = self.problem.change(self.problem.vehicle, values)
        return np.array([(one.of(vehicle) - one.value) / one.deviation for one in self.problem.known])

    def known_columns(self, x: Array) -> Array:
        """Returns the derivatives of the known combinations, each divided by its standard deviation, shape (k, unknowns)."""
        values, columns = self.values(x), np.zeros((len(self.problem.known), len(x)))
        for i, name in enumerate(self.unknowns.free if self.problem.known else ()):
            ahead = {**values, name: values[name] * (1 + 1e-6)}
            columns[:, i] = (self._known(ahead) - self._known(values)) / 1e-6
        return columns
