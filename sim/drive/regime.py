"""Ends of the linear regime, and their times: a tyre off the ground, a suspension, actuator, damper or curve at its limit."""

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

AT = 1 - 1e-12  # share of a threshold that counts as reached: a force at its limit is equal to it, to rounding
# m; the stiffest tyre, compressed nearly flat, flings a hub 1 mm off its way within 1 ms. A reading from beyond the hub jumps by
# 0.1 m and more, as hubs are 0.3 m and more over their roads.
JUMP = 0.02
RATE_REACHED = 1 - 1e-7  # share of a rate limit that counts as reached: behind a lag a command follows from rounded forces
MISSING_FORCE = 1e-3  # N of an adjustable damper: a smaller missing force is rounding
BLOCK = 200  # samples per block of many runs, so that it stays in the cache


@dataclass(frozen=True)
class Threshold:
    """Limit of a signal that ends the linear regime.

    Attributes:
        signal: name of the signal.
        sign: sign of the side with the limit; 0 for both.
        value: limit of sign * signal, or of its magnitude [the signal's unit].
        tyre: velocities that count, in addition to the deflection, for a tyre that damps; None for the signal alone.
        part: part whose force beyond its line counts [N]; None for the signal.
        of_rate: True if the value limits the change of an actuator's command per second, see `command_rates`.
    """

    signal: str
    sign: float
    value: float
    tyre: DampedTyre | None = None
    part: "SuspensionPart | None" = None
    of_rate: bool = False

    def of(self, response: Response) -> Array:
        """Returns the signal of a response, the equivalent deflection of a tyre, or the force beyond a damper's line."""
        return reading([self])(lambda name: response[name][..., None])[..., 0]

    def towards(self, values: Array) -> Array:
        """Returns the values of the signal in the threshold's direction."""
        return self.sign * values if self.sign else np.abs(values)


def reading(limits: Sequence[Threshold]) -> Callable[[Callable[[str], Array]], Array]:
    """Returns a function to what the limits of N runs are on, shape (..., N), from one that returns signals by name, alike."""
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
    times = np.array([0.0 if one.tyre is None else one.tyre.time for one in limits])  # c / k of every run [s]
    return lambda get: get(first.signal) + times * (get(tyre.hub) - get(tyre.road))


@dataclass(frozen=True)
class End:
    """End of the linear regime.

    Attributes:
        name: name in tables, maps and JSON.
        event: name of its first time among a log's events; empty if it is not logged.
        verdict: line of a verdict about it, with `when` [s]; empty if that is said elsewhere.
        color: colour in a map, on a light background.
        marker: marker on curves, on a dark background: its shape, as Rerun names it, and a colour that no curve has.
        thresholds: function that returns the thresholds of a vehicle; empty if it has no such limit.
        exact: True if the exact response continues beyond it, and only linearity ends.
    """

    name: str
    event: str
    verdict: str
    color: str
    marker: tuple[str, tuple[int, int, int]]
    thresholds: Callable[[Vehicle], list[Threshold]]
    exact: bool = False


def _flat(vehicle: Vehicle) -> list[Threshold]:
    """Returns thresholds at which tyres are fully compressed."""
    return [Threshold(wheel.tyre_deflection, -1.0, MOST_SQUEEZE) for wheel in vehicle.kind.wheels]


def _off_the_road(vehicle: Vehicle) -> list[Threshold]:
    """Returns thresholds at which tyres no longer push: their deflections, or equivalent ones, reach the static ones."""
    damped = vehicle.kind.damped_tyres(vehicle.parameters)
    static = vehicle.kind.static_tyre_deflection(vehicle.parameters)
    return [Threshold(name, 1.0, value, damped.get(name)) for name, value in static.items()]


def _either_way(
    names: Callable[[Vehicle], Sequence[str]], limit: Callable[[Vehicle], float | None], of_rate: bool = False
) -> Callable[[Vehicle], list[Threshold]]:
    """Returns thresholds on some signals of a vehicle, if it has the limit."""

    def thresholds(vehicle: Vehicle) -> list[Threshold]:
        value = limit(vehicle)
        return [Threshold(name, 0.0, value, of_rate=of_rate) for name in names(vehicle)] if value is not None else []

    return thresholds


def _of_parts(end: str) -> Callable[[Vehicle], list[Threshold]]:
    """Returns a function that returns the thresholds at which parts of a vehicle reach an end."""

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
    """Returns the largest deviation of curves from their lines, over their largest forces, by parameter; the largest of all
    wheels.
    """
    shares: dict[str, float] = {}
    for fitted in vehicle.parts.with_curve:
        d = response[fitted.deflection]
        v = response[fitted.place.velocity.name] if fitted.damps else np.zeros_like(d)
        apart = np.fmax.reduce(np.abs(fitted.part.beyond(d, v)), axis=None, initial=0.0) / fitted.part.range  # no samples: NaN
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
FLAT = End(  # no model of the vehicle holds from there
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


def utilisation(vehicle: Vehicle, response: Response, anti_windup: bool = False) -> Array:
    """Returns the share of each of `REGIME_ENDS` that a response reaches, shape (..., E): 1 at the limit, 0 without a limit.

    Args:
        anti_windup: True if clipped demands of its actuators end the linear regime, see `EndDetector`.
    """
    columns, times = [], response.time
    way, interval = _way_and_interval(vehicle, float(times[1] - times[0]) if len(times) > 1 else 0.0, True)
    for end in REGIME_ENDS:
        share = np.zeros(response.values.shape[:-2])
        for limit in end.thresholds(vehicle):
            values = limit.of(response)
            if limit.of_rate:
                values = np.pad(values, [(0, 0)] * (values.ndim - 1) + [(1, 0)])  # from rest
                share = np.maximum(share, np.fmax.reduce(np.abs(command_rates(values, way, interval)), axis=-1) / limit.value)
                continue
            share = np.maximum(share, limit.towards(values).max(axis=-1) / limit.value)
            demanded = anti_windup or vehicle.limits.limits_commands
            if demanded and way and end is SATURATION and limit.signal not in vehicle.dampers:
                demand = values[..., :-1] + np.diff(values, axis=-1) / way
                share = np.maximum(share, limit.towards(demand).max(axis=-1) / limit.value)
        columns.append(share)
    return np.stack(columns, axis=-1)


def _way_and_interval(vehicle: Vehicle, timestep: float, predicted: bool) -> tuple[float, float]:
    """Returns the share of the way to its command that a force goes in a step, exactly or as RK4, and the sample period [s].

    The share is 0 without a lag. A timestep of 0 is that of a single sample.
    """
    z = (vehicle.limits.actuator_bandwidth or 0.0) * timestep
    way = float(-np.expm1(-z)) if predicted else way_in_step(z)
    return way, vehicle.implementation.sample_period or timestep or math.inf


@np.errstate(over="ignore", invalid="ignore")  # of runs that have diverged
def command_rates(forces: Array, way: Any, interval: Any) -> Array:
    """Returns the changes of commands from sample to sample over the sample period [N/s], shape (..., T - 1).

    Behind a lag a command follows from the forces at both ends of a step, so the last one is unknown, and its change is NaN.

    Args:
        forces: forces at the samples [N], shape (..., T).
        way: share of the way to its command that a force goes in a step, shape (...); 0 without a lag.
        interval: sample period [s], shape (...).
    """
    way, interval = np.asarray(way)[..., None], np.asarray(interval)[..., None]
    ahead = np.diff(forces, axis=-1, append=np.nan) / np.where(way > 0, way, 1.0)
    return np.diff(forces + np.where(way > 0, ahead, 0.0), axis=-1) / interval


class EndDetector:
    """Detector of the time at which each of N runs first reaches each of `REGIME_ENDS`, from whole signals or block by block.

    MuJoCo reads a tyre as a length, never below zero: if a road rises through a hub within a step, the reading is that of a long
    tyre on a hub that has jumped. Therefore a tyre also counts as flat if its hub has jumped and the road is above the hub's
    extrapolated position.

    A tyre that damps leaves the road where its whole force ends, by its equivalent deflection (`models/kinds/strut_and_tyre.py`).

    Anti-windup acts from the first sample at which the demand on an actuator is clipped, and so does a limit of commands. Behind
    a lag that is before the force reaches its limit. The demand follows from the forces at both ends of a step, and its clipping
    counts as saturation. The changes of commands, which a rate limit limits, follow likewise.

    Attributes:
        times: first time of each end [s], shape (N, E), or infinity.
    """

    def __init__(
        self,
        vehicles: Sequence[Vehicle],
        time: Array,
        predicted: bool = False,
        anti_windup: Sequence[bool] | None = None,
    ) -> None:
        """Prepares runs over these sample times [s], read by MuJoCo, or predicted: predicted tyres pass through hubs.

        Args:
            anti_windup: True for each run whose law has anti-windup, N of them; None if no law has.
        """
        self.samples, self.times = time, np.full((len(vehicles), len(REGIME_ENDS)), np.inf)
        h = float(time[1] - time[0]) if len(time) > 1 else 0.0
        flags = [False] * len(vehicles) if anti_windup is None else anti_windup
        self.lags = np.array([_way_and_interval(one, h, predicted) for one in vehicles]).T
        demanded = [flag or one.limits.limits_commands for one, flag in zip(vehicles, flags, strict=True)]
        self.way = np.where(
            demanded, self.lags[0], 0.0
        )  # elsewhere clipped demands change nothing before a force is at its limit
        self.pushing = {names for names in vehicles[0].linear_model.inputs if names not in vehicles[0].dampers}
        self.before = dict[int, Array]()  # forces at the last two samples, by signal [N], shape (N, 2)
        self.forces: dict[int, Array] = {}  # at the last sample, by signal [N], shape (1, N)
        self.places = {signal.name: i for i, signal in enumerate(vehicles[0].kind.signals)}
        roads = {wheel.tyre_deflection: wheel.road_displacement for wheel in vehicles[0].kind.wheels if not predicted}
        self.road = {self.places[tyre]: self.places[road] for tyre, road in roads.items()}
        self.hubs: dict[int, Array] = {}  # at the last two samples, by tyre [m], shape (2, N)
        # (end, threshold of the first run, its signal, the value of every run, what the limit is on)
        once = {id(vehicle): vehicle for vehicle in vehicles}  # most are of one vehicle
        thresholds = {key: [kind.thresholds(vehicle) for kind in REGIME_ENDS] for key, vehicle in once.items()}
        self.limits = [
            (
                end,
                limits[0],
                self.places[limits[0].signal],
                AT * np.array([limit.value for limit in limits]),
                reading(limits),
            )
            for end in range(len(REGIME_ENDS))
            for limits in zip(*(thresholds[id(vehicle)][end] for vehicle in vehicles), strict=True)
        ]

    @property
    def first(self) -> Array:
        """Returns the time of the first end [s], shape (N,)."""
        return self.times.min(axis=1)

    @property
    def which(self) -> Array:
        """Returns the first end as an index into `REGIME_ENDS`, -1 for no end, shape (N,)."""
        return first_end(self.times)

    @property
    def flat(self) -> Array:
        """Returns the time at which a tyre is first flat, whatever came before [s], shape (N,)."""
        return self.times[:, REGIME_ENDS.index(FLAT)]

    def update(self, start: int, values: Array) -> None:
        """Takes the block of signals, shape (B, S, N), that starts at a sample."""
        for end, threshold, signal, limit, read in self.limits:
            if threshold.of_rate:
                self._note_rates(end, start, signal, values, limit)
                continue
            towards = threshold.towards(read(lambda name: values[:, self.places[name]]))
            if REGIME_ENDS[end] is FLAT and signal in self.road:
                towards = np.maximum(towards, self._risen(signal, values))
            self._note(end, start, towards >= limit)
            if REGIME_ENDS[end] is SATURATION and threshold.signal in self.pushing and self.way.any():
                demands = self._demands(signal, values)
                # The first of a later block is that of the last sample before it.
                self._note(end, start + len(values) - 1 - len(demands), threshold.towards(demands) >= limit)

    def _note_rates(self, end: int, start: int, signal: int, values: Array, limit: Array) -> None:
        """Notes the first sample of each run at which a command changes as fast as its limit allows [N/s], shape (N,)."""
        before = self.before.get(signal, np.zeros((values.shape[2], 2)))
        forces = np.concatenate([before, values[:, signal].T], axis=1)
        self.before[signal] = forces[:, -2:]
        # The first change is that of the last sample before the block, and 0 at the start.
        rates = np.abs(command_rates(forces, *self.lags)).T
        self._note(end, start - 1, rates >= RATE_REACHED * limit)

    def _note(self, end: int, start: int, beyond: Array) -> None:
        """Notes the first sample of each run that is beyond a limit, shape (B, N), from a sample on."""
        hit = np.flatnonzero(beyond.any(axis=0))
        when = self.samples[start + beyond[:, hit].argmax(axis=0)]
        self.times[hit, end] = np.minimum(self.times[hit, end], when)

    @np.errstate(over="ignore", invalid="ignore")  # of runs that have diverged
    def _demands(self, signal: int, values: Array) -> Array:
        """Returns the forces requested from lagging actuators [N], without the last sample; 0 if clipping does not count."""
        forces = values[:, signal]
        forces = np.concatenate([self.forces[signal], forces]) if signal in self.forces else forces
        self.forces[signal] = forces[-1:].copy()
        demands = forces[:-1] + np.diff(forces, axis=0) / np.where(self.way, self.way, 1.0)
        return np.where(self.way, demands, 0.0)

    def _risen(self, tyre: int, values: Array) -> Array:
        """Returns the height of a road over the extrapolated hub, if the hub has jumped [m], shape (B, N); -inf otherwise."""
        road = values[:, self.road[tyre]]
        hub = values[:, tyre] + road
        hubs = np.concatenate([self.hubs[tyre] if tyre in self.hubs else hub[[0, 0]], hub])
        self.hubs[tyre] = hubs[-2:]
        before = 2 * hubs[1:-1] - hubs[:-2]
        return np.where(hub - before > JUMP, road - before, -np.inf)


def end_times(vehicle: Vehicle, response: Response, anti_windup: bool = False) -> Array:
    """Returns the time at which physics first reaches each of `REGIME_ENDS` [s], shape (..., E), or infinity; leading axes are
    runs. `anti_windup` is that of their law.
    """
    leading, whole = response.values.shape[:-2], response.values.shape[-2:]
    runs = response.values.reshape(-1, *whole)
    detector = EndDetector([vehicle] * len(runs), response.time, anti_windup=[anti_windup] * len(runs))
    detector.update(0, np.moveaxis(runs, 0, 2))
    return detector.times.reshape(*leading, len(REGIME_ENDS))


def scaled_reached(vehicle: Vehicle, response: Response, factors: Array, anti_windup: bool = False) -> Array:
    """Returns the time at which a linear response, times N factors, would reach each of `REGIME_ENDS` [s], shape (N, E).

    Args:
        factors: factors on the height, negative for a hole; shape (N,).
        anti_windup: True if the law of the response has anti-windup.
    """
    detector = EndDetector([vehicle] * len(factors), response.time, True, [anti_windup] * len(factors))
    for start in range(0, len(response.time), BLOCK):
        detector.update(start, response.values[start : start + BLOCK, :, None] * factors)
    return detector.times


def first_end(times: Array) -> Array:
    """Returns the index of the first of `REGIME_ENDS`, -1 if none occurs; from `end_times`, shape (..., E) to (...,).

    For two at one sample it is the first in order.
    """
    return np.where(np.isfinite(times).any(axis=-1), times.argmin(axis=-1), -1)


def ended_by(vehicle: Vehicle, response: Response, anti_windup: bool = False) -> tuple[str, ...]:
    """Returns the names of `REGIME_ENDS`, and `DIVERGENCE` or `LAW_OVERFLOW`, that occur in the physics of one run.

    `anti_windup` is that of its law.
    """
    times = end_times(vehicle, response, anti_windup)
    ended = [name for name, when in zip(END_NAMES, times, strict=True) if np.isfinite(when)]
    return (*ended, *((broken_by(response),) if np.isfinite(response.diverged) else ()))


def broken_by(response: Response) -> str:
    """Returns the reason why a run broke off: `DIVERGENCE`, or `LAW_OVERFLOW` for a law whose own states diverged."""
    return LAW_OVERFLOW if response.law_diverged else DIVERGENCE
