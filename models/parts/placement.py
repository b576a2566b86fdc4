"""Placement of all parts of a vehicle at the wheels of its suspensions."""

from typing import Any

from models.common.extensions import PARTS
from models.parts.part import Part, Parts, SuspensionPart
from models.parts.ratio import AtRatio, Constant


def parts_of(vehicle: Any) -> Parts:
    """Returns all parts of a vehicle, as they act at the wheels, except its linear springs and dampers; the parts are ordered
    by suspension.
    """
    placed, kind, classes = list[SuspensionPart](), vehicle.kind, PARTS.load_all().values()
    for place in kind.suspensions:
        rows = [(part, parameter, "") for one in classes for part, parameter in one.of(vehicle, place)]
        rows += [(_element(vehicle, place, one), "", one.name) for one in vehicle.elements if place.corner in one.corners]
        ratio = place.motion_ratio(vehicle.parameters)
        for part, parameter, name in rows:
            if (table := kind.table_of(place)) is None:
                at_wheel = part.at_wheel(ratio) or AtRatio(part, Constant(), ratio)
                placed.append(SuspensionPart(place, at_wheel, parameter, ratio, name))
                continue
            carries = bool(parameter) and parameter == place.stiffness
            load = kind.static_loads(vehicle.parameters)[place.deflection] if carries else 0.0
            placed.append(SuspensionPart(place, AtRatio(part, table, ratio / table.at_rest, load), parameter, ratio, name))
    return Parts(placed)


def _element(vehicle: Any, place: Any, one: Any) -> Part:
    """Returns the part that represents an element of `[parts]` at a suspension. A controller may set the voltage of the
    element.
    """
    damper = vehicle.dampers.get(place.force)
    if getattr(damper, "name", None) != one.name:
        return one.part
    from models.parts.settable import set_element

    return set_element(damper, place, one.part)
