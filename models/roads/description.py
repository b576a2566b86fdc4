"""Tables that describe roads, in logs and in files of the gallery.

The key `type` gives the class of a road; the other keys are its fields.
"""

import math
from collections.abc import Mapping
from typing import Any

from models.common.checks import check
from models.common.errors import InputError, list_names, short_repr
from models.common.schema import read
from models.roads.iso8608 import Iso8608
from models.roads.loads.choice import described_loads
from models.roads.loads.road_with_loads import RoadWithLoads
from models.roads.obstacles import OBSTACLES
from models.roads.profile import from_csv
from models.roads.rig import rig_from_csv
from models.roads.road import Obstacle, Road, ScaledRoad
from models.roads.sinusoids import MULTISINES, Multisine
from models.vehicle.names import PLUS

DescribedRoad = Obstacle | Iso8608 | Multisine
ROADS: Mapping[str, type[DescribedRoad]] = {"iso8608": Iso8608, **OBSTACLES, **dict.fromkeys(MULTISINES, Multisine)}
SAME = 1e-12  # relative rounding error of a number that is computed from other numbers


def read_road(where: str, table: Mapping[str, Any]) -> DescribedRoad:
    """Returns the road that a table describes.

    Args:
        where: place of the table in the file, for messages.
        table: the table, with the key `type`.

    Raises:
        InputError: the type is unknown, or a key or value is not allowed.
    """
    kind = table.get("type")
    if not isinstance(kind, str) or kind not in ROADS:
        wrong = "has no type; give one of" if kind is None else f"type = {short_repr(kind)} is unknown; known types are"
        raise InputError(f"{where} {wrong} {list_names(ROADS)}")
    fields = {name: value for name, value in table.items() if name != "type"}
    return read(where, ROADS[kind], fields | ({"name": kind} if kind in MULTISINES else {}))


def described_road(description: Mapping[str, Any], points: bytes | None = None) -> Road:
    """Returns the road that a description specifies. The function is the inverse of `Road.describe`.

    Args:
        description: result of `Road.describe`, possibly after conversion to JSON and back.
        points: text `Road.points` of a profile or rig; None for other roads.

    Raises:
        InputError: the description is not that of a road, or is not complete.
    """
    kind, where = description.get("type"), f"road {description.get('type')}:"
    if "loads" in description:
        loads = check(f"{where} loads", description["loads"], str)
        road = described_road({name: value for name, value in description.items() if name != "loads"}, points)
        return RoadWithLoads(road, described_loads(loads.split(PLUS)))
    if kind in ("profile", "rig"):
        if points is None:
            raise InputError(f"the log does not contain the points of the road ({kind}); repeat the simulation to get a new log")
        source = str(description.get("source", ""))
        if kind == "rig":
            return rig_from_csv(points, source)
        if "join" not in description:
            raise InputError(
                "an older version of Roadproof recorded this road, and interpolated between its points in a different way; "
                "repeat the simulation to get a new log"
            )
        return from_csv(points, check(f"{where} speed", description.get("speed"), float), source, str(description["join"]))
    factor = description["factor"] if kind in OBSTACLES and "factor" in description else None
    road = read_road(where, {name: value for name, value in description.items() if factor is None or name != "factor"})
    for name, value in road.describe().items():
        if name not in description and name != "factor":
            raise InputError(f"{where} the log contains no value of {name} for this road; repeat the simulation to get a new log")
        if not isinstance(value, float):
            continue
        logged = check(f"{where} {name}", description.get(name, value), float)
        if not math.isclose(logged, value, rel_tol=SAME):
            raise InputError(
                f"{where} {name} was logged as {logged:g}, but is now computed as {value:g}, so this road is not the logged "
                "road; repeat the simulation to get a new log"
            )
    return road if factor is None else ScaledRoad(road, check(f"{where} factor", factor, float))
