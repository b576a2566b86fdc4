"""What ends the linear regime, and when: a tyre off the road, a suspension, actuator, damper or curve at its end."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from models.kinds.kind import MOST_SQUEEZE
from models.suspension import LEAVES
from models.vehicle.vehicle import Vehicle
from sim.response.response import Response

if TYPE_CHECKING:
    from models.suspension.fitted_curves import Fitted

AT = 1 - 1e-12  # of a threshold: a force at its limit is equal to it, to rounding
# m; the stiffest tyre, squeezed nearly flat, flings a hub 1 mm off its way within 1 ms. A reading that is through a hub, and yet
# not that of a flat tyre, has jumped by 0.1 m and more, as hubs are 0.3 m and more over their roads.
JUMP = 0.02
MISSED = 1e-3  # N of an adjustable damper; less is rounding
BLOCK = 200  # samples of many runs at once that stay in the cache


@dataclass(frozen=True)
class Threshold:
    """Where a signal ends the linear regime.

    Attributes:
        signal: its name.
        sign: of the side on which it does; 0 for either.
        value: sign * signal, or its magnitude, that is too much [the signal's unit].
    """

    signal: str
    sign: float
    value: float

    def towards(self, values: Array) -> Array:
        """Values of the signal as they are held against the threshold."""
        return self.sign * values if self.sign else np.abs(values)


@dataclass(frozen=True)
class End:
    """One thing that ends the linear regime.

    Attributes:
        name: as tables, maps and JSON have it.
        happens: in words, what happens.
        event: what its first time is called among a log's events; empty where it is none of them.
        verdict: the line of a verdict that says so, of `when` [s]; empty where that is said otherwise.
        color: in a map, on light ground.
        marker: on curves, on dark ground: its shape, as Rerun names it, and a colour that no curve has.
        thresholds: of a vehicle; none where it has no such limit.
        exact: whether the exact response as built goes on beyond it, and only what is linear ends.
    """

    name: str
    happens: str
    event: str
    verdict: str
    color: str
    marker: tuple[str, tuple[int, int, int]]
    thresholds: Callable[[Vehicle], list[Threshold]]
    exact: bool = False


def _on_every_tyre(sign: float, limit: Callable[[float], float]) -> Callable[[Vehicle], list[Threshold]]:
    """Thresholds on every tyre's deflection, each from its static one."""

    def thresholds(vehicle: Vehicle) -> list[Threshold]:
        static = vehicle.kind.static_tyre_deflection(vehicle.parameters)
        return [Threshold(name, sign, limit(value)) for name, value in static.items()]

    return thresholds


def _either_way(
    names: Callable[[Vehicle], Sequence[str]], limit: Callable[[Vehicle], float | None]
) -> Callable[[Vehicle], list[Threshold]]:
    """Thresholds on some signals of a vehicle, if it has the limit."""

    def thresholds(vehicle: Vehicle) -> list[Threshold]:
        value = limit(vehicle)
        return [Threshold(name, 0.0, value) for name in names(vehicle)] if value is not None else []

    return thresholds


def _at_the_stops(vehicle: Vehicle) -> list[Threshold]:
    """Thresholds on every suspension's deflection, one to each side, if it has stops."""
    found = vehicle.limits.stops(vehicle.kind.suspensions).items()
    return [Threshold(name, sign, one.stroke) for name, both in found for sign, one in ((-1.0, both.bump), (1.0, both.rebound))]


def over(vehicle: Vehicle, one: "Fitted") -> str:
    """The signal that a curve's force is over."""
    if not one.damps:
        return one.deflection
    return next(suspension.velocity.name for suspension in vehicle.kind.suspensions if suspension.deflection == one.deflection)


def _off_the_line(vehicle: Vehicle) -> list[Threshold]:
    """Thresholds where curves have left their lines at rest, one to each side."""
    found = []
    for one in vehicle.fitted:
        low, high = one.curve.left_at
        found += [Threshold(over(vehicle, one), sign, far) for sign, far in ((-1.0, -low), (1.0, high)) if far < np.inf]
    return found


def departures(vehicle: Vehicle, response: Response) -> dict[str, float]:
    """How far curves were from their lines at most, over their largest forces, by parameter: of wheels that with most."""
    found: dict[str, float] = {}
    for one in vehicle.fitted:
        apart = np.abs(one.curve.pieces.force(response[over(vehicle, one)])).max(initial=0.0) / one.curve.range
        found[one.parameter] = max(found.get(one.parameter, 0.0), float(apart))
    return found


LIFT_OFF = End(
    "lift-off",
    "a tyre leaves the road",
    "lift-off",
    "",
    "#7aa6d8",
    ("Up", (255, 221, 0)),
    _on_every_tyre(1.0, lambda static: static),
)
BUMP_STOP = End(
    "bump stop",
    "a suspension meets its bump stop",
    "bump stop",
    "bump stop: a suspension is at the end of its stroke first at {when:.4g} s",
    "#e8955a",
    ("Square", (255, 0, 200)),
    _at_the_stops,
)
SATURATION = End(
    "force saturation",
    "an actuator gives all its force",
    "actuator saturated",
    "saturation: an actuator gives all its force first at {when:.4g} s",
    "#c9a3d9",
    ("Diamond", (0, 220, 220)),
    _either_way(lambda vehicle: vehicle.linear_model.inputs, lambda vehicle: vehicle.limits.actuator_force),
)
FLAT = End(  # no model of the vehicle holds from there
    "flat tyre",
    "a tyre is squeezed flat",
    "",
    "",
    "#555555",
    ("Cross", (20, 20, 20)),
    _on_every_tyre(-1.0, lambda static: MOST_SQUEEZE),
)
CURVE = End(
    "curve",
    "a damper or spring leaves the line of its curve at rest",
    "curve left",
    f"curve: a damper's or spring's force is off its line at rest by {100 * LEAVES:g} % of its largest first at {{when:.4g}} s",
    "#a3b86c",
    ("Asterisk", (150, 255, 60)),
    _off_the_line,
    exact=True,
)
DAMPER = End(
    "damper",
    "an adjustable damper does not give the force",
    "damper at its end",
    "damper: an adjustable damper first does not give the force that is asked of it at {when:.4g} s; no linear claim from there",
    "#8fbf7f",
    ("Circle", (120, 255, 120)),
    lambda vehicle: [Threshold(one.missing, 0.0, MISSED) for one in vehicle.adjustable],
    exact=True,
)
REGIME_ENDS = (LIFT_OFF, BUMP_STOP, SATURATION, FLAT, CURVE, DAMPER)
END_NAMES = tuple(end.name for end in REGIME_ENDS)


def utilisation(vehicle: Vehicle, response: Response) -> Array:
    """How much of the way to each of `REGIME_ENDS` a response goes, shape (..., E): 1 reaches it, 0 where there is none."""
    columns = []
    for end in REGIME_ENDS:
        share = np.zeros(response.values.shape[:-2])
        for limit in end.thresholds(vehicle):
            share = np.maximum(share, limit.towards(response[limit.signal]).max(axis=-1) / limit.value)
        columns.append(share)
    return np.stack(columns, axis=-1)


class EndDetector:
    """When each of N runs first reaches each of `REGIME_ENDS`, from their signals, whole or block by block.

    What is read of a tyre in MuJoCo is a length, never below zero: where a road rises through a hub within a step, the reading
    is that of a tyre that is long again, of a hub that has jumped. Therefore a tyre is flat, too, where its hub has jumped and
    the road has risen that far over where the hub would be, had it gone on as before.

    Attributes:
        times: when each is first reached [s], infinite where it is not, shape (N, E).
    """

    def __init__(self, vehicles: Sequence[Vehicle], time: Array, predicted: bool = False) -> None:
        """For runs over these sample times [s], as MuJoCo reads them, or as they are predicted: then tyres go on through hubs."""
        self.samples, self.times = time, np.full((len(vehicles), len(REGIME_ENDS)), np.inf)
        names = [signal.name for signal in vehicles[0].kind.signals]
        roads = {wheel.tyre_deflection: wheel.road_displacement for wheel in vehicles[0].kind.wheels if not predicted}
        self.road = {names.index(tyre): names.index(road) for tyre, road in roads.items()}
        self.hubs: dict[int, Array] = {}  # at the last two samples, by tyre [m], shape (2, N)
        # (end, threshold of the first run, its signal, the value of every run)
        once = {id(vehicle): vehicle for vehicle in vehicles}  # most are of one vehicle
        thresholds = {key: [kind.thresholds(vehicle) for kind in REGIME_ENDS] for key, vehicle in once.items()}
        self.limits = [
            (end, limits[0], names.index(limits[0].signal), AT * np.array([limit.value for limit in limits]))
            for end in range(len(REGIME_ENDS))
            for limits in zip(*(thresholds[id(vehicle)][end] for vehicle in vehicles), strict=True)
        ]

    @property
    def first(self) -> Array:
        """When the first of them is reached [s], shape (N,)."""
        return self.times.min(axis=1)

    @property
    def which(self) -> Array:
        """Which that is, as an index into `REGIME_ENDS`, -1 for none, shape (N,)."""
        return first_end(self.times)

    @property
    def flat(self) -> Array:
        """When a tyre is first flat, whatever came before [s], shape (N,)."""
        return self.times[:, REGIME_ENDS.index(FLAT)]

    def update(self, start: int, values: Array) -> None:
        """Takes the block of signals, shape (B, S, N), that starts at a sample."""
        for end, threshold, signal, limit in self.limits:
            towards = threshold.towards(values[:, signal])
            if REGIME_ENDS[end] is FLAT and signal in self.road:
                towards = np.maximum(towards, self._risen(signal, values))
            beyond = towards >= limit
            hit = np.flatnonzero(beyond.any(axis=0))
            when = self.samples[start + beyond[:, hit].argmax(axis=0)]
            self.times[hit, end] = np.minimum(self.times[hit, end], when)

    def _risen(self, tyre: int, values: Array) -> Array:
        """How far a road is over where its hub would be, had it not jumped but gone on as before [m], shape (B, N)."""
        road = values[:, self.road[tyre]]
        hub = values[:, tyre] + road
        hubs = np.concatenate([self.hubs[tyre] if tyre in self.hubs else hub[[0, 0]], hub])
        self.hubs[tyre] = hubs[-2:]
        before = 2 * hubs[1:-1] - hubs[:-2]
        return np.where(hub - before > JUMP, road - before, -np.inf)


def reached(vehicle: Vehicle, response: Response) -> Array:
    """When physics first reaches each of `REGIME_ENDS` [s], infinite where it does not, shape (..., E); leading axes are runs."""
    leading, whole = response.values.shape[:-2], response.values.shape[-2:]
    runs = response.values.reshape(-1, *whole)
    detector = EndDetector([vehicle] * len(runs), response.time)
    detector.update(0, np.moveaxis(runs, 0, 2))
    return detector.times.reshape(*leading, len(REGIME_ENDS))


def scaled_reached(vehicle: Vehicle, response: Response, factors: Array) -> Array:
    """When a linear response, which no limit stops, would reach each of `REGIME_ENDS` [s], times N factors, shape (N, E).

    Args:
        vehicle: the vehicle.
        response: of one run.
        factors: below zero too, as over a hole; shape (N,).
    """
    detector = EndDetector([vehicle] * len(factors), response.time, predicted=True)
    for start in range(0, len(response.time), BLOCK):
        detector.update(start, response.values[start : start + BLOCK, :, None] * factors)
    return detector.times


def first_end(times: Array) -> Array:
    """Which of `REGIME_ENDS` comes first, as its index, and -1 where none does; from `reached`, shape (..., E) to (...,).

    Of two at one sample, the one that is named first.
    """
    return np.where(np.isfinite(times).any(axis=-1), times.argmin(axis=-1), -1)


def ended_by(vehicle: Vehicle, response: Response) -> tuple[str, ...]:
    """What of `REGIME_ENDS`, or "divergence", happens in the physics of one run."""
    ended = [name for name, when in zip(END_NAMES, reached(vehicle, response), strict=True) if np.isfinite(when)]
    return (*ended, *(() if np.all(np.isfinite(response.values)) else ("divergence",)))
