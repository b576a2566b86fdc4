"""Random roads of ISO 8608, classes A to H, with two tracks.

The vertical displacement of a road has the one-sided power spectral density

    G_d(n) = G_d(n0) (n / n0)^-w,    n0 = 0.1 cycle/m,    G_d(n0) = 16e-6, 64e-6, ..., 4^i 16e-6 m^3 for A, B, ..., H.

The values of G_d(n0) are the geometric means of the classes. The limits of a class are half and twice its geometric mean; A/B
denotes the limit between the classes A and B. The waviness w is 2 in the standard. Instead of a class, G_d(n0) itself or the
International Roughness Index (IRI) may be given. If the IRI is given, G_d(n0) has the value at which the mean IRI of the roads
is the given IRI.

A road is a sum of sinusoids with the frequencies n_k = k / length, the amplitudes sqrt(2 G_d(n_k) / length) and random phases.
By default, the frequency band of a road is 0.01 to 10 cycle/m; the band of the standard is 0.011 to 2.83 cycle/m. Sinusoids
with frequencies below the band would be hills. Waves with frequencies above the band are shorter than the contact patch of a
tyre, so they do not move the wheel. The road repeats after `length`.

The standard does not define the coherence of two tracks. This module uses the coherence of an isotropic surface, which the
spectrum of one track determines (C. J. Dodds and J. D. Robson (1973), J. Sound Vib. 31, 175-183; K. M. A. Kamash and J. D.
Robson (1978), J. Sound Vib. 57, 89-100). For two tracks at the distance b, the cross-spectrum is the integral over m of the
surface spectrum (n^2 + m^2)^(-(w+1)/2) times cos(2 pi m b). It follows that

    coherency(n) = 2 (x/2)^(w/2) K_{w/2}(x) / Gamma(w/2) = x K_1(x) for w = 2,    x = 2 pi n b.

The coherency is a real number, which is 1 for long waves and 0 for short waves. Each sinusoid of the right track is the
coherency times the sinusoid of the left track, plus a share of an independent sinusoid.
"""

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Annotated, Any, ClassVar

import numpy as np

from models.common.arrays import Array
from models.common.checks import check_fields
from models.common.errors import InputError
from models.common.extensions import FEATURES
from models.common.schema import MOST_SEED, SI, Integer, Section, Text
from models.common.units import setting
from models.roads.road import Road
from models.roads.spectrum import N0, Spectrum, coherency
from models.vehicle.names import CLASSES

LOWEST, HIGHEST = 0.01, 10.0  # default band of spatial frequencies [cycle/m]
LENGTH = 1024.0  # default length of a road [m]
# Roads of class H have a mean IRI of 200 m/km
IRI = SI("m/km", "mean IRI of such roads before the factor, instead of a class", 0.01, 300.0)
BAND = (1e-3, 100.0)  # range in which a band of spatial frequencies must lie [cycle/m]
BLOCK = 1_000_000  # number of terms that are summed at once if the times are not evenly spaced
FEW = 10  # for more evenly spaced times than this, a transform is faster than a sum
FAST = (2, 3, 5, 7, 11)  # NumPy's transforms are fast for lengths with only these prime factors
MOST_KEPT = 200_000  # a sum is cached for at most this number of times (1.6 MB)


def roughness(road_class: str) -> float:
    """Returns G_d(n0) of a class [m3]: its geometric mean, or the limit between two classes, such as "A/B".

    Raises:
        InputError: the class does not exist.
    """
    known = [*CLASSES, *(f"{a}/{b}" for a, b in itertools.pairwise(CLASSES))]
    if road_class not in known:
        raise InputError(
            f"unknown road class {road_class!r}; give {', '.join(CLASSES)}, or the boundary of two classes, such as "
            "A/B (ISO 8608)"
        )
    return 16e-6 * 4.0 ** CLASSES.index(road_class[0]) * (2.0 if "/" in road_class else 1.0)


def roughness_by_iri(iri: float, lowest: float = LOWEST, highest: float = HIGHEST, waviness: float = 2.0) -> float:
    """Returns G_d(n0) [m3] of roads with a given mean IRI. G_d(n0) is proportional to the square of the IRI.

    Args:
        iri: mean IRI [m/km].
        lowest: lower end of the road's frequency band [cycle/m].
        highest: upper end of the road's frequency band [cycle/m].
        waviness: exponent w of the road spectrum.

    Raises:
        InputError: the IRI is out of its range.
    """
    return FEATURES.load("IRI").slope_density(IRI.number("road iri", iri), lowest, highest, waviness) / (2 * np.pi * N0) ** 2


@dataclass(frozen=True)
class Iso8608(Section, Road):
    """Random road of ISO 8608, with a roughness class, an IRI or a spectral density.

    Roads with equal seeds and lengths are equal on every machine, except for rounding errors of the sines. The phases are the
    raw output of the Philox generator, which NumPy does not change between versions. At time 0, the first wheel reaches the
    road. The flat ground before the road has the same height as the beginning of the road. At time 0, the road velocity jumps,
    as if the vehicle started in equilibrium and were then excited by white noise.

    Raises:
        InputError: the class is unknown, the band contains too few sinusoids, or another number is out of its range. The error
            is also raised if more than one of class, IRI and G_d(n0) is given.
    """

    # Names of the numbers that the text of a road contains
    settings: ClassVar[tuple[str, ...]] = ("class", "iri", "gd", "waviness", "band")
    road_class: Annotated[
        str, Text("`class` in a text: `A` to `H`, or the boundary of two classes, such as `A/B`; empty if `iri` or `gd` is given")
    ] = "C"
    seed: Annotated[int, Integer("seed of the phases", high=MOST_SEED)] = 0
    speed: Annotated[float, SI("m/s", "speed of the vehicle", 0.1, 200.0)] = 20.0
    track_width: Annotated[float, SI("m", "lateral distance from the right track to the left", 0.0, 10.0)] = 0.0
    length: Annotated[
        float, SI("m", "distance after which the road repeats; a different length gives a different road", 100.0, 1e6)
    ] = LENGTH
    factor: Annotated[float, SI("1", "factor on the heights", -1e9, 1e9)] = 1.0
    iri: Annotated[float, IRI] | None = None
    gd: Annotated[float, SI("m3", "G_d(n0) before the factor, instead of a class", 1e-12, 1.0)] | None = None
    waviness: Annotated[float, SI("1", "waviness w", 1.0, 4.0)] = 2.0
    lowest: Annotated[
        float,
        SI(
            "1/m",
            "spatial frequency of the first spectral line; in a text, `band` gives the first and the last, as in "
            "`band=0.011..2.83`",
            *BAND,
        ),
    ] = LOWEST
    highest: Annotated[float, SI("1/m", "spatial frequency of the last spectral line", *BAND)] = HIGHEST

    def __post_init__(self) -> None:
        check_fields(self, "road ")
        given = {name: value for name, value in self._rough.items() if value is not None}
        if len(given) > 1:
            several = " and ".join(
                f"{name} = {value if isinstance(value, str) else f'{value:g}'}" for name, value in given.items()
            )
            raise InputError(f"the roughness of this road is given more than once, by {several}; give only one of these keys")
        if not (self.lowest < self.highest and len(self.n) > 1):
            band, (low, high) = f"{self.lowest:g}..{self.highest:g}", BAND
            raise InputError(
                f"road band = {band} is not allowed; give both ends, the lower one first, from {low:g} to {high:g} cycle/m"
            )
        _ = self.roughness

    @classmethod
    def prepared(cls, given: Mapping[str, Any]) -> Mapping[str, Any]:
        """Converts the keys of a table to fields of the class: `class` to `road_class` (default C), and `band` to the two ends
        of the band.
        """
        fields = {name: value for name, value in given.items() if name not in ("class", "band", "roughness")}
        if "road_class" not in given:
            fields["road_class"] = given.get("class", "" if {"iri", "gd"} & given.keys() else "C")
        if "band" in given:
            ends = str(given["band"]).split("..")
            if len(ends) != 2:
                raise InputError(
                    f"band = {given['band']!r} is not allowed; give the lower and the upper end in cycle/m, as in "
                    "band=0.011..2.83"
                )
            fields |= {name: setting("band", end, "1/m") for name, end in zip(("lowest", "highest"), ends, strict=True)}
        return fields

    def displacement(self, t: Array, side: str = "") -> Array:
        """Returns the sum of the sinusoids minus their sum at the start [m].

        A vehicle with one track drives on the left track of the road.
        """
        return np.where(t >= 0, self._sum(side, False, t) - np.real(self._lines(side, False)).sum(), 0.0)

    def velocity(self, t: Array, side: str = "") -> Array:
        """Returns the sum of the exact time derivatives of the sinusoids [m/s]."""
        return np.where(t >= 0, self._sum(side, True, t), 0.0)

    @property
    def kinks(self) -> tuple[float, ...]:
        """Time at which the random road begins [s]."""
        return (0.0,)

    def describe(self) -> dict[str, float | str]:
        """Returns a description: class, IRI or G_d(n0), then roughness, seed, band, speed, track width, length and factor."""
        return {
            "type": "iso8608",
            **{name: value for name, value in self._rough.items() if value is not None},
            **({"waviness": self.waviness} if self.waviness != 2 else {}),
            "roughness": self.roughness * self.factor**2,
            "seed": self.seed,
            "lowest": self.lowest,
            "highest": self.highest,
            "speed": self.speed,
            "track_width": self.track_width,
            "length": self.length,
            "factor": self.factor,
        }

    @property
    def words(self) -> str:
        """Properties that distinguish random roads: class, IRI or G_d(n0), then seed and speed."""
        which = f"class {self.road_class}" if self.iri is None else f"IRI {self.iri:g} m/km"
        which = which if self.gd is None else f"G_d(n0) {self.gd:g} m3"
        which += f", waviness {self.waviness:g}" if self.waviness != 2 else ""
        which += f", {self.lowest:g} to {self.highest:g} cycle/m" if (self.lowest, self.highest) != (LOWEST, HIGHEST) else ""
        return f"random, {which}, seed {self.seed}, speed {self.speed:g} m/s"

    def scaled(self, factor: float) -> "Iso8608":
        """Returns the road with heights multiplied by a factor."""
        return replace(self, factor=self.factor * factor)

    @property
    def roughness(self) -> float:
        """G_d(n0) before the factor [m3]."""
        if self.gd is not None:
            return self.gd
        if self.iri is not None:
            return roughness_by_iri(self.iri, self.lowest, self.highest, self.waviness)
        return roughness(self.road_class)

    @property
    def _rough(self) -> dict[str, float | str | None]:
        """The three possible measures of roughness, by name. Only one of the three measures has a value."""
        return {"class": self.road_class or None, "iri": self.iri, "gd": self.gd}

    @property
    def n(self) -> Array:
        """Spatial frequencies of the K sinusoids [cycle/m], shape (K,)."""
        return _frequencies(self.length, self.lowest, self.highest)

    @property
    def band(self) -> tuple[float, float]:
        """Frequency band that the sinusoids represent [cycle/m].

        The band extends beyond the first and the last frequency by half of the spacing between frequencies.
        """
        return float(self.n[0]) - 0.5 / self.length, float(self.n[-1]) + 0.5 / self.length

    @property
    def spectrum(self) -> Spectrum:
        """Spectrum of the road when it is driven at the speed `speed`."""
        low, high = (2 * np.pi * self.speed * n for n in self.band)
        density = (2 * np.pi * N0) ** 2 * self.roughness * self.factor**2 * self.speed
        return Spectrum(density, (low, high), self.speed, self.length, self.track_width, self.waviness)

    @cached_property
    def _left(self) -> Array:
        """Phase factor exp(i phase) of every sinusoid on the left track, shape (K,)."""
        return self._phasors(0)

    @cached_property
    def _other(self) -> Array:
        """Phase factor exp(i phase) of every sinusoid in the independent share of the right track, shape (K,)."""
        return self._phasors(1)

    def _phasors(self, track: int) -> Array:
        count = len(self.n)
        raw = np.random.Philox(self.seed).random_raw((track + 1) * count)[track * count :]
        phases = 2 * np.pi * ((raw >> np.uint64(11)) * 2.0**-53)
        return np.cos(phases) + 1j * np.sin(phases)

    def _lines(self, side: str, rate: bool) -> Array:
        """Returns the complex amplitude of every sinusoid [m], or of its derivative [m/s], shape (K,)."""
        if rate:
            return self._lines(side, False) * (2j * np.pi * self.speed * self.n)
        amplitudes = self.factor * np.sqrt(2 * self.roughness * (self.n / N0) ** -self.waviness / self.length)
        if side != "right":
            return amplitudes * self._left
        alike = _coherency_of_lines(self.length, self.lowest, self.highest, self.track_width, self.waviness)
        return amplitudes * (alike * self._left + np.sqrt(1 - alike**2) * self._other)

    def _sum(self, side: str, rate: bool, t: Array) -> Array:
        """Returns the real part of the sum of all sinusoids exp(2 pi i n V t), or of its derivative, same shape as t."""
        t = np.asarray(t, dtype=float)
        step = (t[-1] - t[0]) / (len(t) - 1) if t.ndim == 1 and len(t) > FEW else math.nan
        if math.isnan(step) or not np.allclose(np.diff(t), step, rtol=1e-6, atol=0.0):
            lines = self._lines(side, rate)
            flat, size = t.ravel(), max(1, BLOCK // len(lines))
            parts = [self._turn(flat[i : i + size, None]) for i in range(0, max(len(flat), 1), size)]
            return np.concatenate([np.real(part @ lines) for part in parts]).reshape(t.shape)
        evenly = _evenly if len(t) <= MOST_KEPT else _evenly.__wrapped__
        return evenly(self, side, rate, float(t[0]), float(step), len(t))

    def _turn(self, t: Array) -> Array:
        angle = self.n * (self.speed * t)
        return np.exp(2j * np.pi * (angle - np.round(angle)))


def long_enough(distance: float) -> float:
    """Returns the length [m] that a road must have if it is not to repeat within the driven distance [m]."""
    return LENGTH * 2 ** max(0, math.ceil(math.log2(distance / LENGTH))) if distance > 0 else LENGTH


@lru_cache(maxsize=4)
def _frequencies(length: float, lowest: float, highest: float) -> Array:
    n = np.arange(math.ceil(lowest * length), math.floor(highest * length) + 1) / length
    n.flags.writeable = False
    return n


@lru_cache(maxsize=64)
def _coherency_of_lines(length: float, lowest: float, highest: float, width: float, waviness: float) -> Array:
    return coherency(_frequencies(length, lowest, highest), width, waviness)


@lru_cache(maxsize=16)
def _evenly(road: Iso8608, side: str, rate: bool, first: float, step: float, count: int) -> Array:
    """Returns the sum of the sinusoids, or of their derivatives, at evenly spaced times, shape (T,).

    The sum is cached, because simulation and analysis need it many times.
    """
    lines, turned = road._lines(side, rate), road._turn(np.array(first))
    turn = float(f"{road.speed * step / road.length:.14g}")
    angle = np.arange(count) * (round(road.n[0] * road.length) * turn)
    shift = np.exp(-2j * np.pi * (angle - np.round(angle)))
    # The transform has a negative exponent, so the complex conjugates are used; the real part of the sum is the same.
    return (shift * _chirp_transform(len(lines), count, turn)(np.conj(lines * turned))).real


@lru_cache(maxsize=8)
def _chirp_transform(lines: int, times: int, turn: float) -> Callable[[Array], Array]:
    """Returns a function that computes the sum over k of x_k exp(-2 pi i k turn j) for j = 0, ..., T - 1.

    The function maps K amplitudes, shape (K,), to T values, shape (T,). The function is a chirp z-transform. Because 2 k j =
    k^2 + j^2 - (j - k)^2, the sum becomes a convolution of length K + T, which FFTs compute fast. `scipy.signal.ZoomFFT` gives
    the same numbers bit for bit, but its import takes 0.5 s.
    """
    k = np.arange(max(lines, times), dtype=np.int64)
    scale = turn * (times - 1) * times / (times - 1)
    chirp = np.exp(-(1j * np.pi * scale * k**2) / times)
    length = _fast_length(lines + times - 1)
    kernel = np.fft.fft(1 / np.hstack((chirp[lines - 1 : 0 : -1], chirp[:times])), length)

    def transform(x: Array) -> Array:
        convolved = np.fft.ifft(kernel * np.fft.fft(x * chirp[:lines], length))
        return convolved[lines - 1 : lines + times - 1] * chirp[:times]

    return transform


def _fast_length(least: int) -> int:
    """Returns the smallest integer that is not below `least` and has only the prime factors in `FAST`."""
    while True:
        rest = least
        for factor in FAST:
            while rest % factor == 0:
                rest //= factor
        if rest == 1:
            return least
        least += 1
