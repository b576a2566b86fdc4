"""Keys of a controller's law that a campaign draws: numbers of a semi-active law, and entries of a gain or of a law's matrices.

A drawn law is read as a vehicle file's section is, with the same limits, so that it can be written as one.
"""

import re
import unicodedata
from collections.abc import Mapping
from typing import Any

import numpy as np

from models.common.errors import InputError
from models.laws.semi_active import LAWS
from models.vehicle.controllers import ControllerEntry, read_controllers
from models.vehicle.vehicle import Vehicle

ENTRY = re.compile(r"(gain|[ABCD])\[(\d+)\]\[(\d+)\]")


def law_values(vehicle: Vehicle, controller: str) -> dict[str, float | None]:
    """Returns the keys of a law, with the values that the vehicle file gives; None for a default.

    Raises:
        InputError: the law is designed, in Python, or without keys, or the file has no such section.
    """
    entry = vehicle.controllers.get(controller)
    if entry is not None and entry.semi_active is not None and (keys := LAWS[entry.semi_active.name][2]):
        return {key: dict(entry.semi_active.numbers).get(key) for key in keys}
    if entry is None or entry.law is None:
        raise InputError(
            f"controller {controller!r} has no numbers in the vehicle file to sample, like all designed controllers, laws in "
            "Python and some semi-active laws; sample another controller, or write its gain with python -m synth --save"
        )
    matrices = {name: value for name, value in entry.law.record.items() if isinstance(value, list)}
    rate: dict[str, float | None] = {"anti_windup": entry.law.anti_windup} if entry.law.anti_windup is not None else {}
    return rate | {f"{name}[{i}][{j}]": value for name, one in matrices.items() for (i, j), value in np.ndenumerate(one)}


def record_of(vehicle: Vehicle, controller: str, values: Mapping[str, float]) -> dict[str, Any]:
    """Returns the section of a controller with drawn values, as TOML holds it; goals and certificate are of another law."""
    entry = vehicle.controllers[controller]
    if entry.semi_active is not None:
        return {**entry.semi_active.record, **values}
    assert entry.law is not None, "it has keys"
    record: dict[str, Any] = {"measured": list(entry.measured), **entry.law.record}
    for key, value in values.items():
        if match := ENTRY.fullmatch(key):
            record[match[1]][int(match[2])][int(match[3])] = value
        else:
            record[key] = value
    return record | entry.hardware.record


def drawn_entry(vehicle: Vehicle, controller: str, values: Mapping[str, float]) -> ControllerEntry:
    """Returns a controller's entry with drawn values.

    Raises:
        InputError: a value is not allowed.
    """
    endings = {one.force: one.ending for one in vehicle.parts.adjustable}
    section, model = {controller: record_of(vehicle, controller, values)}, vehicle.kind.whole_model(vehicle.parameters)
    read = read_controllers(section, model, vehicle.limits, vehicle.implementation, vehicle.kind, dampers=endings)
    return read[unicodedata.normalize("NFC", controller)]
