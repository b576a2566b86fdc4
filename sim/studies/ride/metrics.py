"""Metrics of a suspension: ride, travel, road holding, and actuator effort. Measured while runs go on.

Ride, of every vertical acceleration a of the body, weighted as ISO 2631-1 has it (`sim/studies/ride/weighting.py`), a_w:

    weighted rms (6.1);    VDV = (integral a_w^4 dt)^(1/4) (6.3.2);    crest factor = largest |a_w| / rms (6.2);
    MTVV = largest running rms, averaged exponentially over 1 s (6.3.1).

A force that is held leaps at its sample, and every acceleration with it. There an acceleration counts as the mean of what it is
just before and just after. Read after the leaps alone, it would be that of a computer without the half step by which a held force
is late on average, and of a loop whose forces cancel most of the spring's and the damper's too good by per cents.

Travel of every suspension: rms, largest, and the share of time at the bump stops. Of every tyre, whose load is F = k_u (static -
t) and never negative: dynamic load coefficient rms(F - F_static) / F_static, and the share of time off the ground; where loads
push the body, which tyres carry as long as they last, the standard deviation of F in place of that rms. Of every
actuator: force, mean power into the suspension, and the energy that it puts in where it drives, none being given back where it
brakes. Both are of its work: a force u is held from one sample to the next while the suspension's travel s goes on, so that is
u[k] (s[k+1] - s[k]), exactly; of a force that lags, which goes on too, the mean of u[k] and u[k+1] counts.

Of a body that loads push, how far it dives, squats and rolls.

All are means over a window that leaves out the beginning, in which a vehicle from rest still knows nothing of its road.

A run's acceleration at a sample is that of the force that acts from there on. Up to there the last one has acted, so that just
before, it was less by D (u[k] - u[k-1]), with D of (28); of an adjustable damper, whose force goes on with the suspension's
velocity v while its coefficient c is held, the leap is -(c[k] - c[k-1]) v. Behind a lag nothing leaps.

A body's angles follow from its heights over the wheels, and those from deflections and the road (`VehicleKind.angles`): that is
linear, and of MuJoCo's readings right to the square of the angle.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.kinds.signals import CONTROL_FORCE, TYRE_DEFLECTION, UNSPRUNG_ACCELERATION, Signal
from models.roads.road import Road
from models.vehicle.vehicle import Vehicle
from sim.linear.sampled_response import readings_of_loads
from sim.response.response import Response
from sim.studies.ride.weighting import filtered, sampled_wk
from synth.controller.controller import Controller
from synth.controller.open_loop import continuous


class AccelerationAtJumps:
    """Takes N runs of one kind of vehicle block by block, from their first sample on."""

    def __init__(self, vehicles: Sequence[Vehicle], accelerations: Sequence[str], index: Mapping[str, int]) -> None:
        """Prepares these acceleration signals; `index` has the place of every output signal and coefficient among the values."""
        vehicle = vehicles[0]
        forces, outputs = vehicle.linear_model.inputs, vehicle.linear_model.outputs
        dampers = {one.force: one for one in vehicle.adjustable}
        self.nominal = {force: np.array([_nominal(one, force) for one in vehicles])[:, None] for force in dampers}
        self.coefficient = {force: index[one.coefficient] for force, one in dampers.items()}
        lagging = {force for force, one in dampers.items() if one.damper.bandwidth is not None}
        if vehicle.limits.actuator_bandwidth is not None:
            lagging |= set(forces) - set(dampers)
        D = np.stack([one.linear_model.D for one in vehicles], axis=-1)  # (p, m, N)
        # Of every acceleration what it leaps by per newton, by force, shape (N, 1).
        self.shares = {
            name: {
                force: D[outputs.index(name), j][:, None]
                for j, force in enumerate(forces)
                if force not in lagging and np.any(D[outputs.index(name), j])
            }
            for name in accelerations
        }
        self.leaping = [force for force in forces if any(force in shares for shares in self.shares.values())]
        self.index = {force: index[force] for force in self.leaping}
        self.before: dict[int, Array] = {}  # the last sample, by place, shape (N, 1)

    def __call__(self, values: Array) -> dict[str, Array]:
        """Returns half the leaps of each acceleration, shape (N, B), from the next block of signals, shape (B, S, N), to be
        subtracted.
        """
        half = {force: self._leap(force, values) / 2 for force in self.leaping}
        half_leaps = {}
        for name, shares in self.shares.items():
            for force, share in shares.items():
                part = share * half[force]
                half_leaps[name] = half_leaps[name] + part if name in half_leaps else part
        return half_leaps

    def _leap(self, force: str, values: Array) -> Array:
        """Returns the leap of a force at every sample, shape (N, B); zero at the first sample of all."""
        last, now = self._both(self.index[force], values)
        if force not in self.coefficient:
            return now - last
        # v from the force u = -(c - nominal) v on the side where the coefficient tells it better.
        nominal = self.nominal[force]
        c_last, c_now = self._both(self.coefficient[force], values)
        after = np.abs(c_now - nominal) >= np.abs(c_last - nominal)
        beyond, u = np.where(after, c_now, c_last) - nominal, np.where(after, now, last)
        return (c_now - c_last) * u / np.where(beyond == 0, 1.0, beyond)

    def _both(self, place: int, values: Array) -> tuple[Array, Array]:
        """A signal one sample earlier, and as it is, shape (N, B)."""
        now = values[:, place].T
        last = np.concatenate([self.before.get(place, now[:, :1]), now[:, :-1]], axis=1)
        self.before[place] = now[:, -1:].copy()
        return last, now


def _nominal(vehicle: Vehicle, force: str) -> float:
    return next(one.nominal for one in vehicle.adjustable if one.force == force)


DEGREES = 180 / math.pi
PITCH, ROLL = "pitch_angle", "roll_angle"
KINDS = {PITCH: ("dive", "squat", "at_end"), ROLL: ("peak", "at_end")}  # nose down, nose up; either way; with its sign


def angles_of(vehicle: Vehicle) -> Mapping[str, Mapping[str, float]]:
    """The angles that a vehicle's body can have, each as a sum of its signals [rad]."""
    return vehicle.kind.angles(vehicle.parameters)


def angle_metrics(angle: Array) -> dict[str, Array]:
    """Returns the metrics of an angle [rad] over time, shape (N, B), in degrees, shape (N,): those of `KINDS` for either
    angle.
    """
    largest, smallest = angle.max(axis=1), angle.min(axis=1)
    zero = np.zeros(len(angle))
    metrics = {
        "dive": np.maximum(largest, zero),
        "squat": np.maximum(-smallest, zero),
        "peak": np.maximum(largest, -smallest),
        "at_end": angle[:, -1],
    }
    return {name: DEGREES * value for name, value in metrics.items()}


def static_angles(vehicle: Vehicle, controller: Controller, road: Road, time: float) -> dict[str, float]:
    """Returns the angles of the linear loop at rest under the loads of a time [s], in degrees; empty if it has no rest.

    Args:
        road: with the loads.
        time: of the loads [s].
    """
    cut = continuous(vehicle, controller)
    model, felt = cut.model, readings_of_loads(cut, controller)
    A, load = model.A + model.B @ cut.G, road.loads(vehicle, np.array([time]))[0]
    if np.linalg.eigvals(A).real.max() >= 0:
        return {}
    x = np.linalg.solve(A, -(model.Bl + model.B @ felt) @ load)
    outputs = dict(zip(model.outputs, model.C @ x + model.D @ (cut.G @ x + felt @ load) + model.Dl @ load, strict=True))
    sums = angles_of(vehicle).items()
    return {angle: DEGREES * sum(share * float(outputs.get(name, 0.0)) for name, share in parts.items()) for angle, parts in sums}


RUNNING = 1.0  # s, of the running rms
DEFINITIONS = 5  # of the metrics and what is expected of them; one more wherever a number comes out otherwise than before


@dataclass(frozen=True)
class Metric:
    """Definition of a metric of a run.

    Attributes:
        name: of its column in a file.
        unit: SI.
        source: signal that is evaluated.
        what: quantity that is taken of that signal.
    """

    name: str
    unit: str
    source: str
    what: str


@dataclass(frozen=True)
class Points:
    """Names of the signals at which a vehicle is measured.

    Attributes:
        accelerations: of the body, where people sit.
        suspensions: deflections.
        tyres: deflections.
        actuators: (force, deflection that it pushes along), or (force,) if there is no such suspension.
    """

    accelerations: tuple[str, ...]
    suspensions: tuple[str, ...]
    tyres: tuple[str, ...]
    actuators: tuple[tuple[str, ...], ...]


def points(vehicle: Vehicle) -> Points:
    """The points of a vehicle: by unit, by suspension, by wheel, by actuator."""
    model, kind = vehicle.linear_model, vehicle.kind
    return Points(
        accelerations=tuple(
            name for name in model.outputs if kind.signal(name).unit == "m/s2" and not name.startswith(UNSPRUNG_ACCELERATION.name)
        ),
        suspensions=tuple(one.deflection for one in kind.suspensions),
        tyres=tuple(wheel.tyre_deflection for wheel in kind.wheels),
        actuators=tuple((force, kind.pushed(force)) if kind.pushed(force) else (force,) for force in model.inputs),
    )


def metrics_of(vehicle: Vehicle, loaded: bool = False) -> tuple[Metric, ...]:
    """The metrics of a vehicle, in the order of a table; where its body is loaded, with its angles first."""
    where, stops = points(vehicle), vehicle.limits.stops(vehicle.kind.suspensions)
    found = [_of(angle, what, "deg") for angle in angles_of(vehicle) for what in KINDS[angle]] if loaded else []
    for name in where.accelerations:
        units = {"rms": "m/s2", "weighted": "m/s2", "vdv": "m/s1.75", "mtvv": "m/s2", "crest": "-"}
        found += [_of(name, what, unit) for what, unit in units.items()]
    for name in where.suspensions:
        found += [_of(name, "rms", "m"), _of(name, "peak", "m")]
        if name in stops:
            found.append(_of(name, "at_stops", "-"))
    for name in where.tyres:
        found += [Metric(dynamic_load(name), "-", name, "dynamic_load"), Metric(off_ground(name), "-", name, "off_ground")]
    for name, *travel in where.actuators:
        found += [_of(name, "rms", "N"), _of(name, "peak", "N")]
        if travel:
            found += [Metric(power(name), "W", name, "power"), Metric(energy(name), "J", name, "energy")]
    return tuple(found)


def _of(signal: str, what: str, unit: str) -> Metric:
    return Metric(f"{signal}_{what}", unit, signal, what)


def dynamic_load(tyre: str) -> str:
    """Name of the dynamic load coefficient of a tyre."""
    return _named_after(tyre, TYRE_DEFLECTION, "dynamic_load")


def off_ground(tyre: str) -> str:
    """Name of its share of time off the ground."""
    return _named_after(tyre, TYRE_DEFLECTION, "off_ground")


def power(force: str) -> str:
    """Name of the mean power of an actuator."""
    return _named_after(force, CONTROL_FORCE, "control_power")


def energy(force: str) -> str:
    """Name of its energy."""
    return _named_after(force, CONTROL_FORCE, "control_energy")


def _named_after(signal: str, common: Signal, metric: str) -> str:
    """A metric's name in place of the common name that its signal begins with, or after a name of the signal's own."""
    return f"{metric}{signal.removeprefix(common.name)}" if signal.startswith(common.name) else f"{signal}_{metric}"


class Meter:
    """Measures N runs of one kind of vehicle block by block, in memory that does not grow.

    A run's numbers are the same to the last bit whatever runs beside it: each is summed along its own time.
    """

    def __init__(
        self, vehicles: Sequence[Vehicle], timestep: float, first: int, loaded: bool = False, pushed: Sequence[bool] | None = None
    ) -> None:
        """For signals a timestep [s] apart, from sample `first` on.

        Args:
            vehicles: N of one kind.
            timestep: [s].
            first: sample that is measured first.
            loaded: whether any body is pushed by loads, and angles are measured.
            pushed: which, N of them; None for all of them, or none.
        """
        self.pushed = np.array([loaded] * len(vehicles) if pushed is None else pushed)
        self.vehicle, self.timestep, self.first, count = vehicles[0], timestep, first, len(vehicles)
        self.where, self.stops = points(self.vehicle), self.vehicle.limits.stops(self.vehicle.kind.suspensions)
        names = [signal.name for signal in self.vehicle.kind.signals]
        self.index = {name: names.index(name) for name in self.vehicle.linear_model.outputs}
        statics = [vehicle.kind.static_tyre_deflection(vehicle.parameters) for vehicle in vehicles]
        self.static = {name: np.array([static[name] for static in statics]) for name in self.where.tyres}
        # Of every angle its signals, by index, each with its share of all runs.
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
        self.running = {name: np.zeros((count, 1)) for name in self.where.accelerations}
        places = {name: i for i, name in enumerate(names)}
        self.midway = AccelerationAtJumps(vehicles, self.where.accelerations, places)
        self.lags = self.vehicle.limits.actuator_bandwidth is not None
        self.before: dict[str, Array] = {}  # the last sample of what work is made of, shape (N, 1)
        self.sums: dict[str, Array] = {}
        self.largest: dict[str, Array] = {}
        self.seen = self.samples = 0

    def update(self, values: Array) -> None:
        """Takes the next block of signals, of shape (B, S, N), B samples of the S signals of the vehicle's kind."""
        skip = min(max(self.first - self.seen, 0), len(values))
        self.seen += len(values)
        self.samples += len(values) - skip
        halves = self.midway(values)
        for name in self.where.accelerations:
            acceleration = self._signal(values, name)
            self._ride(name, acceleration - halves[name] if name in halves else acceleration, skip)
        if skip == len(values):
            return
        values = values[skip:]
        for angle, parts in self.angles.items():
            over = np.zeros(values.shape[:1:-1] + values.shape[:1])
            for i, share in parts.items():
                over += share[:, None] * values[:, i].T
            made = angle_metrics(over)
            for what in KINDS[angle]:
                name = f"{angle}_{what}"
                self.ends[name] = made[what] if what == "at_end" else np.maximum(self.ends.get(name, 0.0), made[what])
        for name in self.where.suspensions:
            deflection = self._signal(values, name)
            self._add(f"{name}_rms", _squares(deflection))
            self._keep(f"{name}_peak", deflection)
            if name in self.stops:
                stops = self.stops[name]
                beyond = (deflection <= -stops.bump.stroke) | (deflection >= stops.rebound.stroke)
                self._add(f"{name}_at_stops", np.count_nonzero(beyond, axis=1))
        for name in self.where.tyres:
            deflection, static = self._signal(values, name), self.static[name][:, None]
            self._add(off_ground(name), np.count_nonzero(deflection >= static, axis=1))
            carried = np.minimum(deflection, static)
            self._add(dynamic_load(name), _squares(carried))
            if self.pushed.any():
                self._add(f"{dynamic_load(name)}_shift", carried.sum(axis=1))
        for name, *travel in self.where.actuators:
            force = self._signal(values, name)
            self._add(f"{name}_rms", _squares(force))
            self._keep(f"{name}_peak", force)
            if travel:
                force, along = self._joined(name, force), self._joined(travel[0], self._signal(values, travel[0]))
                work = (force[:, :-1] + force[:, 1:]) / 2 if self.lags else force[:, :-1]
                work = work * np.diff(along, axis=1)
                self._add(power(name), work.sum(axis=1))
                self._add(energy(name), np.maximum(work, 0.0, out=work).sum(axis=1))

    def result(self) -> dict[str, Array]:
        """Every metric, shape (N,)."""
        mean, duration = {name: total / self.samples for name, total in self.sums.items()}, self.samples * self.timestep
        found: dict[str, Array] = dict(self.ends)
        for name in self.where.accelerations:
            weighted = np.sqrt(mean[f"{name}_weighted"])
            found |= {f"{name}_rms": np.sqrt(mean[f"{name}_rms"]), f"{name}_weighted": weighted}
            found[f"{name}_vdv"] = (mean[f"{name}_vdv"] * duration) ** 0.25
            found[f"{name}_mtvv"] = np.sqrt(self.largest[f"{name}_mtvv"])
            still = weighted == 0
            found[f"{name}_crest"] = np.where(still, 0.0, self.largest[f"{name}_crest"] / np.where(still, 1.0, weighted))
        for name in self.where.suspensions:
            found |= {f"{name}_rms": np.sqrt(mean[f"{name}_rms"]), f"{name}_peak": self.largest[f"{name}_peak"]}
            if name in self.stops:
                found[f"{name}_at_stops"] = mean[f"{name}_at_stops"]
        for name in self.where.tyres:
            shift = np.where(self.pushed, mean.get(f"{dynamic_load(name)}_shift", 0.0), 0.0)
            found[dynamic_load(name)] = np.sqrt(np.maximum(mean[dynamic_load(name)] - shift * shift, 0.0)) / self.static[name]
            found[off_ground(name)] = mean[off_ground(name)]
        for name, *travel in self.where.actuators:
            found |= {f"{name}_rms": np.sqrt(mean[f"{name}_rms"]), f"{name}_peak": self.largest[f"{name}_peak"]}
            if travel:
                passed = max(self.samples - 1, 1) * self.timestep  # from the first sample to the last
                found |= {power(name): self.sums[power(name)] / passed, energy(name): self.sums[energy(name)]}
        return found

    def _ride(self, name: str, acceleration: Array, skip: int) -> None:
        weighted, memory = np.zeros_like(acceleration), self.memory[name]
        for i, (b, a) in enumerate(zip(self.filter.numerators, self.filter.denominators, strict=True)):
            part, memory[i] = filtered(b, a, acceleration, memory[i])
            weighted += part
        square = weighted * weighted
        forget = np.exp(-self.timestep / RUNNING)
        running, self.running[name] = filtered(np.array([1 - forget, 0.0]), np.array([1.0, -forget]), square, self.running[name])
        if skip < acceleration.shape[1]:
            acceleration, square = acceleration[:, skip:], square[:, skip:]
            self._add(f"{name}_rms", _squares(acceleration))
            self._add(f"{name}_weighted", square.sum(axis=1))
            self._add(f"{name}_vdv", _squares(square))
            self._keep(f"{name}_crest", weighted[:, skip:])
            self._keep(f"{name}_mtvv", running[:, skip:])

    def _signal(self, values: Array, name: str) -> Array:
        """A signal, each run's samples side by side, shape (N, B)."""
        return np.ascontiguousarray(values[:, self.index[name]].T)

    def _joined(self, name: str, signal: Array) -> Array:
        """A signal of one block after its last sample of the one before."""
        joined = np.concatenate([self.before[name], signal], axis=1) if name in self.before else signal
        self.before[name] = signal[:, -1:].copy()
        return joined

    def _add(self, name: str, amount: Array) -> None:
        self.sums[name] = self.sums[name] + amount if name in self.sums else amount

    def _keep(self, name: str, values: Array) -> None:
        largest = np.maximum(values.max(axis=1), -values.min(axis=1)) + 0.0  # no -0
        self.largest[name] = np.maximum(self.largest[name], largest) if name in self.largest else largest


def measure(vehicle: Vehicle, response: Response, first: int, loaded: bool = False) -> dict[str, float]:
    """The metrics of one run's response from sample `first` on; NaN from where it broke off. Arguments as for `Meter`."""
    meter = Meter([vehicle], float(response.time[1] - response.time[0]), first, loaded)
    meter.update(response.values[:, :, None])
    return {name: float(value[0]) for name, value in meter.result().items()}


def _squares(values: Array) -> Array:
    """Sum of squares of each row."""
    return (values * values).sum(axis=1)
