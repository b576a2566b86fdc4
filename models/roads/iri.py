"""The International Roughness Index of any road: what it has on the way that is driven, and what a random one has in the mean.

A road that was measured at even distances is taken as it was measured; any other is read every 25 mm. A vehicle with two tracks
has one IRI for each, `left` and `right`; `mean` is the mean of the two (MRI), `half_car` that of the mean of the two profiles
(HRI), in which a road's twist is missing. Names: M. W. Sayers and S. M. Karamihas (1998), "The little book of profiling", UMTRI.

The car's answer y to a random road is Gaussian, of variance s^2, so E|y| = sqrt(2/pi) s; and with the correlation rho(x) of two
places, cov(|y|, |y'|) = (2/pi) s^2 (sqrt(1 - rho^2) + rho asin rho - 1), from which follows how far the mean over a distance is
from that, from road to road.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from models.common.arrays import Array
from models.roads.golden_car import BASE, START, missing, roughness_index, slope_response
from models.roads.profile import Profile
from models.roads.road import Road, track_width
from models.roads.spectrum import Spectrum, coherency
from models.vehicle import Vehicle

TRACKS = ("left", "right", "mean", "half_car")  # what there is an IRI of, of two tracks
STEP = 0.025  # m, from sample to sample; a tenth of the moving average
COARSEST = 0.3  # m; ASTM E1926 has no IRI of what was measured further apart
EVEN = 1e-6  # of the spacing: how far distances are off by the digits of a file
SHORTEST = START + BASE  # m; less has no IRI
LONGEST = 1e5  # m that are looked at
COUNTED = 512.0  # lines per cycle/m, of a start: it is over in a fifth of 512 m
GRAIN = 4096.0  # lines per cycle/m of a spectrum that is looked at: a car forgets within a tenth of 4096 m
LINES = 8192  # per cycle/m, of integrals over a spectrum: its resonances are a hundred times as wide


@dataclass(frozen=True)
class Roughness:
    """One IRI of a road.

    Attributes:
        name: of the track, `left` or `right`, or `mean` or `half_car` of both.
        iri: of this road [m/km].
        expected: over all roads of its kind [m/km]; None where it has no spectrum.
        spread: its standard deviation from road to road [m/km]; None likewise.
    """

    name: str
    iri: float
    expected: float | None = None
    spread: float | None = None


def roughness_of(road: Road, vehicle: Vehicle, distance: float) -> tuple[Roughness, ...]:
    """Every IRI of a road as far as a vehicle drives on it; none of a road too short, or measured too coarsely, or of a rig.

    Args:
        road: of which a profile ends with its last point.
        vehicle: its track width counts.
        distance: how far it drives [m].
    """
    if not road.laid:
        return ()
    width = track_width(vehicle)
    step, tracks = _sampled(road, min(distance, LONGEST), ("left", "right") if width else ("left",))
    if step > COARSEST * (1 + EVEN) or len(tracks) * step <= SHORTEST:
        return ()
    found = {"left": roughness_index(tracks[:, 0], step)}
    if width:
        found["right"] = roughness_index(tracks[:, 1], step)
        found |= {"mean": (found["left"] + found["right"]) / 2, "half_car": roughness_index(tracks.mean(axis=1), step)}
    if (spectrum := road.spectrum) is None:
        return tuple(Roughness(name, iri) for name, iri in found.items())
    expected = _expected(spectrum, len(tracks) * step)
    return tuple(Roughness(name, iri, *expected[name]) for name, iri in found.items())


def white_slope(iri: float, low: float, high: float) -> float:
    """One-sided density of the slope [m/cycle] of a random road that has this IRI in the mean [m/km], and white slope in a band.

    Args:
        iri: [m/km].
        low, high: spatial frequencies from which and to which there is any [cycle/m].
    """
    return math.pi / 2 * (iri / 1e3) ** 2 / _unit_variance(low, high)


@lru_cache(maxsize=16)
def _unit_variance(low: float, high: float) -> float:
    """Of the car's answer to a white slope of density 1 [cycle/m]."""
    count = math.ceil((high - low) * LINES)
    n = low + (np.arange(count) + 0.5) * (high - low) / count
    return float(np.sum(np.abs(slope_response(n, STEP)) ** 2)) * (high - low) / count


def _sampled(road: Road, distance: float, sides: tuple[str, ...]) -> tuple[float, Array]:
    """How far samples are apart [m], and heights under the tracks of a road [m], shape (P, tracks)."""
    if isinstance(road, Profile):
        spacing = np.diff(road.distance)
        step = float(np.median(spacing))
        heights = road.heights[: round(distance / step) + 1, : len(sides)]
        if np.ptp(spacing) <= EVEN * step or step > COARSEST * (1 + EVEN):
            return step, heights
        distance = min(distance, float(road.distance[-1] - road.distance[0]))
    t = np.arange(math.floor(distance / STEP) + 1) * (STEP / road.speed)
    return STEP, np.stack([road.displacement(t, side) for side in sides], axis=-1)


@lru_cache(maxsize=16)
def _expected(spectrum: Spectrum, distance: float) -> dict[str, tuple[float, float]]:
    """Mean and standard deviation of every IRI over roads of a spectrum, driven so far [m].

    A road's lines have fixed amplitudes, where a Gaussian signal's are free: over all of its length its mean square is known.
    What is left of their variance there is 0 on the left track, and 2 a^2 (1 - a^2) on the right one, of coherency a. That takes
    away from the part of cov(|y|, |y'|) that goes with rho^2, which y^2 alone makes; what goes with its higher powers, of which
    whole roads differ, stays.
    """
    low, high = (edge / (2 * math.pi * spectrum.speed) for edge in spectrum.band)
    length = min(spectrum.length, GRAIN)
    first, last = math.ceil(low * length), math.floor(high * length)
    n = np.arange(first, last + 1) / length
    lines = np.abs(slope_response(n, STEP)) ** 2 * spectrum.density / spectrum.speed / length
    a = coherency(n, spectrum.track_width)
    lags = 2 * max(last, math.ceil(length / STEP / 2))
    step = length / lags
    x = np.arange(min(lags // 2, math.floor(distance / step)) + 1) * step
    weight = 2 * step / distance * (1 - x / distance)
    weight[0] /= 2

    def moments(own: Array, other: Array, free: Array) -> tuple[float, float]:
        """Of the mean of two |y| of that spectrum and that common one, where so much of their lines' squares is free."""
        variance, of_squares, of_more = float(own.sum()), 0.0, 0.0
        for each in (own, other):
            spread_out = np.zeros(lags // 2 + 1)
            spread_out[first : last + 1] = each
            rho = (np.fft.irfft(spread_out) * (lags / 2) / variance)[: len(x)].clip(-1.0, 1.0)
            of_squares += variance / math.pi * float(weight @ (rho**2 / 2))
            of_more += variance / math.pi * float(weight @ (np.sqrt(1 - rho**2) + rho * np.arcsin(rho) - 1 - rho**2 / 2))
        squares = own**2 + other**2
        left = 1 - (1 - float(squares @ free) / float(squares.sum())) * distance / spectrum.length
        begun = 1 - _lost(low, high, distance) / distance
        return 1e3 * math.sqrt(2 / math.pi * variance) * begun, 1e3 * math.sqrt(max(of_squares * left, 0.0) + max(of_more, 0.0))

    both = lines * (1 + a) / 2
    return {
        "left": moments(lines, lines, np.zeros(len(n))),
        "right": moments(lines, lines, 2 * a**2 * (1 - a**2)),
        "mean": moments(lines, lines * a, a**2 * (1 - a**2) / (1 + a**2)),
        "half_car": moments(both, both, (1 - a**2) / 2),
    }


def _lost(low: float, high: float, distance: float) -> float:
    """Way that counts for nothing as the car has to forget its start [m]: of white slopes, and nearly so of two tracks' mean."""
    ways = _ways_lost(low, high)
    return float(ways[min(round(distance / BASE), len(ways)) - 1])


@lru_cache(maxsize=16)
def _ways_lost(low: float, high: float) -> Array:
    n = np.arange(math.ceil(low * COUNTED), math.floor(high * COUNTED) + 1) / COUNTED
    return missing(n, np.ones(len(n)), STEP)
