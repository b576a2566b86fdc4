"""Roads: height under a wheel as a function of time, with its exact time derivative."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, ClassVar, NamedTuple

import numpy as np

from models.common.arrays import Array
from models.common.checks import check_fields, forwarded_attribute
from models.common.errors import InputError
from models.common.extensions import FEATURES
from models.common.schema import SI, Choice, Section, keys
from models.kinds.kind import Parameters, Wheel
from models.vehicle.names import BUMP_HEIGHT, BUMP_LENGTH, BUMP_SPEED
from models.vehicle.vehicle import Vehicle

if TYPE_CHECKING:
    from models.roads.spectrum import Spectrum

HIGHEST = 10.0  # largest allowed height of a bump [m]
Length = Annotated[float, SI("m", "length", 1e-3, 1e4)]
Speed = Annotated[float, SI("m/s", "speed of the vehicle", 1e-3, 1e3)]
Track = Annotated[str, Choice("side of the road that it is under", ("left", "right", "both"))]
STEADY = 1e-12  # a value below this share of the largest term of a state or signal in steady motion counts as a rounding error
LOWEST = 1e-5  # smallest height of a road [m]; rounding errors of the vehicle's weight would hide the effect of a lower road


class Road(ABC):
    """Road that is driven at constant speed, or the moving posts of a rig. At time 0, the first wheel reaches the start of the
    road.
    """

    speed: float
    """Forward velocity of the vehicle [m/s]."""

    track: str = "both"
    """The side of the vehicle under which the road is not flat: "left", "right" or "both"."""

    laid: bool = True
    """True if the road lies along the driving direction, so all wheels of a side drive over it. False for posts of a rig."""

    @property
    def duration(self) -> float:
        """Time that one wheel needs from the start to the end of the road [s]; infinite for a road without end."""
        return math.inf

    def track_of(self, wheel: Wheel) -> str:
        """Returns the side of a wheel in the form of the argument `side` of `displacement`."""
        return wheel.side

    def delay_of(self, wheel: Wheel, parameters: Parameters) -> float:
        """Returns the delay of a wheel relative to the first wheel [s]."""
        return wheel.behind(parameters) / self.speed

    @property
    def units(self) -> Mapping[str, str]:
        """Units of the numbers in the road's description, by the name of the number."""
        return {name: key.unit for name, key in keys(type(self)).items()} if isinstance(self, Section) else {}

    @property
    def spectrum(self) -> "Spectrum | None":
        """Spectrum of a random road; None for other roads."""
        return None

    @property
    def points(self) -> bytes | None:
        """Data of the road that are too long for `describe`, as the text of a CSV file; None if the description is complete."""
        return None

    @property
    def from_start(self) -> "Road":
        """The road relative to the steady motion in which the vehicle starts (`MeasuredRoad`).

        For a vehicle that starts in equilibrium on flat ground, the result is the road itself.
        """
        return self

    @property
    def warnings(self) -> list[str]:
        """Warnings about numbers that probably have a wrong unit: the speed, or the height of an obstacle."""
        about_numbers = FEATURES.load_if_known("doubts about numbers")
        return about_numbers.road_remarks(self) if about_numbers else []

    @property
    def loaded(self) -> bool:
        """True if loads act on the body of the vehicle."""
        return False

    @property
    def load_kinks(self) -> tuple[float, ...]:
        """Times [s] at which a load or one of its derivatives jumps."""
        return ()

    def loads(self, vehicle: Vehicle, t: Array) -> Array:
        """Returns the loads on a vehicle's body [N, N m], shape (T, l), in the order of its vehicle type.

        Args:
            vehicle: the vehicle, with l loads.
            t: times [s], shape (T,).
        """
        return np.zeros((len(t), len(vehicle.kind.loads)))

    def held_loads(self, vehicle: Vehicle, t: Array, timestep: float) -> Array:
        """Returns the loads that MuJoCo holds constant during each time step, shape (T, l); by default, the loads in the middle
        of the step.

        Args:
            vehicle: the vehicle, with l loads.
            t: middle times of the steps [s], shape (T,).
            timestep: length of a step [s].
        """
        return self.loads(vehicle, t)

    @abstractmethod
    def displacement(self, t: Array, side: str = "") -> Array:
        """Returns the height under the first wheel of a side [m] at times t [s], same shape as t.

        See `Wheel.side` and `track_of`.
        """

    def held_height(self, t: Array, timestep: float, side: str = "") -> Array:
        """Returns the height that MuJoCo holds constant during each time step [m], same shape as t.

        By default, MuJoCo holds the height in the middle of the step.

        A measured road may have several points within a step. For a measured road, MuJoCo therefore holds the mean height over
        the step.

        Args:
            t: middle times of the steps [s].
            timestep: length of a step [s].
            side: side of the wheel; see `displacement`.
        """
        return self.displacement(t, side)

    @abstractmethod
    def velocity(self, t: Array, side: str = "") -> Array:
        """Returns the time derivative of `displacement` [m/s] at times t [s], same shape as t."""

    @abstractmethod
    def scaled(self, factor: float) -> "Road":
        """Returns the road with all heights multiplied by a factor."""

    @property
    @abstractmethod
    def kinks(self) -> tuple[float, ...]:
        """Times [s] at which `velocity` or one of its derivatives jumps. A numerical integration must begin a new step at every
        jump.
        """

    @property
    def jumps(self) -> tuple[tuple[float, float], ...]:
        """Times [s] at which the height jumps, each with the change of height [m].

        At the time of a jump, the road still has the height before the jump. The method `velocity` does not include jumps, but
        `kinks` includes their times.
        """
        return ()

    @abstractmethod
    def describe(self) -> dict[str, float | str]:
        """Returns a description: the type of the road (key `type`), then the road's numbers in SI units."""

    @property
    def words(self) -> str:
        """The description of the road as one line of text, without long lists."""
        kind, *short = [(key, value) for key, value in self.describe().items() if not isinstance(value, list) and value != ""]
        units = self.units
        number = [
            f"{key} {value:g} {units.get(key, '')}".rstrip() if isinstance(value, float) else f"{key} {value}"
            for key, value in short
        ]
        return ", ".join([str(kind[1]), *number])

    def check(self, vehicle: Vehicle, time: Array) -> None:
        """Checks that the road suits the vehicle and the sample times, and that it excites the vehicle unless it is flat.

        Args:
            vehicle: the vehicle.
            time: sample times of the run, from 0 [s].

        Raises:
            InputError: the road ends within two timesteps, is too low, or lies under only one side although the vehicle has one
                track.
        """
        timestep = float(time[1])
        if self.duration < 2 * timestep and not self.jumps:
            raise InputError(
                f"each wheel is on the road for only {self.duration:.3g} s, less than two timesteps of {timestep:g} s, so the "
                "simulation would miss the road; give a longer road, a lower speed, or a smaller timestep"
            )
        if self.track != "both" and not any(wheel.side for wheel in vehicle.kind.wheels):
            raise InputError(
                f"track = {self.track} needs a vehicle with a left and a right track, but a {vehicle.kind.name} has only "
                "one track; omit track"
            )
        heights = under_wheels(self.displacement, self, vehicle, time)
        if heights.ndim != 2 or len(heights) != len(time) or not np.all(np.isfinite(heights)):
            raise InputError(
                f"{type(self).__name__}.displacement(t) returned a wrong result; return one finite height [m] for each time in t"
            )
        highest = float(np.abs(heights).max())
        if 0 < highest < LOWEST:
            raise InputError(
                f"the road's height is at most {highest:.2g} m during the {time[-1]:.4g} s of the run, but heights "
                f"below {LOWEST:g} m are lost in rounding; give larger heights, drive longer or faster to larger heights, "
                "or give height 0"
            )


@dataclass(frozen=True)
class Obstacle(Section, Road):
    """Road that is defined by a few numbers, which are the fields of the class.

    The names of the fields are also the keys in texts, tables and logs.

    Raises:
        InputError: a number is out of its range, or has a unit of another dimension.
    """

    kind: ClassVar[str]
    tall: ClassVar[tuple[str, ...]] = ("height",)  # names of the fields that the method `scaled` multiplies

    def __post_init__(self) -> None:
        check_fields(self, f"{self.kind} ")

    def describe(self) -> dict[str, float | str]:
        """Returns a description: the type of the road (key `type`), and the fields of the road."""
        return {"type": self.kind, **asdict(self)}

    def scaled(self, factor: float) -> Road:
        """Returns the road with heights multiplied by a factor."""
        return replace(self, **{name: getattr(self, name) * factor for name in self.tall})


@dataclass(frozen=True)
class Bump(Obstacle):
    """Isolated bump, equation (61) of the paper: one period of a cosine. The default height, length and speed are those of
    equation (62) of the paper.

    Raises:
        InputError: a number is out of its range, or has a unit of another dimension.
    """

    kind: ClassVar[str] = "bump"
    height: Annotated[float, SI("m", "height", -HIGHEST, HIGHEST)] = BUMP_HEIGHT
    length: Length = BUMP_LENGTH
    speed: Speed = BUMP_SPEED
    track: Track = "both"

    @property
    def duration(self) -> float:
        """Time that a wheel spends on the bump, L / V [s]."""
        return self.length / self.speed

    def displacement(self, t: Array, side: str = "") -> Array:
        """Returns the height of the bump by equation (61) of the paper [m]."""
        on = self._on(t, side)
        return np.where(on, self.height / 2 * (1 - np.cos(2 * np.pi * t / self.duration)), 0.0)

    def velocity(self, t: Array, side: str = "") -> Array:
        """Returns the time derivative of the height of the bump (61) [m/s]."""
        on = self._on(t, side)
        return np.where(on, self.height * np.pi / self.duration * np.sin(2 * np.pi * t / self.duration), 0.0)

    @property
    def kinks(self) -> tuple[float, ...]:
        """Times at which the first wheel is at the ends of the bump [s]."""
        return (0.0, self.duration)

    def _on(self, t: Array, side: str) -> Array:
        return (t >= 0) & (t <= self.duration) & (not side or self.track in ("both", side))


@dataclass(frozen=True, eq=False)
class DerivedRoad(Road):
    """Road that is derived from an original road, with the same speed, track, duration and kinks.

    Attributes:
        road: original road, from which this road is derived.
    """

    road: Road

    speed, track, laid = (forwarded_attribute(f"road.{name}") for name in ("speed", "track", "laid"))
    track_of, delay_of = forwarded_attribute("road.track_of"), forwarded_attribute("road.delay_of")
    units, duration = forwarded_attribute("road.units"), forwarded_attribute("road.duration")  # pyright: ignore[reportIncompatibleMethodOverride]
    kinks, jumps = forwarded_attribute("road.kinks"), forwarded_attribute("road.jumps")  # pyright: ignore[reportIncompatibleMethodOverride]
    warnings = forwarded_attribute("road.warnings")  # pyright: ignore[reportIncompatibleMethodOverride]


class MeasuredRoad(Road):
    """Road whose heights were measured. The vehicle starts on the road in steady motion: each wheel moves along a straight
    line.

    Heights are relative to one datum, the mean of the heights at the first contact points.
    """

    @property
    def units(self) -> Mapping[str, str]:
        """Units of the numbers in the road's description."""
        return {**dict.fromkeys(("from", "length", "lowest", "highest"), "m"), "duration": "s", "speed": "m/s"}

    @abstractmethod
    def start(self, side: str) -> tuple[float, float]:
        """Returns the height [m] at time 0, and the rate of change [m/s], of the steady motion on one side of the vehicle."""

    @abstractmethod
    def departure(self, t: Array, side: str = "") -> Array:
        """Returns the height of the road above the steady motion [m] at times t [s], same shape as t; 0 up to time 0."""

    @abstractmethod
    def departure_rate(self, t: Array, side: str = "") -> Array:
        """Returns the time derivative of `departure` [m/s] at times t [s], same shape as t."""

    def displacement(self, t: Array, side: str = "") -> Array:
        """Returns the height above the datum [m]."""
        height, rate = self.start(side)
        return height + rate * np.asarray(t) + self.departure(t, side)

    def velocity(self, t: Array, side: str = "") -> Array:
        """Returns the time derivative of the height [m/s]."""
        return self.start(side)[1] + self.departure_rate(t, side)

    @property
    @abstractmethod
    def knots(self) -> Array:
        """Times of the road's measured points [s], ascending. Between two points, `departure` is a straight line or a cubic
        polynomial.
        """

    @property
    def kinks(self) -> tuple[float, ...]:
        """Times of all points [s].

        The points of a spline also count as kinks, because many spline segments within one integration step reduce the
        accuracy.
        """
        return tuple(self.knots.tolist())

    def mean_departure(self, t: Array, timestep: float, side: str = "") -> Array:
        """Returns the mean of `departure` over each time step [m], exact except for rounding errors.

        Args:
            t: middle times of the steps [s].
            timestep: length of a step [s].
            side: side of the wheel; see `displacement`.
        """
        return means(lambda t: self.departure(t, side), self.knots, t, timestep)

    @property
    def from_start(self) -> "Departure":
        """The road relative to the steady motion."""
        return Departure(self)


@dataclass(frozen=True, eq=False)
class Departure(DerivedRoad):
    """Measured road relative to the steady motion in which the vehicle starts."""

    road: MeasuredRoad

    displacement, velocity = forwarded_attribute("road.departure"), forwarded_attribute("road.departure_rate")
    held_height, describe = forwarded_attribute("road.mean_departure"), forwarded_attribute("road.describe")

    def scaled(self, factor: float) -> Road:
        """Returns the measured road with multiplied heights, relative to its own steady motion."""
        return self.road.scaled(factor).from_start


@dataclass(frozen=True)
class ScaledRoad(DerivedRoad):
    """Road whose heights are multiplied by a factor.

    Attributes:
        factor: number by which the heights are multiplied.
    """

    factor: float

    @property
    def jumps(self) -> tuple[tuple[float, float], ...]:
        """Height jumps of the original road, multiplied by the factor."""
        return tuple((time, self.factor * height) for time, height in self.road.jumps)

    def displacement(self, t: Array, side: str = "") -> Array:
        """Returns the height of the original road, multiplied by the factor [m]."""
        return self.factor * self.road.displacement(t, side)

    def held_height(self, t: Array, timestep: float, side: str = "") -> Array:
        """Returns the heights that MuJoCo holds constant during each time step, multiplied by the factor [m]."""
        return self.factor * self.road.held_height(t, timestep, side)

    def velocity(self, t: Array, side: str = "") -> Array:
        """Returns the velocity of the original road, multiplied by the factor [m/s]."""
        return self.factor * self.road.velocity(t, side)

    def describe(self) -> dict[str, float | str]:
        """Returns the description of the original road, extended by the factor."""
        return {**self.road.describe(), "factor": self.factor}

    def scaled(self, factor: float) -> "ScaledRoad":
        """Returns the road with heights multiplied by an additional factor."""
        return ScaledRoad(self.road, self.factor * factor)


def means(function: Callable[[Array], Array], knots: Array, t: Array, length: float) -> Array:
    """Returns the means of a function over intervals, same shape as t.

    The result is exact if the function is a straight line or a cubic polynomial between knots.

    Args:
        function: continuous function to average.
        knots: points at which the function has a kink, ascending, shape (K,).
        t: middle of each interval.
        length: length of every interval.
    """
    start, end = t - length / 2, t + length / 2

    def area(a: Array, b: Array) -> Array:
        """Returns the integrals of the function from a to b, by Gauss quadrature with two points."""
        middle, apart = (a + b) / 2, (b - a) / math.sqrt(12)
        return (b - a) / 2 * (function(middle - apart) + function(middle + apart))

    mean = area(start, end) / length
    # Indices of the first and the last knot inside each interval
    first, last = np.searchsorted(knots, start, side="right"), np.searchsorted(knots, end) - 1
    (some,) = np.nonzero(first <= last)
    if len(some):
        first, last = first[some], last[some]
        sums = np.add.reduceat(np.append(area(knots[:-1], knots[1:]), 0.0), np.stack([first, last], axis=-1).ravel())[::2]
        ends = area(start[some], knots[first]) + area(knots[last], end[some])
        mean[some] = (ends + np.where(first < last, sums, 0.0)) / length
    return mean


def delays(road: Road, vehicle: Vehicle) -> list[float]:
    """Returns the delay of each wheel relative to the first wheel [s]."""
    return [road.delay_of(wheel, vehicle.parameters) for wheel in vehicle.kind.wheels]


def track_width(vehicle: Vehicle) -> float:
    """Returns the lateral distance between the outermost wheels [m]; 0 for a vehicle with one track."""
    lateral = [wheel.lateral(vehicle.parameters) for wheel in vehicle.kind.wheels]
    return max(lateral) - min(lateral)


def under_wheels(function: Callable[[Array, str], Array], road: Road, vehicle: Vehicle, t: Array) -> Array:
    """Returns the displacement or velocity of a road under every wheel, shape (T, r).

    Args:
        function: `road.displacement` or `road.velocity`, the quantity to evaluate.
        road: road to which `function` belongs.
        vehicle: vehicle with r wheels.
        t: times [s], shape (T,).
    """
    tracks = [(delay, road.track_of(wheel)) for wheel, delay in zip(vehicle.kind.wheels, delays(road, vehicle), strict=True)]
    return np.stack([function(t - delay, track) for delay, track in tracks], axis=-1)


SAME_TIME = 1e-12  # rounding error of a time, relative to the timestep


def jumps_under_wheels(road: Road, vehicle: Vehicle) -> list[tuple[float, int, float]]:
    """Returns the jumps of a road's height under the wheels, each with time [s], index of the wheel, and change of height [m]."""
    later = enumerate(delays(road, vehicle))
    return [(time + delay, i, height) for i, delay in later for time, height in road.jumps]


class Edge(NamedTuple):
    """Vertical edge of the road near a sample.

    Attributes:
        change: change of the heights under the r wheels from the sample's side of the edge to the opposite side [m], shape
            (r,).
        behind: True if the wheels are already behind the edge at the time of the sample.
    """

    change: Array
    behind: bool


@dataclass(frozen=True, eq=False)
class RoadInput:
    """Road and loads at the samples of a run. Each of the quantities is computed when it is first needed, and then cached.

    Heights and velocities are relative to the steady motion in which the vehicle starts (`MeasuredRoad`). The steady motion is
    an inertial frame, in which the run starts in equilibrium. `steady_signals` returns the steady motion.

    Attributes:
        vehicle: vehicle with r wheels and l loads on its body.
        road: road that excites the vehicle.
        time: equidistant sample times [s], shape (T,).
        earlier: True to repeat a run of an earlier version. In the earlier version, signals at a sample used the load of the
            step that begins at the sample, and vertical edges had only one side.
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
        """True if loads act on the body."""
        return self.road.loaded

    @property
    def has_held_inputs(self) -> bool:
        """True if inputs other than road heights are held constant during each time step: loads, or road velocities if tyres
        have damping.
        """
        return self.loaded or self.vehicle.linear_model.tyres_damp

    @cached_property
    def relative_road(self) -> Road:
        """The road relative to the steady motion."""
        return self.road.from_start

    def steady_signals(self, time: Array) -> Array | None:
        """Returns the vehicle's signals in the steady motion, computed from the linear model.

        The state is constant, x = -A^-1 (Bw w + Br z_r). In the steady motion, velocities are those of the inclined plane on
        which the vehicle starts. Deflections are zero with two exceptions: posts can warp the vehicle, and the weight of an
        inclined body with a roll or pitch axis has a moment.

        Args:
            time: times [s], shape (T,).

        Returns:
            Signals of the steady motion, shape (T, S); None for equilibrium on a flat road.
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
        """Heights at which MuJoCo holds the road during the steps that begin at the samples [m], shape (T, r)."""
        return self.held_heights(self.time + self.timestep / 2)

    def held_heights(self, middle: Array) -> Array:
        """Returns the heights [m] at which MuJoCo holds the road during steps with the middle times t [s], shape (T, r)."""
        return under_wheels(
            lambda t, side: self.relative_road.held_height(t, self.timestep, side), self.relative_road, self.vehicle, middle
        )

    @cached_property
    def velocities(self) -> Array:
        """Rates of change of the heights at the samples [m/s], shape (T, r)."""
        return under_wheels(self.relative_road.velocity, self.relative_road, self.vehicle, self.time)

    @cached_property
    def loads(self) -> Array:
        """Loads on the body at the samples [N, N m], shape (T, l)."""
        return self.road.loads(self.vehicle, self.time)

    @cached_property
    def held_loads(self) -> Array:
        """Loads that MuJoCo holds constant during the steps that begin at the samples [N, N m], shape (T, l)."""
        return self.road.held_loads(self.vehicle, self.time + self.timestep / 2, self.timestep)

    @cached_property
    def held_velocities(self) -> Array:
        """Mean rates of change of the heights over the time steps that begin at the samples [m/s], shape (T, r).

        During each time step, MuJoCo holds the road velocity constant at its mean.

        If the height changes by dz in a step, the tyre damping c therefore gives the impulse c dz, even across a kink or an
        edge.
        """
        end = under_wheels(self.relative_road.displacement, self.relative_road, self.vehicle, self.time[-1:] + self.timestep)
        return np.diff(self.heights, axis=0, append=end) / self.timestep

    @cached_property
    def held_inputs(self) -> Array:
        """All inputs that are held constant during each time step: loads, and road velocities if tyres have damping.

        The shape of the inputs is (T, l), or (T, l + r) if tyres have damping.
        """
        if not self.vehicle.linear_model.tyres_damp:
            return self.held_loads
        return np.hstack([self.held_loads, self.held_velocities])

    @cached_property
    def in_signals(self) -> Array:
        """Inputs that act on the signals at the samples: loads at the samples, and held road velocities; same shape as
        `held_inputs`.
        """
        return self.held_inputs if self.earlier else np.hstack([self.loads, self.held_inputs[:, self.loads.shape[1] :]])

    @cached_property
    def in_readings(self) -> Array:
        """Inputs that act on each sample's measurements, before new forces act: loads at the sample, and road velocities before
        the sample.
        """
        before = np.concatenate([np.zeros_like(self.held_inputs[:1]), self.held_inputs[:-1]])
        return before if self.earlier else np.hstack([self.loads, before[:, self.loads.shape[1] :]])

    def vertical_edges(self, held: bool = True) -> dict[int, Edge]:
        """Returns the vertical edges of the road, by the number of the sample at which each edge acts.

        Args:
            held: True for the road as MuJoCo holds it constant during each step. An edge in the first half of a step acts at
                the beginning of the step. An edge in the second half of a step acts at the end of the step, where the sample
                already has the height behind the edge. False to assign each edge to the last sample before the edge.
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
        """Returns the heights under the wheels at `count` additional samples after the last sample [m], shape (count, r)."""
        after = self.time[-1] + self.timestep * np.arange(1, count + 1)
        return under_wheels(self.relative_road.displacement, self.relative_road, self.vehicle, after)

    def scaled(self, share: float) -> "RoadInput":
        """Returns this input with road heights and loads multiplied by a factor."""
        return replace(self, road=self.road.scaled(share))
