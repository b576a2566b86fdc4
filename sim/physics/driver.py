"""Control laws of N runs side by side, from measurements to requests: linear, semi-active, in Python, and known commands.

A driver receives the measurements after noise and quantisation. The request that it returns passes through the computer's delay
(`sim.physics.computer`) and the actuators (`sim.physics.actuators`). `sim.physics.exported_code` has the driver of exported code.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Literal, Protocol

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.laws.python_law import Programmed, samples_ahead
from models.laws.semi_active import SemiActive
from models.vehicle.limits_and_implementation import Implementation, steps_per_sample
from models.vehicle.vehicle import Vehicle
from sim.physics.actuators import closing_names
from synth.controller.controller import Controller
from synth.controller.controller import Driver as Law

if TYPE_CHECKING:
    from models.laws.python_runtime import FileRuns, LawRuns
    from models.suspension.damper_range import CoefficientRange

WILD = 1e8  # largest measurement, in SI units: beyond it the run has diverged, and its law is no longer called

Request = Literal["forces", "coefficients", "commands"]


class Driver(Protocol):
    """Control law of N runs; a single run is N = 1.

    Attributes:
        measured: names of the q signals that it reads, in their order. Names of `sim.physics.actuators.closing_names` are those
            of the closing velocities of suspensions [m/s].
        ahead: number P of road heights that it reads under each wheel, the present one included; 0 without preview.
        requests: meaning of what it returns. "forces" [N] and "coefficients" of all dampers [N s/m] have shape (N, m), and
            actuators limit them. "commands" are applied unchanged, see `sim.physics.actuators.Actuators`.
    """

    measured: tuple[str, ...]
    ahead: int
    requests: Request

    def start(self, vehicles: Sequence[Vehicle], timestep: float) -> Array:
        """Returns the states before the first sample, shape (N, k); k is 0 for laws that keep their states to themselves.

        Args:
            vehicles: the N vehicles, all with the same sample period.
            timestep: timestep of the runs [s].
        """
        ...

    def step(self, k: int, y: Array, ahead: Array | None, state: Array) -> tuple[Array, Array]:
        """Returns the requests of a sample and the states after it.

        Args:
            k: timestep of the sample, from 0.
            y: measurements, shape (N, q).
            ahead: heights of the road at this and the next samples [m], shape (N, r, P), or None without preview.
            state: states, shape (N, k).
        """
        ...


@dataclass(frozen=True, eq=False)
class RecordedForces:
    """Commands that are known beforehand, whatever the measurements.

    Attributes:
        measured: measurements of the original controller.
        forces: forces at every timestep [N], shape (T, m), or commands of adjustable dampers, shape (T, 2 m).
    """

    measured: tuple[str, ...]
    forces: Array


RunDriver = Law | RecordedForces  # a controller or known commands, for one run


@dataclass(frozen=True)
class Failure:
    """Failure of the law of a run.

    Attributes:
        why: reason, in one line.
        together: True if the law was called for several runs at once, so another of them may have caused the failure.
    """

    why: str
    together: bool


class LinearDriver:
    """Linear laws with their anti-windup, and their forces from the road ahead."""

    ahead = 0
    requests: Request = "forces"

    def __init__(self, controllers: Sequence[Controller], ahead: Array | None = None) -> None:
        """Takes N controllers, and their forces from the road ahead at every timestep [N], shape (T, N, m), or None."""
        self._controllers, self._ahead = controllers, ahead
        self.measured = tuple({name for one in controllers for name in one.measured})
        self._windup: Array | None = None
        self._range: CoefficientRange | None = None

    def start(self, vehicles: Sequence[Vehicle], timestep: float) -> Array:
        """See `Driver.start`."""
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
            from models.laws.anti_windup import anti_windup_gain
            from models.suspension.damper_range import range_of

            gains = {key: anti_windup_gain(law) for key, law in laws.items()}
            self._windup = np.zeros((count, k, m))
            for i, one in enumerate(self._controllers):
                gain = gains[id(one)]
                self._windup[i, : len(gain)] = gain
            most = [vehicle.limits.actuator_force for vehicle in vehicles]
            self._range = range_of([vehicle.adjustable for vehicle in vehicles], first.linear_model.inputs, most)
            self.measured = (*self.measured, *closing_names(first))
        return np.zeros((count, k))

    def step(self, k: int, y: Array, ahead: Array | None, state: Array) -> tuple[Array, Array]:
        """See `Driver.step`."""
        m, q = self._forces, len(self._gain)
        computed = np.zeros(self._gain.shape[1:])
        for term in self._gain * y.T[:q, :, None]:  # zeros for the measurements of other controllers do not change the rounding
            computed += term
        if state.shape[1]:
            computed += np.matvec(self._memory, state)
        forces, state = computed[:, :m], computed[:, m:]
        if self._ahead is not None:
            forces = forces + self._ahead[k]
        if self._windup is not None and self._range is not None:
            closing = y[:, q:] if y.shape[1] > q else None
            state = state + np.matvec(self._windup, self._range.clipped_off(forces, closing))
        return forces, state


class SemiActiveDriver:
    """Semi-active laws that ship; see `models.laws.semi_active`."""

    ahead = 0
    requests: Request = "coefficients"

    def __init__(self, controllers: Sequence[SemiActive]) -> None:
        """Takes N controllers with the same law, whose numbers may differ."""
        self._laws = [one.law for one in controllers]
        self.measured = self._laws[0].measured

    def start(self, vehicles: Sequence[Vehicle], timestep: float) -> Array:
        """See `Driver.start`."""
        from models.suspension.damper_range import range_of
        from models.vehicle.semi_active_coefficients import numbers_at, numbers_of

        self._range = range_of([vehicle.adjustable for vehicle in vehicles], vehicles[0].linear_model.inputs)
        self._numbers_at = partial(numbers_at, numbers_of(self._laws, vehicles), self._range)
        self._signals = len(self.measured)
        if self._range.bent is not None:
            self.measured = (*self.measured, *closing_names(vehicles[0]))
        return np.zeros((len(vehicles), 0))

    def step(self, k: int, y: Array, ahead: Array | None, state: Array) -> tuple[Array, Array]:
        """See `Driver.step`."""
        numbers = self._numbers_at(y[:, self._signals :], slice(None))
        return self._laws[0].coefficients(y[:, : self._signals], numbers), state


class PythonDriver:
    """Law in Python, or FMU, of N runs with a state each; a vectorised law serves all its runs at once."""

    requests: Request = "forces"

    def __init__(
        self, controller: Programmed, period: float, failures: dict[int, Failure] | None = None, numbers: Sequence[int] = ()
    ) -> None:
        """Takes the controller.

        Args:
            period: time between two samples [s].
            failures: receives failures, whose runs go on without forces, or None to raise them.
            numbers: keys of the N runs in `failures`.
        """
        self._controller, self._period, self._failures, self._numbers = controller, period, failures, numbers
        self.measured, self.ahead = controller.measured, preview_samples(controller, period)

    def start(self, vehicles: Sequence[Vehicle], timestep: float) -> Array:
        """Executes the law's file for each run. See `Driver.start`.

        Raises:
            InputError: a law fails, and failures are not collected; so does `step`.
        """
        from models.laws.python_runtime import runs_of

        self._timestep, self._forces = timestep, len(vehicles[0].linear_model.inputs)
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
        """See `Driver.step`."""
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
        """Records that the law of these runs has failed, or raises the error if failures are not collected."""
        if self._failures is None:
            raise error
        self._gone[runs] = True
        self._failures |= {self._numbers[i]: Failure(str(error), together) for i in runs}


class RecordedDriver:
    """Known commands of N runs."""

    ahead = 0
    requests: Request = "commands"

    def __init__(self, runs: Sequence[RecordedForces]) -> None:
        self.measured, self._commands = runs[0].measured, np.stack([one.forces for one in runs], axis=1)

    def start(self, vehicles: Sequence[Vehicle], timestep: float) -> Array:
        """See `Driver.start`."""
        return np.zeros((len(vehicles), 0))

    def step(self, k: int, y: Array, ahead: Array | None, state: Array) -> tuple[Array, Array]:
        """See `Driver.step`."""
        return self._commands[k], state


def preview_samples(controller: RunDriver, period: float) -> int:
    """Returns the number of road heights that a controller receives under each wheel, the present one included; 0 without
    preview.
    """
    if isinstance(controller, Programmed) and controller.law.preview is not None:
        return samples_ahead(controller.law.preview, period)
    if isinstance(controller, Controller) and controller.preview is not None:
        return controller.preview.samples(period)
    return 0


def steps_ahead(vehicles: Sequence[Vehicle], controllers: Sequence[RunDriver], timestep: float) -> int:
    """Returns the largest number of timesteps [s] by which a controller previews its road beyond a run's end."""
    periods = [steps_per_sample(vehicle.implementation, timestep) for vehicle in vehicles]
    pairs = zip(controllers, periods, strict=True)
    return max((max(preview_samples(driver, steps * timestep) - 1, 0) * steps for driver, steps in pairs), default=0)


def implementation_around(controller: RunDriver, vehicle: Vehicle) -> Implementation:
    """Returns the implementation around a controller: without an FMU's own delay, and none for known commands."""
    how = vehicle.implementation
    if isinstance(controller, RecordedForces):
        return Implementation()
    if not isinstance(controller, Programmed) or not controller.law.is_fmu or controller.law.path is None or not how.delay:
        return how
    from models.vehicle.foreign_fmu import own_delay

    return replace(how, delay=max(how.delay - own_delay(controller.law.path), 0))


def preview_forces(
    controllers: Sequence[RunDriver], vehicles: Sequence[Vehicle], heights: Array, timestep: float, samples: int
) -> Array | None:
    """Returns the forces by which N linear controllers answer the road ahead [N], shape (T, N, m), or None if none does.

    Args:
        heights: road heights from the start to `steps_ahead` of the end [m], shape (.., N, r).
        timestep: [s].
        samples: T.
    """
    ahead = [one.preview if isinstance(one, Controller) else None for one in controllers]
    if not any(ahead):
        return None
    forces = np.zeros((samples, len(controllers), len(vehicles[0].linear_model.inputs)))
    for i, (one, vehicle) in enumerate(zip(ahead, vehicles, strict=True)):
        if one is not None:
            forces[:, i] = one.forces(heights[:, i], steps_per_sample(vehicle.implementation, timestep), timestep, samples)
    return forces
