"""The drivers by name: the class or function of each, in a file of its own, makes the driver of some controllers."""

from collections.abc import Sequence

from models.common.extensions import DRIVERS
from sim.drive.driver import Driver, Failure, RunDriver


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
    return DRIVERS.load(name or controllers[0].driver_key[0])(controllers, failures, numbers)
