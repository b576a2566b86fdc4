"""JSON schema of vehicle files. With the JSON schema, an editor can complete keys, show their meanings and mark mistakes."""

from collections.abc import Iterable
from typing import Any

from models.characteristics.adjustable_range import ActuatorSection
from models.characteristics.curve_reading import DamperTable, SpringTable, SurfaceTable
from models.characteristics.ratio_table import RatioSection
from models.common.schema import NUMBER, Section, described_key, json_schema
from models.kinds.seat import Seat
from models.kinds.seated_kind import seated_kind
from models.laws.filter import FilterSection
from models.parts.element import PartSite, element_kinds
from models.parts.stops.section import StopSection
from models.parts.stops.stop import places_of
from models.vehicle.controller_section import ControllerSection
from models.vehicle.limits_and_implementation import ImplementationSection, LimitsSection
from models.vehicle.payload import PayloadSection
from models.vehicle.performance import ROAD, WEIGHT
from models.vehicle.vehicle import LIFTED, PLANES, VehicleFile, kind
from models.vehicle.weights import WeightSection

TABLE = {"type": "object"}
WEIGHTED_SIGNAL = {"anyOf": [WEIGHT.json, json_schema(WeightSection)]}


def file_schema(name: str) -> dict[str, Any]:
    """Returns the JSON schema of vehicle files of a built-in type (json-schema.org, draft 2020-12).

    Args:
        name: name of the vehicle type, such as "quarter_car".
    """
    plain, known = kind(name), seated_kind(kind(name))
    parameters = {one.name: described_key(one.number.json, one.meaning, one.unit) for one in plain.parameters}
    seat = json_schema(Seat)
    own = {one.name.removeprefix("seat_") for one in known.parameters[len(plain.parameters) :]}
    seat["properties"] = {key: one for key, one in seat["properties"].items() if key in own}
    corners = [part.corner for part in known.suspensions]
    payload, implementation = json_schema(PayloadSection), json_schema(ImplementationSection)
    of_road = {name for wheel in known.wheels for name in (wheel.road_displacement, wheel.road_velocity)}
    signals = [name for name in known.possible if name not in of_road]
    for key in ("noise", "quantisation"):
        one = implementation["properties"][key]
        one |= {"properties": dict.fromkeys(signals, one["additionalProperties"]), "additionalProperties": False}
    controller = json_schema(ControllerSection)
    controller["properties"]["measured"] |= {"items": {"anyOf": [{"enum": signals}, {"type": "string"}]}}
    weights = {one.name: described_key(WEIGHTED_SIGNAL, one.meaning, one.unit) for one in known.possible.values()}
    tables = {"damping": (DamperTable, SurfaceTable), "stiffness": (SpringTable,), "ratio": (RatioSection,)}
    curves = {
        getattr(part, of): {"anyOf": [*schemas, {"type": "array", "items": {"anyOf": [*schemas, NUMBER]}}]}
        for part in known.suspensions
        for of, sections in tables.items()
        if getattr(part, of) and (schemas := [json_schema(one) for one in sections])
    }
    needed = [one.name for one in plain.parameters if one.usual is None and not one.optional and one.name not in curves]
    lifted = described_key(NUMBER, "height by which the whole vehicle is lifted above the road at the start of a run", "m")
    states = {
        each: described_key(NUMBER, f"{one.meaning}, at the start of a run", one.unit) for each, one in known.possible.items()
    }
    sections = {
        "parameters": TABLE | {"properties": parameters, "required": needed, "additionalProperties": False},
        "performance": TABLE
        | {"properties": weights | {ROAD: json_schema(FilterSection)}, "additionalProperties": WEIGHTED_SIGNAL},
        "limits": _with_places(LimitsSection, StopSection, places_of(corners)),
        "implementation": implementation,
        "seat": seat,
        "start": TABLE | {"properties": states | {LIFTED: lifted}, "additionalProperties": NUMBER},
        "payload": TABLE | {"anyOf": [payload, {"additionalProperties": payload}]},
        "actuators": _with_places(ActuatorSection, ActuatorSection, filter(None, corners)),
        "curves": TABLE | {"properties": curves, "additionalProperties": False},
        "controllers": TABLE | {"additionalProperties": controller},
        "parts": TABLE | {"additionalProperties": {"anyOf": [_element(name, one) for name, one in element_kinds().items()]}},
    }
    file = json_schema(VehicleFile)
    given, plane = next(((of, key) for of, planes in PLANES.items() for key, one in planes.items() if one == name), (name, ""))
    file["properties"] |= {"type": {"const": given}, "plane": {**file["properties"]["plane"], "const": plane}, **sections}
    file["required"] += ["plane"] * (given != name)
    if not plane:
        del file["properties"]["plane"]
    title = f"Roadproof vehicle file of type {name}"
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": title, **file}


def _element(name: str, section: type[Section]) -> dict[str, Any]:
    """Returns the JSON schema of a section of `[parts]` for one kind of force element."""
    whole, own = json_schema(PartSite), json_schema(section)
    at = {"anyOf": [whole["properties"]["at"], {"type": "string"}]}
    properties = whole["properties"] | {"kind": {"const": name}, "at": at} | own["properties"]
    return own | {"properties": properties, "required": ["kind", *own.get("required", [])]}


def _with_places(common: type[Section], own: type[Section], places: Iterable[str]) -> dict[str, Any]:
    """Returns the JSON schema of a section that may contain sections for single suspensions or axles."""
    whole, part = json_schema(common), json_schema(own)
    return whole | {"properties": whole["properties"] | dict.fromkeys(places, part | {"required": []}), "required": []}
