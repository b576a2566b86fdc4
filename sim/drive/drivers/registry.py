"""Drivers by name. Registry of drivers: for each type of control law, a class or function in a separate file creates the
driver.
"""

from collections.abc import Sequence

from models.common.extensions import DRIVERS
from sim.drive.driver import Driver, Failure, RunDriver


def driver_of(
    controllers: Sequence[RunDriver],
    name: str = "",
    failures: dict[int, Failure] | None = None,
    numbers: Sequence[int] = (),
) -> Driver:
    """Returns the driver of N controllers with the same `driver_key`.

    Args:
        name: name of a driver to use instead of the driver that belongs to the controllers.
        failures: dictionary that receives the failures of Python control laws; None to raise failures as errors. Runs with
            failures continue without control forces.
        numbers: keys that identify the N runs in `failures`.

    Raises:
        InputError: there is no driver with the requested name.
    """
    return DRIVERS.load(name or controllers[0].driver_key[0])(controllers, failures, numbers)
