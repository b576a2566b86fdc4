"""Roads of sinusoids: sums, a single one, one for the worst case, and a sweep with rising frequency."""

import math
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from models.common.arrays import Array
from models.roads.road import LIMITS, Obstacle, Road, check_numbers

START = (0.0, 1e4)  # s, when a road may begin
BLOCK = 4_000_000  # sines that are evaluated at once; more only costs memory
MULTISINES = ("multisine", "chirp", "random", "sinusoid")  # names in a log


@dataclass(frozen=True)
class Multisine(Road):
    """Sum of sinusoids that begins at time 0 at its own height there; before, the road is flat.

        z_r(t) = s(t) - s(0),    s(t) = sum of a_i sin(omega_i t + phi_i),    t >= 0.

    Attributes:
        omega: angular frequencies [rad/s], F of them.
        amplitudes: a_i [m].
        phases: phi_i [rad].
        speed: forward velocity [m/s].
        name: name in a log, one of `MULTISINES`.
    """

    omega: tuple[float, ...]
    amplitudes: tuple[float, ...]
    phases: tuple[float, ...]
    speed: float = 12.5
    name: str = "multisine"

    def displacement(self, t: Array, side: str = "") -> Array:
        """Returns the sum, the same on both sides."""
        start = float(np.dot(self.amplitudes, np.sin(self.phases)))
        return np.where(t >= 0, self._sum(t, np.asarray(self.amplitudes), 0.0) - start, 0.0)

    def velocity(self, t: Array, side: str = "") -> Array:
        """Returns the exact derivative."""
        return np.where(t >= 0, self._sum(t, np.multiply(self.amplitudes, self.omega), np.pi / 2), 0.0)

    @property
    def kinks(self) -> tuple[float, ...]:
        """The beginning, at which the velocity jumps. After that the road is smooth."""
        return (0.0,)

    def describe(self) -> dict[str, Any]:
        """Returns number, range and rms of the lines, and every one of them."""
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
        """Returns the road higher or lower."""
        return replace(self, amplitudes=tuple(factor * a for a in self.amplitudes))

    def to_height(self, height: float, time: Array) -> "Multisine":
        """Returns the road scaled to a peak [m], either way, over these times [s]."""
        return self.scaled(height / float(np.abs(self.displacement(time)).max()))

    def _sum(self, t: Array, amplitudes: Array, ahead: float) -> Array:
        phases, omega = np.asarray(self.phases) + ahead, np.asarray(self.omega)
        flat = np.ravel(t)
        total = [np.sin(np.multiply.outer(block, omega) + phases) @ amplitudes for block in _blocks(flat, len(omega))]
        return np.concatenate(total).reshape(np.shape(t))


def _blocks(t: Array, lines: int) -> list[Array]:
    return np.array_split(t, max(1, -(-len(t) * lines // BLOCK)))


def chirp(omega: Array, period: float, speed: float) -> Multisine:
    """Returns lines of equal velocity with Schroeder's phases: a periodic chirp without high peaks.

    M. R. Schroeder (1970), IEEE Trans. Inf. Theory 16, 85-89: the phases make the group delay of a line the share of the power
    below it, so the lines take turns over the period: phi_i = -T sum over l < i of p_l (omega_i - omega_l), here p_l = 1/F.
    Equal velocities are a road as roads are: its velocity is white (ISO 8608 with w = 2).

    Args:
        omega: ascending angular frequencies [rad/s], shape (F,), multiples of 2 pi / period.
        period: period of the signal [s].
        speed: forward velocity [m/s].
    """
    below = np.tril(np.subtract.outer(omega, omega), -1)
    return _white(omega, -period * below.sum(axis=1) / len(omega), speed, "chirp")


def random_road(omega: Array, seed: int, speed: float) -> Multisine:
    """Returns lines of equal velocity with random phases.

    Args:
        omega: angular frequencies [rad/s], shape (F,).
        speed: forward velocity [m/s].
    """
    return _white(omega, np.random.default_rng(seed).uniform(0, 2 * np.pi, len(omega)), speed, "random")


def sinusoid(omega: float, speed: float) -> Multisine:
    """Returns one line that starts from standstill: z_r = 1 - cos(omega t) [m]."""
    return Multisine((omega,), (1.0,), (-np.pi / 2,), speed, "sinusoid")


def _white(omega: Array, phases: Array, speed: float, name: str) -> Multisine:
    return Multisine(tuple(omega.tolist()), tuple((1 / omega).tolist()), tuple(phases.tolist()), speed, name)


@dataclass(frozen=True)
class Sine(Obstacle):
    """Sine that begins at any phase, at its own height there; before, the road is flat.

        z_r = amplitude (sin(2 pi frequency (t - start) + phase) - sin(phase)),    t >= start.

    Attributes:
        amplitude: amplitude of the sine [m].
        frequency: frequency of the sine [Hz].
        phase: phase at the beginning [degrees].
        speed: V [m/s]; it matters only for the delays of the rear wheels.
        start: time at which the first wheel reaches the sine [s].

    Raises:
        InputError: a number beyond its limits.
    """

    kind: ClassVar[str] = "sine"
    tall: ClassVar[tuple[str, ...]] = ("amplitude",)
    amplitude: float = 0.02
    frequency: float = 1.0
    phase: float = 0.0
    speed: float = 20.0
    start: float = 0.0

    def __post_init__(self) -> None:
        limits = {"amplitude": LIMITS["height"], "frequency": (0.001, 100.0), "phase": (-360.0, 360.0), "speed": LIMITS["speed"]}
        check_numbers("sine", self, {**limits, "start": START})

    def displacement(self, t: Array, side: str = "") -> Array:
        """Returns the sine, the same on both sides."""
        begins = math.sin(math.radians(self.phase))
        return np.where(t >= self.start, self.amplitude * (np.sin(self._angle(t)) - begins), 0.0)

    def velocity(self, t: Array, side: str = "") -> Array:
        """Returns the exact derivative."""
        return np.where(t >= self.start, self.amplitude * 2 * np.pi * self.frequency * np.cos(self._angle(t)), 0.0)

    @property
    def kinks(self) -> tuple[float, ...]:
        """The beginning."""
        return (self.start,)

    def _angle(self, t: Array) -> Array:
        return 2 * np.pi * self.frequency * (np.asarray(t) - self.start) + math.radians(self.phase)


@dataclass(frozen=True)
class SineSweep(Obstacle):
    """Sine whose frequency f rises by the same factor every second, and whose height falls as 1/f.

        z_r = amplitude exp(-k t) sin(2 pi lowest (exp(k t) - 1) / k),    k = ln(highest / lowest) / duration.

    So the road's velocity, to which a vehicle responds, has nearly the same amplitude at all frequencies.

    Attributes:
        amplitude: amplitude at the beginning [m].
        lowest, highest: f at the beginning and at the end [Hz].
        duration: time from the first frequency to the last [s]; then the road is level.
        speed: V [m/s]; it matters only for the delays of the rear wheels.

    Raises:
        InputError: a number beyond its limits.
    """

    kind: ClassVar[str] = "sweep"
    tall: ClassVar[tuple[str, ...]] = ("amplitude",)
    amplitude: float = 0.02
    lowest: float = 0.5
    highest: float = 25.0
    duration: float = 10.0  # pyright: ignore[reportIncompatibleMethodOverride]
    speed: float = 20.0

    def __post_init__(self) -> None:
        limits = {"amplitude": LIMITS["height"], "lowest": (0.01, 100.0), "duration": (0.1, 1e4), "speed": LIMITS["speed"]}
        check_numbers("sweep", self, limits)
        check_numbers("sweep", self, {"highest": (self.lowest * 1.001, 100.0)})

    def displacement(self, t: Array, side: str = "") -> Array:
        """Returns the sweep, the same on both sides; it stays at its last height."""
        t = np.clip(t, 0.0, self.duration)
        return self.amplitude * np.exp(-self._rate * t) * np.sin(self._angle(t))

    def velocity(self, t: Array, side: str = "") -> Array:
        """Returns the exact derivative."""
        on, s = (t >= 0) & (t <= self.duration), np.clip(t, 0.0, self.duration)
        fading = self._rate * np.exp(-self._rate * s) * np.sin(self._angle(s))
        return np.where(on, self.amplitude * (2 * np.pi * self.lowest * np.cos(self._angle(s)) - fading), 0.0)

    @property
    def kinks(self) -> tuple[float, ...]:
        """Both ends."""
        return (0.0, self.duration)

    @property
    def _rate(self) -> float:
        return math.log(self.highest / self.lowest) / self.duration

    def _angle(self, t: Array) -> Array:
        return 2 * np.pi * self.lowest / self._rate * np.expm1(self._rate * t)
