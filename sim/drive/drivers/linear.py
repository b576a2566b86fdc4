"""Driver for linear control laws."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from models.common.extensions import FEATURES
from models.vehicle.limits_and_implementation import command_limiter, steps_per_sample
from models.vehicle.vehicle import Vehicle
from sim.drive.actuators import closing_names
from sim.drive.driver import Request
from synth.controller.controller import Controller

if TYPE_CHECKING:
    from models.parts.damper_range import CoefficientRange

IN_ORDER = 8  # smallest number of terms for which NumPy adds pairs of terms, instead of one term after the other


class LinearDriver:
    """Linear control laws of N runs, including anti-windup and preview forces."""

    ahead = 0
    requests: Request = "forces"

    def __init__(self, controllers: Sequence[Controller], *_: object) -> None:
        self._controllers = controllers
        self.measured = tuple({name for one in controllers for name in one.measured})
        self._windup: Array | None = None
        self._range: CoefficientRange | None = None

    def start(self, vehicles: Sequence[Vehicle], timestep: float) -> Array:
        first = vehicles[0]
        signals = self.measured = tuple(name for name in first.linear_model.outputs if name in self.measured)
        period = steps_per_sample(first.implementation, timestep) * timestep
        distinct = {id(one): one for one in self._controllers}
        laws = {key: one.law.sampled(period) for key, one in distinct.items()}
        m, k = len(first.linear_model.inputs), max(law.states for law in laws.values())
        self._forces, count = m, len(vehicles)
        self._gain, self._memory = np.zeros((len(signals), count, m + k)), np.zeros((count, m + k, k))
        for i, one in enumerate(self._controllers):
            law, seen = laws[id(one)], [signals.index(name) for name in one.measured]
            end = m + law.states
            self._gain[seen, i, :m], self._gain[seen, i, m:end] = law.D.T, law.B.T
            self._memory[i, :m, : law.states], self._memory[i, m:end, : law.states] = law.C, law.A
        if any(one.law.anti_windup is not None for one in self._controllers):
            anti_windup_gain = FEATURES.load("anti-windup").anti_windup_gain
            gains = {key: anti_windup_gain(law) for key, law in laws.items()}
            self._windup = np.zeros((count, k, m))
            for i, one in enumerate(self._controllers):
                gain = gains[id(one)]
                self._windup[i, : len(gain)] = gain
            most = [vehicle.limits.actuator_force for vehicle in vehicles]
            self._range, self._limiter = (
                FEATURES.load("damper ranges").range_of(vehicles, most),
                command_limiter(vehicles, timestep),
            )
            self._given = np.zeros((count, m))  # commands at the last sample, for the rate limit
            self.measured = (*self.measured, *closing_names(first))
        self.ahead = max(one.preview_samples(period) for one in self._controllers)
        self._preview = np.zeros((count, m, len(first.kind.wheels), self.ahead))
        for i, one in enumerate(self._controllers):
            if one.preview is not None:
                weights = one.preview.weights(period)
                self._preview[i, ..., : len(weights)] = np.moveaxis(weights, 0, 2)
        return np.zeros((count, k))

    def step(self, k: int, y: Array, ahead: Array | None, state: Array) -> tuple[Array, Array]:
        m, q = self._forces, len(self._gain)
        # Each controller's gain is zero for measurements of other controllers; adding such zero terms does not change the
        # rounding.
        products = self._gain * y.T[:q, :, None]
        # With few terms, NumPy adds one term after the other, for any number of runs. With more terms, the order may depend on
        # the number of runs.
        computed = np.add.reduce(products, axis=0) if q < IN_ORDER else sum(products, start=np.zeros(products.shape[1:]))
        if state.shape[1]:
            computed += np.matvec(self._memory, state)
        forces, state = computed[:, :m], computed[:, m:]
        if ahead is not None:
            forces = forces + np.matvec(self._preview.reshape(*forces.shape, -1), ahead.reshape(len(y), -1))
        if self._windup is not None and self._range is not None:
            closing = y[:, q:] if y.shape[1] > q else None
            lost = self._range.clipped_off(forces, closing)
            if self._limiter is not None:
                self._given = self._limiter(forces, self._given)
                lost = np.where(np.isfinite(self._limiter.change), self._given - forces, lost)
            state = state + np.matvec(self._windup, lost)
        return forces, state
