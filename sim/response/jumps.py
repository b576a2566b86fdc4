"""Jumps of signals at the samples, where a held force changes, or the held coefficient of an adjustable damper.

A run's signal at a sample is its value just after the jump, with the new force. Just before, it was less by D (u[k] - u[k-1]),
with D of (28). For an adjustable damper, whose coefficient c is held while the velocity v of the suspension changes, u jumps by
-(c[k] - c[k-1]) v. A lagging force does not jump.

A motion ratio r that changes with travel is held, too: at the wheel r[k] u[k] - r[k-1] u[k-1] jumps.
"""

from collections.abc import Sequence

import numpy as np

from models.common.arrays import Array
from models.vehicle.vehicle import Vehicle


class Jumps:
    """Jumps of forces and accelerations, for N runs of one kind of vehicle, block by block."""

    def __init__(self, vehicles: Sequence[Vehicle], signals: Sequence[str]) -> None:
        """Prepares the jumps of some output signals."""
        vehicle = vehicles[0]
        index = {signal.name: i for i, signal in enumerate(vehicle.kind.signals)}
        model, forces, outputs = vehicle.linear_model, vehicle.linear_model.inputs, vehicle.linear_model.outputs
        dampers = {one.force: one for one in vehicle.adjustable}
        self.coefficient = {force: index[one.coefficient] for force, one in dampers.items()}
        self.shapes = {one.force: [other.adjustable[i].shape for other in vehicles] for i, one in enumerate(vehicle.adjustable)}
        # Velocity of a damper's suspension: its share of every state, by place. Vehicles side by side have the same geometry.
        rows = {force: one.ratio * model.A[model.states.index(vehicle.kind.pushed(force))] for force, one in dampers.items()}
        self.rates = {force: {index[model.states[i]]: row[i] for i in np.flatnonzero(row)} for force, row in rows.items()}
        lagging = {force for force, one in dampers.items() if one.damper.bandwidth is not None}
        if vehicle.limits.actuator_bandwidth is not None:
            lagging |= set(forces) - set(dampers)
        D = np.stack([one.linear_model.D for one in vehicles], axis=-1)  # (p, m, N)
        # Jump of every signal per newton of each force, shape (N, 1).
        self.shares = {
            name: {
                force: D[outputs.index(name), j][:, None]
                for j, force in enumerate(forces)
                if force not in lagging and np.any(D[outputs.index(name), j])
            }
            for name in signals
        }
        self.index = {force: index[force] for force in forces if any(force in shares for shares in self.shares.values())}
        self.turning = list(vehicles) if vehicle.ratio_tables else []
        self.travels = {force: index[vehicle.kind.pushed(force)] for force in forces if vehicle.kind.pushed(force)}
        nominal = [[[one.nominal] for one in other.adjustable] for other in vehicles]  # shape (N, d, 1)
        self.nominal = {force: np.array(nominal)[:, i] for i, force in enumerate(dampers)}
        self.before: dict[int | str, Array] = {}  # last sample of the previous block, by place or force, shape (N, 1)

    def __call__(self, values: Array) -> dict[str, Array]:
        """Returns the jumps of each signal that jumps, shape (N, B), for the next block of signals, shape (B, S, N)."""
        both = {force: self._over_travel(force, values) if self.turning else (self._jump(force, values),) for force in self.index}
        jumps = {}
        for name, shares in self.shares.items():
            for force, share in shares.items():
                part = share * both[force][0 if name == force else -1]
                jumps[name] = jumps[name] + part if name in jumps else part
        return jumps

    def _jump(self, force: str, values: Array) -> Array:
        """Returns the jump of a force at every sample, shape (N, B); zero at the first sample of the run."""
        if force not in self.coefficient:
            now = values[:, self.index[force]].T
            return now - self._last(self.index[force], now)
        now = values[:, self.coefficient[force]].T
        return -(now - self._last(self.coefficient[force], now)) * self._shaped(force, values)

    def _over_travel(self, force: str, values: Array) -> tuple[Array, Array]:
        """Returns the jumps of a force, and of the force at the wheel over the ratio at rest, shapes (N, B)."""
        at_rest = np.array([[one.motion_ratios[force]] for one in self.turning])
        if force not in self.travels:
            return (jump := self._jump(force, values)), jump
        travels = values[:, self.travels[force]].T
        ratio = np.stack([one.ratio_at(force, d) for one, d in zip(self.turning, travels, strict=True)]) / at_rest
        ratio_before = self._last(force, ratio)
        if force not in self.coefficient:
            now = values[:, self.index[force]].T
            before = self._last(self.index[force], now)
        else:
            beyond = values[:, self.coefficient[force]].T - self.nominal[force]
            now = -beyond * self._shaped(force, values, ratio)
            before = -self._last(self.coefficient[force], beyond) * self._shaped(force, values, ratio_before)
        return now - before, ratio * now - ratio_before * before

    def _shaped(self, force: str, values: Array, ratio: Array | float = 1.0) -> Array:
        """Returns h [m/s] of a damper, at its ratio over that at rest, shape (N, B)."""
        parts = [share * values[:, place].T for place, share in self.rates[force].items()]
        return np.stack([shape(v) for shape, v in zip(self.shapes[force], ratio * np.sum(parts, axis=0), strict=True)])

    def _last(self, place: int | str, now: Array) -> Array:
        """Returns a signal at the samples before, shape (N, B); the first one of the run is its own."""
        last = np.concatenate([self.before.get(place, now[:, :1]), now[:, :-1]], axis=1)
        self.before[place] = now[:, -1:].copy()
        return last
