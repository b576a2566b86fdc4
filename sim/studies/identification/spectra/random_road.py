"""Spectra of logs from a random road, both as measured by the sensors and as predicted for a vehicle.

The road is not measured; only the form of its spectrum is known (ISO 8608). Let F be the frequency response of a vehicle from
the random sources of the road to the q sensors. The one-sided spectral matrix of the measurements is then

    S(f) = F F* + 2 h diag(noise^2),

where h is the sample time. F contains the delays between the wheels, so front and rear wheels drive over the same road.

Each log is divided into segments of equal length; for high frequencies, shorter segments are used. Each segment is multiplied
by a taper w that rises from 0 to 1 and falls back to 0. The periodogram, averaged over all segments, has the expected value E,
which is the convolution of S with the spectrum of the taper. The comparison of periodograms with E instead of S avoids the bias
due to leakage (A. M. Sykulski et al. (2019), Biometrika 106, 251-266). Periodograms at different frequencies are treated as
independent. The taper reduces the information in the periodograms by the factor N sum w^4 / (sum w^2)^2 (R. Dahlhaus (1988), J.
Multivariate Anal. 27, 55-83).
"""

import itertools
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
from sim.studies.identification.estimation.problem import IdentificationProblem
from sim.studies.identification.experiment import Experiment
from sim.studies.identification.prediction import LogPrediction, continuous_model
from sim.studies.identification.whiteness import LAGS

ROUGHNESS, WAVINESS = "roughness", "waviness"  # parameters of the road, in addition to those of the vehicle
ROAD_UNITS: Mapping[str, str] = {ROUGHNESS: "m3", WAVINESS: ""}
RAMP = 0.1  # share of a segment over which the taper rises, and over which it falls
# Each range of frequencies has its own length of segments, because resonances at high frequencies are wider. The numbers are the
# lower end of the range [Hz] and the longest segment [s].
RANGES = ((0.0, 60.0), (3.0, 12.0))
USABLE = 0.39  # largest usable frequency relative to the sampling rate; anti-aliasing filters act above it
FIRST = 3  # lowest frequency that is used, in units of 1 / length of a segment
REACH = 16  # half-width of the taper's spectrum in half-bins
FEWEST = 20  # a log is too short if its spectra have fewer frequencies than this
NARROW = 4  # smallest number of frequencies in a band for fits and tests
DIFFERENCE = 1e-5  # relative step of finite differences of matrices


@dataclass(frozen=True, eq=False)
class Periodograms:
    """Measured spectra of the segments of an experiment; all segments have the same length.

    Attributes:
        experiment: experiment from whose log the spectra are computed.
        frequencies: frequencies at which the periodograms are used [Hz], shape (K,).
        measured: mean of the segments' periodograms, shape (K, q, q); complex, one-sided.
        segments: number of segments into which the log is divided.
        inflation: factor by which the taper reduces the information.
        kernel: spectrum of the taper at frequency offsets of half a bin, shape (2 REACH + 1,); the sum is 1.
        first: index of the first frequency that is used, counted in bins from 0 Hz.
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
        """Number of independent segments that would contain the same information; smaller than `segments`, because the taper
        reduces the information.
        """
        return self.segments / self.inflation

    @property
    def width(self) -> float:
        """Spacing of the periodograms' frequencies [Hz]."""
        return float(self.frequencies[0]) / self.first

    def powers(self, spectra: Array) -> Array:
        """Returns the mean squares of the q signals, computed from the signals' spectra at some of the frequencies, shape
        (q,).
        """
        return np.real(np.einsum("kii->i", spectra)) * self.width

    @cached_property
    def bands(self) -> list[slice]:
        """Frequency bands for fits and tests; the width of each band is about proportional to its frequency."""
        last = self.first + len(self.frequencies)
        edges = [0]
        for edge in np.geomspace(self.first, last, LAGS + 1)[1:]:
            place = round(float(edge)) - self.first
            if place - edges[-1] >= NARROW and last - self.first - place >= NARROW:
                edges.append(place)
        return [slice(a, b) for a, b in itertools.pairwise([*edges, last - self.first])]

    @cached_property
    def grid(self) -> tuple[Array, Array]:
        """Frequencies at which the convolution is computed [Hz], half a bin apart, shape (J,), and True for frequencies below
        0, which are mirrored.
        """
        places = np.arange(2 * self.first - REACH, 2 * (self.first + len(self.frequencies) - 1) + REACH + 1)
        return np.maximum(np.abs(places), 1) * self.width / 2, places < 0

    def expected(self, spectra: Array) -> Array:
        """Returns the expected periodograms, shape (K, ...), from spectra at the frequencies `grid`, shape (J, ...)."""
        below = self.grid[1]
        spectra[below] = spectra[below].conj()
        last = 2 * len(self.frequencies) - 1
        return sum((share * spectra[i : i + last : 2] for i, share in enumerate(self.kernel)), np.zeros(1))


def free_road(experiments: Sequence[Experiment], fix: Sequence[str], free: Sequence[str]) -> dict[str, float] | None:
    """Returns the initial values of the free parameters of a random road; None if no experiment has a random road.

    By default, the roughness is free, and the waviness is fixed.

    Args:
        fix: names of parameters that keep their initial values; names of vehicle parameters are ignored, as in `free`.
        free: names of additional free parameters of the road.

    Raises:
        InputError: only some of the roads are random, or the initial values of the roads differ.
    """
    roads = [one.random for one in experiments if one.random is not None]
    if not roads:
        return None
    if len(roads) < len(experiments):
        raise InputError(
            "some logs have a random road, and others do not, but all logs of one estimate must be alike; identify the "
            "two groups separately"
        )
    if len({(one.roughness, one.waviness) for one in roads}) > 1:
        raise InputError("the random roads of the logs have different classes; give the same road for all logs")
    names = [name for name in ROAD_UNITS if name not in fix and (name == ROUGHNESS or name in free)]
    return {name: value for name, value in road_values(roads[0]).items() if name in names}


def road_values(road: Iso8608) -> dict[str, float]:
    """Returns the values of the parameters of a random road, by name."""
    return {ROUGHNESS: road.roughness * road.factor**2, WAVINESS: road.waviness}


def taper(count: int) -> Array:
    """Returns a taper with cosine ramps at both ends, shape (count,)."""
    ramp = max(1, round(RAMP * count))
    rise = np.sin(np.pi / 2 * (np.arange(ramp) + 0.5) / ramp) ** 2
    return np.concatenate([rise, np.ones(count - 2 * ramp), rise[::-1]])


def periodograms(experiment: Experiment) -> Iterator[Periodograms]:
    """Yields the measured spectra of an experiment in each range of frequencies.

    Raises:
        InputError: the log is too short for the frequency range of the road.
    """
    road = experiment.random
    assert road is not None
    values = np.stack([one.values for one in experiment.channels], axis=-1)
    low, high = road.lowest * road.speed, min(road.highest * road.speed, USABLE / experiment.step)
    ranges = [one for one in RANGES if one[0] < high]
    total = 0
    for (start, longest), (end, _) in zip(ranges, [*ranges[1:], (high, 0.0)], strict=True):
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
            f"{experiment.name}: the log has only {total} frequencies between {rough(low)} and {rough(high)} Hz, "
            "which are too few; give a longer log, or a road with a wider band of frequencies"
        )


class RoadResponse:
    """Frequency responses from the road to an experiment's sensors, and derivatives of these responses, for one set of free
    parameters.

    The road is represented by two independent sources with the one-sided spectral density 1.

    Args:
        problem: identification problem with the vehicle and its parameters.
        one: experiment whose log was recorded on a random road.
        values: values of all parameters, including those of the random road.
        free: names of the p parameters with respect to which the responses are differentiated.
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
        """Returns the frequency responses, shape (J, q, 2), and the derivatives of these responses with respect to the
        parameters' logarithms, in the same shape.

        Args:
            omega: angular frequencies at which the responses are computed [rad/s], shape (J,).
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
    """Returns the matrices A, Bv, Bd, C, Dv and Dd of `continuous_model`, with the road as the only input."""
    A, Bv, Bd, C, Dv, Dd = continuous_model(vehicle, one)
    r = one.road.shape[1]
    return [A, Bv[:, :r], Bd[:, :r], C, Dv[:, :r], Dd[:, :r]]
