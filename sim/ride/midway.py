"""Accelerations where held forces leap: midway between just before and just after.

A run's acceleration at a sample is that of the force that acts from there on. Up to there the last one has acted, so that just
before, it was less by D (u[k] - u[k-1]), with D of (28); of an adjustable damper, whose force goes on with the suspension's
velocity v while its coefficient c is held, the leap is -(c[k] - c[k-1]) v. Behind a lag nothing leaps.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from models.common.arrays import Array
from models.vehicle import Vehicle


class Midway:
    """Takes N runs of one kind of vehicle block by block, from their first sample on."""

    def __init__(self, vehicles: Sequence[Vehicle], accelerations: Sequence[str], index: Mapping[str, int]) -> None:
        """Of these signals; `index` has the place of every output signal and coefficient among the values."""
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
        """What to take from each acceleration of the next block of signals, of shape (B, S, N): half its leaps, shape (N, B)."""
        half = {force: self._leap(force, values) / 2 for force in self.leaping}
        found = {}
        for name, shares in self.shares.items():
            for force, share in shares.items():
                part = share * half[force]
                found[name] = found[name] + part if name in found else part
        return found

    def _leap(self, force: str, values: Array) -> Array:
        """What a force leaps by at every sample, shape (N, B); nothing at the first, before which nobody has looked."""
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
