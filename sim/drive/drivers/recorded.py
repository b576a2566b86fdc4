"""Driver that repeats recorded commands."""

from collections.abc import Sequence

import numpy as np

from models.common.arrays import Array
from models.vehicle.vehicle import Vehicle
from sim.drive.driver import RecordedForces, Request


class RecordedDriver:
    """Recorded commands of N runs."""

    ahead = 0
    requests: Request = "commands"

    def __init__(self, runs: Sequence[RecordedForces], *_: object) -> None:
        self.measured, self._commands = runs[0].measured, np.stack([one.forces for one in runs], axis=1)

    def start(self, vehicles: Sequence[Vehicle], timestep: float) -> Array:
        return np.zeros((len(vehicles), 0))

    def step(self, k: int, y: Array, ahead: Array | None, state: Array) -> tuple[Array, Array]:
        return self._commands[k], state
