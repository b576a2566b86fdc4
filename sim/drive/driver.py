"""Protocol of drivers of N runs side by side, from measurements to requests. `sim.drive.drivers` has one file for each driver.

A driver receives the measurements after noise and quantisation. The request that it returns passes through the computer's delay
(`sim.drive.computer`) and the actuators (`sim.drive.actuators`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal, Protocol, runtime_checkable

from models.common.arrays import Array
from models.laws.law import ControlLaw, DriverKey
from models.vehicle.limits_and_implementation import steps_per_sample
from models.vehicle.vehicle import Vehicle
from synth.controller.controller import AnyController

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

    linear: ClassVar[Literal[False]] = False
    implemented = False

    measured: tuple[str, ...]
    forces: Array

    @property
    def law_key(self) -> DriverKey:
        """See `ControlLaw`."""
        return ("recorded",)


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


def steps_ahead(vehicles: Sequence[Vehicle], controllers: Sequence[RunDriver], timestep: float) -> int:
    """Returns the largest number of timesteps [s] by which a controller previews its road beyond a run's end."""
    periods = [steps_per_sample(vehicle.implementation, timestep) for vehicle in vehicles]
    pairs = zip(controllers, periods, strict=True)
    return max((max(one.preview_samples(steps * timestep) - 1, 0) * steps for one, steps in pairs), default=0)
