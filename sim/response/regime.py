"""What ends the linear regime, and when: a tyre off the road, a suspension at its bump stop, an actuator at its limit."""

from collections.abc import Sequence

import numpy as np

from models.common.arrays import Array
from models.kind import MOST_SQUEEZE
from models.vehicle import Vehicle
from sim.response.response import Response

ENDS = ("lift-off", "bump stop", "force saturation", "flat tyre")


def thresholds(vehicle: Vehicle) -> list[list[tuple[str, float, float]]]:
    """For each of `ENDS`, where the linear regime of a vehicle ends: (signal, sign, value), reached by sign * signal >= value.

    A sign of 0 is either way. A limit that the vehicle has not, has no thresholds.
    """
    names, limits = vehicle.linear_model.outputs, vehicle.limits
    lift = [(name, 1.0, static) for name, static in vehicle.kind.static_tyre_deflection(vehicle.parameters).items()]
    found = [lift]
    for kind, limit in (("suspension_deflection", limits.suspension_stroke), ("control_force", limits.actuator_force)):
        found.append([(name, 0.0, limit) for name in names if name.startswith(kind)] if limit is not None else [])
    found.append([(name, -1.0, MOST_SQUEEZE) for name in vehicle.kind.static_tyre_deflection(vehicle.parameters)])
    return found


def utilisation(vehicle: Vehicle, response: Response) -> Array:
    """How much of the way to each of `ENDS` a response goes, shape (..., 4): 1 reaches it, 0 where there is no such limit."""
    columns = []
    for signals in thresholds(vehicle):
        share = np.zeros(response.values.shape[:-2])
        for name, sign, value in signals:
            signal = response[name]
            share = np.maximum(share, (sign * signal if sign else np.abs(signal)).max(axis=-1) / value)
        columns.append(share)
    return np.stack(columns, axis=-1)


def reached(vehicle: Vehicle, response: Response, factor: Array | float = 1.0) -> Array:
    """When each of `ENDS` is first reached [s], infinite where it is not, shape (..., 4).

    Args:
        vehicle: the vehicle.
        response: of the physics, where a force stops at its limit, or of the linear model, where it would go on. Leading axes are
            runs.
        factor: multiplies the response; shape (N,) adds a leading axis to that of a single run.
    """
    factor = np.asarray(factor)[..., None]
    columns = []
    for signals in thresholds(vehicle):
        first = np.full(np.broadcast_shapes(factor.shape[:-1], response.values.shape[:-2]), np.inf)
        for name, sign, value in signals:
            signal = response[name]
            beyond = factor * (sign * signal if sign else np.abs(signal)) >= value * (1 - 1e-12)  # a force at its limit is equal
            first = np.minimum(first, np.where(beyond.any(axis=-1), response.time[beyond.argmax(axis=-1)], np.inf))
        columns.append(first)
    return np.stack(columns, axis=-1)


class Ends:
    """What ends the linear regime of each of N runs first, and when, from their signals block by block.

    A tyre's length is never below zero, so where a road rises through a hub within a step, the reading is that of a tyre that is
    long again. Therefore a tyre is flat, too, where the road has risen that far over where the hub was a sample before.

    Attributes:
        first: when [s], infinite for never, shape (N,).
        which: what, as an index into `ENDS`, -1 for nothing, shape (N,). Of two at one sample, the one that is named first.
        flat: when a tyre is first flat, whatever came before, shape (N,).
    """

    def __init__(self, vehicles: Sequence[Vehicle], time: Array) -> None:
        self.time, count = time, len(vehicles)
        self.first, self.which, self.flat = np.full(count, np.inf), np.full(count, -1), np.full(count, np.inf)
        names = [signal.name for signal in vehicles[0].kind.signals]
        roads = {wheel.tyre_deflection: wheel.road_displacement for wheel in vehicles[0].kind.wheels}
        self.road = {names.index(tyre): names.index(road) for tyre, road in roads.items()}
        self.hub: dict[int, Array] = {}  # at the last sample, by tyre [m], shape (N,)
        each = [thresholds(vehicle) for vehicle in vehicles]
        # (end, signal, sign, value of every run)
        self.limits = [
            (end, names.index(signal), sign, np.array([one[end][j][2] for one in each]) * (1 - 1e-12))
            for end, signals in enumerate(each[0])
            for j, (signal, sign, _) in enumerate(signals)
        ]

    def update(self, start: int, values: Array) -> None:
        """Takes the block of signals, shape (B, S, N), that starts at a sample."""
        for end, signal, sign, limit in self.limits:
            reached = sign * values[:, signal] if sign else np.abs(values[:, signal])
            if ENDS[end] == "flat tyre":
                reached = np.maximum(reached, self._risen(signal, values))
            for i in np.flatnonzero(reached.max(axis=0) >= limit):
                when = self.time[start + int(np.argmax(reached[:, i] >= limit[i]))]
                if ENDS[end] == "flat tyre":
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
    """Which of `ENDS` comes first, as its index, and -1 where none does; from `reached`, shape (..., 4) to (...,).

    Of two at one sample, the one that is named first.
    """
    return np.where(np.isfinite(times).any(axis=-1), times.argmin(axis=-1), -1)


def ended_by(vehicle: Vehicle, response: Response) -> tuple[str, ...]:
    """What of `ENDS`, or "divergence", happens in the physics of one run."""
    ended = [name for name, when in zip(ENDS, reached(vehicle, response), strict=True) if np.isfinite(when)]
    return (*ended, *(() if np.all(np.isfinite(response.values)) else ("divergence",)))
