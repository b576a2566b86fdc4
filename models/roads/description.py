"""Roads from their descriptions, the reverse of `Road.describe`."""

import math
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from models.common.checks import check
from models.common.errors import InputError, listing, quoted
from models.roads.iso8608 import Iso8608, check_seed
from models.roads.load_choice import described_loads
from models.roads.loaded import RoadWithLoads
from models.roads.obstacles import OBSTACLES
from models.roads.profile import from_csv
from models.roads.rig import rig_from_csv
from models.roads.road import Road, ScaledRoad
from models.roads.sinusoids import MULTISINES, Multisine
from models.vehicle.names import PLUS

KINDS = ("iso8608", "profile", "rig", *OBSTACLES, *MULTISINES)
SAME = 1e-12  # relative rounding of numbers that follow from others


def described_road(description: Mapping[str, Any], points: bytes | None = None) -> Road:
    """Returns the road of a description.

    Args:
        description: result of `Road.describe`, through JSON or not.
        points: `points` of a profile or a rig; None for other roads.

    Raises:
        InputError: the description is not that of a road, or not complete.
    """
    if "loads" in description:
        loads = check("its loads", description["loads"], str)
        road = described_road({name: value for name, value in description.items() if name != "loads"}, points)
        return RoadWithLoads(road, described_loads(loads.split(PLUS)))
    kind = description.get("type")
    if not isinstance(kind, str) or kind not in KINDS:
        raise InputError(f"the road has type = {quoted(kind)}, which is unknown; known types are {listing(KINDS)}")
    if kind in ("profile", "rig"):
        if points is None:
            raise InputError(f"the points of the road ({kind}) are missing")
        source = str(description.get("source", ""))
        if kind == "rig":
            return rig_from_csv(points, source)
        if "join" not in description:
            raise InputError("an older version recorded this road, and joined its points differently; drive over the road again")
        return from_csv(points, _read(description, "speed"), source, str(description["join"]))
    if kind == "iso8608":
        return _random(description)
    if kind in MULTISINES:
        omega, amplitudes, phases = (_read(description, name, tuple[float, ...]) for name in ("omega", "amplitudes", "phases"))
        if not len(omega) == len(amplitudes) == len(phases):
            raise InputError(f"road {kind}: omega, amplitudes and phases have different lengths; give lists of equal length")
        return Multisine(omega, amplitudes, phases, _read(description, "speed"), kind)

    allowed = {field.name: field.default for field in fields(OBSTACLES[kind])}
    for name in description:
        if name not in (*allowed, "type", "factor"):
            raise InputError(f"road {kind}: unknown key {quoted(name)}; known keys: {listing(allowed)}")
    given = [name for name in allowed if name in description or name != "start"]  # of a step that begins at once it is not said
    values = {name: _read(description, name, str if name == "track" else float) for name in given}
    road = OBSTACLES[kind](**values)
    return ScaledRoad(road, _read(description, "factor")) if "factor" in description else road


def _random(description: Mapping[str, Any]) -> Iso8608:
    seed, road_class = check_seed(description.get("seed")), description.get("class", "")
    iri = _read(description, "iri") if "iri" in description else None
    gd = _read(description, "gd") if "gd" in description else None
    if not isinstance(road_class, str) or (not road_class and iri is None and gd is None):
        raise InputError("road iso8608: class, iri or gd is missing; give one of them")
    factor = _read({"factor": 1.0, **description}, "factor")
    speed, width, length = (_read(description, name) for name in ("speed", "track_width", "length"))
    waviness = _read({"waviness": 2.0, **description}, "waviness")
    band = _read(description, "lowest"), _read(description, "highest")
    road = Iso8608(road_class, seed, speed, width, length, factor, iri, gd, waviness, *band)
    for name, value in {"roughness": road.roughness * factor**2}.items():
        if not math.isclose(_read(description, name), value, rel_tol=SAME):
            raise InputError(f"road iso8608: {name} was logged as {description[name]:g}, but is now {value:g}: the road differs")
    return road


def _read(description: Mapping[str, Any], name: str, annotation: Any = float) -> Any:
    """Returns a value of a description; a number by default."""
    return check(f"road {description['type']}: its {name}", description.get(name), annotation)
