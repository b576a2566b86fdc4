"""Roads from their descriptions, the reverse of `Road.describe`."""

import math
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from models.common.errors import InputError, listing, quoted
from models.roads.iso8608 import HIGHEST, LOWEST, Iso8608, check_seed
from models.roads.load_choice import described_loads
from models.roads.loaded import RoadWithLoads
from models.roads.obstacles import OBSTACLES
from models.roads.profile import from_csv
from models.roads.rig import rig_from_csv
from models.roads.road import Road, ScaledRoad
from models.roads.sinusoids import MULTISINES, Multisine
from models.vehicle.names import PLUS

KINDS = ("iso8608", "profile", "rig", *OBSTACLES, *MULTISINES)
MOST_LOADS = 8_000_000  # characters
MOST_LINES = 1000  # of a sum of sinusoids
SAME = 1e-12  # relative rounding of numbers that follow from others
SIDES = ("left", "right", "both")


def described_road(description: Mapping[str, Any], points: bytes | None = None) -> Road:
    """Returns the road of a description.

    Args:
        description: result of `Road.describe`, through JSON or not.
        points: `points` of a profile or a rig; None for other roads.

    Raises:
        InputError: the description is no road's, or not complete.
    """
    if "loads" in description:
        loads = description["loads"]
        if not isinstance(loads, str) or len(loads) > MOST_LOADS:
            raise InputError(f"its loads are no text of at most {MOST_LOADS} characters")
        road = described_road({name: value for name, value in description.items() if name != "loads"}, points)
        return RoadWithLoads(road, described_loads(loads.split(PLUS)))
    kind = description.get("type")
    if not isinstance(kind, str) or kind not in KINDS:
        raise InputError(f"a road of unknown type; known: {listing(KINDS)}")
    if kind in ("profile", "rig"):
        if points is None:
            raise InputError(f"the points of a {kind} are missing")
        source = str(description.get("source", ""))
        if kind == "rig":
            return rig_from_csv(points, source)
        if "join" not in description:
            raise InputError("its points were joined by an older version, from another start; drive over the road again")
        return from_csv(points, _number(description, "speed"), source, str(description["join"]))
    if kind == "iso8608":
        return _random(description)
    if kind in MULTISINES:
        omega, amplitudes, phases = (_numbers(description, name) for name in ("omega", "amplitudes", "phases"))
        if not len(omega) == len(amplitudes) == len(phases):
            raise InputError(f"road {kind}: omega, amplitudes and phases are not equally many")
        return Multisine(omega, amplitudes, phases, _number(description, "speed"), kind)

    allowed = {field.name: field.default for field in fields(OBSTACLES[kind])}
    for name in description:
        if name not in (*allowed, "type", "factor"):
            raise InputError(f"road {kind}: it has no {quoted(name)}; known: {listing(allowed)}")
    given = [name for name in allowed if name in description or name != "start"]  # of a step that begins at once it is not said
    values = {name: _side(description) if name == "track" else _number(description, name) for name in given}
    road = OBSTACLES[kind](**values)
    return ScaledRoad(road, _number(description, "factor")) if "factor" in description else road


def _random(description: Mapping[str, Any]) -> Iso8608:
    seed, road_class = check_seed(description.get("seed")), description.get("class", "")
    iri = _number(description, "iri") if "iri" in description else None
    if not isinstance(road_class, str) or (not road_class and iri is None):
        raise InputError("road iso8608: its class is missing, or its iri")
    factor = _number({"factor": 1.0, **description}, "factor")
    speed, width, length = (_number(description, name) for name in ("speed", "track_width", "length"))
    road = Iso8608(road_class, seed, speed, width, length, factor, iri)
    follows = {"lowest": LOWEST, "highest": HIGHEST, "roughness": road.roughness * factor**2}
    for name, value in follows.items():
        if not math.isclose(_number(description, name), value, rel_tol=SAME):
            raise InputError(f"road iso8608: {name} was {description[name]:g}, and is {value:g} here: it is another road")
    return road


def _number(description: Mapping[str, Any], name: str) -> float:
    value = description.get(name)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= 1e300:
        raise InputError(f"road {quoted(description['type'])}: its {name} is no finite number")
    return float(value)


def _numbers(description: Mapping[str, Any], name: str) -> tuple[float, ...]:
    values = description.get(name)
    if not isinstance(values, list) or not 0 < len(values) <= MOST_LINES:
        raise InputError(f"road {description['type']}: its {name} are missing, or more than {MOST_LINES}")
    return tuple(_number({"type": description["type"], name: value}, name) for value in values)


def _side(description: Mapping[str, Any]) -> str:
    side = description.get("track")
    if side not in SIDES:
        raise InputError(f"road {description['type']}: track is not one of {listing(SIDES)}")
    return side
