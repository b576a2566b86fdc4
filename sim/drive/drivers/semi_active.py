"""Driver for semi-active control laws."""

from collections.abc import Sequence
from functools import partial

import numpy as np

from models.common.arrays import Array
from models.laws.semi_active import SemiActive
from models.vehicle.vehicle import Vehicle
from sim.drive.actuators import closing_names
from sim.drive.driver import Request


class SemiActiveDriver:
    """Built-in semi-active laws of N runs; see `models.laws.semi_active`."""

    ahead = 0
    requests: Request = "coefficients"

    def __init__(self, controllers: Sequence[SemiActive], *_: object) -> None:
        """Prepares N controllers with the same law. The parameters of the law may differ between the controllers."""
        self._laws = [one.law for one in controllers]
        self.measured = self._laws[0].measured

    def start(self, vehicles: Sequence[Vehicle], timestep: float) -> Array:
        from models.parts.damper_range import range_of
        from models.vehicle.semi_active_coefficients import numbers_at, numbers_of

        self._range = range_of(vehicles)
        self._numbers_at = partial(numbers_at, numbers_of(self._laws, vehicles), self._range)
        self._signals = len(self.measured)
        if self._range.curved:
            self.measured = (*self.measured, *closing_names(vehicles[0]))
        return np.zeros((len(vehicles), 0))

    def step(self, k: int, y: Array, ahead: Array | None, state: Array) -> tuple[Array, Array]:
        numbers = self._numbers_at(y[:, self._signals :], slice(None))
        return self._laws[0].coefficients(y[:, : self._signals], numbers), state
