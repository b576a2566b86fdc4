"""Roads: the height under a wheel as a function of time, and its exact derivative."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, ClassVar, NamedTuple

import numpy as np

from models.common.arrays import Array
from models.common.checks import check_fields
from models.common.errors import InputError
from models.common.schema import SI, Choice, Section, keys
from models.kinds.kind import Parameters, Wheel
from models.kinds.plausibility import KnownQuantity, remarks
from models.vehicle.names import BUMP_HEIGHT, BUMP_LENGTH, BUMP_SPEED
from models.vehicle.vehicle import Vehicle

if TYPE_CHECKING:
    from models.roads.spectrum import Spectrum

HIGHEST = 10.0  # m
Length = Annotated[float, SI("m", "length", 1e-3, 1e4)]
Speed = Annotated[float, SI("m/s", "speed of the vehicle", 1e-3, 1e3)]
Track = Annotated[str, Choice("side of the road that it is under", ("left", "right", "both"))]
STEADY = 1e-12  # of the largest state, or term of a signal, in steady motion; what is smaller is rounding
LOWEST = 1e-5  # m; the effect of a lower road is lost in the rounding of a vehicle's weight


class Road(ABC):
    """Road driven at constant speed, or posts that move. Time 0 is when the first wheel reaches its start."""

    speed: float
    """Forward velocity of the vehicle [m/s]."""

    track: str = "both"
    """The side that it lies under: "left", "right" or "both"."""

    laid: bool = True
    """True if it lies along the way, so that every wheel of a side drives over it; False for a rig with a post per wheel."""

    @property
    def duration(self) -> float:
        """Time of a wheel on it [s]; infinite for a road without end."""
        return math.inf

    def track_of(self, wheel: Wheel) -> str:
        """Returns the side of a wheel, as `displacement` takes it."""
        return wheel.side

    def delay_of(self, wheel: Wheel, parameters: Parameters) -> float:
        """Returns the delay of a wheel after the first one [s]."""
        return wheel.behind(parameters) / self.speed

    @property
    def units(self) -> Mapping[str, str]:
        """Units of the numbers in its description, by name."""
        return {name: key.unit for name, key in keys(type(self)).items()} if isinstance(self, Section) else {}

    @property
    def spectrum(self) -> "Spectrum | None":
        """Spectrum of a random road; None for others."""
        return None

    @property
    def points(self) -> bytes | None:
        """Data too long for `describe`, as a CSV file; None if the description alone gives the road."""
        return None

    @property
    def from_start(self) -> "Road":
        """The road measured from the steady motion in which the vehicle starts, see `MeasuredRoad`; itself if that is rest."""
        return self

    @property
    def warnings(self) -> list[str]:
        """Remarks on numbers that are probably in another unit: a speed, or the height of an obstacle."""
        heights = ({"obstacle": KnownQuantity(name, abs(getattr(self, name)), "m")} for name in getattr(self, "tall", ()))
        return remarks([{"speed": KnownQuantity("speed", self.speed, "m/s")}, *heights])

    @property
    def loaded(self) -> bool:
        """True if loads act on the vehicle's body."""
        return False

    @property
    def load_kinks(self) -> tuple[float, ...]:
        """Times [s] at which a load or one of its derivatives jumps."""
        return ()

    def loads(self, vehicle: Vehicle, t: Array) -> Array:
        """Returns the loads on a vehicle's body [N, N m] at times t [s], shapes (T,) and (T, l), in the order of its kind's."""
        return np.zeros((len(t), len(vehicle.kind.loads)))

    def held_loads(self, vehicle: Vehicle, t: Array, timestep: float) -> Array:
        """Returns the loads that physics holds over steps, by their middle times t [s], see `loads`: those at t."""
        return self.loads(vehicle, t)

    @abstractmethod
    def displacement(self, t: Array, side: str = "") -> Array:
        """Returns the height under the first wheel of a side [m] at times t [s], same shape. See `Wheel.side`, and `track_of`."""

    def held_height(self, t: Array, timestep: float, side: str = "") -> Array:
        """Returns the height at which physics holds it over steps [m], by their middle times t [s], same shape: the one at t.

        A measured road, whose points may be closer than a step, is held at its mean height over the step.
        """
        return self.displacement(t, side)

    @abstractmethod
    def velocity(self, t: Array, side: str = "") -> Array:
        """Returns the time derivative of `displacement` [m/s] at times t [s], same shape."""

    @abstractmethod
    def scaled(self, factor: float) -> "Road":
        """Returns the road with its heights multiplied."""

    @property
    @abstractmethod
    def kinks(self) -> tuple[float, ...]:
        """Times [s] at which `velocity` or one of its derivatives jumps; a quadrature must not step across one."""

    @property
    def jumps(self) -> tuple[tuple[float, float], ...]:
        """Times [s] at which the height jumps, and by how much [m]: to the left of a jump the road has its earlier height.

        The velocity leaves them out. They are among the kinks.
        """
        return ()

    @abstractmethod
    def describe(self) -> dict[str, float | str]:
        """Returns its kind under `type`, then its numbers in SI units."""

    @property
    def words(self) -> str:
        """The description on a line for people, without long lists."""
        kind, *short = [(key, value) for key, value in self.describe().items() if not isinstance(value, list) and value != ""]
        units = self.units
        number = [
            f"{key} {value:g} {units.get(key, '')}".rstrip() if isinstance(value, float) else f"{key} {value}"
            for key, value in short
        ]
        return ", ".join([str(kind[1]), *number])

    def check(self, vehicle: Vehicle, time: Array) -> None:
        """Checks that a vehicle can be driven over it at these sample times from 0 [s], and feels it. A flat one is fine.

        Raises:
            InputError: the road ends within two timesteps, is under one side of a vehicle with one track, or is too low.
        """
        timestep = float(time[1])
        if self.duration < 2 * timestep and not self.jumps:
            raise InputError(
                f"the road takes only {self.duration:.3g} s, less than two timesteps of {timestep:g} s, so the simulation would "
                "miss it; give a longer road, a lower speed, or a smaller timestep"
            )
        if self.track != "both" and not any(wheel.side for wheel in vehicle.kind.wheels):
            raise InputError(f"track = {self.track} needs two tracks, but a {vehicle.kind.name} has only one; omit track")
        heights = under_wheels(self.displacement, self, vehicle, time)
        if heights.ndim != 2 or len(heights) != len(time) or not np.all(np.isfinite(heights)):
            raise InputError(f"{type(self).__name__}.displacement(t) must return one finite height [m] for each time in t")
        highest = float(np.abs(heights).max())
        if 0 < highest < LOWEST:
            raise InputError(
                f"the road's height is at most {highest:.2g} m in {time[-1]:.4g} s of the run, and heights below {LOWEST:g} m "
                "are lost in rounding; give a higher road, a higher speed, a longer duration, or height 0"
            )


@dataclass(frozen=True)
class Obstacle(Section, Road):
    """Road that a few numbers describe: its fields, the keys of its text, its table and its record in a log.

    Raises:
        InputError: a number out of its range, or in a unit of another dimension.
    """

    kind: ClassVar[str]
    tall: ClassVar[tuple[str, ...]] = ("height",)  # fields that a factor on its heights multiplies

    def __post_init__(self) -> None:
        check_fields(self, f"{self.kind} ")

    def describe(self) -> dict[str, float | str]:
        """Returns its kind under `type`, and its fields."""
        return {"type": self.kind, **asdict(self)}

    def scaled(self, factor: float) -> Road:
        """Returns the road higher or lower."""
        return replace(self, **{name: getattr(self, name) * factor for name in self.tall})


@dataclass(frozen=True)
class Bump(Obstacle):
    """Isolated bump (61): one period of a cosine. Defaults are the paper's (62)."""

    kind: ClassVar[str] = "bump"
    height: Annotated[float, SI("m", "height", -HIGHEST, HIGHEST)] = BUMP_HEIGHT
    length: Length = BUMP_LENGTH
    speed: Speed = BUMP_SPEED
    track: Track = "both"

    @property
    def duration(self) -> float:
        """Time of a wheel on the bump, L / V [s]."""
        return self.length / self.speed

    def displacement(self, t: Array, side: str = "") -> Array:
        """Returns equation (61)."""
        on = self._on(t, side)
        return np.where(on, self.height / 2 * (1 - np.cos(2 * np.pi * t / self.duration)), 0.0)

    def velocity(self, t: Array, side: str = "") -> Array:
        """Returns the derivative of (61)."""
        on = self._on(t, side)
        return np.where(on, self.height * np.pi / self.duration * np.sin(2 * np.pi * t / self.duration), 0.0)

    @property
    def kinks(self) -> tuple[float, ...]:
        """Both ends."""
        return (0.0, self.duration)

    def _on(self, t: Array, side: str) -> Array:
        return (t >= 0) & (t <= self.duration) & (not side or self.track in ("both", side))


@dataclass(frozen=True, eq=False)
class DerivedRoad(Road):
    """Road made of another one: same speed, track, duration and kinks.

    Attributes:
        road: the other road.
    """

    road: Road

    @property
    def speed(self) -> float:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Speed on the road [m/s]."""
        return self.road.speed

    @property
    def track(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Track of the road."""
        return self.road.track

    @property
    def units(self) -> Mapping[str, str]:
        """Units of the road's description."""
        return self.road.units

    @property
    def duration(self) -> float:
        """Duration of the road [s]."""
        return self.road.duration

    @property
    def kinks(self) -> tuple[float, ...]:
        """Kinks of the road."""
        return self.road.kinks

    @property
    def warnings(self) -> list[str]:
        """Remarks on the road."""
        return self.road.warnings

    @property
    def jumps(self) -> tuple[tuple[float, float], ...]:
        """Jumps of the road."""
        return self.road.jumps

    @property
    def laid(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        """True if the road is laid."""
        return self.road.laid

    def track_of(self, wheel: Wheel) -> str:
        """Returns the track of the road under a wheel."""
        return self.road.track_of(wheel)

    def delay_of(self, wheel: Wheel, parameters: Parameters) -> float:
        """Returns the delay of a wheel on the road [s]."""
        return self.road.delay_of(wheel, parameters)


class MeasuredRoad(Road):
    """Road of measured heights, on which a vehicle starts in steady motion: its wheels climb a straight line each.

    Heights are measured from one datum, the mean of the heights at the first contacts.
    """

    @property
    def units(self) -> Mapping[str, str]:
        """Units of the numbers in its description."""
        return {**dict.fromkeys(("from", "length", "lowest", "highest"), "m"), "duration": "s", "speed": "m/s"}

    @abstractmethod
    def start(self, side: str) -> tuple[float, float]:
        """Returns height [m] at time 0 and rate [m/s] of the steady motion on a side."""

    @abstractmethod
    def departure(self, t: Array, side: str) -> Array:
        """Returns the height of the road over the steady motion [m] at times t [s], same shape; 0 up to time 0."""

    @abstractmethod
    def departure_rate(self, t: Array, side: str) -> Array:
        """Returns the time derivative of `departure` [m/s] at times t [s], same shape."""

    def displacement(self, t: Array, side: str = "") -> Array:
        """Returns the height over the datum."""
        height, rate = self.start(side)
        return height + rate * np.asarray(t) + self.departure(t, side)

    def velocity(self, t: Array, side: str = "") -> Array:
        """Returns the derivative."""
        return self.start(side)[1] + self.departure_rate(t, side)

    @property
    @abstractmethod
    def knots(self) -> Array:
        """Times of the points, ascending [s]; between them `departure` is a line or a cubic."""

    @property
    def kinks(self) -> tuple[float, ...]:
        """Every point: many of a spline in one step would be too much for its quadrature."""
        return tuple(self.knots.tolist())

    def mean_departure(self, t: Array, timestep: float, side: str) -> Array:
        """Returns the mean of `departure` over steps [m], by their middle times t [s], same shape; exact but for rounding."""
        return means(lambda t: self.departure(t, side), self.knots, t, timestep)

    @property
    def from_start(self) -> "Departure":
        """The road measured from the steady motion."""
        return Departure(self)


@dataclass(frozen=True, eq=False)
class Departure(DerivedRoad):
    """Measured road, measured from the steady motion in which the vehicle starts."""

    road: MeasuredRoad

    def displacement(self, t: Array, side: str = "") -> Array:
        """Returns the height over the steady motion."""
        return self.road.departure(t, side)

    def held_height(self, t: Array, timestep: float, side: str = "") -> Array:
        """Returns its mean over steps."""
        return self.road.mean_departure(t, timestep, side)

    def velocity(self, t: Array, side: str = "") -> Array:
        """Returns its derivative."""
        return self.road.departure_rate(t, side)

    def describe(self) -> dict[str, float | str]:
        """Returns the description of the road."""
        return self.road.describe()

    def scaled(self, factor: float) -> Road:
        """Returns the multiplied road, measured from its own steady motion."""
        return self.road.scaled(factor).from_start


@dataclass(frozen=True)
class ScaledRoad(DerivedRoad):
    """Road with multiplied heights.

    Attributes:
        factor: factor on its heights.
    """

    factor: float

    @property
    def jumps(self) -> tuple[tuple[float, float], ...]:
        """Jumps of the road, multiplied."""
        return tuple((time, self.factor * height) for time, height in self.road.jumps)

    def displacement(self, t: Array, side: str = "") -> Array:
        """Returns the multiplied height."""
        return self.factor * self.road.displacement(t, side)

    def held_height(self, t: Array, timestep: float, side: str = "") -> Array:
        """Returns the multiplied height of the steps."""
        return self.factor * self.road.held_height(t, timestep, side)

    def velocity(self, t: Array, side: str = "") -> Array:
        """Returns the multiplied velocity."""
        return self.factor * self.road.velocity(t, side)

    def describe(self) -> dict[str, float | str]:
        """Returns the road's description and the factor."""
        return {**self.road.describe(), "factor": self.factor}

    def scaled(self, factor: float) -> "ScaledRoad":
        """Returns the road higher or lower."""
        return ScaledRoad(self.road, self.factor * factor)


def means(function: Callable[[Array], Array], knots: Array, t: Array, length: float) -> Array:
    """Returns means of a function over intervals, same shape as t; exact if it is a line or a cubic between knots.

    Args:
        function: function to average, continuous.
        knots: points at which the function has a kink, ascending, shape (K,).
        t: middles of the intervals.
        length: length of each.
    """
    start, end = t - length / 2, t + length / 2

    def area(a: Array, b: Array) -> Array:
        """Returns integrals by two points of Gauss."""
        middle, apart = (a + b) / 2, (b - a) / math.sqrt(12)
        return (b - a) / 2 * (function(middle - apart) + function(middle + apart))

    mean = area(start, end) / length
    first, last = np.searchsorted(knots, start, side="right"), np.searchsorted(knots, end) - 1  # knots inside
    (some,) = np.nonzero(first <= last)
    if len(some):
        first, last = first[some], last[some]
        sums = np.add.reduceat(np.append(area(knots[:-1], knots[1:]), 0.0), np.stack([first, last], axis=-1).ravel())[::2]
        ends = area(start[some], knots[first]) + area(knots[last], end[some])
        mean[some] = (ends + np.where(first < last, sums, 0.0)) / length
    return mean


def delays(road: Road, vehicle: Vehicle) -> list[float]:
    """Returns the delay of each wheel after the first one [s]."""
    return [road.delay_of(wheel, vehicle.parameters) for wheel in vehicle.kind.wheels]


def track_width(vehicle: Vehicle) -> float:
    """Returns the distance from the rightmost wheel to the leftmost [m]; 0 for a vehicle with one track."""
    lateral = [wheel.lateral(vehicle.parameters) for wheel in vehicle.kind.wheels]
    return max(lateral) - min(lateral)


def under_wheels(function: Callable[[Array, str], Array], road: Road, vehicle: Vehicle, t: Array) -> Array:
    """Returns a road's `displacement` or `velocity` under every wheel, shape (T, r), at times t [s] of shape (T,).

    Args:
        function: `road.displacement` or `road.velocity`.
        vehicle: r wheels.
        t: times [s].
    """
    tracks = [(delay, road.track_of(wheel)) for wheel, delay in zip(vehicle.kind.wheels, delays(road, vehicle), strict=True)]
    return np.stack([function(t - delay, track) for delay, track in tracks], axis=-1)


SAME_TIME = 1e-12  # relative rounding of a time over the timestep


def jumps_under_wheels(road: Road, vehicle: Vehicle) -> list[tuple[float, int, float]]:
    """Returns the jumps of a road's height: time [s], wheel by index, and how far [m]."""
    later = enumerate(delays(road, vehicle))
    return [(time + delay, i, height) for i, delay in later for time, height in road.jumps]


class Edge(NamedTuple):
    """Vertical edge of the road at a sample: the change of the heights to its other side [m], shape (r,).

    `behind` is True if the sample has the height behind the edge.
    """

    change: Array
    behind: bool


@dataclass(frozen=True, eq=False)
class RoadInput:
    """Road and loads at the samples of a run on a vehicle, each computed once, when first needed.

    Heights and velocities are measured from the steady motion in which the vehicle starts (`MeasuredRoad`), which is an inertial
    frame in which the run starts from rest. `steady` is that motion.

    Attributes:
        vehicle: r wheels, and a body that l loads push.
        road: the road.
        time: equidistant sample times [s], shape (T,).
        earlier: True to repeat a run of an earlier version, whose signals at a sample were under the load of the step from there,
            and lacked the other side of vertical edges.
    """

    vehicle: Vehicle
    road: Road
    time: Array
    earlier: bool = False

    @property
    def timestep(self) -> float:
        """Time between two samples [s]."""
        return float(self.time[1] - self.time[0])

    @property
    def loaded(self) -> bool:
        """True if there are loads."""
        return self.road.loaded

    @property
    def has_held_inputs(self) -> bool:
        """True if something held acts beside the road's heights: loads, or its velocities through tyres that damp."""
        return self.loaded or self.vehicle.linear_model.tyres_damp

    @cached_property
    def relative_road(self) -> Road:
        """The road measured from the steady motion."""
        return self.road.from_start

    def steady_signals(self, time: Array) -> Array | None:
        """Returns the vehicle's signals in the steady motion, by its linear model, shape (T, S); None for rest on a flat road.

        The state rests at x = -A^-1 (Bw w + Br z_r): velocities are those of the plane, and deflections are zero, except where
        posts twist the vehicle, or the weight of a body with a roll or pitch axis leans.

        Args:
            time: times [s], shape (T,).
        """
        if not isinstance(self.relative_road, Departure):
            return None
        start, model, kind = self.relative_road.road.start, self.vehicle.linear_model, self.vehicle.kind
        z = under_wheels(lambda t, side: start(side)[0] + start(side)[1] * t, self.relative_road, self.vehicle, time)
        w = under_wheels(lambda t, side: np.full(np.shape(t), start(side)[1]), self.relative_road, self.vehicle, time)
        state = np.linalg.lstsq(model.A, -(model.Bw @ w[0] + model.Br @ z[0]))[0] if len(time) else np.zeros(len(model.A))
        state[np.abs(state) <= STEADY * np.abs(state).max(initial=0.0)] = 0.0
        outputs = model.C @ state + z @ model.Cr.T + w @ model.Dw.T
        terms = np.abs(model.C) @ np.abs(state) + np.abs(z) @ np.abs(model.Cr.T) + np.abs(w) @ np.abs(model.Dw.T)
        outputs[np.abs(outputs) <= STEADY * terms] = 0.0
        values = dict(zip(model.outputs, outputs.T, strict=True))
        for i, wheel in enumerate(kind.wheels):
            values |= {wheel.road_displacement: z[:, i], wheel.road_velocity: w[:, i]}
        return np.stack([values.get(signal.name, np.zeros(len(time))) for signal in kind.signals], axis=-1)

    @cached_property
    def heights(self) -> Array:
        """Heights under the wheels at the samples [m], shape (T, r)."""
        return under_wheels(self.relative_road.displacement, self.relative_road, self.vehicle, self.time)

    @cached_property
    def midway(self) -> Array:
        """Heights at which MuJoCo holds the road over the steps from the samples [m], shape (T, r)."""
        return self.held_heights(self.time + self.timestep / 2)

    def held_heights(self, middle: Array) -> Array:
        """Returns heights at which MuJoCo holds the road [m], shape (T, r), over steps with these middle times [s]."""
        return under_wheels(
            lambda t, side: self.relative_road.held_height(t, self.timestep, side), self.relative_road, self.vehicle, middle
        )

    @cached_property
    def velocities(self) -> Array:
        """Rates of the heights at the samples [m/s], shape (T, r)."""
        return under_wheels(self.relative_road.velocity, self.relative_road, self.vehicle, self.time)

    @cached_property
    def loads(self) -> Array:
        """Loads on the body at the samples [N, N m], shape (T, l)."""
        return self.road.loads(self.vehicle, self.time)

    @cached_property
    def held_loads(self) -> Array:
        """Loads as MuJoCo holds them over the steps from the samples [N, N m], shape (T, l)."""
        return self.road.held_loads(self.vehicle, self.time + self.timestep / 2, self.timestep)

    @cached_property
    def held_velocities(self) -> Array:
        """Mean velocities of the heights over the steps from the samples [m/s], shape (T, r), at which MuJoCo holds them.

        With them a tyre's damping has the impulse c dz of every step, also over a kink or an edge.
        """
        end = under_wheels(self.relative_road.displacement, self.relative_road, self.vehicle, self.time[-1:] + self.timestep)
        return np.diff(self.heights, axis=0, append=end) / self.timestep

    @cached_property
    def held_inputs(self) -> Array:
        """All that is held over the steps: loads, and if tyres damp the road's velocities, shape (T, l) or (T, l + r)."""
        if not self.vehicle.linear_model.tyres_damp:
            return self.held_loads
        return np.hstack([self.held_loads, self.held_velocities])

    @cached_property
    def in_signals(self) -> Array:
        """Inputs of the signals of the samples: the loads there, and the road's velocities as held; shape as of `held_inputs`."""
        return self.held_inputs if self.earlier else np.hstack([self.loads, self.held_inputs[:, self.loads.shape[1] :]])

    @cached_property
    def in_readings(self) -> Array:
        """Inputs of the measurements, before new forces: the loads at the samples, and velocities held until then."""
        before = np.concatenate([np.zeros_like(self.held_inputs[:1]), self.held_inputs[:-1]])
        return before if self.earlier else np.hstack([self.loads, before[:, self.loads.shape[1] :]])

    def vertical_edges(self, held: bool = True) -> dict[int, Edge]:
        """Returns the vertical edges of the road, by sample.

        Args:
            held: True for the road that MuJoCo holds over steps. It jumps at the first sample of a step if its midpoint is behind
                the edge, else at the last one, which already has the height behind. False for the last samples before edges.
        """
        edges: dict[int, Edge] = {}
        for at, wheel, height in jumps_under_wheels(self.road, self.vehicle) if not self.earlier else ():
            k = math.floor((at - self.time[0]) / self.timestep * (1 + SAME_TIME))
            if 0 <= k < len(self.time) - 1:
                later = bool(held and abs(self.midway[k, wheel] - self.heights[k, wheel]) < abs(height) / 2)
                edge = edges.setdefault(k + later, Edge(np.zeros(self.heights.shape[1]), later))
                edge.change[wheel] += -height if later else height
        return edges

    def ahead(self, count: int) -> Array:
        """Returns heights under the wheels at so many further samples after the last [m], shape (count, r)."""
        after = self.time[-1] + self.timestep * np.arange(1, count + 1)
        return under_wheels(self.relative_road.displacement, self.relative_road, self.vehicle, after)

    def scaled(self, share: float) -> "RoadInput":
        """Returns the input with heights and loads multiplied."""
        return replace(self, road=self.road.scaled(share))
