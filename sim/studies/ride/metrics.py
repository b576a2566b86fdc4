"""Metrics of a suspension: ride, travel, road holding, and actuator effort, computed block by block during a run.

Ride, for every vertical acceleration a of the body, weighted by W_k of ISO 2631-1 (`sim/studies/ride/weighting.py`) to a_w:

    weighted rms (6.1);    VDV = (integral a_w^4 dt)^(1/4) (6.3.2);    crest factor = largest |a_w| / rms (6.2);
    MTVV = largest running rms, averaged exponentially over 1 s (6.3.1).

A held force jumps at a sample, and so do the accelerations. A sample of an acceleration counts as the mean of its values just
before and just after the jump. Taken after the jump, it would lack the mean delay of a held force, half a step. A loop whose
forces cancel most of the spring's and the damper's would then look better by per cents.

Travel, for every suspension: rms, peak, and the share of time at the bump stops.

Road holding, for every tyre, whose load F = k_u (static - t) is never negative: the dynamic load coefficient rms(F - F_static) /
F_static, and the share of time off the ground. If loads act on the body, the standard deviation of F replaces that rms.

Effort, for every actuator: force, mean power into the suspension, and the energy put in, without recovery of what is taken out.
Power and energy follow from the work of each step. It is exactly u[k] (s[k+1] - s[k]) for a force u that is held while the travel
s changes. For a lagging force, which changes too, the mean of u[k] and u[k+1] counts.

Angles, for a body under loads: dive, squat and roll.

The window of all metrics leaves out the transient at the start of a run from rest. The filter of W_k is three samples late, and
its outputs of the window's last samples follow from a straight line through the last two.

The rms of an acceleration, and rms and peak of a damper's force, use the values on both sides of a jump if the vehicle has
adjustable dampers.

A body's angles are linear in its heights over the wheels, and so in deflections and road heights (`VehicleKind.angles`). From
MuJoCo's readings they are right to the square of the angle.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from models.characteristics import SIDES
from models.common.arrays import Array
from models.kinds.signals import CONTROL_FORCE, TYRE_DEFLECTION, Signal
from models.roads.road import Road
from models.vehicle.suspension_forces import MotionRatios
from models.vehicle.vehicle import Vehicle
from sim.drive.jumps import Jumps
from sim.drive.response import Response
from sim.studies.ride.weighting import LATE, filtered, sampled_wk
from synth.controller.controller import AnyController
from synth.controller.loop_of import loop_of

DEGREES = 180 / math.pi
PITCH, ROLL = "pitch_angle", "roll_angle"
KINDS = {PITCH: ("dive", "squat", "at_end"), ROLL: ("peak", "at_end")}  # dive: nose down; squat: nose up; at_end: signed


def angles_of(vehicle: Vehicle) -> Mapping[str, Mapping[str, float]]:
    """Returns the angles of a vehicle's body [rad], each as coefficients of its signals."""
    return vehicle.kind.angles(vehicle.parameters)


def angle_metrics(angle: Array) -> dict[str, Array]:
    """Returns the metrics of `KINDS`, in degrees, shape (N,), for an angle [rad] over time, shape (N, B)."""
    largest, smallest, zero = angle.max(axis=1), angle.min(axis=1), np.zeros(len(angle))
    metrics = {"dive": np.maximum(largest, zero), "squat": np.maximum(-smallest, zero)}
    metrics |= {"peak": np.maximum(largest, -smallest), "at_end": angle[:, -1]}
    return {name: DEGREES * value for name, value in metrics.items()}


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


RUNNING = 1.0  # time constant of the running rms [s]
DEFINITIONS = 7  # version of the metrics and their expectations; one more whenever a number changes
LATE_WINDOW = 6  # the last version whose weighted metrics had a window that was three samples late
ONE_SIDED = 5  # the version in which signals that adjustable dampers switch had one value at a jump; else the same numbers


@dataclass(frozen=True)
class Metric:
    """Definition of a metric of a run.

    Attributes:
        name: column name in files.
        unit: SI.
        source: signal that is evaluated.
        what: statistic of that signal.
    """

    name: str
    unit: str
    source: str
    what: str

    @property
    def words(self) -> str:
        """The name in words."""
        return self.name.replace("_", " ")


@dataclass(frozen=True)
class Points:
    """Names of the signals at which a vehicle is measured.

    Attributes:
        accelerations: accelerations of the body, those of points with a person first.
        suspensions: deflections of the suspensions.
        tyres: deflections of the tyres.
        actuators: (force, deflection of its suspension), or (force,) if it acts in no suspension.
    """

    accelerations: tuple[str, ...]
    suspensions: tuple[str, ...]
    tyres: tuple[str, ...]
    actuators: tuple[tuple[str, ...], ...]


def points(vehicle: Vehicle) -> Points:
    """Returns the points of a vehicle."""
    model, kind = vehicle.linear_model, vehicle.kind
    return Points(
        accelerations=vehicle.ride_points.all,
        suspensions=tuple(one.deflection for one in kind.suspensions),
        tyres=tuple(wheel.tyre_deflection for wheel in kind.wheels),
        actuators=tuple((force, kind.pushed(force)) if kind.pushed(force) else (force,) for force in model.inputs),
    )


def metrics_of(vehicle: Vehicle, loaded: bool = False) -> tuple[Metric, ...]:
    """Returns the metrics of a vehicle, in the order of a table; if loads act on its body, its angles come first."""
    where, stops = points(vehicle), vehicle.parts.strokes
    metrics = [_of(angle, what, "deg") for angle in angles_of(vehicle) for what in KINDS[angle]] if loaded else []
    for name in where.accelerations:
        units = {"rms": "m/s2", "weighted": "m/s2", "vdv": "m/s1.75", "mtvv": "m/s2", "crest": "-"}
        metrics += [_of(name, what, unit) for what, unit in units.items()]
    for name in where.suspensions:
        metrics += [_of(name, "rms", "m"), _of(name, "peak", "m")]
        if name in stops:
            metrics.append(_of(name, "at_stops", "-"))
    for name in where.tyres:
        metrics += [Metric(dynamic_load(name), "-", name, "dynamic_load"), Metric(off_ground(name), "-", name, "off_ground")]
    for name, *travel in where.actuators:
        metrics += [_of(name, "rms", "N"), _of(name, "peak", "N")]
        if travel:
            metrics += [Metric(power(name), "W", name, "power"), Metric(energy(name), "J", name, "energy")]
    return tuple(metrics)


def _of(signal: str, what: str, unit: str) -> Metric:
    return Metric(f"{signal}_{what}", unit, signal, what)


def dynamic_load(tyre: str) -> str:
    """Returns the name of the dynamic load coefficient of a tyre."""
    return _named_after(tyre, TYRE_DEFLECTION, "dynamic_load")


def off_ground(tyre: str) -> str:
    """Returns the name of a tyre's share of time off the ground."""
    return _named_after(tyre, TYRE_DEFLECTION, "off_ground")


def power(force: str) -> str:
    """Returns the name of the mean power of an actuator."""
    return _named_after(force, CONTROL_FORCE, "control_power")


def energy(force: str) -> str:
    """Returns the name of the energy of an actuator."""
    return _named_after(force, CONTROL_FORCE, "control_energy")


def _named_after(signal: str, common: Signal, metric: str) -> str:
    """Returns a signal's name with the metric instead of the common prefix, or behind the name if it lacks that prefix."""
    return f"{metric}{signal.removeprefix(common.name)}" if signal.startswith(common.name) else f"{signal}_{metric}"


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
    ) -> None:
        """Prepares the meter.

        Args:
            vehicles: N vehicles of one type.
            timestep: timestep of the signals [s].
            first: index of the first sample measured.
            loaded: True if loads act on any body, so that angles are measured.
            pushed: mask of the runs with loads, N entries. Default: all or none, as `loaded`.
            earlier: True for the weighted metrics of earlier versions, whose window was as late as the filter.
        """
        self.late = 0 if earlier else LATE
        self.pushed = np.array([loaded] * len(vehicles) if pushed is None else pushed)
        self.vehicle, self.timestep, self.first, count = vehicles[0], timestep, first, len(vehicles)
        self.where = points(self.vehicle)
        names = [signal.name for signal in self.vehicle.kind.signals]
        self.index = {name: names.index(name) for name in self.vehicle.linear_model.outputs}
        self.ratios = MotionRatios(vehicles)
        statics = [vehicle.kind.static_tyre_deflection(vehicle.parameters) for vehicle in vehicles]
        self.static = {name: np.array([static[name] for static in statics]) for name in self.where.tyres}
        self.strokes = {
            name: np.array([[one.parts.strokes[name].get(side, np.inf) for side in SIDES] for one in vehicles]).T[..., None]
            for name in self.vehicle.parts.strokes
        }
        damped = [vehicle.kind.damped_tyres(vehicle.parameters) for vehicle in vehicles]
        tyres = {name: tyre for one in damped for name, tyre in one.items()}
        times = {name: np.array([one[name].time if name in one else 0.0 for one in damped]) for name in tyres}
        self.damped = {name: (names.index(one.hub), names.index(one.road), times[name]) for name, one in tyres.items()}
        # Coefficients of every angle, by index of the signal, shape (N,).
        angles = [angles_of(vehicle) for vehicle in vehicles] if loaded else []
        self.angles = {
            angle: {names.index(name): np.array([one[angle][name] for one in angles]) for name in parts}
            for angle, parts in (angles[0].items() if angles else ())
        }
        self.ends: dict[str, Array] = {}
        self.filter = sampled_wk(timestep)
        self.memory = {
            name: np.zeros((*np.shape(self.filter.denominators)[:1], count, self.filter.numerators.shape[1] - 1))
            for name in self.where.accelerations
        }
        self.running = {name: np.zeros((1, count, 1)) for name in self.where.accelerations}
        self.last: dict[str, Array] = {}  # last two samples of accelerations, shape (N, 2)
        self.both_sides = bool(self.vehicle.dampers)
        self.jumps = Jumps(vehicles, (*self.where.accelerations, *(self.vehicle.linear_model.inputs if self.both_sides else ())))
        self.lags = self.vehicle.limits.actuator_bandwidth is not None
        self.before: dict[str, Array] = {}  # last sample of forces and deflections, for the work, shape (N, 1)
        self.sums: dict[str, Array] = {}
        self.largest: dict[str, Array] = {}
        self.seen = self.samples = 0

    def update(self, values: Array) -> None:
        """Adds the next block of signals, shape (B, S, N): B samples of the S signals of the vehicle's kind."""
        skip = min(max(self.first - self.seen, 0), len(values))
        self.seen += len(values)
        self.samples += len(values) - skip
        jumps = self.jumps(values)
        for name in self.where.accelerations:
            acceleration = self._signal(values, name)
            acceleration = acceleration - jumps[name] / 2 if name in jumps else acceleration
            if skip < len(values):
                self._add(f"{name}_rms", _squares(acceleration[:, skip:]))
            self._ride(name, acceleration, self.seen - len(values))
            self.last[name] = np.concatenate([self.last.get(name, acceleration[:, :1]), acceleration], axis=1)[:, -2:]
            if self.both_sides and name in jumps:  # of both sides: of their mean, and of half their difference
                self._add(f"{name}_rms", _squares(jumps[name][:, skip:] / 2))
        if skip == len(values):
            return
        values = values[skip:]
        for angle, parts in self.angles.items():
            over = np.zeros(values.shape[:1:-1] + values.shape[:1])
            for i, share in parts.items():
                over += share[:, None] * values[:, i].T
            of_block = angle_metrics(over)
            for what in KINDS[angle]:
                name = f"{angle}_{what}"
                self.ends[name] = of_block[what] if what == "at_end" else np.maximum(self.ends.get(name, 0.0), of_block[what])
        for name in self.where.suspensions:
            deflection = self._signal(values, name)
            self._add(f"{name}_rms", _squares(deflection))
            self._keep(f"{name}_peak", deflection)
            if name in self.strokes:
                bump, rebound = self.strokes[name]
                beyond = (deflection <= -bump) | (deflection >= rebound)
                self._add(f"{name}_at_stops", np.count_nonzero(beyond, axis=1))
        for name in self.where.tyres:
            deflection, static = self._signal(values, name), self.static[name][:, None]
            if name in self.damped:  # by its whole force
                hub, road, time = self.damped[name]
                deflection = deflection + time[:, None] * (values[:, hub] - values[:, road]).T
            self._add(off_ground(name), np.count_nonzero(deflection >= static, axis=1))
            carried = np.minimum(deflection, static)
            self._add(dynamic_load(name), _squares(carried))
            if self.pushed.any():
                self._add(f"{dynamic_load(name)}_shift", carried.sum(axis=1))
        for name, *travel in self.where.actuators:
            force = self._signal(values, name)
            self._add(f"{name}_rms", _squares(force))
            self._keep(f"{name}_peak", force)
            if name in jumps:
                before = force - jumps[name][:, skip:]
                self._add(f"{name}_rms", (_squares(before) - _squares(force)) / 2)
                self._keep(f"{name}_peak", before)
            if travel:
                force, along = self._joined(name, force), self._joined(travel[0], self._signal(values, travel[0]))
                work = (force[:, :-1] + force[:, 1:]) / 2 if self.lags else force[:, :-1]
                work = work * np.diff(along, axis=1) * self.ratios.of(name, along[:, :-1].T).T
                self._add(power(name), work.sum(axis=1))
                self._add(energy(name), np.maximum(work, 0.0, out=work).sum(axis=1))

    def result(self) -> dict[str, Array]:
        """Returns every metric, shape (N,), after the last block."""
        for name, last in self.last.items():  # the filter is late: straight lines go on behind the last samples
            self._ride(name, last[:, 1:] + np.diff(last, axis=1) * np.arange(1, self.late + 1), self.seen)
        self.last = {}
        mean, duration = {name: total / self.samples for name, total in self.sums.items()}, self.samples * self.timestep
        values = self.ends | {name: largest for name, largest in self.largest.items() if name.endswith("_peak")}
        values |= {name: np.sqrt(square) for name, square in mean.items() if name.endswith(("_rms", "_weighted"))}
        values |= {
            name: mean[name] for name in (*(f"{one}_at_stops" for one in self.strokes), *map(off_ground, self.where.tyres))
        }
        for name in self.where.accelerations:
            weighted = values[f"{name}_weighted"]
            still = weighted == 0
            values[f"{name}_vdv"] = (mean[f"{name}_vdv"] * duration) ** 0.25
            values[f"{name}_mtvv"] = np.sqrt(self.largest[f"{name}_mtvv"])
            values[f"{name}_crest"] = np.where(still, 0.0, self.largest[f"{name}_crest"] / np.where(still, 1.0, weighted))
        for name in self.where.tyres:
            shift = np.where(self.pushed, mean.get(f"{dynamic_load(name)}_shift", 0.0), 0.0)
            values[dynamic_load(name)] = np.sqrt(np.maximum(mean[dynamic_load(name)] - shift * shift, 0.0)) / self.static[name]
        passed = max(self.samples - 1, 1) * self.timestep  # from the first sample to the last
        for name, *travel in self.where.actuators:
            if travel:
                values |= {power(name): self.sums[power(name)] / passed, energy(name): self.sums[energy(name)]}
        return values

    def _ride(self, name: str, acceleration: Array, seen: int) -> None:
        """Adds the next samples of an acceleration, shape (N, B), after so many."""
        skip = max(self.first + self.late - seen, 0)
        weighted, wk = np.zeros_like(acceleration), self.filter
        parts, self.memory[name] = filtered(wk.numerators, wk.denominators, acceleration, self.memory[name])
        for part in parts:
            weighted += part
        square = weighted * weighted
        forget = np.exp(-self.timestep / RUNNING)
        mean = np.array([[1 - forget, 0.0]]), np.array([[1.0, -forget]])
        (running,), self.running[name] = filtered(*mean, square, self.running[name])
        if skip < acceleration.shape[1]:
            square = square[:, skip:]
            self._add(f"{name}_weighted", square.sum(axis=1))
            self._add(f"{name}_vdv", _squares(square))
            self._keep(f"{name}_crest", weighted[:, skip:])
            self._keep(f"{name}_mtvv", running[:, skip:])

    def _signal(self, values: Array, name: str) -> Array:
        """Returns a signal with each run's samples contiguous, shape (N, B)."""
        return np.ascontiguousarray(values[:, self.index[name]].T)

    def _joined(self, name: str, signal: Array) -> Array:
        """Returns a signal of a block, preceded by its last sample of the previous block."""
        joined = np.concatenate([self.before[name], signal], axis=1) if name in self.before else signal
        self.before[name] = signal[:, -1:].copy()
        return joined

    def _add(self, name: str, amount: Array) -> None:
        self.sums[name] = self.sums[name] + amount if name in self.sums else amount

    def _keep(self, name: str, values: Array) -> None:
        largest = np.maximum(values.max(axis=1), -values.min(axis=1)) + 0.0  # no -0
        self.largest[name] = np.maximum(self.largest[name], largest) if name in self.largest else largest


def measure(
    vehicle: Vehicle, response: Response, first: int, loaded: bool = False, end: int | None = None, earlier: bool = False
) -> dict[str, float]:
    """Returns the metrics of one response from sample `first` on; NaN if it broke off. Arguments as for `Meter`.

    Args:
        end: index of the sample after the last one measured; None for the end of the response.
    """
    meter = Meter([vehicle], float(response.time[1] - response.time[0]), first, loaded, earlier=earlier)
    meter.update(response.values[:end, :, None])
    return {name: float(value[0]) for name, value in meter.result().items()}


def _squares(values: Array) -> Array:
    """Returns the sum of squares of each row."""
    return (values * values).sum(axis=1)
