"""Single obstacles, each defined by one formula, and the table of all roads that are defined by a name and numbers."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Annotated, ClassVar

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.schema import SI
from models.roads.road import Bump, Length, Obstacle, Road, ScaledRoad, Speed, Track
from models.roads.sinusoids import Sine, SineSweep, Start

# A time that exceeds the time of a vertical edge by at most this rounding error [s] counts as the time of the edge
AT_ONCE = 1e-9


@dataclass(frozen=True)
class WattsHump(Obstacle):
    """Speed hump of Watts: a circular arc. The slope of the hump jumps at both ends.

    Source: G. R. Watts (1973), "Road humps for the control of vehicle speeds", TRRL report LR 597. The humps in the report of
        Watts are 3.7 m long and 25 to 100 mm high.

    Raises:
        InputError: a number is out of its range, or the arc is longer than half a circle.
    """

    kind: ClassVar[str] = "watts_hump"
    height: Annotated[float, SI("m", "height, at most half of the length", 1e-6, 5e3)] = 0.1
    length: Length = 3.7
    speed: Speed = 8.0

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_half(self, "height", 1e-6, "twice its height of")

    @property
    def radius(self) -> float:
        """Radius of the arc [m]."""
        return (self.length**2 / 4 + self.height**2) / (2 * self.height)

    @property
    def duration(self) -> float:
        """Time that a wheel spends on the hump [s]."""
        return self.length / self.speed

    def displacement(self, t: Array, side: str = "") -> Array:
        """Returns the height of the arc [m], which is equal for left and right wheels."""
        x, on = self._from_crown(t)
        return np.where(on, np.sqrt(self.radius**2 - x**2) - (self.radius - self.height), 0.0)

    def velocity(self, t: Array, side: str = "") -> Array:
        """Returns the time derivative of the height [m/s]."""
        x, on = self._from_crown(t)
        return np.where(on, -self.speed * x / np.sqrt(self.radius**2 - x**2), 0.0)

    @property
    def kinks(self) -> tuple[float, ...]:
        """Times at which the first wheel is at the ends of the hump [s]."""
        return (0.0, self.duration)

    def scaled(self, factor: float) -> Road:
        """Returns the same shape with heights multiplied by a factor."""
        return ScaledRoad(self, factor)

    def _from_crown(self, t: Array) -> tuple[Array, Array]:
        on = (t >= 0) & (t <= self.duration)
        return np.where(on, self.speed * t - self.length / 2, 0.0), on


@dataclass(frozen=True)
class Step(Obstacle):
    """Kerb, up or down; its edge is vertical, or rounded as half a period of a cosine.

    No real tyre follows a vertical edge, but formulas often assume a vertical edge. At a vertical edge, the height of the road
    jumps. In linear analysis, the road velocity at a vertical edge is an impulse. In MuJoCo, the height at a vertical edge
    changes between two time steps.

    Raises:
        InputError: a number is out of its range, or the edge is not vertical (0) but shorter than the smallest allowed length.
    """

    kind: ClassVar[str] = "step"
    height: Annotated[float, SI("m", "height, negative for a step down", -10.0, 10.0)] = 0.05
    edge: Annotated[float, SI("m", "length over which it rises; 0 for a vertical step", 0.0, 1e4)] = 0.2
    speed: Speed = 8.0
    start: Start = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.edge:
            SI("m", low=1e-3, high=1e4).number("step edge", self.edge)

    @property
    def rise(self) -> float:
        """Time that a wheel needs to pass the edge [s]."""
        return self.edge / self.speed

    @property
    def duration(self) -> float:
        """Time until a wheel has passed the edge [s]."""
        return self.start + self.rise

    def displacement(self, t: Array, side: str = "") -> Array:
        """Returns the height of the road [m] on the edge and behind the edge, which is equal for left and right wheels."""
        if not self.edge:
            return np.where(np.asarray(t) > self.start + AT_ONCE, self.height, 0.0)
        return self.height / 2 * (1 - np.cos(np.pi * np.clip((t - self.start) / self.rise, 0, 1)))

    def velocity(self, t: Array, side: str = "") -> Array:
        """Returns the time derivative of the height [m/s], without the impulse of a vertical edge."""
        if not self.edge:
            return np.zeros(np.shape(t))
        return self.height * np.pi / (2 * self.rise) * np.sin(np.pi * np.clip((t - self.start) / self.rise, 0, 1))

    @property
    def kinks(self) -> tuple[float, ...]:
        """Times at which the first wheel is at the ends of the edge [s]."""
        return (self.start, self.duration) if self.edge else (self.start,)

    @property
    def jumps(self) -> tuple[tuple[float, float], ...]:
        """Time [s] at which the first wheel reaches a vertical edge, and height of the edge [m]; empty for a rounded edge."""
        return () if self.edge else ((self.start, self.height),)

    def describe(self) -> dict[str, float | str]:
        """Returns a description with height, edge and speed, and also with the start if the start is not 0."""
        return {"type": "step", **{name: value for name, value in asdict(self).items() if name != "start" or value}}


@dataclass(frozen=True)
class Pothole(Obstacle):
    """Pothole: a step down and a step up again, under the wheels of one side or of both sides.

    Raises:
        InputError: a number is out of its range, or the edges are longer than the pothole.
    """

    kind: ClassVar[str] = "pothole"
    tall: ClassVar[tuple[str, ...]] = ("depth",)
    depth: Annotated[float, SI("m", "depth", -10.0, 10.0)] = 0.05
    length: Annotated[float, SI("m", "distance from the beginning of the first edge to the end of the second", 1e-3, 1e4)] = 1.0
    edge: Annotated[float, SI("m", "length of each edge, at most half of the length", 1e-3, 5e3)] = 0.2
    speed: Speed = 8.0
    track: Track = "both"

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_half(self, "edge", 1e-3, "its two edges of")

    @property
    def duration(self) -> float:
        """Time that a wheel spends in the pothole [s]."""
        return self.length / self.speed

    def displacement(self, t: Array, side: str = "") -> Array:
        """Returns the height of the road [m], which is the sum of the two steps of the pothole."""
        down, up = self._edges
        return self._under(side) * (down.displacement(t) + up.displacement(t - self.duration + up.duration))

    def velocity(self, t: Array, side: str = "") -> Array:
        """Returns the time derivative of the height [m/s]."""
        down, up = self._edges
        return self._under(side) * (down.velocity(t) + up.velocity(t - self.duration + up.duration))

    @property
    def kinks(self) -> tuple[float, ...]:
        """Times at which the first wheel is at the ends of the two edges [s]."""
        edge = self.edge / self.speed
        return (0.0, edge, self.duration - edge, self.duration)

    @property
    def _edges(self) -> tuple[Step, Step]:
        return Step(-self.depth, self.edge, self.speed), Step(self.depth, self.edge, self.speed)

    def _under(self, side: str) -> float:
        return 1.0 if not side or self.track in ("both", side) else 0.0


@dataclass(frozen=True)
class Flat(Obstacle):
    """Flat road, for a vehicle that is excited only by loads.

    Raises:
        InputError: the speed is out of its range.
    """

    kind: ClassVar[str] = "flat"
    tall: ClassVar[tuple[str, ...]] = ()
    speed: Speed = 20.0

    def displacement(self, t: Array, side: str = "") -> Array:
        """Returns zeros [m]."""
        return np.zeros_like(t)

    def velocity(self, t: Array, side: str = "") -> Array:
        """Returns zeros [m/s]."""
        return np.zeros_like(t)

    @property
    def kinks(self) -> tuple[float, ...]:
        """Empty, because a flat road has no kinks."""
        return ()


def _check_half(road: WattsHump | Pothole, other: str, low: float, least: str) -> None:
    """Checks that a number, such as the height, is at most half of the obstacle's length.

    If the number has its default value, the error message is about the length instead.
    """
    usual, value = getattr(type(road), other), getattr(road, other)
    if value == usual and road.length < 2 * usual:
        short = f"{road.kind} length = {road.length:g} m is less than {least} {usual:g} m"
        raise InputError(f"{short}; give a length of at least {2 * usual:g} m, or set {other} to at most {road.length / 2:g} m")
    SI("m", low=low, high=road.length / 2).number(f"{road.kind} {other}", value)


# Types of road, with the names that are used on a command line, in a campaign file and in a log.
OBSTACLES: Mapping[str, type] = {one.kind: one for one in (Bump, WattsHump, Step, Pothole, SineSweep, Flat, Sine)}
