"""Metrics of a suspension: ride, travel, road holding, and actuator effort, computed block by block during a run.

A metric is a class of the registry: its name, unit and signals, its rules over time and over runs, and its expectation.

A held force jumps at a sample, and so do the accelerations. A sample of an acceleration counts as the mean of its values just
before and just after the jump. Taken after the jump, it would lack the mean delay of a held force, half a step. A loop whose
forces cancel most of the spring's and the damper's would then look better by per cents.

The window of all metrics leaves out the transient at the start of a run from rest. The filter of W_k of ISO 2631-1
(`sim/studies/ride/weighting.py`) is three samples late. Its outputs of the window's last samples follow from a straight line
through the last two.

The rms of an acceleration, and rms and peak of a damper's force, use the values on both sides of a jump if the vehicle has
adjustable dampers.

A body's angles are linear in its heights over the wheels, and so in deflections and road heights (`VehicleKind.angles`). From
MuJoCo's readings they are right to the square of the angle.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from models.characteristics import SIDES
from models.common.arrays import Array
from models.common.extensions import METRICS
from models.roads.road import Road
from models.vehicle.suspension_forces import MotionRatios
from models.vehicle.vehicle import Vehicle
from sim.drive.jumps import Jumps
from sim.drive.response import Response
from sim.studies.ride.weighting import LATE, filter_signals, sampled_wk
from synth.controller.controller import AnyController
from synth.controller.loop_of import loop_of

if TYPE_CHECKING:
    from sim.studies.ride.gaussian import RandomSignals

DEGREES = 180 / math.pi
PITCH, ROLL = "pitch_angle", "roll_angle"


def angles_of(vehicle: Vehicle) -> Mapping[str, Mapping[str, float]]:
    """Returns the angles of a vehicle's body [rad], each as coefficients of its signals."""
    return vehicle.kind.angles(vehicle.parameters)


def static_angles(vehicle: Vehicle, controller: AnyController, road: Road, time: float) -> dict[str, float]:
    """Returns the angles [deg] of the linear loop in equilibrium under the loads of a time [s].

    Empty if the loop is unstable, or the law is not linear.

    Args:
        road: road with the loads.
        time: time of the loads [s].
    """
    if controller.linear is False:
        return {}
    model, load = vehicle.linear_model, road.loads(vehicle, np.array([time]))[0]
    closed = loop_of(vehicle, controller).closed_loop.part(model.outputs, model.loads)
    if np.linalg.eigvals(closed.A).real.max() >= 0:
        return {}
    outputs = dict(zip(model.outputs, closed.response(np.zeros(1))[0] @ load, strict=True))
    sums = angles_of(vehicle).items()
    return {angle: DEGREES * sum(share * float(outputs.get(name, 0.0)) for name, share in parts.items()) for angle, parts in sums}


RUNNING_TIME_CONSTANT = 1.0  # time constant of the running rms [s]
DEFINITIONS = 7  # version of the metrics and their expectations; one more whenever a number changes
LATE_WINDOW = 6  # the last version whose weighted metrics had a window that was three samples late
ONE_SIDED = 5  # the version in which signals that adjustable dampers switch had one value at a jump; else the same numbers


@dataclass(frozen=True)
class OverRuns:
    """Rule that combines a metric of several runs.

    Attributes:
        words: the rule in words.
        of: function of the values of the runs and of their measured distances [m], shape (R,) each.
    """

    words: str
    of: Callable[[Array, Array], Any]


ROOT_MEAN_SQUARE = OverRuns("root mean square", lambda values, _: np.sqrt(np.mean(values**2)))
MEAN = OverRuns("mean", lambda values, _: values.mean())
LARGEST = OverRuns("largest", lambda values, _: values.max())
TOTAL = OverRuns("sum", lambda values, _: values.sum())
PER_DISTANCE = OverRuns("mean by distance", lambda values, distances: values @ distances / distances.sum())


@dataclass(frozen=True)
class Column:
    """Column of the table of controllers: the largest value of a metric over the vehicle's points, smaller is better.

    Attributes:
        label: heading.
        unit: printed unit; empty for none.
        scale: printed number of an SI unit.
        change: name of the change from passive; empty for a column without changes.
        praise: verb and object of a controller that is the best, for a sentence; empty for a column that no sentence names.
        bars: title of the bars of a report; empty for none.
        by_side: True for a travel, which is shown in bump and in rebound if the vehicle has strokes.
    """

    label: str
    unit: str = ""
    scale: float = 1.0
    change: str = ""
    praise: tuple[str, str] = ("", "")
    bars: str = ""
    by_side: bool = False


Expectation = tuple[float, float | None] | None  # and the standard deviation from road to road


class Totals:
    """Sums and largest values of a metric over the blocks so far, each of shape (N,) after the first."""

    sum: Any = 0
    shift: Any = 0
    largest: Any = -math.inf

    def add(self, amount: Array) -> None:
        """Adds the amounts of a block, shape (N,)."""
        self.sum = self.sum + amount

    def keep(self, values: Array) -> None:
        """Keeps the largest magnitude of values, shape (N, B)."""
        self.keep_largest(np.maximum(values.max(axis=1), -values.min(axis=1)) + 0.0)  # no -0

    def keep_largest(self, largest: Array) -> None:
        """Keeps the larger of values, shape (N,)."""
        self.largest = np.maximum(self.largest, largest)


@dataclass(frozen=True)
class Metric:
    """A metric of one signal of a run. Its class is registered in `EXTENSIONS`.

    Attributes:
        source: signal that is evaluated.
        what: statistic of that signal.
        unit: SI.
        of: group of signals in whose rows a table shows the metric.
        over_runs: rule over several runs.
        approximate: False if the expectation is exact for a stationary linear run.
        expectation: definition of the expected value, if it is not the mean.
        accuracy: clause on the error of an approximate expectation; empty for none.
        column: column of the table of controllers; None without one.
        headline: name in the short tables of campaigns and reports; empty if it is not in them.
        effort: True for a metric of actuators, which passive has not.
        loaded: True for a metric that is measured only if loads act on the body.
    """

    source: str
    what: ClassVar[str]
    unit: ClassVar[str]
    of: ClassVar[str]
    over_runs: ClassVar[OverRuns]
    approximate: ClassVar[bool] = True
    expectation: ClassVar[str] = "for a root mean square: the root of the expected mean square"
    accuracy: ClassVar[str] = ""
    column: ClassVar[Column | None] = None
    headline: ClassVar[str] = ""
    effort: ClassVar[bool] = False
    loaded: ClassVar[bool] = False

    @property
    def name(self) -> str:
        """Column name in files."""
        return f"{self.source}_{self.what}"

    @property
    def words(self) -> str:
        """The name in words."""
        return self.name.replace("_", " ")

    @classmethod
    def sources(cls, vehicle: Vehicle) -> Sequence[str]:
        """Returns the signals of a vehicle that have this metric."""
        raise NotImplementedError

    @classmethod
    def compared(cls, vehicle: Vehicle) -> Sequence[str]:
        """Returns the signals whose largest value counts for the vehicle: all of them, unless a metric knows better."""
        return cls.sources(vehicle)

    @classmethod
    def shown_apart(cls, vehicle: Vehicle) -> Sequence[str]:
        """Returns the signals that have a column of their own, too."""
        return ()

    def update(self, meter: "Meter", totals: Totals) -> None:
        """Adds the meter's block."""

    def update_weighted(self, weighted: Array, running: Array, totals: Totals) -> None:
        """Adds a block of the weighted acceleration, and its mean square over `RUNNING_TIME_CONSTANT`, shape (N, B) each."""

    def result(self, totals: Totals, meter: "Meter") -> Array:
        """Returns the metric after the last block, shape (N,)."""
        raise NotImplementedError

    def expected(self, random: "RandomSignals") -> Expectation:
        """Returns the expectation over random roads, and its standard deviation from road to road or None if that is unknown.

        None if the metric has no known expectation.
        """
        return None


def over_runs(metric: Metric, values: Array, distances: Array | None = None) -> float:
    """Returns a metric over several runs by its own rule.

    Args:
        values: value of each run, shape (R,).
        distances: measured distance of each run [m], shape (R,); None if all are equal.
    """
    return float(metric.over_runs.of(values, np.ones(len(values)) if distances is None else distances))


def squares(values: Array) -> Array:
    """Returns the sum of squares of each row."""
    return (values * values).sum(axis=1)


def metrics_of(vehicle: Vehicle, loaded: bool = False) -> tuple[Metric, ...]:
    """Returns the metrics of a vehicle, signal by signal; if loads act on its body, its angles come first."""
    groups: dict[str, list[tuple[type[Metric], Sequence[str]]]] = {}
    for kind in METRICS.load_all().values():
        if loaded or not kind.loaded:
            groups.setdefault(kind.of, []).append((kind, kind.sources(vehicle)))
    return tuple(
        kind(source)
        for group in groups.values()
        for source in dict.fromkeys(name for _, sources in group for name in sources)
        for kind, sources in group
        if source in sources
    )


def compared_metrics(vehicle: Vehicle, loaded: bool = False) -> dict[str, tuple[Metric, ...]]:
    """Returns, by name of the registry, the metrics of which the largest counts for the vehicle; empty if it has none."""
    return {
        name: tuple(map(kind, kind.compared(vehicle))) for name, kind in METRICS.load_all().items() if loaded or not kind.loaded
    }


class Meter:
    """Metrics of N runs of one kind of vehicle, computed block by block in constant memory.

    The numbers of a run are bit for bit independent of the other runs: each is summed along its own time.
    """

    def __init__(
        self,
        vehicles: Sequence[Vehicle],
        timestep: float,
        first: int,
        loaded: bool = False,
        pushed: Sequence[bool] | None = None,
        earlier: bool = False,
        speeds: Sequence[float] | None = None,
    ) -> None:
        """Prepares the meter.

        Args:
            vehicles: N vehicles of one type.
            timestep: timestep of the signals [s].
            first: index of the first sample measured.
            loaded: True if loads act on any body, so that angles are measured.
            pushed: mask of the runs with loads, N entries. Default: all or none, as `loaded`.
            earlier: True for the weighted metrics of earlier versions, whose window was as late as the filter.
            speeds: speed of each run [m/s], N entries; None if it is unknown, so that no metric refers to the distance.
        """
        self.late = 0 if earlier else LATE
        self.pushed = np.array([loaded] * len(vehicles) if pushed is None else pushed)
        self.vehicle, self.timestep, self.first, count = vehicles[0], timestep, first, len(vehicles)
        self.speeds = np.array([math.nan] * count if speeds is None else speeds)
        self.accelerations, tyres = self.vehicle.ride_points.all, [one.tyre_deflection for one in self.vehicle.kind.wheels]
        self.totals = {metric: Totals() for metric in metrics_of(self.vehicle, loaded)}
        names = [signal.name for signal in self.vehicle.kind.signals]
        self.index = {name: names.index(name) for name in self.vehicle.linear_model.outputs}
        self.ratios = MotionRatios(vehicles)
        statics = [vehicle.kind.static_tyre_deflection(vehicle.parameters) for vehicle in vehicles]
        self.static = {name: np.array([static[name] for static in statics]) for name in tyres}
        self.strokes = {
            name: np.array([[one.parts.strokes[name].get(side, np.inf) for side in SIDES] for one in vehicles]).T[..., None]
            for name in self.vehicle.parts.strokes
        }
        damped = [vehicle.kind.damped_tyres(vehicle.parameters) for vehicle in vehicles]
        dampers = {name: tyre for one in damped for name, tyre in one.items()}
        times = {name: np.array([one[name].time if name in one else 0.0 for one in damped]) for name in dampers}
        self.damped = {name: (names.index(one.hub), names.index(one.road), times[name]) for name, one in dampers.items()}
        # Coefficients of every angle, by index of the signal, shape (N,).
        angles = [angles_of(vehicle) for vehicle in vehicles] if loaded else []
        self.angles = {
            angle: {names.index(name): np.array([one[angle][name] for one in angles]) for name in parts}
            for angle, parts in (angles[0].items() if angles else ())
        }
        self.filter = sampled_wk(timestep)
        self.memory = {
            name: np.zeros((*np.shape(self.filter.denominators)[:1], count, self.filter.numerators.shape[1] - 1))
            for name in self.accelerations
        }
        self.running = {name: np.zeros((1, count, 1)) for name in self.accelerations}
        self.last: dict[str, Array] = {}  # last two samples of accelerations, shape (N, 2)
        self.jumps = Jumps(vehicles, (*self.accelerations, *(self.vehicle.linear_model.inputs if self.vehicle.dampers else ())))
        self.lags = self.vehicle.limits.actuator_bandwidth is not None
        self.before: dict[str, Array] = {}  # last sample of forces and deflections, for the work, shape (N, 1)
        self.seen = self.samples = 0

    def update(self, values: Array) -> None:
        """Adds the next block of signals, shape (B, S, N): B samples of the S signals of the vehicle's kind."""
        skip = min(max(self.first - self.seen, 0), len(values))
        self.seen += len(values)
        self.samples += len(values) - skip
        jumps, self.block, self.midway, self.works = self.jumps(values), values, dict[str, Array](), dict[str, Array]()
        for name in self.accelerations:
            acceleration = self[name] - jumps[name] / 2 if name in jumps else self[name]
            self._weigh(name, acceleration, self.seen - len(values))
            self.last[name] = np.concatenate([self.last.get(name, acceleration[:, :1]), acceleration], axis=1)[:, -2:]
            self.midway[name] = acceleration[:, skip:]
        if skip == len(values):
            return
        self.block = values[skip:]
        self.both_sides = {name: jump[:, skip:] for name, jump in jumps.items()} if self.vehicle.dampers else {}
        for metric, totals in self.totals.items():
            metric.update(self, totals)

    def result(self) -> dict[str, Array]:
        """Returns every metric, shape (N,), after the last block."""
        for name, last in self.last.items():  # the filter is late: straight lines go on behind the last samples
            self._weigh(name, last[:, 1:] + np.diff(last, axis=1) * np.arange(1, self.late + 1), self.seen)
        self.last = {}
        return {metric.name: metric.result(totals, self) for metric, totals in self.totals.items()}

    @property
    def duration(self) -> float:
        """Duration of the window, a timestep for every sample [s]."""
        return self.samples * self.timestep

    @property
    def distances(self) -> Array:
        """Distance of each run in the window [m], shape (N,); NaN on a rig, or without a speed."""
        return np.where(self.speeds > 0, self.speeds * self.duration, np.nan)

    def __getitem__(self, name: str) -> Array:
        """Returns an output signal of the block, with each run's samples contiguous, shape (N, B)."""
        return np.ascontiguousarray(self.block[:, self.index[name]].T)

    def angle(self, name: str) -> Array:
        """Returns an angle of the body in the block [rad], shape (N, B)."""
        angle = np.zeros(self.block.shape[:1:-1] + self.block.shape[:1])
        for i, share in self.angles[name].items():
            angle += share[:, None] * self.block[:, i].T
        return angle

    def tyre(self, name: str) -> tuple[Array, Array]:
        """Returns the deflection of a tyre with the same force but no damping, shape (N, B), and the static one, (N, 1) [m]."""
        deflection = self[name]
        if name in self.damped:
            hub, road, time = self.damped[name]
            deflection = deflection + time[:, None] * (self.block[:, hub] - self.block[:, road]).T
        return deflection, self.static[name][:, None]

    def work(self, force: str) -> Array:
        """Returns the work of an actuator [J] in each step that ends in the block, shape (N, B), or (N, B - 1) at first."""
        if force not in self.works:
            acting, along = self._joined(force), self._joined(self.vehicle.kind.deflection_of(force))
            work = (acting[:, :-1] + acting[:, 1:]) / 2 if self.lags else acting[:, :-1]
            self.works[force] = work * np.diff(along, axis=1) * self.ratios.of(force, along[:, :-1].T).T
        return self.works[force]

    def _joined(self, name: str) -> Array:
        """Returns a signal of the block, preceded by its last sample of the previous block."""
        signal = self[name]
        joined = np.concatenate([self.before[name], signal], axis=1) if name in self.before else signal
        self.before[name] = signal[:, -1:].copy()
        return joined

    def _weigh(self, name: str, acceleration: Array, seen: int) -> None:
        """Weighs the next samples of an acceleration, shape (N, B), after so many, and adds those of the window."""
        skip = max(self.first + self.late - seen, 0)
        weighted, wk = np.zeros_like(acceleration), self.filter
        parts, self.memory[name] = filter_signals(wk.numerators, wk.denominators, acceleration, self.memory[name])
        for part in parts:
            weighted += part
        forget = np.exp(-self.timestep / RUNNING_TIME_CONSTANT)
        mean = np.array([[1 - forget, 0.0]]), np.array([[1.0, -forget]])
        (running,), self.running[name] = filter_signals(*mean, weighted * weighted, self.running[name])
        if skip < acceleration.shape[1]:
            for metric, totals in self.totals.items():
                if metric.source == name:
                    metric.update_weighted(weighted[:, skip:], running[:, skip:], totals)


def measure(
    vehicle: Vehicle,
    response: Response,
    first: int,
    loaded: bool = False,
    end: int | None = None,
    earlier: bool = False,
    speed: float = math.nan,
) -> dict[str, float]:
    """Returns the metrics of one response from sample `first` on; NaN if it broke off. Arguments as for `Meter`.

    Args:
        end: index of the sample after the last one measured; None for the end of the response.
        speed: speed of the vehicle [m/s].
    """
    meter = Meter([vehicle], float(response.time[1] - response.time[0]), first, loaded, earlier=earlier, speeds=[speed])
    meter.update(response.values[:end, :, None])
    return {name: float(value[0]) for name, value in meter.result().items()}
