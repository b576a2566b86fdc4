"""Keys of a controller's law that a campaign draws: numbers of a semi-active law, and entries of a gain or of a law's matrices.

A drawn law is read as a vehicle file's section is, with the same limits, so that it can be written as one.
"""

import unicodedata
from collections.abc import Mapping
from typing import Any

from models.common.errors import InputError
from models.vehicle.controllers import ControllerEntry, read_controllers
from models.vehicle.vehicle import Vehicle


def law_values(vehicle: Vehicle, controller: str) -> dict[str, float | None]:
    """Returns the keys of a law, with the values that the vehicle file gives; None for a default.

    Raises:
        InputError: the law is designed, in Python, or without keys, or the file has no such section.
    """
    entry = vehicle.controllers.get(controller)
    if entry is None or not entry.source.values:
        raise InputError(
            f"controller {controller!r} has no numbers in the vehicle file to sample, like all designed controllers, laws in "
            "Python and some semi-active laws; sample another controller, or write its gain with python -m synth --save"
        )
    return entry.source.values


def record_of(vehicle: Vehicle, controller: str, values: Mapping[str, float]) -> dict[str, Any]:
    """Returns the section of a controller with drawn values, as TOML holds it; goals and certificate are of another law."""
    entry = vehicle.controllers[controller]
    return entry.source.with_values(entry.measured, values) | entry.hardware.record


def drawn_entry(vehicle: Vehicle, controller: str, values: Mapping[str, float]) -> ControllerEntry:
    """Returns a controller's entry with drawn values.

    Raises:
        InputError: a value is not allowed.
    """
    endings = {one.force: one.ending for one in vehicle.parts.adjustable}
    section, model = {controller: record_of(vehicle, controller, values)}, vehicle.kind.full_model(vehicle.parameters)
    read = read_controllers(section, model, vehicle.limits, vehicle.implementation, vehicle.kind, dampers=endings)
    return read[unicodedata.normalize("NFC", controller)]
