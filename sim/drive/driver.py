"""Control laws of N runs side by side, from measurements to requests: linear, semi-active, in Python, and known commands.

A driver receives the measurements after noise and quantisation. The request that it returns passes through the computer's delay
(`sim.drive.computer`) and the actuators (`sim.drive.actuators`). `sim.drive.exported_code` has the driver of exported code.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Literal, Protocol, runtime_checkable

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.laws.law import ControlLaw
from models.laws.python_law import Programmed
from models.laws.semi_active import SemiActive
from models.vehicle.limits_and_implementation import command_limiter, steps_per_sample
from models.vehicle.vehicle import Vehicle
from sim.drive.actuators import closing_names
from synth.controller.controller import AnyController, Controller

if TYPE_CHECKING:
    from models.laws.python_runtime import FileRuns, LawRuns
    from models.parts.damper_range import CoefficientRange

WILD = 1e8  # largest measurement, in SI units: beyond it the run has diverged, and its law is no longer called

Request = Literal["forces", "coefficients", "commands"]


@runtime_checkable
class Driver(Protocol):
    """Control law of N runs; a single run is N = 1.

    `sim.run` takes an object with these attributes and methods as a controller. `start` begins each repetition of a run, so a
    driver that keeps anything to itself has to reset it there.

    Example:
        >>> import numpy as np
        >>> from models import Bump, read_vehicle
        >>> from sim import run
        >>> class Smoothed:
        ...     measured, ahead, requests = ("sprung_velocity",), 0, "forces"
        ...     def start(self, vehicles, timestep):
        ...         return np.zeros((len(vehicles), 1))
        ...     def step(self, k, y, ahead, state):
        ...         state = 0.9 * state + 0.1 * y
        ...         return -2000.0 * state, state
        >>> [smoothed] = run(read_vehicle("quarter_car"), Smoothed(), Bump(height=0.05), duration=1.0)
        >>> smoothed.passed
        True

    """

    @property
    def measured(self) -> tuple[str, ...]:
        """Names of the q signals that it reads, in their order.

        Names of `sim.drive.actuators.closing_names` are those of the closing velocities of suspensions [m/s].
        """
        ...

    @property
    def ahead(self) -> int:
        """Number P of road heights that it reads under each wheel, the present one included; 0 without preview."""
        ...

    @property
    def requests(self) -> str:
        """Meaning of what it returns.

        "forces" [N] and "coefficients" of all dampers [N s/m] have shape (N, m), and actuators limit them. "commands" are applied
        unchanged, see `sim.drive.actuators.Actuators`.
        """
        ...

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
class RecordedForces(ControlLaw):
    """Commands that are known beforehand, whatever the measurements.

    Attributes:
        measured: measurements of the original controller.
        forces: forces at every timestep [N], shape (T, m), or commands of adjustable dampers, shape (T, 2 m).
    """

    measured: tuple[str, ...]
    forces: Array


RunDriver = AnyController | RecordedForces  # a controller or known commands, for one run


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

    def __init__(self, controllers: Sequence[Controller]) -> None:
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
            from models.laws.anti_windup import anti_windup_gain
            from models.parts.damper_range import range_of

            gains = {key: anti_windup_gain(law) for key, law in laws.items()}
            self._windup = np.zeros((count, k, m))
            for i, one in enumerate(self._controllers):
                gain = gains[id(one)]
                self._windup[i, : len(gain)] = gain
            most = [vehicle.limits.actuator_force for vehicle in vehicles]
            self._range, self._limiter = range_of(vehicles, most), command_limiter(vehicles, timestep)
            self._given = np.zeros((count, m))  # commands of the last sample, under a rate limit
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
        # Zeros for the measurements of other controllers do not change the rounding.
        computed = sum(self._gain * y.T[:q, :, None], start=np.zeros(self._gain.shape[1:]))
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


class SemiActiveDriver:
    """Semi-active laws that ship; see `models.laws.semi_active`."""

    ahead = 0
    requests: Request = "coefficients"

    def __init__(self, controllers: Sequence[SemiActive]) -> None:
        """Takes N controllers with the same law, whose numbers may differ."""
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


class PythonDriver:
    """Law in Python, or FMU, of N runs with a state each; a vectorised law serves all its runs at once."""

    requests: Request = "forces"

    ahead = 0

    def __init__(self, controller: Programmed, failures: dict[int, Failure] | None = None, numbers: Sequence[int] = ()) -> None:
        """Takes the controller.

        Args:
            failures: receives failures, whose runs go on without forces, or None to raise them.
            numbers: keys of the N runs in `failures`.
        """
        self._controller, self._failures, self._numbers = controller, failures, numbers
        self.measured = controller.measured

    def start(self, vehicles: Sequence[Vehicle], timestep: float) -> Array:
        """Executes the law's file for each run. See `Driver.start`.

        Raises:
            InputError: a law fails, and failures are not collected; so does `step`.
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
        return np.zeros((len(vehicles), 0))

    def step(self, k: int, y: Array, ahead: Array | None, state: Array) -> tuple[Array, Array]:
        return self._commands[k], state


def steps_ahead(vehicles: Sequence[Vehicle], controllers: Sequence[RunDriver], timestep: float) -> int:
    """Returns the largest number of timesteps [s] by which a controller previews its road beyond a run's end."""
    periods = [steps_per_sample(vehicle.implementation, timestep) for vehicle in vehicles]
    pairs = zip(controllers, periods, strict=True)
    return max((max(one.preview_samples(steps * timestep) - 1, 0) * steps for one, steps in pairs), default=0)
