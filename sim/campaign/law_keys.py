"""Keys of a control law that a campaign can sample: parameters of a semi-active law, entries of a gain or of a law's matrices.

Sampled values are checked like the values in a section of a vehicle file, and have the same limits. A law with sampled values
can therefore be written to a vehicle file.
"""

import unicodedata
from collections.abc import Mapping
from typing import Any

from models.common.errors import InputError
from models.vehicle.controllers import ControllerEntry, read_controllers
from models.vehicle.vehicle import Vehicle


def law_values(vehicle: Vehicle, controller: str) -> dict[str, float | None]:
    """Returns the keys of a law with their values in the vehicle file. The value is None if the file does not contain the key.

    Raises:
        InputError: the controller has no section in the vehicle file, is designed, is a law in Python, or has no keys.
    """
    entry = vehicle.controllers.get(controller)
    if entry is None or not entry.source.values:
        raise InputError(
            f"controller {controller!r} has no numbers in the vehicle file to sample, because its law is designed, in "
            "Python or semi-active; sample a different controller, or first write its gain with synth --save"
        )
    return entry.source.values


def record_of(vehicle: Vehicle, controller: str, values: Mapping[str, float]) -> dict[str, Any]:
    """Returns a controller's section of the vehicle file, with sampled values, to be written as TOML.

    Goals and certificate are omitted, because they belong to the law without sampled values.
    """
    entry = vehicle.controllers[controller]
    return entry.source.with_values(entry.measured, values) | entry.hardware.record


def drawn_entry(vehicle: Vehicle, controller: str, values: Mapping[str, float]) -> ControllerEntry:
    """Returns the controller's entry in the vehicle file, with sampled values in its law.

    Raises:
        InputError: a value is not allowed.
    """
    endings = {one.force: one.ending for one in vehicle.parts.adjustable}
    section, model = {controller: record_of(vehicle, controller, values)}, vehicle.kind.full_model(vehicle.parameters)
    read = read_controllers(section, model, vehicle.limits, vehicle.implementation, vehicle.kind, dampers=endings)
    return read[unicodedata.normalize("NFC", controller)]
