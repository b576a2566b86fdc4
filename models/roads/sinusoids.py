"""Roads that consist of sinusoids: a sum, a single sinusoid, a worst-case road, and a sweep with rising frequency."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.schema import SI, Choice, ListedValues, Section
from models.roads.road import Obstacle, Road, Speed

Start = Annotated[float, SI("s", "time at which the first wheel reaches it", 0.0, 1e4)]
# Number of sines that are evaluated together; with a larger number, the evaluation would need more memory, but no less time
BLOCK = 4_000_000
MULTISINES = ("multisine", "chirp", "random", "sinusoid")  # names that roads of this class can have in a log


@dataclass(frozen=True)
class Multisine(Section, Road):
    """Road that is a sum of sinusoids and begins at time 0. Heights are relative to the height at time 0. The road is flat
    before time 0.

    z_r(t) = s(t) - s(0),    s(t) = sum of a_i sin(omega_i t + phi_i),    t >= 0.

    """

    omega: Annotated[tuple[float, ...], ListedValues("angular frequencies, F of them", SI("rad/s"))]
    amplitudes: Annotated[tuple[float, ...], ListedValues("amplitudes a_i", SI("m", low=-1e9, high=1e9))]
    phases: Annotated[tuple[float, ...], ListedValues("phases phi_i", SI("rad", low=-1e12))]
    speed: Annotated[float, SI("m/s", "speed of the vehicle", 0.0)] = 12.5
    name: Annotated[str, Choice("name in a log", MULTISINES)] = MULTISINES[0]

    def __post_init__(self) -> None:
        if not len(self.omega) == len(self.amplitudes) == len(self.phases):
            raise InputError(
                f"road {self.name}: omega, amplitudes and phases have different lengths; give three lists of equal length"
            )

    @classmethod
    def prepared(cls, given: Mapping[str, Any]) -> Mapping[str, Any]:
        """Returns the keys of a description, without keys whose values are computed from other keys."""
        return {name: value for name, value in given.items() if name not in ("lines", "lowest", "highest", "rms")}

    @property
    def units(self) -> Mapping[str, str]:
        """Units of the numbers in the description."""
        return {"lowest": "rad/s", "highest": "rad/s", "rms": "m", "speed": "m/s"}

    def displacement(self, t: Array, side: str = "") -> Array:
        """Returns the sum of the sinusoids [m], which is equal for left and right wheels."""
        start = float(np.dot(self.amplitudes, np.sin(self.phases)))
        return np.where(t >= 0, self._sum(t, np.asarray(self.amplitudes), 0.0) - start, 0.0)

    def velocity(self, t: Array, side: str = "") -> Array:
        """Returns the exact time derivative of the height [m/s]."""
        return np.where(t >= 0, self._sum(t, np.multiply(self.amplitudes, self.omega), np.pi / 2), 0.0)

    @property
    def kinks(self) -> tuple[float, ...]:
        """Time at which the road begins [s]. The road velocity jumps when the road begins; later, the road is smooth."""
        return (0.0,)

    def describe(self) -> dict[str, Any]:
        """Returns a description: number, frequency range and rms of the sinusoids, then amplitude, frequency and phase of each
        sinusoid.
        """
        return {
            "type": self.name,
            "lines": len(self.omega),
            "lowest": min(self.omega),
            "highest": max(self.omega),
            "rms": float(np.sqrt(np.sum(np.square(self.amplitudes)) / 2)),
            "speed": self.speed,
            "omega": list(self.omega),
            "amplitudes": list(self.amplitudes),
            "phases": list(self.phases),
        }

    def scaled(self, factor: float) -> "Multisine":
        """Returns the road with heights multiplied by a factor."""
        return replace(self, amplitudes=tuple(factor * a for a in self.amplitudes))

    def to_height(self, height: float, time: Array) -> "Multisine":
        """Returns the road with heights scaled so that their peak magnitude at the sample times has the requested value.

        Args:
            height: peak magnitude of the height [m].
            time: times at which the road is evaluated [s].
        """
        return self.scaled(height / float(np.abs(self.displacement(time)).max()))

    def _sum(self, t: Array, amplitudes: Array, ahead: float) -> Array:
        phases, omega = np.asarray(self.phases) + ahead, np.asarray(self.omega)
        flat = np.ravel(t)
        total = [np.sin(np.multiply.outer(block, omega) + phases) @ amplitudes for block in _blocks(flat, len(omega))]
        return np.concatenate(total).reshape(np.shape(t))


def _blocks(t: Array, lines: int) -> list[Array]:
    return np.array_split(t, max(1, -(-len(t) * lines // BLOCK)))


def chirp(omega: Array, period: float, speed: float) -> Multisine:
    """Returns sinusoids of equal velocity amplitude with Schroeder's phases: a periodic chirp with a low crest factor.

    Source: M. R. Schroeder (1970), IEEE Trans. Inf. Theory 16, 85-89. With Schroeder's phases, the group delay at a frequency
    is proportional to the power at lower frequencies. The frequencies of the signal are therefore reached one after another
    during the period. The phases are phi_i = -T sum over l < i of p_l (omega_i - omega_l), where all F sinusoids have the same
    power p_l = 1/F. With equal velocity amplitudes, the road velocity is white, as on a road of ISO 8608 with w = 2.

    Args:
        omega: ascending angular frequencies [rad/s], multiples of 2 pi / period, shape (F,).
        period: period T of the signal [s].
        speed: forward velocity [m/s].
    """
    below = np.tril(np.subtract.outer(omega, omega), -1)
    return _white(omega, -period * below.sum(axis=1) / len(omega), speed, "chirp")


def random_road(omega: Array, seed: int, speed: float) -> Multisine:
    """Returns sinusoids of equal velocity amplitude with random phases.

    Args:
        omega: angular frequencies [rad/s], shape (F,).
        seed: seed of the phases.
        speed: forward velocity [m/s].
    """
    return _white(omega, np.random.default_rng(seed).uniform(0, 2 * np.pi, len(omega)), speed, "random")


def sinusoid(omega: float, speed: float) -> Multisine:
    """Returns a sinusoid with the angular frequency omega that starts with zero velocity: z_r = 1 - cos(omega t) [m]."""
    return Multisine((omega,), (1.0,), (-np.pi / 2,), speed, "sinusoid")


def _white(omega: Array, phases: Array, speed: float, name: str) -> Multisine:
    return Multisine(tuple(omega.tolist()), tuple((1 / omega).tolist()), tuple(phases.tolist()), speed, name)


@dataclass(frozen=True)
class Sine(Obstacle):
    """Road that is a sine and begins at a given phase.

    Heights are relative to the height at the beginning. The road is flat before the beginning.

    z_r = amplitude (sin(2 pi frequency (t - start) + phase) - sin(phase)),    t >= start.

    """

    kind: ClassVar[str] = "sine"
    tall: ClassVar[tuple[str, ...]] = ("amplitude",)
    amplitude: Annotated[float, SI("m", "amplitude", -10.0, 10.0)] = 0.02
    frequency: Annotated[float, SI("Hz", "frequency", 0.001, 100.0)] = 1.0
    phase: Annotated[float, SI("deg", "phase at the beginning", -360.0, 360.0)] = 0.0
    speed: Speed = 20.0
    start: Start = 0.0

    def displacement(self, t: Array, side: str = "") -> Array:
        """Returns the height [m], which is equal for left and right wheels."""
        begins = math.sin(math.radians(self.phase))
        return np.where(t >= self.start, self.amplitude * (np.sin(self._angle(t)) - begins), 0.0)

    def velocity(self, t: Array, side: str = "") -> Array:
        """Returns the exact time derivative of the height [m/s]."""
        return np.where(t >= self.start, self.amplitude * 2 * np.pi * self.frequency * np.cos(self._angle(t)), 0.0)

    @property
    def kinks(self) -> tuple[float, ...]:
        """Time at which the sine begins [s]."""
        return (self.start,)

    def _angle(self, t: Array) -> Array:
        return 2 * np.pi * self.frequency * (np.asarray(t) - self.start) + math.radians(self.phase)


@dataclass(frozen=True)
class SineSweep(Obstacle):
    """Sine sweep whose frequency f rises exponentially, and whose amplitude falls as 1/f.

        z_r = amplitude exp(-k t) sin(2 pi lowest (exp(k t) - 1) / k),    k = ln(highest / lowest) / duration.

    The road velocity, which excites the vehicle, therefore has nearly the same amplitude at all frequencies.

    Raises:
        InputError: a number is out of its range, or the last frequency is not above the first.
    """

    kind: ClassVar[str] = "sweep"
    tall: ClassVar[tuple[str, ...]] = ("amplitude",)
    amplitude: Annotated[float, SI("m", "amplitude at the beginning", -10.0, 10.0)] = 0.02
    lowest: Annotated[float, SI("Hz", "first frequency", 0.01, 100.0)] = 0.5
    highest: Annotated[float, SI("Hz", "last frequency", 0.01, 100.0)] = 25.0
    duration: Annotated[float, SI("s", "time from the first frequency to the last; then the road is level", 0.1, 1e4)] = 10.0  # pyright: ignore[reportIncompatibleMethodOverride]
    speed: Speed = 20.0

    def __post_init__(self) -> None:
        super().__post_init__()
        SI("Hz", low=self.lowest * 1.001, high=100.0).number("sweep highest", self.highest)

    def displacement(self, t: Array, side: str = "") -> Array:
        """Returns the height [m], which is equal for left and right wheels. After the sweep, the height keeps its last value."""
        t = np.clip(t, 0.0, self.duration)
        return self.amplitude * np.exp(-self._rate * t) * np.sin(self._angle(t))

    def velocity(self, t: Array, side: str = "") -> Array:
        """Returns the exact time derivative of the height [m/s]."""
        on, s = (t >= 0) & (t <= self.duration), np.clip(t, 0.0, self.duration)
        fading = self._rate * np.exp(-self._rate * s) * np.sin(self._angle(s))
        return np.where(on, self.amplitude * (2 * np.pi * self.lowest * np.cos(self._angle(s)) - fading), 0.0)

    @property
    def kinks(self) -> tuple[float, ...]:
        """Times at which the sweep begins and ends [s]."""
        return (0.0, self.duration)

    @property
    def _rate(self) -> float:
        return math.log(self.highest / self.lowest) / self.duration

    def _angle(self, t: Array) -> Array:
        return 2 * np.pi * self.lowest / self._rate * np.expm1(self._rate * t)
