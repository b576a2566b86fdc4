"""Runs of a vehicle with several controllers, which can be selected by name in the vehicle file."""

from collections.abc import Callable, Sequence
from typing import Annotated, Any

from models import USUAL_TIMESTEP
from models.common.checks import AT_LEAST_ONE, Must, Time
from models.common.errors import InputError, list_names
from models.laws.python_law import of_function
from models.roads.road import Road
from models.vehicle.controllers import ControllerEntry
from models.vehicle.vehicle import Vehicle
from sim.drive.driver import Driver
from sim.runs.run import Run, run_controllers, sample_times
from synth.controller.controller import AnyController, check_fits
from synth.vehicle.designer import Designer

ControllerLike = Annotated[
    AnyController | ControllerEntry | str | Callable[..., Any] | Driver,
    Must("a controller, its name, an entry of vehicle.controllers, a function or a driver", lambda value: True),
]


def run(
    vehicle: Vehicle,
    controllers: ControllerLike | Annotated[Sequence[ControllerLike], AT_LEAST_ONE],
    road: Road,
    duration: Time = 3.0,
    timestep: Time = USUAL_TIMESTEP,
) -> list[Run]:
    """Simulates each controller over a road in MuJoCo, starting from equilibrium, and compares the runs with linear analysis.

    Args:
        controllers: results of `synth.design_controllers`, or names or entries of `vehicle.controllers`, which are designed if
            necessary. A function can also be used as a control law. law(t, y) receives the time [s] and the q measurements,
            shape (q,). The function law(t, y) returns the force [N], a number or an array of shape (m,). A function law(sample,
            state) returns the force and the next state, like a control law in a Python file. A function receives the signals
            that its attribute `measured` lists or, without this attribute, all measurable signals. An object with the methods
            of `sim.Driver` can also be used as a control law. A single controller may be given without a list; the result is
            then a list with one run.
        road: road to drive over, for example `models.Bump(height=0.1)`.
        duration: duration of the run [s].
        timestep: time step of MuJoCo [s]. The time step is also the sample period of the controllers if the vehicle file does
            not define one.

    Returns:
        One run per controller, with the simulated response, the predicted responses, and the verdict `agrees`.

    Raises:
        InputError: the vehicle cannot drive over the road, a controller belongs to a different vehicle, a time is not allowed,
            or a function fails.
        DesignError: a controller cannot be designed.

    Example:
        >>> from models import Bump, read_vehicle
        >>> from sim import run
        >>> [passive] = run(read_vehicle("quarter_car"), ["passive"], Bump(height=0.05), duration=1.0)
        >>> passive.agrees, passive.physics["tyre_deflection"].shape
        (True, (1001,))
        >>> def damper(sample, state):
        ...     return -2000.0 * sample["sprung_velocity"], state
        >>> [damped] = run(read_vehicle("quarter_car"), damper, Bump(height=0.05), duration=1.0)
        >>> damped.agrees, bool(damped.physics.peak("sprung_velocity") < passive.physics.peak("sprung_velocity"))
        (True, True)
    """
    time = sample_times(vehicle, duration, timestep)
    road.check(vehicle, time)
    designer = Designer(vehicle)
    several = controllers if isinstance(controllers, Sequence) and not isinstance(controllers, str) else [controllers]
    drivers = [_driver(designer, one) for one in several]
    check_fits(vehicle, *drivers)
    return run_controllers(vehicle, drivers, road, time)


def _driver(designer: Designer, given: ControllerLike) -> AnyController:
    """Returns the controller for a name, an entry of the vehicle file, or a function."""
    if isinstance(given, AnyController):
        return given
    if not isinstance(given, str | ControllerEntry):
        return of_function(given, designer.vehicle.linear_model.measurable)
    name, known = given if isinstance(given, str) else given.name, designer.vehicle.controllers
    if isinstance(given, ControllerEntry) and known.get(name) is not given:
        raise InputError(f"controllers: {name!r} belongs to another vehicle; give one of {list_names(known)} of this vehicle")
    return designer.vehicle.driver(name, designer.design)
