"""The drivers by name: the class or function of each, in a file of its own, makes the driver of some controllers."""

from collections.abc import Sequence

from models.common.errors import InputError
from models.common.lazy import named
from sim.drive.driver import Driver, Failure, RunDriver

DRIVERS = {  # name -> module and what makes the driver of (controllers, failures, numbers), see `driver_of`
    "linear": "sim.drive.drivers.linear:LinearDriver",
    "semi_active": "sim.drive.drivers.semi_active:SemiActiveDriver",
    "python": "sim.drive.drivers.python:in_python",
    "recorded": "sim.drive.drivers.recorded:RecordedDriver",
    "code": "sim.drive.drivers.code:CodeDriver",
}


def driver_of(
    controllers: Sequence[RunDriver],
    name: str = "",
    failures: dict[int, Failure] | None = None,
    numbers: Sequence[int] = (),
) -> Driver:
    """Returns the driver of N controllers whose `driver_key` is equal.

    Args:
        name: name of another driver than that of the controllers.
        failures: receives the failures of laws in Python, whose runs go on without forces; None to raise them.
        numbers: keys of the N runs in `failures`.

    Raises:
        InputError: no such driver is registered.
    """
    name = name or controllers[0].driver_key[0]
    if name not in DRIVERS:
        raise InputError(f"no driver {name!r} runs this controller; known are {', '.join(DRIVERS)}")
    return named(DRIVERS[name])(controllers, failures, numbers)
