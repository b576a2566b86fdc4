"""Runs of a vehicle's controllers, which may be named as its file names them."""

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
    """Returns a run for each controller, over the road from rest: MuJoCo, the linear prediction, and whether they agree.

    Args:
        controllers: results of `synth.design_controllers`, or names or entries of `vehicle.controllers`, which are designed if
            necessary. A function is a law, too: law(t, y) gets the time [s] and the q measurements, shape (q,), and returns the
            force [N], a number or shape (m,); law(sample, state) returns force and next state, as in a file. It measures the
            signals of its attribute `measured`, or all that can be measured. An object with the methods of `sim.Driver` is a law,
            too. A single controller gives a list of one run.
        road: the road, such as `models.Bump(height=0.1)`.
        duration: duration of the run [s].
        timestep: MuJoCo's timestep [s], and the controllers' sample period if the vehicle file has none.

    Raises:
        InputError: the road cannot be driven by this vehicle, a controller belongs to another one, a time is not allowed, or a
            function fails.
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
    """Returns the controller of a name, of an entry of the vehicle file, or of a function."""
    if isinstance(given, AnyController):
        return given
    if not isinstance(given, str | ControllerEntry):
        return of_function(given, designer.vehicle.linear_model.measurable)
    name, known = given if isinstance(given, str) else given.name, designer.vehicle.controllers
    if isinstance(given, ControllerEntry) and known.get(name) is not given:
        raise InputError(f"controllers: {name!r} belongs to another vehicle; give one of {list_names(known)} of this vehicle")
    return designer.vehicle.driver(name, designer.design)
