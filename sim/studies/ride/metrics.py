"""Metrics of a suspension, such as ride, travel, road holding and actuator effort, computed block by block during a run.

A metric is a class of the registry `METRICS`, with a name, a unit, signals, rules that combine values over time and over runs,
and an expected value.

A held force jumps at each sample, and accelerations jump with the force. Each sample of an acceleration is the mean of the
values just before and just after the jump of the force. The value after the jump would not include the mean delay of a held
force, which is half a step. With the value after the jump, a loop whose forces cancel most of the spring and damper forces
would seem better by several per cent.

The time window of all metrics excludes the transient at the start of a run. The filter for the weighting W_k of ISO 2631-1
(`sim/studies/ride/weighting.py`) has a delay of three samples. For the last three filter outputs of the window, the
acceleration is extrapolated by a straight line through its last two samples.

With semi-active dampers, the rms of an acceleration uses the values before and after each jump of the damper force. The rms and
the peak of a damper force also use the values before and after each jump.

The angles of the body are linear functions of deflections and road heights (`VehicleKind.angles`). The angles in MuJoCo are
finite, so that the linear functions have an error of second order in the angle.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from models.characteristics import SIDES
from models.common.arrays import Array
from models.common.extensions import METRICS
from models.vehicle.suspension_forces import MotionRatios
from models.vehicle.vehicle import Vehicle
from sim.drive.jumps import Jumps
from sim.drive.response import Response
from sim.studies.ride.weighting import LATE, after_samples, sampled_wk

if TYPE_CHECKING:
    from sim.studies.ride.gaussian import RandomSignals

DEGREES = 180 / math.pi
PITCH, ROLL = "pitch_angle", "roll_angle"


def angles_of(vehicle: Vehicle) -> Mapping[str, Mapping[str, float]]:
    """Returns, for each body angle by name, the weights of the signals whose weighted sum is the angle [rad]."""
    return vehicle.kind.angles(vehicle.parameters)


RUNNING_TIME_CONSTANT = 1.0  # time constant with which the running rms is computed [s]
DEFINITIONS = 7  # version number of the metrics and their expected values; it is increased whenever a number changes
LATE_WINDOW = 6  # last version in which weighted metrics were measured over a window that began and ended three samples late
# last version that used only one value at a jump caused by a semi-active damper; all other numbers equal those of version 6
ONE_SIDED = 5


@dataclass(frozen=True)
class OverRuns:
    """Rule that combines the values of a metric over several runs.

    Attributes:
        words: name of the rule in printed texts.
        of: function that combines the values of R runs, using their measured distances [m]; both arguments have shape (R,).
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
    """Column in the table of controllers, which shows the largest value of a metric over the compared signals of the vehicle.

    Attributes:
        label: heading of the table column.
        unit: unit in which the values are printed; empty for a number without a unit.
        scale: factor from the SI unit to the printed unit.
        change: name of the quantity in the column of changes relative to the passive vehicle; empty if there is no such column.
        praise: verb and object for a sentence about the best controller; empty if no sentence mentions this column.
        bars: title of the bar chart in a report; empty if the report has no bar chart for this column.
        by_side: True for suspension travel, which is shown separately for bump and rebound if the vehicle has stops.
    """

    label: str
    unit: str = ""
    scale: float = 1.0
    change: str = ""
    praise: tuple[str, str] = ("", "")
    bars: str = ""
    by_side: bool = False


# expected value of a metric, and its standard deviation from road to road (None if unknown)
Expectation = tuple[float, float | None] | None


class Totals:
    """Sums and largest values of a metric over all blocks so far; after the first block, each has the shape (N,)."""

    sum: Any = 0
    shift: Any = 0
    largest: Any = -math.inf

    def add(self, amount: Array) -> None:
        """Adds a block's contribution to the sums, shape (N,)."""
        self.sum = self.sum + amount

    def keep(self, values: Array) -> None:
        """Updates the largest values so far with the magnitudes of `values`, shape (N, B)."""
        self.keep_largest(np.maximum(values.max(axis=1), -values.min(axis=1)) + 0.0)  # adding 0.0 changes -0.0 to 0.0

    def keep_largest(self, largest: Array) -> None:
        """Updates the largest values so far, shape (N,)."""
        self.largest = np.maximum(self.largest, largest)


@dataclass(frozen=True)
class Metric:
    """A metric of one signal in a run. The class of the metric is registered in `METRICS`.

    Attributes:
        source: name of the signal that the metric evaluates.
        what: name of the statistic, such as peak, which forms part of the metric's name.
        unit: SI unit of the metric's values.
        of: name of the group of signals to which the metric belongs. In tables, the metrics of a group are next to each other.
        over_runs: rule that combines the metric's values of several runs.
        approximate: False if the expected value is exact for a stationary linear run.
        expectation: text that defines the expected value, if this is not the mean.
        accuracy: text about the error of an approximate expected value; empty if no error is stated.
        column: column of this metric in the table of controllers; None if the table does not contain the metric.
        headline: name of the metric in the short tables of campaigns and reports; empty if these tables do not contain the
            metric.
        effort: True for a metric of actuators, which a passive vehicle does not have.
        loaded: True for a metric that is measured only in runs with loads on the body.
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
        """Name of the metric in files and in JSON."""
        return f"{self.source}_{self.what}"

    @property
    def words(self) -> str:
        """Name of the metric with spaces instead of underscores."""
        return self.name.replace("_", " ")

    @classmethod
    def sources(cls, vehicle: Vehicle) -> Sequence[str]:
        """Returns the signals of a vehicle that have this metric."""
        raise NotImplementedError

    @classmethod
    def compared(cls, vehicle: Vehicle) -> Sequence[str]:
        """Returns the signals by which controllers are compared; the signal with the worst value represents the vehicle. By
        default, all signals are returned.
        """
        return cls.sources(vehicle)

    @classmethod
    def shown_apart(cls, vehicle: Vehicle) -> Sequence[str]:
        """Returns the signals that have additional, separate columns in the table of controllers."""
        return ()

    def update(self, meter: "Meter", totals: Totals) -> None:
        """Adds the current block of signals, which the meter holds, to the totals of the metric."""

    def update_weighted(self, weighted: Array, running: Array, totals: Totals) -> None:
        """Adds a block of the weighted acceleration to the totals of this metric.

        Args:
            weighted: weighted acceleration [m/s2], shape (N, B).
            running: running mean square of the weighted acceleration with the time constant `RUNNING_TIME_CONSTANT`, shape (N,
                B).
            totals: sums and largest values of this metric.
        """

    def result(self, totals: Totals, meter: "Meter") -> Array:
        """Returns the values of the metric for N runs after the last block, shape (N,)."""
        raise NotImplementedError

    def expected(self, random: "RandomSignals") -> Expectation:
        """Returns the metric's expected value over random roads, and its standard deviation from road to road (None if
        unknown).

        Returns None if no formula for the metric's expected value is known.
        """
        return None


def over_runs(metric: Metric, values: Array, distances: Array | None = None) -> float:
    """Returns the combined value of a metric over R runs, by the rule that belongs to the metric.

    Args:
        metric: the metric.
        values: value of the metric in each run, shape (R,).
        distances: measured distance of each run [m], shape (R,); None if all distances are equal.
    """
    return float(metric.over_runs.of(values, np.ones(len(values)) if distances is None else distances))


def squares(values: Array) -> Array:
    """Returns the sum of squares of each row, shape (N,)."""
    return (values * values).sum(axis=1)


def metrics_of(vehicle: Vehicle, loaded: bool = False) -> tuple[Metric, ...]:
    """Returns all metrics that a vehicle has, ordered by signal. With `loaded`, the metrics of body angles are included and
    come first.
    """
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
    """Returns the metrics by which controllers are compared, by name in `METRICS`.

    If the vehicle has several metrics with one name, the metric with the worst value represents the vehicle.
    """
    return {
        name: tuple(map(kind, kind.compared(vehicle))) for name, kind in METRICS.load_all().items() if loaded or not kind.loaded
    }


class Meter:
    """Computation of the metrics of N runs with one vehicle type, block by block, in constant memory.

    The results of a run do not depend on the other runs, bit for bit, because each sum extends over the time of a single run.
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
            vehicles: vehicles of the N runs, all of one type.
            timestep: timestep of the signals [s].
            first: index of the first sample that is measured.
            loaded: True if loads act in any run; body angles are then measured.
            pushed: True for each run in which loads act, N entries; None if `loaded` applies to all runs.
            earlier: True to compute the weighted metrics as earlier versions of Roadproof did, with a window that was delayed
                by three samples.
            speeds: speed of each run [m/s], N entries; None if the speeds are unknown. Metrics per distance are NaN if the
                speed is unknown.
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
        # Coefficients with which each signal contributes to an angle, by index of the signal, shape (N,).
        angles = [angles_of(vehicle) for vehicle in vehicles] if loaded else []
        self.angles = {
            angle: {names.index(name): np.array([one[angle][name] for one in angles]) for name in parts}
            for angle, parts in (angles[0].items() if angles else ())
        }
        self.filter = sampled_wk(timestep)
        self.memory: dict[str, Array] = {}  # memory of the weighting of each acceleration
        self.running = {name: np.zeros((count, 1)) for name in self.accelerations}  # most recent running mean, shape (N, 1)
        self.last: dict[str, Array] = {}  # the two most recent samples of each acceleration, shape (N, 2)
        self.jumps = Jumps(vehicles, (*self.accelerations, *(self.vehicle.linear_model.inputs if self.vehicle.dampers else ())))
        self.lags = self.vehicle.limits.actuator_bandwidth is not None
        # The most recent sample of each force and deflection, from which the work is computed, shape (N, 1)
        self.before: dict[str, Array] = {}
        self.seen = self.samples = 0

    def update(self, values: Array) -> None:
        """Adds the next block of signals, shape (B, S, N), which contains B samples of the S signals in N runs."""
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
        """Returns all metrics by name after the last block, each of shape (N,)."""
        # the accelerations are extrapolated linearly beyond the end, because the filter has a delay
        for name, last in self.last.items():
            self._weigh(name, last[:, 1:] + np.diff(last, axis=1) * np.arange(1, self.late + 1), self.seen)
        self.last = {}
        return {metric.name: metric.result(totals, self) for metric, totals in self.totals.items()}

    @property
    def duration(self) -> float:
        """Duration of the measurement [s]: the number of measured samples times the timestep."""
        return self.samples * self.timestep

    @property
    def distances(self) -> Array:
        """Measured distance of each run [m], shape (N,); NaN on a test rig or if the speed is unknown."""
        return np.where(self.speeds > 0, self.speeds * self.duration, np.nan)

    def __getitem__(self, name: str) -> Array:
        """Returns the current block of an output signal, shape (N, B). In the result, the samples of a run are contiguous in
        memory.
        """
        return np.ascontiguousarray(self.block[:, self.index[name]].T)

    def angle(self, name: str) -> Array:
        """Returns the current block of a body angle [rad], shape (N, B)."""
        angle = np.zeros(self.block.shape[:1:-1] + self.block.shape[:1])
        for i, share in self.angles[name].items():
            angle += share[:, None] * self.block[:, i].T
        return angle

    def tyre(self, name: str) -> tuple[Array, Array]:
        """Returns the current block of a tyre deflection and the tyre's static deflection [m], shapes (N, B) and (N, 1).

        For a damped tyre, the result is the deflection of an undamped tyre with the same force.
        """
        deflection = self[name]
        if name in self.damped:
            hub, road, time = self.damped[name]
            deflection = deflection + time[:, None] * (self.block[:, hub] - self.block[:, road]).T
        return deflection, self.static[name][:, None]

    def work(self, force: str) -> Array:
        """Returns an actuator's work [J] in each step that ends in the current block, shape (N, B).

        The first block has one step fewer than samples, so that the result for this block has the shape (N, B - 1).
        """
        if force not in self.works:
            acting, along = self._joined(force), self._joined(self.vehicle.kind.deflection_of(force))
            work = (acting[:, :-1] + acting[:, 1:]) / 2 if self.lags else acting[:, :-1]
            self.works[force] = work * np.diff(along, axis=1) * self.ratios.of(force, along[:, :-1].T).T
        return self.works[force]

    def _joined(self, name: str) -> Array:
        """Returns the current block of a signal, preceded by the last sample of the previous block."""
        signal = self[name]
        joined = np.concatenate([self.before[name], signal], axis=1) if name in self.before else signal
        self.before[name] = signal[:, -1:].copy()
        return joined

    def _weigh(self, name: str, acceleration: Array, seen: int) -> None:
        """Filters the next samples of an acceleration with W_k, and adds the samples within the window to the totals.

        Args:
            name: name of the acceleration signal.
            acceleration: samples [m/s2], shape (N, B).
            seen: number of samples of the run that precede these samples.
        """
        if not acceleration.shape[1]:
            return
        skip = max(self.first + self.late - seen, 0)
        weighted, self.memory[name] = self.filter(acceleration, self.memory.get(name))
        forget = np.exp(-self.timestep / RUNNING_TIME_CONSTANT)
        means = after_samples(np.array([[forget]]), (1 - forget) * np.square(weighted)[..., None], self.running[name])
        running, self.running[name] = means[..., 0], means[:, -1]
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
    """Returns the metrics of one response by name; NaN if the run of the response was aborted.

    Args:
        vehicle: the vehicle.
        response: response of the run.
        first: index of the first sample that is measured.
        loaded: True if loads act on the body, so that the body angles are measured.
        end: index of the sample after the last measured sample; None for the end of the response.
        earlier: True to compute the weighted metrics as earlier versions of Roadproof did, see `Meter`.
        speed: speed of the vehicle [m/s]; NaN if the speed is unknown.
    """
    meter = Meter([vehicle], float(response.time[1] - response.time[0]), first, loaded, earlier=earlier, speeds=[speed])
    meter.update(response.values[:end, :, None])
    return {name: float(value[0]) for name, value in meter.result().items()}
