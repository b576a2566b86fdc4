"""Vehicle in which new values replace those of parameters, semi-active dampers and force elements."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from models.characteristics.adjustable_range import CURVE_KEYS
from models.parts.part import SettablePart
from models.vehicle.vehicle import Vehicle

OF_DAMPERS = (*CURVE_KEYS, "bandwidth")  # keys of [actuators], in addition to parameters, whose values can be varied


def damper_numbers(vehicle: Vehicle) -> dict[str, tuple[float, list[str]]]:
    """Returns, by name, the damper parameters that can be varied, each with its value and the names of the damper forces to
    which it belongs.

    A parameter has one entry for each damper whose value is a number, and one entry for all dampers if all values are equal.
    """
    quantities: dict[str, tuple[float, list[str]]] = {}
    for name in OF_DAMPERS:
        # A limit that is given as a characteristic cannot be multiplied like a number.
        own = [one for one in vehicle.parts.adjustable if one.damper.replaces]
        curved = {one for one in own if name in CURVE_KEYS and one.damper.pair is not None}
        values: dict[SettablePart, Any] = {one: None if one in curved else getattr(one.damper, name) for one in own}
        if len(set(values.values())) == 1:
            quantities[name] = (next(iter(values.values())), [one.force for one in values])
        quantities |= {f"{name}{one.ending}": (value, [one.force]) for one, value in values.items() if one.ending}
    return {name: (value, forces) for name, (value, forces) in quantities.items() if value is not None}


def with_sample(vehicle: Vehicle, sample: Mapping[str, float]) -> Vehicle:
    """Returns a vehicle with new values of parameters, semi-active dampers and force elements, given by name in `sample` [SI]."""
    if not sample:
        return vehicle
    known, dampers = damper_numbers(vehicle), dict(vehicle.dampers)
    endings = {one.force: one.ending for one in vehicle.parts.adjustable}
    for name in (one for one in known if one in sample):
        for force in known[name][1]:
            dampers[force] = replace(dampers[force], **{name.removesuffix(endings[force]): sample[name]})
    elements = tuple(one.sampled(sample) for one in vehicle.elements)
    dampers = {force: damper.among(elements) for force, damper in dampers.items()}
    parameters = {name: value for name, value in sample.items() if name in vehicle.parameters}
    return vehicle.altered(parameters, dampers=dampers, elements=elements)
