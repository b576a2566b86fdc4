"""The vehicle for which a saved certificate was proved, and what has changed in the vehicle file since."""

from collections.abc import Mapping
from typing import Any

from models.common.errors import InputError
from models.vehicle.controllers import ControllerEntry
from models.vehicle.vehicle import Vehicle
from synth.analysis.record import SAME, VEHICLE
from synth.controller.controller import verify_record
from synth.controller.problem import problem

CHANGED = "the vehicle is no longer the one that was certified: "


def vehicle_record(vehicle: Vehicle) -> dict[str, dict[str, float]]:
    """Returns the numbers on which a certificate depends [SI units], by section of the vehicle file."""
    how, lag = vehicle.implementation, vehicle.limits.actuator_bandwidth
    computer = {"sample_period": how.sample_period or 0.0, "delay": how.delay}
    return {
        "parameters": {name: float(value) for name, value in vehicle.parameters.items()},
        "performance": {name: float(weight) for name, weight in vehicle.performance.items() if weight},
        "implementation": {name: float(value) for name, value in (*computer.items(), *how.noise.items()) if value},
        "limits": {"actuator_bandwidth": float(lag)} if lag is not None else {},
    }


def changed_since(vehicle: Vehicle, entry: ControllerEntry) -> str:
    """Returns a sentence on what differs from the vehicle that was certified; empty if this is not known.

    Args:
        entry: section of the vehicle file, whose certificate does not hold.
    """
    record, unladen = entry.certificate or {}, vehicle.unladen
    then = record.get(VEHICLE)
    payload = vehicle.parameters.get("sprung_mass", 0.0) - unladen.parameters.get("sprung_mass", 0.0)
    loaded = [f"payload {payload:g} kg"] if unladen is not vehicle else []
    if not isinstance(then, Mapping):  # saved by an earlier version
        return f"{CHANGED}{loaded[0]}" if loaded and _holds(unladen, entry) else ""
    differences = _differences(vehicle, then)
    if loaded and differences and len(others := _differences(unladen, then)) < len(differences):
        differences = [*loaded, *others]
    return f"{CHANGED}{', '.join(differences)}" if differences else ""


def _holds(vehicle: Vehicle, entry: ControllerEntry) -> bool:
    """Returns True if every claim of a certificate on the ideal loop holds for a vehicle."""
    try:
        return not verify_record(problem(vehicle, entry.measured, entry.hardware), entry)[1]
    except InputError:
        return False


def _differences(vehicle: Vehicle, then: Mapping[str, Any]) -> list[str]:
    """Returns the numbers that differ from those of the certified vehicle, in words."""
    texts, units = list[str](), {one.name: one.unit for one in vehicle.kind.parameters}
    for section, now in vehicle_record(vehicle).items():
        before = then.get(section, {})
        before = before if isinstance(before, Mapping) else {}
        for name in dict.fromkeys((*now, *before)):
            new, old = now.get(name, 0.0), before.get(name, 0.0)
            if not isinstance(old, (int, float)) or abs(new - old) > SAME * abs(new):
                of = "" if section == "parameters" else f"[{section}] "
                texts.append(f"{of}{name} {new:.6g} instead of {old:.6g} {units.get(name, '') if not of else ''}".rstrip())
    return texts
