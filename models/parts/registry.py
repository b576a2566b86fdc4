"""All parts that a vehicle file can have, and those of a vehicle."""

import importlib
from functools import cache
from typing import Any

from models.parts.part import SuspensionPart
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
    placed, kind = list[SuspensionPart](), vehicle.kind
    for place in kind.suspensions:
        of_registry = [one for name in PARTS for one in part_class(name).of(vehicle, place)]
        for part, parameter in (*of_registry, *((one.part, "") for one in vehicle.elements if place.corner in one.corners)):
            ratio = place.motion_ratio(vehicle.parameters)
            if (table := kind.table_of(place)) is None:
                placed.append(SuspensionPart(place, part.at_wheel(ratio), parameter, ratio))
                continue
            carries = bool(parameter) and parameter == place.stiffness
            load = kind.static_loads(vehicle.parameters)[place.deflection] if carries else 0.0
            placed.append(SuspensionPart(place, AtRatio(part, table, ratio / table.at_rest, load), parameter, ratio))
    return tuple(placed)
