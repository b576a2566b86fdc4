"""What ends the linear regime, and when: a tyre off the road, a suspension at its bump stop, an actuator at its limit."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.kind import MOST_SQUEEZE
from models.vehicle import Vehicle
from sim.response.response import Response

AT = 1 - 1e-12  # of a threshold: a force at its limit is equal to it, to rounding


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
    """

    name: str
    happens: str
    event: str
    verdict: str
    color: str
    marker: tuple[str, tuple[int, int, int]]
    thresholds: Callable[[Vehicle], list[Threshold]]


def _on_every_tyre(sign: float, limit: Callable[[float], float]) -> Callable[[Vehicle], list[Threshold]]:
    """Thresholds on every tyre's deflection, each from its static one."""

    def thresholds(vehicle: Vehicle) -> list[Threshold]:
        static = vehicle.kind.static_tyre_deflection(vehicle.parameters)
        return [Threshold(name, sign, limit(value)) for name, value in static.items()]

    return thresholds


def _either_way(kind: str, limit: Callable[[Vehicle], float | None]) -> Callable[[Vehicle], list[Threshold]]:
    """Thresholds on every signal whose name begins so."""

    def thresholds(vehicle: Vehicle) -> list[Threshold]:
        value = limit(vehicle)
        names = [name for name in vehicle.linear_model.outputs if name.startswith(kind)]
        return [Threshold(name, 0.0, value) for name in names] if value is not None else []

    return thresholds


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
    _either_way("suspension_deflection", lambda vehicle: vehicle.limits.suspension_stroke),
)
SATURATION = End(
    "force saturation",
    "an actuator gives all its force",
    "actuator saturated",
    "saturation: an actuator gives all its force first at {when:.4g} s",
    "#c9a3d9",
    ("Diamond", (0, 220, 220)),
    _either_way("control_force", lambda vehicle: vehicle.limits.actuator_force),
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
REGIME_ENDS = (LIFT_OFF, BUMP_STOP, SATURATION, FLAT)
END_NAMES = tuple(end.name for end in REGIME_ENDS)


def utilisation(vehicle: Vehicle, response: Response) -> Array:
    """How much of the way to each of `REGIME_ENDS` a response goes, shape (..., 4): 1 reaches it, 0 where there is none."""
    columns = []
    for end in REGIME_ENDS:
        share = np.zeros(response.values.shape[:-2])
        for limit in end.thresholds(vehicle):
            share = np.maximum(share, limit.towards(response[limit.signal]).max(axis=-1) / limit.value)
        columns.append(share)
    return np.stack(columns, axis=-1)


def reached(vehicle: Vehicle, response: Response, factor: Array | float = 1.0) -> Array:
    """When each of `REGIME_ENDS` is first reached [s], infinite where it is not, shape (..., 4).

    Args:
        vehicle: the vehicle.
        response: of the physics, where a force stops at its limit, or of the linear model, where it would go on. Leading axes are
            runs.
        factor: multiplies the response; shape (N,) adds a leading axis to that of a single run.
    """
    factor = np.asarray(factor)[..., None]
    columns = []
    for end in REGIME_ENDS:
        first = np.full(np.broadcast_shapes(factor.shape[:-1], response.values.shape[:-2]), np.inf)
        for limit in end.thresholds(vehicle):
            beyond = factor * limit.towards(response[limit.signal]) >= AT * limit.value
            first = np.minimum(first, np.where(beyond.any(axis=-1), response.time[beyond.argmax(axis=-1)], np.inf))
        columns.append(first)
    return np.stack(columns, axis=-1)


class EndDetector:
    """What ends the linear regime of each of N runs first, and when, from their signals block by block.

    A tyre's length is never below zero, so where a road rises through a hub within a step, the reading is that of a tyre that is
    long again. Therefore a tyre is flat, too, where the road has risen that far over where the hub was a sample before.

    Attributes:
        first: when [s], infinite for never, shape (N,).
        which: what, as an index into `REGIME_ENDS`, -1 for nothing, shape (N,). Of two at one sample, the one named first.
        flat: when a tyre is first flat, whatever came before, shape (N,).
    """

    def __init__(self, vehicles: Sequence[Vehicle], time: Array) -> None:
        self.time, count = time, len(vehicles)
        self.first, self.which, self.flat = np.full(count, np.inf), np.full(count, -1), np.full(count, np.inf)
        names = [signal.name for signal in vehicles[0].kind.signals]
        roads = {wheel.tyre_deflection: wheel.road_displacement for wheel in vehicles[0].kind.wheels}
        self.road = {names.index(tyre): names.index(road) for tyre, road in roads.items()}
        self.hub: dict[int, Array] = {}  # at the last sample, by tyre [m], shape (N,)
        # (end, threshold of the first run, its signal, the value of every run)
        self.limits = [
            (end, limits[0], names.index(limits[0].signal), AT * np.array([limit.value for limit in limits]))
            for end, kind in enumerate(REGIME_ENDS)
            for limits in zip(*(kind.thresholds(vehicle) for vehicle in vehicles), strict=True)
        ]

    def update(self, start: int, values: Array) -> None:
        """Takes the block of signals, shape (B, S, N), that starts at a sample."""
        for end, threshold, signal, limit in self.limits:
            reached = threshold.towards(values[:, signal])
            if REGIME_ENDS[end] is FLAT:
                reached = np.maximum(reached, self._risen(signal, values))
            for i in np.flatnonzero(reached.max(axis=0) >= limit):
                when = self.time[start + int(np.argmax(reached[:, i] >= limit[i]))]
                if REGIME_ENDS[end] is FLAT:
                    self.flat[i] = min(self.flat[i], when)
                if when < self.first[i]:
                    self.first[i], self.which[i] = when, end

    def _risen(self, tyre: int, values: Array) -> Array:
        """How far a road has risen over where the hub was a sample before [m], shape (B, N)."""
        road = values[:, self.road[tyre]]
        hub = values[:, tyre] + road
        before = self.hub[tyre] if tyre in self.hub else hub[0]
        self.hub[tyre] = hub[-1]
        return road - np.concatenate([before[None], hub[:-1]])


def first_end(times: Array) -> Array:
    """Which of `REGIME_ENDS` comes first, as its index, and -1 where none does; from `reached`, shape (..., 4) to (...,).

    Of two at one sample, the one that is named first.
    """
    return np.where(np.isfinite(times).any(axis=-1), times.argmin(axis=-1), -1)


def ended_by(vehicle: Vehicle, response: Response) -> tuple[str, ...]:
    """What of `REGIME_ENDS`, or "divergence", happens in the physics of one run."""
    ended = [name for name, when in zip(END_NAMES, reached(vehicle, response), strict=True) if np.isfinite(when)]
    return (*ended, *(() if np.all(np.isfinite(response.values)) else ("divergence",)))
