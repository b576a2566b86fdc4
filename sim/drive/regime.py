"""Events that end the linear regime, and their times: lift-off, or reaching a limit of a suspension, actuator, damper or
characteristic.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from models.characteristics import LEAVES
from models.common.arrays import Array
from models.kinds.kind import MOST_SQUEEZE, DampedTyre
from models.parts import part as parts
from models.parts.part import Stack
from models.vehicle.vehicle import Vehicle
from sim.drive.recursion import way_in_step
from sim.drive.response import Response

if TYPE_CHECKING:
    from models.parts.part import SuspensionPart

# A threshold counts as reached at this fraction of its value, because a force at its limit equals the limit only up to rounding
AT = 1 - 1e-12
# If a hub jumps by at least this distance [m], the road has passed through it within a step. Even the stiffest tyre, compressed
# nearly flat, moves a hub by only 1 mm within 1 ms. After the road has passed the hub, the measurement jumps by at least 0.1 m,
# because hubs are at least 0.3 m above their road.
JUMP = 0.02
# a rate limit counts as reached at this fraction of its value, because a command before a lag is computed from rounded forces
RATE_REACHED = 1 - 1e-7
MISSING_FORCE = 1e-3  # N; a missing force of a semi-active damper that is smaller than this is a rounding error
BLOCK = 200  # samples per block of many runs, so that a block fits into the cache


@dataclass(frozen=True)
class Threshold:
    """Limit of a signal; the linear regime ends when the signal reaches this limit.

    Attributes:
        signal: name of the signal that is limited.
        sign: 1 for an upper limit, -1 for a lower limit, 0 for a limit of the magnitude.
        value: limit of sign * signal, or of the magnitude of the signal [unit of the signal].
        tyre: names of the hub and road velocities, on which the force of a tyre with damping also depends; None if the
            velocities do not matter.
        part: part for which the difference [N] between its force and its linearised force is limited; None if the signal itself
            is limited.
        of_rate: True if the value limits the rate of an actuator's command, see `command_rates`.
    """

    signal: str
    sign: float
    value: float
    tyre: DampedTyre | None = None
    part: "SuspensionPart | None" = None
    of_rate: bool = False

    def of(self, response: Response) -> Array:
        """Returns the limited quantity: a signal, the equivalent deflection of a tyre, or a force minus its linearisation."""
        return reading([self])(lambda name: response[name][..., None])[..., 0]

    def towards(self, values: Array) -> Array:
        """Returns the limited values, negated if the limit is a lower limit; returns the magnitudes of the values if both signs
        are limited.
        """
        return self.sign * values if self.sign else np.abs(values)


def reading(limits: Sequence[Threshold]) -> Callable[[Callable[[str], Array]], Array]:
    """Returns a function that computes the limited quantity of N runs, shape (..., N), from a function that returns a signal
    by name.
    """
    first = limits[0]
    if first.part is not None:
        stack, place = Stack([[one.part.part] for one in limits if one.part is not None]), first.part.place
        names = [place.deflection, place.velocity.name, *(one.name for one in first.part.states)]

        def beyond(get: Callable[[str], Array]) -> Array:
            d, v, *z = (get(name)[..., None] for name in names)
            return stack.beyond(d, v, np.stack(z, axis=-1) if z else None)[..., 0]

        return beyond
    tyre = next((one.tyre for one in limits if one.tyre is not None), None)
    if tyre is None:
        return lambda get: get(first.signal)
    # damping divided by stiffness, c / k, of the tyre in every run [s]
    times = np.array([0.0 if one.tyre is None else one.tyre.time for one in limits])
    return lambda get: get(first.signal) + times * (get(tyre.hub) - get(tyre.road))


@dataclass(frozen=True)
class End:
    """Type of event that ends the linear regime.

    Attributes:
        name: name of this type of event in tables, maps and JSON output.
        event: text of the log entry at the time when the event first occurs; empty if the event is not logged.
        verdict: sentence about the event in a verdict, with the time `when` [s]; empty if the verdict reports the event in a
            different way.
        color: colour of the event in a map, on a light background.
        marker: shape and colour of the event's marker in plots with a dark background. The shapes have the names that Rerun
            uses. The colour of the marker differs from the colours of all lines in a plot.
        thresholds: function that returns the limits at which the event occurs in a vehicle; an empty list if the vehicle has no
            such limit.
        exact: True if the exact sampled response remains valid after the event, because only the linearity ends.
    """

    name: str
    event: str
    verdict: str
    color: str
    marker: tuple[str, tuple[int, int, int]]
    thresholds: Callable[[Vehicle], list[Threshold]]
    exact: bool = False


def _flat(vehicle: Vehicle) -> list[Threshold]:
    """Returns the tyre deflections at which tyres are fully compressed, as thresholds."""
    return [Threshold(wheel.tyre_deflection, -1.0, MOST_SQUEEZE) for wheel in vehicle.kind.wheels]


def _off_the_road(vehicle: Vehicle) -> list[Threshold]:
    """Returns the thresholds at which tyres lose contact, because their (equivalent) deflections reach the static deflections."""
    damped = vehicle.kind.damped_tyres(vehicle.parameters)
    static = vehicle.kind.static_tyre_deflection(vehicle.parameters)
    return [Threshold(name, 1.0, value, damped.get(name)) for name, value in static.items()]


def _either_way(
    names: Callable[[Vehicle], Sequence[str]], limit: Callable[[Vehicle], float | None], of_rate: bool = False
) -> Callable[[Vehicle], list[Threshold]]:
    """Returns a function that returns a vehicle's thresholds for the magnitudes of signals, or an empty list if these
    magnitudes are not limited.
    """

    def thresholds(vehicle: Vehicle) -> list[Threshold]:
        value = limit(vehicle)
        return [Threshold(name, 0.0, value, of_rate=of_rate) for name in names(vehicle)] if value is not None else []

    return thresholds


def _of_parts(end: str) -> Callable[[Vehicle], list[Threshold]]:
    """Returns a function that returns the thresholds at which a vehicle's parts reach the end `end` of the linear regime."""

    def thresholds(vehicle: Vehicle) -> list[Threshold]:
        found = []
        for one in vehicle.parts:
            signals = {"deflection": one.deflection, "velocity": one.place.velocity.name, "force": one.argument}
            for limit in one.part.limits():
                if limit.end == end:
                    found.append(Threshold(signals[limit.of], limit.sign, limit.value, part=one if limit.of == "force" else None))
        return found

    return thresholds


def departures(vehicle: Vehicle, response: Response) -> dict[str, float]:
    """Returns the largest deviation of each damper or spring characteristic from its linearisation, by name of the parameter.

    A deviation is relative to the largest force of the characteristic. The result for a parameter is the largest deviation over
    all wheels.
    """
    shares: dict[str, float] = {}
    for fitted in vehicle.parts.with_curve:
        d = response[fitted.deflection]
        v = response[fitted.place.velocity.name] if fitted.damps else np.zeros_like(d)
        # a response without samples has the value NaN
        apart = np.fmax.reduce(np.abs(fitted.part.beyond(d, v)), axis=None, initial=0.0) / fitted.part.range
        shares[fitted.name] = max(shares.get(fitted.name, 0.0), float(apart))
    return shares


LIFT_OFF = End(
    "lift-off",
    "lift-off",
    "",
    "#7aa6d8",
    ("Up", (255, 221, 0)),
    _off_the_road,
)
BUMP_STOP = End(
    "bump stop",
    "bump stop",
    "bump stop: a suspension first reaches the end of its stroke at {when}",
    "#e8955a",
    ("Square", (255, 0, 200)),
    _of_parts(parts.BUMP_STOP),
)
SATURATION = End(
    "force saturation",
    "actuator saturated",
    "saturation: an actuator first reaches its largest force at {when}",
    "#c9a3d9",
    ("Diamond", (0, 220, 220)),
    _either_way(lambda vehicle: vehicle.linear_model.inputs, lambda vehicle: vehicle.limits.actuator_force),
)
RATE_LIMIT = End(
    "rate limit",
    "rate limited",
    "rate limit: a command first changes as fast as force_rate allows at {when}",
    "#d9b8c4",
    ("Plus", (255, 140, 60)),
    _either_way(lambda vehicle: vehicle.linear_model.inputs, lambda vehicle: vehicle.limits.force_rate, of_rate=True),
)
FLAT = End(  # after this event, no model of the vehicle is valid
    "flat tyre",
    "",
    "",
    "#8c8c8c",
    ("Cross", (20, 20, 20)),
    _flat,
)
CURVE = End(
    "curve",
    "curve left",
    f"curve: a damper or spring first differs from its line by {100 * LEAVES:g} % of its largest force at {{when}}",
    "#a3b86c",
    ("Asterisk", (150, 255, 60)),
    _of_parts(parts.CURVE),
    exact=True,
)
DAMPER = End(
    "damper",
    "damper at its end",
    "damper: a semi-active damper first fails to supply the requested force at {when}",
    "#8fbf7f",
    ("Circle", (120, 255, 120)),
    lambda vehicle: [Threshold(one.missing, 0.0, MISSING_FORCE) for one in vehicle.parts.adjustable],
    exact=True,
)
REGIME_ENDS = (LIFT_OFF, BUMP_STOP, SATURATION, RATE_LIMIT, FLAT, CURVE, DAMPER)
END_NAMES = tuple(end.name for end in REGIME_ENDS)
DEMAND_CLIPPED = (
    "saturation: the command of a lagging actuator first exceeds its largest force at {when}; anti-windup acts from then on"
)
COMMAND_LIMITED = "saturation: a command first exceeds the largest force at {when}; it is limited before the actuator's lag"
DIVERGENCE = "divergence"
LAW_OVERFLOW = "law overflow"
LAW_DIVERGED = "the states of the control law overflow; from {when} on, the law requests no finite force"


def _way_and_interval(vehicle: Vehicle, timestep: float, predicted: bool) -> tuple[float, float]:
    """Returns the fraction of the distance to the command that a lagging force covers in a step, and the sample period [s].

    For a predicted response, the fraction follows from the exact solution. For a simulated response, the fraction is the
    fraction that an RK4 step covers. The fraction of the distance is 0 if the actuator has no lag. `timestep` is 0 if the
    response has a single sample.
    """
    z = (vehicle.limits.actuator_bandwidth or 0.0) * timestep
    way = float(-np.expm1(-z)) if predicted else way_in_step(z)
    return way, vehicle.implementation.sample_period or timestep or math.inf


@np.errstate(over="ignore", invalid="ignore")  # signals of runs that have diverged may overflow
def command_rates(forces: Array, way: Any, interval: Any) -> Array:
    """Returns the rates of commands between samples [N/s], shape (..., T - 1).

    If the actuator has a lag, the command during a step is computed from the forces at both ends of the step. The last command
    is therefore unknown, and the last rate is NaN.

    Args:
        forces: forces at the samples [N], shape (..., T).
        way: fraction of the distance to the command that a lagging force covers in a step, shape (...); 0 if there is no lag.
        interval: sample period of the controller [s], shape (...).
    """
    way, interval = np.asarray(way)[..., None], np.asarray(interval)[..., None]
    ahead = np.diff(forces, axis=-1, append=np.nan) / np.where(way > 0, way, 1.0)
    return np.diff(forces + np.where(way > 0, ahead, 0.0), axis=-1) / interval


class EndDetector:
    """Detector of the first time at which each of N runs reaches each of `REGIME_ENDS`, for whole signals or block by block.

    MuJoCo measures a tyre as a length, which is never below zero. If the road rises past a hub within a step, MuJoCo measures a
    long tyre, so that the computed hub position jumps upwards. A tyre therefore also counts as fully compressed if the hub has
    jumped and the road is above the hub's extrapolated position.

    A tyre with damping loses contact when its total force becomes zero; the equivalent deflection of the tyre then reaches the
    static deflection (`models/kinds/strut_and_tyre.py`).

    Anti-windup and limits on commands act from the first sample at which the requested force of an actuator is clipped. With a
    lag, the requested force is clipped before the actual force reaches the limit. The requested force is computed from the
    actual forces at both ends of a step; if it is clipped, the actuator counts as saturated. The rates of commands, which are
    compared with the rate limit, are also computed from the forces at both ends of a step.

    Attributes:
        times: first time at which each run reaches each of the E ends [s], shape (N, E); infinity if a run does not reach an
            end.
        shares: largest value of each limited quantity in a run, relative to the limit, shape (N, E); 0 if there is no limit.
    """

    def __init__(
        self,
        vehicles: Sequence[Vehicle],
        time: Array,
        predicted: bool = False,
        anti_windup: Sequence[bool] | None = None,
    ) -> None:
        """Prepares N runs.

        Args:
            anti_windup: True for each run whose law has anti-windup, N values; None if no law has anti-windup.
        """
        self.samples, self.times = time, np.full((len(vehicles), len(REGIME_ENDS)), np.inf)
        self.shares = np.zeros_like(self.times)
        h = float(time[1] - time[0]) if len(time) > 1 else 0.0
        flags = [False] * len(vehicles) if anti_windup is None else anti_windup
        self.lags = np.array([_way_and_interval(one, h, predicted) for one in vehicles]).T
        demanded = [flag or one.limits.limits_commands for one, flag in zip(vehicles, flags, strict=True)]
        # Without a limit on commands, clipping a requested force has no effect before a force reaches its limit
        self.way = np.where(demanded, self.lags[0], 0.0)
        self.pushing = {names for names in vehicles[0].linear_model.inputs if names not in vehicles[0].dampers}
        self.before = dict[int, Array]()  # forces at the last two samples, by index of the signal [N], shape (N, 2)
        self.forces: dict[int, Array] = {}  # forces at the last sample, by index of the signal [N], shape (1, N)
        self.places = {signal.name: i for i, signal in enumerate(vehicles[0].kind.signals)}
        roads = {wheel.tyre_deflection: wheel.road_displacement for wheel in vehicles[0].kind.wheels if not predicted}
        self.road = {self.places[tyre]: self.places[road] for tyre, road in roads.items()}
        self.hubs: dict[int, Array] = {}  # hub heights at the last two samples, by index of the tyre's signal [m], shape (2, N)
        # Each entry contains the index of the regime end, the threshold of the first run, the index of the limited signal, the
        # limit in every run, and a function that computes the limited quantity.
        once = {id(vehicle): vehicle for vehicle in vehicles}  # one entry per vehicle, because most runs share a vehicle
        thresholds = {key: [kind.thresholds(vehicle) for kind in REGIME_ENDS] for key, vehicle in once.items()}
        self.limits = [
            (end, limits[0], self.places[limits[0].signal], np.array([limit.value for limit in limits]), reading(limits))
            for end in range(len(REGIME_ENDS))
            for limits in zip(*(thresholds[id(vehicle)][end] for vehicle in vehicles), strict=True)
        ]

    @property
    def first(self) -> Array:
        """Time at which each run first reaches an end of the linear regime [s], shape (N,)."""
        return self.times.min(axis=1)

    def update(self, start: int, values: Array) -> None:
        """Receives the block of signals that begins at sample `start`, shape (B, S, N)."""
        for end, threshold, signal, limit, read in self.limits:
            if threshold.of_rate:
                self._note_rates(end, start, signal, values, limit)
                continue
            towards = threshold.towards(read(lambda name: values[:, self.places[name]]))
            if REGIME_ENDS[end] is FLAT and signal in self.road:
                towards = np.maximum(towards, self._risen(signal, values))
            self._note(end, start, towards, limit)
            if REGIME_ENDS[end] is SATURATION and threshold.signal in self.pushing and self.way.any():
                demands = self._demands(signal, values)
                # From the second block on, the first requested force belongs to the last sample of the previous block.
                self._note(end, start + len(values) - 1 - len(demands), threshold.towards(demands), limit)

    def _note_rates(self, end: int, start: int, signal: int, values: Array, limit: Array) -> None:
        """Records the first sample at which the rate of a command reaches the rate limit of its run; the limits have shape (N,)
        [N/s].
        """
        before = self.before.get(signal, np.zeros((values.shape[2], 2)))
        forces = np.concatenate([before, values[:, signal].T], axis=1)
        self.before[signal] = forces[:, -2:]
        # The first rate belongs to the last sample before the block; at the start of the run, the rate is 0.
        rates = np.abs(command_rates(forces, *self.lags)).T
        self._note(end, start - 1, rates, limit, RATE_REACHED)

    @np.errstate(over="ignore")  # signals of runs that have diverged may overflow
    def _note(self, end: int, start: int, towards: Array, limit: Array, at: float = AT) -> None:
        """Records the largest value of a limited quantity in each run, and the first sample at which the quantity reaches its
        limit.

        Args:
            end: index of the end of the linear regime in `REGIME_ENDS`.
            start: index of the first sample in `towards`.
            towards: values of the limited quantity, with such a sign that the limit is an upper limit, shape (B, N).
            limit: value of the limit in each run, shape (N,).
            at: fraction of the limit at which the limit already counts as reached.
        """
        largest = np.fmax.reduce(towards, axis=0, initial=0.0)
        self.shares[:, end] = np.maximum(self.shares[:, end], largest / limit)
        hit = np.flatnonzero(largest >= at * limit)
        when = self.samples[start + (towards[:, hit] >= at * limit[hit]).argmax(axis=0)]
        self.times[hit, end] = np.minimum(self.times[hit, end], when)

    @np.errstate(over="ignore", invalid="ignore")  # signals of runs that have diverged may overflow
    def _demands(self, signal: int, values: Array) -> Array:
        """Returns the forces requested from lagging actuators [N], without the last sample; 0 if clipped requests do not end
        the linear regime.
        """
        forces = values[:, signal]
        forces = np.concatenate([self.forces[signal], forces]) if signal in self.forces else forces
        self.forces[signal] = forces[-1:].copy()
        demands = forces[:-1] + np.diff(forces, axis=0) / np.where(self.way, self.way, 1.0)
        return np.where(self.way, demands, 0.0)

    def _risen(self, tyre: int, values: Array) -> Array:
        """Returns the height of the road above the hub's extrapolated position [m] where the hub has jumped, shape (B, N); -inf
        elsewhere.
        """
        road = values[:, self.road[tyre]]
        hub = values[:, tyre] + road
        hubs = np.concatenate([self.hubs[tyre] if tyre in self.hubs else hub[[0, 0]], hub])
        self.hubs[tyre] = hubs[-2:]
        before = 2 * hubs[1:-1] - hubs[:-2]
        return np.where(hub - before > JUMP, road - before, -np.inf)


def _detected(vehicle: Vehicle, response: Response, predicted: bool, anti_windup: bool) -> EndDetector:
    """Returns a detector that has received all samples of a response. The leading axes of the response correspond to runs."""
    runs = response.values.reshape(-1, *response.values.shape[-2:])
    detector = EndDetector([vehicle] * len(runs), response.time, predicted, [anti_windup] * len(runs))
    detector.update(0, np.moveaxis(runs, 0, 2))
    return detector


def end_times(vehicle: Vehicle, response: Response, anti_windup: bool = False) -> Array:
    """Returns the time at which a simulated response first reaches each of `REGIME_ENDS` [s], shape (..., E), or infinity.

    The leading axes of the response correspond to runs. `anti_windup` is True if the control law of the runs has anti-windup.
    """
    return _detected(vehicle, response, False, anti_windup).times.reshape(*response.values.shape[:-2], len(REGIME_ENDS))


def utilisation(vehicle: Vehicle, response: Response, anti_windup: bool = False) -> Array:
    """Returns the largest value of each quantity that `REGIME_ENDS` limits, relative to its limit, shape (..., E); 0 if there
    is no limit.

    Args:
        anti_windup: True if clipping of requested forces ends the linear regime, see `EndDetector`.
    """
    return _detected(vehicle, response, True, anti_windup).shares.reshape(*response.values.shape[:-2], len(REGIME_ENDS))


def scaled(vehicle: Vehicle, response: Response, factors: Array, anti_windup: bool = False) -> EndDetector:
    """Returns a detector that has received all samples of a linear response multiplied by N factors.

    Args:
        factors: factors by which the road height is multiplied, negative if the bump becomes a hole, shape (N,).
        anti_windup: True if the control law of the runs has anti-windup.
    """
    detector = EndDetector([vehicle] * len(factors), response.time, True, [anti_windup] * len(factors))
    for start in range(0, len(response.time), BLOCK):
        detector.update(start, response.values[start : start + BLOCK, :, None] * factors)
    return detector


def first_end(times: Array) -> Array:
    """Returns the index of that member of `REGIME_ENDS` which a run reaches first, shape (...); -1 if no end is reached.

    Args:
        times: times of the ends from `end_times` [s], shape (..., E).

    If two ends occur at the same sample, the end that comes first in `REGIME_ENDS` is returned.
    """
    return np.where(np.isfinite(times).any(axis=-1), times.argmin(axis=-1), -1)


def ended_by(vehicle: Vehicle, response: Response, anti_windup: bool = False) -> tuple[str, ...]:
    """Returns the names of the ends that a simulated run reaches: `REGIME_ENDS`, `DIVERGENCE` or `LAW_OVERFLOW`.

    `anti_windup` is True if the law of the run has anti-windup.
    """
    times = end_times(vehicle, response, anti_windup)
    ended = [name for name, when in zip(END_NAMES, times, strict=True) if np.isfinite(when)]
    return (*ended, *((broken_by(response),) if np.isfinite(response.diverged) else ()))


def broken_by(response: Response) -> str:
    """Returns the reason why a run ended early: `DIVERGENCE`, or `LAW_OVERFLOW` if only states of the control law diverged."""
    return LAW_OVERFLOW if response.law_diverged else DIVERGENCE
