"""Keys of a controller's law that a campaign draws: numbers of a semi-active law, and entries of a gain or of a law's matrices.

A drawn law is read as a vehicle file's section is, with the same limits, so that it can be written as one.
"""

import re
import unicodedata
from collections.abc import Mapping
from typing import Any

from models.common.errors import InputError, listing, quoted
from models.laws.semi_active import LAWS
from models.vehicle.controllers import ControllerEntry, read_controllers
from models.vehicle.vehicle import Vehicle

ENTRY = re.compile(r"(gain|[ABCD])\[(\d+)\]\[(\d+)\]")


def law_values(vehicle: Vehicle, controller: str) -> dict[str, float | None]:
    """Returns the keys of a law, with the values that the vehicle file gives; None for a default.

    Raises:
        InputError: the law is designed, in Python, or without keys, or the file has no such section.
    """
    where, entry = f"controller {controller!r}", vehicle.controllers.get(controller)
    if entry is None:
        raise InputError(f"{where} is not a section of the vehicle file, and has no law to be drawn; give another one")
    if entry.semi_active is not None:
        if not (keys := LAWS[entry.semi_active.name][2]):
            raise InputError(f"{where}: its law {entry.semi_active.name} has no keys except its name; draw another one's keys")
        return {key: dict(entry.semi_active.numbers).get(key) for key in keys}
    if entry.python is not None:
        raise InputError(f"{where} is {entry.python.with_article}, whose numbers are in its own file; draw another one's keys")
    if entry.law is None:
        raise InputError(
            f"{where} is designed, and the file has no law of it to be drawn; write its gain first, with python -m synth --save"
        )
    matrices = {name: value for name, value in entry.law.record.items() if isinstance(value, list)}
    rate: dict[str, float | None] = {"anti_windup": entry.law.anti_windup} if entry.law.anti_windup is not None else {}
    return rate | {
        f"{name}[{i}][{j}]": number
        for name, matrix in matrices.items()
        for i, row in enumerate(matrix)
        for j, number in enumerate(row)
    }


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
    endings = {one.force: one.ending for one in vehicle.adjustable}
    section, model = {controller: record_of(vehicle, controller, values)}, vehicle.kind.whole_model(vehicle.parameters)
    read = read_controllers(section, model, vehicle.limits, vehicle.implementation, vehicle.kind, dampers=endings)
    return read[unicodedata.normalize("NFC", controller)]


def check_key(vehicle: Vehicle, controller: str, key: str) -> float | None:
    """Returns the file's value of a key of a law; None for a default.

    Raises:
        InputError: the law has no such key.
    """
    values = law_values(vehicle, controller)
    if key not in values:
        raise InputError(f"the law of controller {controller!r} has no key {quoted(key)}; it has {listing(values)}")
    return values[key]
