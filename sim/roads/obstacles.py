"""Single obstacles and the sine sweep: roads that are one formula long."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace

import numpy as np

from models.common.arrays import Array
from sim.roads.road import LIMITS, Bump, Road, check_numbers


@dataclass(frozen=True)
class WattsHump(Road):
    """The speed hump of Watts: a circular arc. Its slope jumps at both ends.

    G. R. Watts (1973), "Road humps for the control of vehicle speeds", TRRL report LR 597: 3.7 m long, 25 to 100 mm high.

    Attributes:
        height: [m].
        length: [m].
        speed: V [m/s].

    Raises:
        InputError: a number beyond `LIMITS`; an arc of more than half a circle.
    """

    height: float = 0.1
    length: float = 3.7
    speed: float = 8.0

    def __post_init__(self) -> None:
        check_numbers("watts_hump", self, LIMITS | {"height": (1e-6, self.length / 2)})

    @property
    def radius(self) -> float:
        """Of the arc [m]."""
        return (self.length**2 / 4 + self.height**2) / (2 * self.height)

    @property
    def duration(self) -> float:
        """How long a wheel is on it [s]."""
        return self.length / self.speed

    def displacement(self, t: Array, side: str = "") -> Array:
        """The arc. Every side has the same."""
        x, on = self._from_crown(t)
        return np.where(on, np.sqrt(self.radius**2 - x**2) - (self.radius - self.height), 0.0)

    def velocity(self, t: Array, side: str = "") -> Array:
        """Its derivative."""
        x, on = self._from_crown(t)
        return np.where(on, -self.speed * x / np.sqrt(self.radius**2 - x**2), 0.0)

    @property
    def kinks(self) -> tuple[float, ...]:
        """Its two ends."""
        return (0.0, self.duration)

    def describe(self) -> dict[str, float | str]:
        """Height, length, speed."""
        return {"type": "watts_hump", **asdict(self)}

    def scaled(self, factor: float) -> Road:
        """The same shape, higher or lower."""
        return Scaled(self, factor)

    def _from_crown(self, t: Array) -> tuple[Array, Array]:
        on = (t >= 0) & (t <= self.duration)
        return np.where(on, self.speed * t - self.length / 2, 0.0), on


@dataclass(frozen=True)
class Step(Road):
    """A kerb, up or down, rounded: half a period of a cosine. A vertical edge has no derivative, and no tyre follows one.

    Attributes:
        height: up, or down where negative [m].
        edge: length over which it rises [m].
        speed: V [m/s].

    Raises:
        InputError: a number beyond its limits.
    """

    height: float = 0.05
    edge: float = 0.2
    speed: float = 8.0

    def __post_init__(self) -> None:
        check_numbers("step", self, {"height": LIMITS["height"], "edge": LIMITS["length"], "speed": LIMITS["speed"]})

    @property
    def duration(self) -> float:
        """How long a wheel is on its edge [s]."""
        return self.edge / self.speed

    def displacement(self, t: Array, side: str = "") -> Array:
        """The edge, then the height. Every side has the same."""
        return self.height / 2 * (1 - np.cos(np.pi * np.clip(t / self.duration, 0, 1)))

    def velocity(self, t: Array, side: str = "") -> Array:
        """Its derivative."""
        return self.height * np.pi / (2 * self.duration) * np.sin(np.pi * np.clip(t / self.duration, 0, 1))

    @property
    def kinks(self) -> tuple[float, ...]:
        """Both ends of the edge."""
        return (0.0, self.duration)

    def describe(self) -> dict[str, float | str]:
        """Height, edge, speed."""
        return {"type": "step", **asdict(self)}

    def scaled(self, factor: float) -> "Step":
        """The same step, higher or lower."""
        return replace(self, height=self.height * factor)


@dataclass(frozen=True)
class Pothole(Road):
    """A step down, and another one up again, under one side or both.

    Attributes:
        depth: [m].
        length: from the beginning of the first edge to the end of the second [m].
        edge: length of each edge [m].
        speed: V [m/s].
        track: the side that it lies under: "left", "right" or "both".

    Raises:
        InputError: a number beyond its limits; edges longer than the pothole.
    """

    depth: float = 0.05
    length: float = 1.0
    edge: float = 0.2
    speed: float = 8.0
    track: str = "both"

    def __post_init__(self) -> None:
        limits = {"depth": LIMITS["height"], "length": LIMITS["length"], "speed": LIMITS["speed"]}
        check_numbers("pothole", self, limits | {"edge": (LIMITS["length"][0], self.length / 2)})

    @property
    def duration(self) -> float:
        """How long a wheel is in it [s]."""
        return self.length / self.speed

    def displacement(self, t: Array, side: str = "") -> Array:
        """Down and up."""
        down, up = self._edges
        return self._under(side) * (down.displacement(t) + up.displacement(t - self.duration + up.duration))

    def velocity(self, t: Array, side: str = "") -> Array:
        """Its derivative."""
        down, up = self._edges
        return self._under(side) * (down.velocity(t) + up.velocity(t - self.duration + up.duration))

    @property
    def kinks(self) -> tuple[float, ...]:
        """Both ends of both edges."""
        edge = self.edge / self.speed
        return (0.0, edge, self.duration - edge, self.duration)

    def describe(self) -> dict[str, float | str]:
        """Depth, length, edge, speed, track."""
        return {"type": "pothole", **asdict(self)}

    def scaled(self, factor: float) -> "Pothole":
        """The same pothole, deeper or shallower."""
        return replace(self, depth=self.depth * factor)

    @property
    def _edges(self) -> tuple[Step, Step]:
        return Step(-self.depth, self.edge, self.speed), Step(self.depth, self.edge, self.speed)

    def _under(self, side: str) -> float:
        return 1.0 if not side or self.track in ("both", side) else 0.0


@dataclass(frozen=True)
class SineSweep(Road):
    """A sine whose frequency f rises by the same factor every second, and whose height falls as 1/f.

        z_r = amplitude exp(-k t) sin(2 pi lowest (exp(k t) - 1) / k),    k = ln(highest / lowest) / duration.

    So the road's velocity, to which a vehicle responds, has nearly the same amplitude at all frequencies.

    Attributes:
        amplitude: at the beginning [m].
        lowest, highest: f at the beginning and at the end [Hz].
        duration: from one to the other [s]; then the road is level.
        speed: V [m/s]; only the later wheels of a vehicle notice.

    Raises:
        InputError: a number beyond its limits.
    """

    amplitude: float = 0.02
    lowest: float = 0.5
    highest: float = 25.0
    duration: float = 10.0
    speed: float = 20.0

    def __post_init__(self) -> None:
        limits = {"amplitude": LIMITS["height"], "lowest": (0.01, 100.0), "highest": (self.lowest * 1.001, 100.0)}
        check_numbers("sweep", self, limits | {"duration": (0.1, 1e4), "speed": LIMITS["speed"]})

    def displacement(self, t: Array, side: str = "") -> Array:
        """The sweep. Every side has the same; at its end it stays where it is."""
        t = np.clip(t, 0.0, self.duration)
        return self.amplitude * np.exp(-self._rate * t) * np.sin(self._angle(t))

    def velocity(self, t: Array, side: str = "") -> Array:
        """Its exact derivative."""
        on, s = (t >= 0) & (t <= self.duration), np.clip(t, 0.0, self.duration)
        fading = self._rate * np.exp(-self._rate * s) * np.sin(self._angle(s))
        return np.where(on, self.amplitude * (2 * np.pi * self.lowest * np.cos(self._angle(s)) - fading), 0.0)

    @property
    def kinks(self) -> tuple[float, ...]:
        """Its beginning and its end."""
        return (0.0, self.duration)

    def describe(self) -> dict[str, float | str]:
        """Amplitude, lowest, highest, duration, speed."""
        return {"type": "sweep", **asdict(self)}

    def scaled(self, factor: float) -> "SineSweep":
        """The same sweep, higher or lower."""
        return replace(self, amplitude=self.amplitude * factor)

    @property
    def _rate(self) -> float:
        return math.log(self.highest / self.lowest) / self.duration

    def _angle(self, t: Array) -> Array:
        return 2 * np.pi * self.lowest / self._rate * np.expm1(self._rate * t)


@dataclass(frozen=True)
class Scaled(Road):
    """A road whose heights are multiplied.

    Attributes:
        road: the road.
        factor: what its heights are multiplied by.
    """

    road: Road
    factor: float

    @property
    def speed(self) -> float:  # pyright: ignore[reportIncompatibleVariableOverride]
        """That of the road [m/s]."""
        return self.road.speed

    def displacement(self, t: Array, side: str = "") -> Array:
        """The multiplied height."""
        return self.factor * self.road.displacement(t, side)

    def velocity(self, t: Array, side: str = "") -> Array:
        """The multiplied velocity."""
        return self.factor * self.road.velocity(t, side)

    @property
    def kinks(self) -> tuple[float, ...]:
        """Those of the road."""
        return self.road.kinks

    def describe(self) -> dict[str, float | str]:
        """The road and the factor."""
        return {**self.road.describe(), "factor": self.factor}

    def scaled(self, factor: float) -> "Scaled":
        """The same road, higher or lower."""
        return Scaled(self.road, self.factor * factor)


# By the name that a command line, a campaign file or a log has for them.
OBSTACLES: Mapping[str, type] = {
    "bump": Bump,
    "watts_hump": WattsHump,
    "step": Step,
    "pothole": Pothole,
    "sweep": SineSweep,
}
