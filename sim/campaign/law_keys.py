"""Keys of a control law whose values a campaign can sample: parameters of a semi-active law, and entries of a gain or of a
law's matrices.

Sampled values are checked like the values in a section of a vehicle file, so the same limits hold for both. A law with sampled
values can therefore be written to a vehicle file.
"""

import unicodedata
from collections.abc import Mapping
from typing import Any

from models.common.errors import InputError
from models.vehicle.controllers import ControllerEntry, read_controllers
from models.vehicle.vehicle import Vehicle


def law_values(vehicle: Vehicle, controller: str) -> dict[str, float | None]:
    """Returns the keys of a control law, each with its value in the vehicle file. The value is None for a key that the vehicle
    file does not contain.

    Raises:
        InputError: the controller has no section in the vehicle file, is designed by Roadproof, is written in Python, or has no
            keys to sample.
    """
    entry = vehicle.controllers.get(controller)
    if entry is None or not entry.source.values:
        why = "it is a design, a law in Python or a law without numbers"
        why = f"the vehicle file contains no [controllers.{controller}]" if entry is None else why
        more = "" if entry is None else ", or first write the designed gain with synth --save"
        raise InputError(
            f"controller {controller!r} has no numbers to sample, because {why}; sample a different controller{more}"
        )
    return entry.source.values


def record_of(vehicle: Vehicle, controller: str, values: Mapping[str, float]) -> dict[str, Any]:
    """Returns a controller's section of the vehicle file, with sampled values, to be written as TOML.

    The design goals and the certificate are omitted, because they are valid only for the control law without sampled values.
    """
    entry = vehicle.controllers[controller]
    return entry.source.with_values(entry.measured, values) | entry.hardware.record


def drawn_entry(vehicle: Vehicle, controller: str, values: Mapping[str, float]) -> ControllerEntry:
    """Returns the controller's section of the vehicle file as an object, with sampled values in its control law.

    Raises:
        InputError: a sampled value is not allowed for its key.
    """
    endings = {one.force: one.ending for one in vehicle.parts.adjustable}
    section, model = {controller: record_of(vehicle, controller, values)}, vehicle.kind.full_model(vehicle.parameters)
    read = read_controllers(section, model, vehicle.limits, vehicle.implementation, vehicle.kind, dampers=endings)
    return read[unicodedata.normalize("NFC", controller)]
