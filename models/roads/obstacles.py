"""Single obstacles, roads of one formula each; and the table of all roads that are given by name and numbers."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import ClassVar

import numpy as np

from models.common.arrays import Array
from models.common.checks import is_finite
from models.common.errors import InputError
from models.roads.road import LIMITS, Bump, Obstacle, Road, ScaledRoad, check_numbers
from models.roads.sinusoids import START, Sine, SineSweep

AT_ONCE = 1e-9  # s: rounding of a time at a vertical edge


@dataclass(frozen=True)
class WattsHump(Obstacle):
    """Speed hump of Watts: a circular arc. Its slope jumps at both ends.

    G. R. Watts (1973), "Road humps for the control of vehicle speeds", TRRL report LR 597: 3.7 m long, 25 to 100 mm high.

    Attributes:
        height: height of the hump [m].
        length: length of the hump [m].
        speed: V [m/s].

    Raises:
        InputError: a number beyond `LIMITS`; an arc of more than half a circle.
    """

    kind: ClassVar[str] = "watts_hump"
    height: float = 0.1
    length: float = 3.7
    speed: float = 8.0

    def __post_init__(self) -> None:
        check_numbers("watts_hump", self, {"length": LIMITS["length"], "speed": LIMITS["speed"]})
        _check_length(self, "watts_hump", "height", "twice its height of")
        check_numbers("watts_hump", self, {"height": (1e-6, self.length / 2)})

    @property
    def radius(self) -> float:
        """Radius of the arc [m]."""
        return (self.length**2 / 4 + self.height**2) / (2 * self.height)

    @property
    def duration(self) -> float:
        """Time of a wheel on the hump [s]."""
        return self.length / self.speed

    def displacement(self, t: Array, side: str = "") -> Array:
        """Returns the arc, the same on both sides."""
        x, on = self._from_crown(t)
        return np.where(on, np.sqrt(self.radius**2 - x**2) - (self.radius - self.height), 0.0)

    def velocity(self, t: Array, side: str = "") -> Array:
        """Returns the derivative."""
        x, on = self._from_crown(t)
        return np.where(on, -self.speed * x / np.sqrt(self.radius**2 - x**2), 0.0)

    @property
    def kinks(self) -> tuple[float, ...]:
        """Both ends."""
        return (0.0, self.duration)

    def scaled(self, factor: float) -> Road:
        """Returns the same shape, higher or lower."""
        return ScaledRoad(self, factor)

    def _from_crown(self, t: Array) -> tuple[Array, Array]:
        on = (t >= 0) & (t <= self.duration)
        return np.where(on, self.speed * t - self.length / 2, 0.0), on


@dataclass(frozen=True)
class Step(Obstacle):
    """Kerb, up or down, rounded: half a period of a cosine; or vertical, which no tyre follows but formulas do.

    A vertical edge is a jump of the height: an impulse of its velocity in the linear response, between two samples in MuJoCo.

    Attributes:
        height: height, negative for a step down [m].
        edge: length over which it rises [m]; 0 for a vertical one.
        speed: V [m/s].
        start: time at which the first wheel reaches the edge [s].

    Raises:
        InputError: a number beyond its limits.
    """

    kind: ClassVar[str] = "step"
    height: float = 0.05
    edge: float = 0.2
    speed: float = 8.0
    start: float = 0.0

    def __post_init__(self) -> None:
        check_numbers("step", self, {"height": LIMITS["height"], "speed": LIMITS["speed"], "start": START})
        if not (isinstance(self.edge, float | int) and self.edge == 0):
            check_numbers("step", self, {"edge": LIMITS["length"]})

    @property
    def rise(self) -> float:
        """Time of a wheel on the edge [s]."""
        return self.edge / self.speed

    @property
    def duration(self) -> float:
        """Time until a wheel is past the edge [s]."""
        return self.start + self.rise

    def displacement(self, t: Array, side: str = "") -> Array:
        """Returns the edge, then the height, the same on both sides."""
        if not self.edge:
            return np.where(np.asarray(t) > self.start + AT_ONCE, self.height, 0.0)
        return self.height / 2 * (1 - np.cos(np.pi * np.clip((t - self.start) / self.rise, 0, 1)))

    def velocity(self, t: Array, side: str = "") -> Array:
        """Returns the derivative, 0 beside a jump."""
        if not self.edge:
            return np.zeros(np.shape(t))
        return self.height * np.pi / (2 * self.rise) * np.sin(np.pi * np.clip((t - self.start) / self.rise, 0, 1))

    @property
    def kinks(self) -> tuple[float, ...]:
        """Both ends of the edge."""
        return (self.start, self.duration) if self.edge else (self.start,)

    @property
    def jumps(self) -> tuple[tuple[float, float], ...]:
        """The edge, if it is vertical."""
        return () if self.edge else ((self.start, self.height),)

    def describe(self) -> dict[str, float | str]:
        """Height, edge, speed, and the start unless it is 0."""
        return {"type": "step", **{name: value for name, value in asdict(self).items() if name != "start" or value}}


@dataclass(frozen=True)
class Pothole(Obstacle):
    """Step down, and another one up again, under one side or both.

    Attributes:
        depth: depth of the pothole [m].
        length: distance from the beginning of the first edge to the end of the second [m].
        edge: length of each edge [m].
        speed: V [m/s].
        track: side of the road: "left", "right" or "both".

    Raises:
        InputError: a number beyond its limits; edges longer than the pothole.
    """

    kind: ClassVar[str] = "pothole"
    tall: ClassVar[tuple[str, ...]] = ("depth",)
    depth: float = 0.05
    length: float = 1.0
    edge: float = 0.2
    speed: float = 8.0
    track: str = "both"

    def __post_init__(self) -> None:
        check_numbers("pothole", self, {"depth": LIMITS["height"], "length": LIMITS["length"], "speed": LIMITS["speed"]})
        _check_length(self, "pothole", "edge", "its two edges of")
        check_numbers("pothole", self, {"edge": (LIMITS["length"][0], self.length / 2)})

    @property
    def duration(self) -> float:
        """Time of a wheel in the pothole [s]."""
        return self.length / self.speed

    def displacement(self, t: Array, side: str = "") -> Array:
        """Returns the steps down and up."""
        down, up = self._edges
        return self._under(side) * (down.displacement(t) + up.displacement(t - self.duration + up.duration))

    def velocity(self, t: Array, side: str = "") -> Array:
        """Returns the derivative."""
        down, up = self._edges
        return self._under(side) * (down.velocity(t) + up.velocity(t - self.duration + up.duration))

    @property
    def kinks(self) -> tuple[float, ...]:
        """Both ends of both edges."""
        edge = self.edge / self.speed
        return (0.0, edge, self.duration - edge, self.duration)

    @property
    def _edges(self) -> tuple[Step, Step]:
        return Step(-self.depth, self.edge, self.speed), Step(self.depth, self.edge, self.speed)

    def _under(self, side: str) -> float:
        return 1.0 if not side or self.track in ("both", side) else 0.0


@dataclass(frozen=True)
class Flat(Obstacle):
    """Flat road, for a vehicle that is excited by loads alone.

    Attributes:
        speed: V [m/s].

    Raises:
        InputError: a number beyond its limits.
    """

    kind: ClassVar[str] = "flat"
    tall: ClassVar[tuple[str, ...]] = ()
    speed: float = 20.0

    def __post_init__(self) -> None:
        check_numbers("flat", self, {"speed": LIMITS["speed"]})

    def displacement(self, t: Array, side: str = "") -> Array:
        """Returns zero."""
        return np.zeros_like(t)

    def velocity(self, t: Array, side: str = "") -> Array:
        """Returns zero."""
        return np.zeros_like(t)

    @property
    def kinks(self) -> tuple[float, ...]:
        """Empty."""
        return ()


def _check_length(road: WattsHump | Pothole, kind: str, other: str, least: str) -> None:
    """Refuses a length below twice another number that has its default, and so is not what was given."""
    usual, value = getattr(type(road), other), getattr(road, other)
    if is_finite(value) and value == usual and road.length < 2 * usual:
        short = f"{kind} length = {road.length:g} m is less than {least} {usual:g} m"
        raise InputError(f"{short}; give at least {2 * usual:g} m, or {other}={road.length / 2:g} or less")


# By their names on a command line, in a campaign file or in a log.
OBSTACLES: Mapping[str, type] = {one.kind: one for one in (Bump, WattsHump, Step, Pothole, SineSweep, Flat, Sine)}
