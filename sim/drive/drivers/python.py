"""Driver for Python control laws, for FMUs, and for a user's own drivers."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.laws.python_law import PythonController, is_driver
from models.vehicle.limits_and_implementation import steps_per_sample
from models.vehicle.vehicle import Vehicle
from sim.drive.driver import Driver, Failure, Request

if TYPE_CHECKING:
    from models.laws.python_runtime import FileRuns, LawRuns

WILD = 1e8  # largest measurement, in SI units, with which a Python law is called; a run with a larger measurement has diverged


def in_python(controllers: Sequence[PythonController], failures: dict[int, Failure] | None, numbers: Sequence[int]) -> Driver:
    """Returns the driver of a Python control law; if the law is a driver itself, returns the law."""
    law = controllers[0]
    return law.function if is_driver(law.function) else PythonDriver(law, failures, numbers)


class PythonDriver:
    """Python control law or FMU that controls N runs, with a separate state for each run. A vectorised law is called once per
    sample for all runs that it controls.
    """

    requests: Request = "forces"

    ahead = 0

    def __init__(self, controller: PythonController, failures: dict[int, Failure] | None, numbers: Sequence[int]) -> None:
        """Prepares the controller of the runs.

        Args:
            failures: dictionary that receives the failures of the law; None to raise failures as errors. Runs with failures
                continue without control forces.
            numbers: keys that identify the N runs in `failures`.
        """
        self._controller, self._failures, self._numbers = controller, failures, numbers
        self.measured = controller.measured

    def start(self, vehicles: Sequence[Vehicle], timestep: float) -> Array:
        """Executes the Python file of the control law once for each run. See `Driver.start`.

        Raises:
            InputError: a law fails, and failures are not collected. The method `step` raises the same error.
        """
        from models.laws.python_runtime import runs_of

        self._timestep, self._forces = timestep, len(vehicles[0].linear_model.inputs)
        self._period = steps_per_sample(vehicles[0].implementation, timestep) * timestep
        self.ahead = self._controller.preview_samples(self._period)
        self._laws: LawRuns | FileRuns = runs_of(self._controller, self._forces)
        self._gone, runs = np.zeros(len(vehicles), dtype=bool), list[int]()
        for i, vehicle in enumerate(vehicles):
            try:
                self._laws.add(vehicle.parameters)
                runs.append(i)
            except InputError as error:
                self._failed(error, [i])
        self._runs = np.array(runs, dtype=int)
        return np.zeros((len(vehicles), 0))

    def step(self, k: int, y: Array, ahead: Array | None, state: Array) -> tuple[Array, Array]:
        forces, runs = np.zeros((len(y), self._forces)), self._runs
        self._gone |= np.any(~(np.abs(y) <= WILD), axis=1)
        gone = self._gone[runs]
        if gone.all():
            return forces, state
        preview = None if ahead is None else np.ascontiguousarray(ahead[runs])
        try:
            forces[runs], errors = self._laws.call(gone, y[runs], k * self._timestep, self._period, preview)
        except InputError as error:
            self._failed(error, runs[~gone].tolist(), len(runs) > 1)
            return forces, state
        for i, error in errors.items():
            self._failed(error, [int(runs[i])])
        return forces, state

    def _failed(self, error: InputError, runs: Sequence[int], together: bool = False) -> None:
        """Records the runs in which the law has failed, or raises the error if failures are not collected."""
        if self._failures is None:
            raise error
        self._gone[runs] = True
        self._failures |= {self._numbers[i]: Failure(str(error), together) for i in runs}
