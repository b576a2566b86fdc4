"""Comparison of a vehicle file with the vehicle for which a saved certificate was proved."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

from models.common.errors import InputError
from models.common.extensions import FEATURES
from models.common.printed import entry as as_entry
from models.vehicle.controllers import ControllerEntry
from models.vehicle.vehicle import Vehicle
from synth.analysis.record import SAME, VEHICLE
from synth.controller.controller import Controller, verify_record
from synth.controller.problem import problem
from synth.controller.report import norm_if_implemented
from synth.controller.sampled_report import false_norm, instability_cured_by_sampling

CHANGED_VEHICLE = "the vehicle is no longer the one that was certified: "


def vehicle_record(vehicle: Vehicle) -> dict[str, dict[str, float]]:
    """Returns the vehicle's data on which a certificate depends, as numbers in SI units, by section of the vehicle file and by
    name.
    """
    how, lag = vehicle.implementation, vehicle.limits.actuator_bandwidth
    computer = {"sample_period": how.sample_period or 0.0, "delay": how.delay}
    return {
        "parameters": {name: float(value) for name, value in vehicle.parameters.items()},
        "performance": {name: float(weight) for name, weight in vehicle.performance.items() if weight},
        "implementation": {name: float(value) for name, value in (*computer.items(), *how.noise.items()) if value},
        "limits": {"actuator_bandwidth": float(lag)} if lag is not None else {},
    }


def changed_since(vehicle: Vehicle, entry: ControllerEntry) -> str:
    """Describes, as text, how a vehicle differs from the certified vehicle. The description is empty if the difference between
    the vehicles is not known.

    Args:
        vehicle: vehicle from the vehicle file.
        entry: section of the vehicle file with the certificate that does not hold.
    """
    unladen, then = vehicle.unladen, (entry.certificate or {}).get(VEHICLE)
    heavier = [vehicle.parameters[name] - unladen.parameters[name] for name in unladen.parameters if name == "sprung_mass"]
    payload = [f"payload {mass:g} kg" for mass in heavier if mass]
    if not isinstance(then, Mapping):  # an earlier version of Roadproof saved the certificate
        with suppress(InputError):
            if payload and not verify_record(problem(unladen, entry.measured, entry.hardware), entry)[1]:
                return f"{CHANGED_VEHICLE}{payload[0]}"
        return ""
    changes = min(payload + _differences(unladen, then), _differences(vehicle, then), key=len)
    return f"{CHANGED_VEHICLE}{', '.join(changes)}" if changes else ""


def false_claims(vehicle: Vehicle, entry: ControllerEntry, controller: Controller, wrong: Sequence[str]) -> tuple[str, ...]:
    """Describes the false claims of a certificate in a vehicle file, including those about the sampled-data loop.

    If the vehicle is no longer the certified vehicle, the result states only what changed.

    Args:
        vehicle: vehicle from the vehicle file.
        entry: section of the vehicle file with the certificate.
        controller: controller that the section describes.
        wrong: false claims about the ideal loop.
    """
    found = tuple(wrong)
    if entry.certificate:
        found += FEATURES.load("norm as implemented").false_sampled_bound(vehicle, entry)
    found += false_norm(entry.certificate, vehicle, lambda: norm_if_implemented(vehicle, controller))
    if found and not controller.certificate.stable:  # sampling may make an unstable loop stable
        norm = norm_if_implemented(vehicle, controller)
        cured = instability_cured_by_sampling(vehicle, controller.certificate, norm)
        found = tuple(each for each in found if each not in cured)
    changed = changed_since(vehicle, entry) if found else ""
    return (changed,) if changed else found


def _differences(vehicle: Vehicle, then: Mapping[str, Any]) -> list[str]:
    """Describes which numbers of a vehicle differ from those of the certified vehicle."""
    texts, units = list[str](), {one.name: f" {one.unit}" for one in vehicle.kind.parameters}
    for section, now in vehicle_record(vehicle).items():
        before = then.get(section, {})
        for name in dict.fromkeys((*now, *before)):
            new, old = now.get(name, 0.0), float(before.get(name, 0.0))
            if abs(new - old) > SAME * abs(new):
                where = "" if section == "parameters" else f"[{section}] "
                unit = "" if where else units.get(name, "")
                shown = [as_entry(value) if name in section else "none" for value, section in ((new, now), (old, before))]
                texts.append(f"{where}{name} {shown[0]} instead of {shown[1]}{unit}")
    return texts
