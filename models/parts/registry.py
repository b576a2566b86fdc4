"""All parts that a vehicle file can have, and those of a vehicle."""

import importlib
from functools import cache
from typing import Any

from models.parts.part import Part, SuspensionPart
from models.parts.ratio import AtRatio

PARTS = {  # name -> module and class
    "stop": "models.parts.stop:Stops",
    "spring": "models.parts.spring:Spring",
    "damper": "models.parts.damper:Damper",
    "surface damper": "models.parts.surface_damper:SurfaceDamper",
    "adjustable damper": "models.parts.adjustable:Adjustable",
    "actuator": "models.parts.actuator:Actuator",
}


@cache
def part_class(name: str) -> Any:
    """Returns the class of a part."""
    module, _, named = PARTS[name].partition(":")
    return getattr(importlib.import_module(module), named)


def parts_of(vehicle: Any) -> tuple[SuspensionPart, ...]:
    """Returns the parts of a vehicle beyond its linear springs and dampers, at the wheels, suspension by suspension."""
    placed, kind, tables = list[SuspensionPart](), vehicle.kind, vehicle.ratio_tables
    loads = kind.static_loads(vehicle.parameters) if tables else {}
    for place in kind.suspensions:
        ratio = place.motion_ratio(vehicle.parameters)
        for name in PARTS:
            for part, parameter in part_class(name).of(vehicle, place):
                placed.append(
                    SuspensionPart(place, _at_wheel(part, place, kind, tables, ratio, loads, parameter), parameter, ratio)
                )
        for element in vehicle.elements:
            if place.corner in element.corners:
                placed.append(SuspensionPart(place, _at_wheel(element.part, place, kind, tables, ratio, loads, ""), "", ratio))
    return tuple(placed)


def _at_wheel(part: Part, place: Any, kind: Any, tables: Any, ratio: float, loads: Any, parameter: str) -> Part:
    """Returns a part of a suspension at its wheel."""
    if place.deflection not in tables:
        return part.at_wheel(ratio)
    carries, table = bool(parameter) and parameter == place.stiffness, kind.ratios[place.ratio]  # the same object in all samples
    return AtRatio(part, table, ratio / table.at_rest, loads[place.deflection] if carries else 0.0)
