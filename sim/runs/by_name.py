"""Runs of a vehicle's controllers, which may be named as its file names them."""

from collections.abc import Sequence
from typing import Annotated

from models import USUAL_TIMESTEP
from models.common.checks import AT_LEAST_ONE
from models.common.errors import InputError, listing
from models.roads.road import Road
from models.vehicle.controllers import ControllerEntry
from models.vehicle.vehicle import Vehicle
from sim.runs.run import Run, run_controllers, sample_times
from synth.controller.controller import Driver, check_fits
from synth.vehicle.designer import Designer


def run(
    vehicle: Vehicle,
    controllers: Driver | ControllerEntry | str | Annotated[Sequence[Driver | ControllerEntry | str], AT_LEAST_ONE],
    road: Road,
    duration: float = 3.0,
    timestep: float = USUAL_TIMESTEP,
) -> list[Run]:
    """Returns a run for each controller, over the road from rest: MuJoCo, the linear prediction, and whether they agree.

    Args:
        vehicle: the vehicle.
        controllers: as `synth.design_controllers` makes them, or names of the vehicle's, or entries of `vehicle.controllers`:
            those are designed, and laws in Python and semi-active ones driven as they are. A single one is a list of one.
        road: the road, such as `models.Bump(height=0.1)`.
        duration: of the run [s].
        timestep: of MuJoCo [s], and the controllers' sample period if the vehicle file has none.

    Raises:
        InputError: the road cannot be driven by this vehicle, a controller belongs to another one, or a time is not allowed.
        DesignError: a controller cannot be designed.

    Example:
        >>> from models import Bump, read_vehicle
        >>> from sim import run
        >>> [passive] = run(read_vehicle("quarter_car"), ["passive"], Bump(height=0.05), duration=1.0)
        >>> passive.agrees, passive.physics["tyre_deflection"].shape
        (True, (1001,))
    """
    time = sample_times(vehicle, duration, timestep)
    road.check(vehicle, time)
    designer = Designer(vehicle)
    several = controllers if isinstance(controllers, Sequence) and not isinstance(controllers, str) else [controllers]
    drivers = [_driver(designer, one) for one in several]
    check_fits(vehicle, *drivers)
    return run_controllers(vehicle, drivers, road, time)


def _driver(designer: Designer, given: Driver | ControllerEntry | str) -> Driver:
    """Returns the controller of a name, or of an entry of the vehicle file."""
    if not isinstance(given, str | ControllerEntry):
        return given
    name, known = given if isinstance(given, str) else given.name, designer.vehicle.controllers
    if isinstance(given, ControllerEntry) and known.get(name) is not given:
        raise InputError(f"controllers: {name!r} is an entry of another vehicle; give one of {listing(known)} of this one")
    return designer.design(name) if name not in known or known[name].linear else known[name].driver()
