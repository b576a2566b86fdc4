"""A controller that is a law in Python, as it is driven: nothing is claimed of it."""

from models.common.errors import InputError
from models.own.python_law import Programmed
from models.vehicle import Vehicle


def programmed(vehicle: Vehicle, name: str) -> Programmed:
    """The controller of that name; the file of its law is read, and not run.

    Args:
        vehicle: the vehicle.
        name: of one of its controllers that is a law in Python.

    Raises:
        InputError: the file cannot be read.
    """
    entry = vehicle.controllers[name]
    assert entry.python is not None, "it is a law in Python"
    try:
        return Programmed(entry.name, entry.measured, entry.python, entry.python.source())
    except InputError as error:
        raise InputError(f"controller {name!r}: {error}") from error
