"""Controllers as they are driven: linear ones with what is claimed of them, laws in Python of which nothing is."""

from collections.abc import Callable, Sequence

from models.common.errors import InputError
from models.damping.laws import SemiActive
from models.own.python_law import Programmed
from models.vehicle import Vehicle
from synth.controller import Controller


def driven(
    vehicle: Vehicle, names: Sequence[str], design: Callable[[str], Controller]
) -> list[Controller | Programmed | SemiActive]:
    """The controllers of these names; no law in Python is run.

    Args:
        vehicle: the vehicle.
        names: of its controllers.
        design: gives a linear one.

    Raises:
        InputError: one cannot be designed, or the file of a law cannot be read.
    """
    linear = vehicle.linear_names
    return [design(name) if name in linear else lawful(vehicle, name) for name in names]


def lawful(vehicle: Vehicle, name: str) -> Programmed | SemiActive:
    """The controller of that name, of which linear analysis does not speak; arguments and errors as for `programmed`."""
    law = vehicle.controllers[name].semi_active
    return programmed(vehicle, name) if law is None else SemiActive(name, law)


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
