"""Protocol of drivers, which compute requests to the actuators (such as forces) from the measurements of N runs. Every built-in
driver has a file in `sim.drive.drivers`.

A driver receives the measurements with noise and quantisation. The requests of a driver pass through the delay of the computer
(`sim.drive.computer`) and through the actuators (`sim.drive.actuators`).
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
    """Control law of N runs that are simulated together. The number of runs N is 1 if a single run is simulated.

    `sim.run` accepts any object with the attributes and methods of this protocol as a controller. `start` is called before each
    repetition of a run, so a driver with internal data must reset these data in `start`.

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
        """Names of the q measured signals, in the order in which `step` receives them.

        The names in `sim.drive.actuators.closing_names` stand for the closing velocities of the suspensions [m/s].
        """
        ...

    @property
    def ahead(self) -> int:
        """Number P of road heights that the driver receives for each wheel, including the present height; 0 if the driver has
        no preview.
        """
        ...

    @property
    def requests(self) -> str:
        """Meaning of the requests that `step` returns: "forces", "coefficients" or "commands".

        "forces" [N] and damping "coefficients" of all dampers [N s/m] have shape (N, m), and are limited by the actuators.
        "commands" go to the actuators unchanged, see `sim.drive.actuators.Actuators`.
        """
        ...

    def start(self, vehicles: Sequence[Vehicle], timestep: float) -> Array:
        """Returns the states of the driver before the first sample, shape (N, k). The number of states k is 0 if the driver
        stores its states itself.

        Args:
            vehicles: the N vehicles, all with the same sample period.
            timestep: duration of a time step of the runs [s].
        """
        ...

    def step(self, k: int, y: Array, ahead: Array | None, state: Array) -> tuple[Array, Array]:
        """Returns the driver's requests at a sample, and the driver's states after this sample.

        Args:
            k: index of the time step, from 0.
            y: measurements of the q signals in `measured`, shape (N, q).
            ahead: road heights under the wheels at the present sample and at the next samples [m], shape (N, r, P); None if
                there is no preview.
            state: states of the driver before this sample, shape (N, k).
        """
        ...


@dataclass(frozen=True, eq=False)
class RecordedForces(ControlLaw):
    """Recorded commands, which do not depend on the measurements.

    Attributes:
        measured: names of the signals that the controller measured when the commands were recorded.
        forces: forces at every time step [N], shape (T, m), or commands of semi-active dampers, shape (T, 2 m).
    """

    linear: ClassVar[Literal[False]] = False
    implemented = False

    measured: tuple[str, ...]
    forces: Array

    @property
    def law_key(self) -> DriverKey:
        """Key in the registry of the driver that repeats recorded commands; see `ControlLaw`."""
        return ("recorded",)


RunDriver = AnyController | RecordedForces  # controller of one run, or the recorded forces that replace a controller


@dataclass(frozen=True)
class Failure:
    """Description of how the control law of a run failed.

    Attributes:
        why: reason why the control law failed, as one line of text.
        together: True if the failed call computed the forces of several runs, so that a different run may have caused the
            failure.
    """

    why: str
    together: bool


def steps_ahead(vehicles: Sequence[Vehicle], controllers: Sequence[RunDriver], timestep: float) -> int:
    """Returns the largest number of time steps beyond the end of a run for which a controller needs the road (preview)."""
    periods = [steps_per_sample(vehicle.implementation, timestep) for vehicle in vehicles]
    pairs = zip(controllers, periods, strict=True)
    return max((max(one.preview_samples(steps * timestep) - 1, 0) * steps for one, steps in pairs), default=0)
