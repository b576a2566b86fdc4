"""International Roughness Index (IRI) of any road: response of the golden car over a distance, or the mean over random roads.

Source: M. W. Sayers (1995), "On the calculation of International Roughness Index from longitudinal road profile",
Transportation Research Record 1501, 1-12; ASTM E1926. The golden car, a quarter-car with fixed parameters, drives at 80 km/h
over the heights h_i of one track, sampled every `step`. The tyre of the golden car follows the moving average of the heights
over 250 mm, so the slope is constant between samples:

    s_i = (h_(i+b) - h_i) / (b step),    b step = 250 mm, b at least 1.

The car starts in steady motion along the mean slope of the first 11 m. The IRI is the mean of the magnitude of the suspension
slope, |z_s' - z_u'| / V, where V is the speed. Because the slope is constant between samples, the state transition is exact.
The transition is computed in the modal coordinates of the car.

A profile with evenly spaced points is used unchanged; a road without such points is sampled every 25 mm. A vehicle with two
tracks has an IRI for each track, `left` and `right`. The value `mean` is the mean of both tracks' IRIs (MRI). The value
`half_car` is the IRI of the mean of both profiles (HRI), which does not contain the warp of the road. Names: M. W. Sayers and
S. M. Karamihas (1998), "The little book of profiling", UMTRI.

On a random road, the response y of the car is Gaussian with the variance s^2, so the mean of |y| is sqrt(2/pi) s. If rho is the
correlation of the responses y and y' at two places, cov(|y|, |y'|) = (2/pi) s^2 (sqrt(1 - rho^2) + rho asin rho - 1). The
covariance of |y| at two places determines the standard deviation of the IRI among random roads of the same length.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from models.common.arrays import Array
from models.roads.profile import START, Profile
from models.roads.road import Departure, Road, track_width
from models.roads.spectrum import Spectrum, coherency, slope_power
from models.vehicle.vehicle import Vehicle

SPEED = 80 / 3.6  # speed of the golden car [m/s], the reference vehicle of the IRI
# Parameters of the golden car: k_s/m_s and k_u/m_s [1/s2], c/m_s [1/s], m_u/m_s
SPRING, TYRE, DAMPER, WHEEL = 63.3, 653.0, 6.0, 0.15
BASE = 0.25  # length of the moving average of the profile [m]
SETTLING_DISTANCE = 100.0  # over this distance [m], the effect of the initial state decays to 1e-5
# A response is truncated where it has decayed to this share of its first value, which is below the rounding error
FORGOTTEN = 1e-18

# The states of the golden car are z_s, z_s', z_u and z_u'. Derivatives are with respect to distance, not time. The input is the
# slope of the profile.
A = np.array(
    [
        [0.0, 1.0, 0.0, 0.0],
        [-SPRING, -DAMPER, SPRING, DAMPER],
        [0.0, 0.0, 0.0, 1.0],
        [SPRING / WHEEL, DAMPER / WHEEL, -(SPRING + TYRE) / WHEEL, -DAMPER / WHEEL],
    ]
)
B = np.array([0.0, 0.0, 0.0, TYRE / WHEEL])
C = np.array([1.0, 0.0, -1.0, 0.0])


def roughness_index(heights: Array, step: float) -> float:
    """Returns the IRI of a profile [m/km].

    Args:
        heights: heights of one track [m], over at least 11 m, shape (P,).
        step: distance between heights [m].
    """
    return 1e3 * float(np.abs(suspension_slopes(heights, step)).mean())


def suspension_slopes(heights: Array, step: float) -> Array:
    """Returns the suspension slope (z_s' - z_u') / V after every sample [-], shape (P - b,), if the tyre averages the heights
    over b samples.

    Args:
        heights: heights of one track [m], shape (P,).
        step: distance between heights [m].
    """
    base, first = _samples(step), min(max(round(START / step), 1), len(heights))
    slopes = (heights[base:] - heights[:-base]) / (base * step)
    # Mean slope at the start of the profile, as in the program listing of Sayers (1995)
    start = (heights[first - 1] - heights[0]) / (step * first)
    answer, settling, size = _answers(step, len(slopes))
    travel_slopes = np.fft.irfft(np.fft.rfft(slopes, size) * answer, size)[: len(slopes)]
    travel_slopes[: len(settling)] += start * settling
    return travel_slopes


def slope_response(n: Array, step: float) -> Array:
    """Returns the frequency response from a profile's slope to `suspension_slopes`, complex, same shape as n.

    Args:
        n: spatial frequencies, not 0 [cycle/m].
        step: distance between samples [m].
    """
    rates, of_slopes, _ = _modes(step)
    turn = np.exp(2j * np.pi * np.asarray(n) * step)
    averaged = (turn ** _samples(step) - 1) / (2j * np.pi * np.asarray(n) * _samples(step) * step)
    return averaged * sum(share / (1 - np.exp(rate) / turn) for rate, share in zip(rates, of_slopes, strict=True))


def missing(lines: Array, variances: Array) -> Array:
    """Returns how far the rms of `suspension_slopes` is below its final value after the start (the deficit), accumulated over
    the distance.

    The deficit is relative to the final value of the rms, and is given every 250 mm. The response to a sinusoid is the
    steady-state response plus a transient in each mode of the car. Sinusoids and places are evenly spaced, so the sum of the
    products of steady-state response and transient over all sinusoids is a Fourier transform.

    Args:
        lines: spatial frequencies of a random road in multiples of 1 / `COUNTED_LINES` cycle/m, ascending positive integers,
            shape (F,).
        variances: variance of the road's slope at each spatial frequency, shape (F,).

    Returns:
        Accumulated deficit of the rms [m], with one value every 250 mm.
    """
    rates, of_slopes, of_start = _modes(STEP)
    base, first, way = _samples(STEP), round(START / STEP), 2j * np.pi * lines / COUNTED_LINES
    turn = np.exp(way * STEP)
    # Steady-state response before sample 0, for each mode
    before = of_slopes / (1 - np.multiply.outer(1 / turn, np.exp(rates)))
    averaged = (turn**base - 1) / (way * base * STEP)
    start = (turn ** (first - 1) - 1) / (way * first * STEP)
    away, moving = start[:, None] * of_start - (averaged / turn)[:, None] * before, averaged * before.sum(axis=-1)

    at = np.arange(0, math.ceil(SETTLING_DISTANCE / STEP), base)
    modes, period = (
        np.exp(np.outer(at + 1, rates)),
        round(COUNTED_LINES / (base * STEP)),
    )  # the phases of the sinusoids repeat after this number of sinusoids
    folded = np.zeros((-(-(int(lines[-1]) + 1) // period) * period, len(rates)), dtype=complex)
    folded[lines] = away * (variances * np.conj(moving))[:, None]
    both = np.fft.fft(folded.reshape(-1, period, len(rates)).sum(axis=0), axis=0)[: len(at)]
    squares = np.einsum("ki,ij,kj->k", np.conj(modes), (np.conj(away.T) * variances) @ away, modes)
    final = float(np.abs(moving) ** 2 @ variances)
    rms = np.sqrt(1 + np.real(squares + 2 * (modes * both).sum(axis=1)) / final)
    return np.cumsum(1 - rms) * base * STEP


def _samples(step: float) -> int:
    """Returns the number of samples over which the moving average is taken."""
    return max(round(BASE / step), 1)


@lru_cache(maxsize=16)
def _modes(step: float) -> tuple[Array, Array, Array]:
    """Returns the modes of the golden car for a profile that is sampled every `step` metres.

    Returns:
        Rate of each mode per sample, and the mode's factors in the response to a slope and in the response to the initial
        state.
    """
    values, vectors = np.linalg.eig(A)
    time = step / SPEED
    shapes, start = C @ vectors, np.array([1.0, 0.0, 1.0, 0.0])
    inputs = np.expm1(values * time) / values * np.linalg.solve(vectors, B)
    return values * time, shapes * inputs, shapes * np.linalg.solve(vectors, start.astype(complex))


@lru_cache(maxsize=4)
def _answers(step: float, count: int) -> tuple[Array, Array, int]:
    """Returns the Fourier transform of the response to a slope, the response to the initial state, and the length of the
    transform.

    The response to the initial state begins before the first sample, and is truncated at `FORGOTTEN`. The result is cached,
    because a campaign needs it for every road.
    """
    rates, of_slopes, of_start = _modes(step)
    remembered = min(count, math.ceil(math.log(FORGOTTEN) / np.real(rates).max()))
    powers = np.exp(np.outer(np.arange(remembered + 1), rates))
    size = 1 << (count + remembered - 1).bit_length()
    return np.fft.rfft(np.real(powers[:-1] @ of_slopes), size), np.real(powers[1:] @ of_start), size


TRACKS = ("left", "right", "mean", "half_car")  # names of the IRIs that a vehicle with two tracks has
STEP = 0.025  # distance between samples of the profile [m]: a tenth of the length of the moving average
COARSEST = 0.3  # largest spacing of samples [m]; ASTM E1926 does not define the IRI for larger spacings
# If the spacing varies by less than this share, the variation counts as a rounding error of distances or coordinates
EVEN = 0.01
ROUNDING = 1e-6  # the largest spacing of samples may be exceeded by this relative rounding error
SHORTEST = START + BASE  # an IRI needs a profile of at least this length [m]
LONGEST = 1e5  # largest distance that is evaluated [m]
# Number of sinusoids per cycle/m with which the effect of the start is computed; this effect ends within a fifth of 512 m
COUNTED_LINES = 512.0
# Number of sinusoids per cycle/m that represent a spectrum; a transient of the golden car ends within a tenth of 4096 m
GRAIN = 4096.0
# Number of points per cycle/m in integrals over a spectrum; a resonance is a hundred times wider than the distance between
# points
LINES = 8192


@dataclass(frozen=True)
class Roughness:
    """The IRI of one track of a road, or of both tracks together.

    Attributes:
        name: name of the track, `left` or `right`; or `mean` or `half_car` for both tracks.
        iri: roughness index of the road [m/km].
        expected: mean of the IRI over all roads with the spectrum of this road [m/km]; None for a road without a spectrum.
        spread: standard deviation of the IRI over all roads with the spectrum of this road [m/km]; None for a road without a
            spectrum.
    """

    name: str
    iri: float
    expected: float | None = None
    spread: float | None = None


def roughness_of(road: Road, vehicle: Vehicle, distance: float) -> tuple[Roughness, ...]:
    """Returns every IRI of a road over a driven distance: that of each track, and those of both tracks together.

    The list is empty for a rig, if the road is too short, or if the points of a profile are too far apart.

    Args:
        road: the road over which the car drives; a measured profile ends at its last point.
        vehicle: the vehicle, whose track width determines the tracks.
        distance: driven distance [m].
    """
    if not road.laid:
        return ()
    road = _without_loads(road)
    width = track_width(vehicle)
    step, tracks = _sample_tracks(road, min(distance, LONGEST), ("left", "right") if width else ("left",))
    if step > COARSEST * (1 + ROUNDING) or len(tracks) * step <= SHORTEST:
        return ()
    values = {"left": roughness_index(tracks[:, 0], step)}
    if width:
        values["right"] = roughness_index(tracks[:, 1], step)
        values |= {"mean": (values["left"] + values["right"]) / 2, "half_car": roughness_index(tracks.mean(axis=1), step)}
    if (spectrum := road.spectrum) is None:
        return tuple(Roughness(name, iri) for name, iri in values.items())
    expected = _expected_indices(spectrum, len(tracks) * step, tuple(values))
    return tuple(Roughness(name, iri, *expected[name]) for name, iri in values.items())


def why_none(road: Road) -> str:
    """Returns a note if a road from a file has no IRI because its points are too far apart; empty otherwise."""
    profile = _without_loads(road)
    step = float(np.median(np.diff(profile.distance))) if isinstance(profile, Profile) else 0.0
    coarse = f"no iri: the road's points are {step:.3g} m apart, but ASTM E1926 allows at most {COARSEST:g} m"
    return coarse if step > COARSEST * (1 + ROUNDING) else ""


def _without_loads(road: Road) -> Road:
    """Returns a measured road without its loads. A road that is not measured is returned unchanged."""
    felt = road.from_start
    return felt.road if isinstance(felt, Departure) else road


def slope_density(iri: float, low: float, high: float, waviness: float) -> float:
    """Returns the one-sided spectral density of the slope at `N0` [m/cycle] for a random road with a given mean IRI.

    Args:
        iri: mean roughness index [m/km].
        low: lower end of the road's frequency band [cycle/m].
        high: upper end of the road's frequency band [cycle/m].
        waviness: exponent of the road spectrum; for the exponent 2, the slope is white noise.
    """
    return math.pi / 2 * (iri / 1e3) ** 2 / _unit_variance(low, high, waviness)


@lru_cache(maxsize=16)
def _unit_variance(low: float, high: float, waviness: float) -> float:
    """Returns the variance of the car's response to a random road, divided by the spectral density of the road's slope at `N0`
    [cycle/m].
    """
    count = math.ceil((high - low) * LINES)
    n = low + (np.arange(count) + 0.5) * (high - low) / count
    return float(np.sum(np.abs(slope_response(n, STEP)) ** 2 * slope_power(n, waviness))) * (high - low) / count


def _sample_tracks(road: Road, distance: float, sides: tuple[str, ...]) -> tuple[float, Array]:
    """Returns the distance between samples of a road [m], and the heights of the road's tracks at the samples [m], shape (P,
    tracks).
    """
    if isinstance(road, Profile):
        spacing = np.diff(road.distance)
        step = float(np.median(spacing))
        heights = road.heights[: round(distance / step) + 1, : len(sides)]
        if np.ptp(spacing) <= EVEN * step or step > COARSEST * (1 + ROUNDING):
            return step, heights
        distance = min(distance, float(road.distance[-1] - road.distance[0]))
    t = np.arange(math.floor(distance / STEP) + 1) * (STEP / road.speed)
    return STEP, np.stack([road.displacement(t, side) for side in sides], axis=-1)


@lru_cache(maxsize=16)
def _expected_indices(spectrum: Spectrum, distance: float, names: tuple[str, ...]) -> dict[str, tuple[float, float]]:
    """Returns mean and standard deviation of the named IRIs over all roads that have the given spectrum, for a driven distance
    [m].

    The sinusoids of a road have fixed amplitudes, unlike those of a Gaussian signal, so the mean square over the road's whole
    length is known. On the left track, the mean square of every sinusoid is the same for all roads. On the right track, the
    share 2 a^2 (1 - a^2) of a sinusoid's mean square varies, where a is the coherency of the tracks. The known share reduces
    the term with rho^2 in cov(|y|, |y'|), which depends only on y^2. The terms with higher powers of rho remain, because they
    differ between roads.
    """
    low, high = (edge / (2 * math.pi * spectrum.speed) for edge in spectrum.band)
    length = min(spectrum.length, GRAIN)
    first, last = math.ceil(low * length), math.floor(high * length)
    n = np.arange(first, last + 1) / length
    power = slope_power(n, spectrum.waviness) * spectrum.density / spectrum.speed / length
    lines = np.abs(slope_response(n, STEP)) ** 2 * power
    a = coherency(n, spectrum.track_width, spectrum.waviness)
    lags = 2 * max(last, math.ceil(length / STEP / 2))
    step = length / lags
    x = np.arange(min(lags // 2, math.floor(distance / step)) + 1) * step
    weight = 2 * step / distance * (1 - x / distance)
    weight[0] /= 2

    def moments(own: Array, other: Array, free: Array) -> tuple[float, float]:
        """Returns mean and standard deviation, among random roads, of the mean IRI of two responses of the car.

        Args:
            own: spectrum of the first response, which is also that of the second response.
            other: cross-spectrum of the two responses; equal to `own` if there is only one response.
            free: share of each sinusoid's mean square that varies between roads.
        """
        variance, of_squares, of_more = float(own.sum()), 0.0, 0.0
        for part, times in ((own, 2),) if own is other else ((own, 1), (other, 1)):
            spread_out = np.zeros(lags // 2 + 1)
            spread_out[first : last + 1] = part
            rho = (np.fft.irfft(spread_out) * (lags / 2) / variance)[: len(x)].clip(-1.0, 1.0)
            of_squares += times * variance / math.pi * float(weight @ (rho**2 / 2))
            of_more += times * variance / math.pi * float(weight @ (np.sqrt(1 - rho**2) + rho * np.arcsin(rho) - 1 - rho**2 / 2))
        squares = own**2 + other**2
        left = 1 - (1 - float(squares @ free) / float(squares.sum())) * distance / spectrum.length
        begun = 1 - _start_distance(low, high, distance) / distance
        return 1e3 * math.sqrt(2 / math.pi * variance) * begun, 1e3 * math.sqrt(max(of_squares * left, 0.0) + max(of_more, 0.0))

    both = lines * (1 + a) / 2
    parts = {
        "left": (lines, lines, np.zeros(len(n))),
        "right": (lines, lines, 2 * a**2 * (1 - a**2)),
        "mean": (lines, lines * a, a**2 * (1 - a**2) / (1 + a**2)),
        "half_car": (both, both, (1 - a**2) / 2),
    }
    return {name: moments(*parts[name]) for name in names}


def _start_distance(low: float, high: float, distance: float) -> float:
    """Returns the effect of the start as a distance [m]: the start reduces the mean IRI as if this distance were missing.

    The result is exact if the slope is white noise, and approximate for the mean of two tracks.
    """
    ways = _ways_lost(low, high)
    return float(ways[min(round(distance / BASE), len(ways)) - 1])


@lru_cache(maxsize=16)
def _ways_lost(low: float, high: float) -> Array:
    lines = np.arange(math.ceil(low * COUNTED_LINES), math.floor(high * COUNTED_LINES) + 1)
    return missing(lines, np.ones(len(lines)))
