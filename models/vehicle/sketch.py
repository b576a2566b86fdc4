"""Sketch of a vehicle file: a drawing, and text about the vehicle type, parameters, limits and computer."""

import re
from collections.abc import Iterator

from models.common.errors import list_names
from models.document.sketch import Sketch, Strut, View
from models.kinds.kind import Parameters, Wheel
from models.kinds.signals import TYRE_DEFLECTION
from models.parts.element import element_kinds
from models.vehicle.limits_and_implementation import Implementation
from models.vehicle.vehicle import Vehicle

AXLES = ("_front", "_rear")
# Suffixes of parameter names; parameters that differ only in these suffixes are drawn in the same row
PAIRS = (*AXLES, "_left", "_right")
FIRST_WORD = re.compile(r"[A-Za-z]_\w+|[a-z](?=,)")  # pattern of the symbol with which the description of a parameter begins


def vehicle_sketch(vehicle: Vehicle, computer: bool = True) -> Sketch:
    """Returns the sketch of a vehicle of any type, seen from the side and, if it has two tracks, from behind.

    A vehicle with all wheels in one cross-section is drawn only from behind. If a vehicle type does not use the usual names of
    parameters, the sketch shows the wheels and suspensions with the symbols k, c and m.

    Args:
        vehicle: vehicle to draw.
        computer: False to omit the sensors and the computer from the sketch.
    """
    kind, given = vehicle.kind, vehicle.parameters
    symbols = {one.name: word[0] for one in kind.parameters if (word := FIRST_WORD.match(one.meaning)) is not None}
    box = _box(vehicle.implementation) if computer else ()
    axles = {-wheel.behind(given): wheel for wheel in reversed(kind.wheels)}  # the first wheel of each axle represents the axle
    mass = next((symbols.setdefault(name, "m") for name in ("sprung_mass", "mass") if name in given), "")
    front, rear = (given.get(f"axle_distance{axle}", 0.0) for axle in AXLES)
    letters = [symbols.get(f"axle_distance{axle}", "") for axle in AXLES]
    spans = ((-front - rear, -front, letters[1]), (-front, 0.0, letters[0])) if front else ()
    struts = [_strut(vehicle, wheel, place, _axle(wheel), symbols) for place, wheel in sorted(axles.items())]
    body = [mass, *filter(None, [symbols.get("pitch_inertia")])]
    views = [View(tuple(struts), ", ".join(body), spans, computer=box, seat=_seat(given, given.get("seat_x", 0.0) - front))]
    across = {-wheel.lateral(given): wheel for wheel in kind.wheels if wheel.side and -wheel.behind(given) == min(axles)}
    if len(across) > 1:
        struts = [_strut(vehicle, wheel, place, wheel.side, symbols) for place, wheel in sorted(across.items())]
        body = [mass, *filter(None, [symbols.get("roll_inertia")])]
        bar = next((name for name in ("anti_roll_stiffness_rear", "anti_roll_stiffness") if given.get(name)), "")
        span = (min(across), max(across), symbols.get("track", ""))
        flat = len(axles) == 1
        seat = _seat(given, -given.get("seat_y", 0.0))
        behind = View(tuple(struts), ", ".join(body), (span,), symbols.get(bar, ""), box if flat else (), seat)
        views = [behind] if flat else [*views, behind]
    title = f"{kind.name.replace('_', ' ')}{', from the side and from behind' * (len(views) > 1)}"
    return Sketch(title, tuple(views), (*_parameters(vehicle, symbols), *_hardware(vehicle, computer)))


def _seat(given: Parameters, place: float) -> Strut | None:
    """Returns the seat at a longitudinal position in the view [m]; None if the vehicle has no seat."""
    parts = (("spring", "k_p"), ("damper", "c_p" if given.get("seat_damping") else ""))
    return Strut(place, "", tuple(part for part in parts if part[1]), "m_p") if "seat_mass" in given else None


def _axle(wheel: Wheel) -> str:
    return wheel.road_body.removeprefix("road").removesuffix(wheel.side).replace("_", " ").strip()


def _strut(vehicle: Vehicle, wheel: Wheel, place: float, name: str, symbols: dict[str, str]) -> Strut:
    """Returns the strut of a wheel and its suspension, and assigns symbols to parameters that have no symbol."""
    kind, ending = vehicle.kind, wheel.tyre_deflection.removeprefix(TYRE_DEFLECTION.name)
    one = next((one for one in kind.suspensions if one.ending == ending or one.deflection == wheel.tyre_deflection), None)
    # If there is no wheel, the suspension element itself touches the road
    stands = one is not None and one.deflection == wheel.tyre_deflection

    def symbol(letter: str, *names: str, ending: str = ending) -> str:
        parameter = next(filter(None, (kind.of_corner(name, ending) for name in names)), "")
        there = vehicle.parameters.get(parameter) or parameter in vehicle.curves
        return symbols.setdefault(parameter, letter) if there else ""

    tyre = [("spring", symbol("k", "tyre_stiffness", "stiffness") or "k"), ("damper", symbol("c", "tyre_damping"))]
    if one is None:
        return Strut(place, name, tuple(tyre[:1]))
    parts = [
        ("spring", symbol("k", one.stiffness, "stiffness", ending=one.ending)),
        ("damper", symbol("c", one.damping, "damping", ending=one.ending)),
        *(("box", element.name) for element in vehicle.elements if one.corner in element.corners),
        ("semi-active damper" if one.force in vehicle.dampers else "force", "u" if one.force else ""),
    ]
    return Strut(
        place,
        name,
        tuple(part for part in parts if part[1]),
        "" if stands else symbol("m", "unsprung_mass") or "m",
        () if stands else tuple(part for part in tyre if part[1]),
        vehicle.limits.stops_at(one.corner) is not None,
    )


def _box(how: Implementation) -> tuple[str, ...]:
    """Returns short lines of text about the computer that runs the controller."""
    period, late, noise = how.sample_period, how.delay, how.noise_text
    lines = [f"every {1e3 * period:g} ms"] if period is not None else []
    lines += [f"{1e3 * late * period:g} ms late" if period is not None else f"{late:g} steps late"] if late else []
    return ("computer", *lines, *([noise.replace(" and ", ", ")] if noise else [] if lines else ["ideal"]))


def _parameters(vehicle: Vehicle, symbols: dict[str, str]) -> Iterator[tuple[str, str, str]]:
    """Yields a row (symbol, meaning and value) for each parameter of the vehicle. A parameter that exists for both axles or for
    both sides has only one row.
    """
    known, groups = {one.name: one for one in vehicle.kind.parameters}, dict[str, dict[str, str]]()
    for name, value in vehicle.parameters.items():
        if value or known[name].usual != 0:
            axle = next((axle for axle in PAIRS if name.endswith(axle)), "")
            text = _number(value, known[name].unit) + " with a curve" * (name in vehicle.curves)
            groups.setdefault(name.removesuffix(axle), {})[axle] = text
    for stem, texts in groups.items():
        symbol = next((symbols[f"{stem}{axle}"] for axle in texts if f"{stem}{axle}" in symbols), "")
        alike = len({*texts.values()}) == 1
        value = (
            next(iter(texts.values())) if alike else ", ".join(f"{text}{axle.replace('_', ' ')}" for axle, text in texts.items())
        )
        yield symbol, stem.replace("_", " "), value


def _number(value: float, unit: str) -> str:
    return f"{value:g} {unit.replace('m2', 'm²').replace('m3', 'm³').replace(' ', '·').removesuffix('1')}".rstrip()


def _hardware(vehicle: Vehicle, computer: bool) -> Iterator[tuple[str, str, str]]:
    """Yields rows about force elements, semi-active dampers, limits (such as strokes), sensors and the computer."""
    kinds: dict[type, str] = {section: name.replace("_", " ") for name, section in element_kinds().items()}
    for one in vehicle.elements:
        given = {key.partition(".")[2].replace("_", " "): (value, si.unit) for key, (value, si) in one.numbers.items() if value}
        text = ", ".join((kinds.get(type(one.part), "element"), *(f"{key} {_number(*value)}" for key, value in given.items())))
        where = list_names(one.corners).replace("_", " ") if len(one.corners) < len(vehicle.kind.suspensions) else ""
        yield "", one.name.replace("_", " "), f"{text}, {where}".removesuffix(", ")
    if vehicle.dampers:
        yield "u", "force", "; ".join(dict.fromkeys(damper.words for damper in vehicle.dampers.values()))
    yield "", "strokes and limits", ", ".join(vehicle.limits.phrases(vehicle.kind.suspensions)) or "none"
    if computer:
        measured = dict.fromkeys(name.replace("_", " ") for entry in vehicle.controllers.values() for name in entry.measured)
        yield "y", "sensors", ", ".join(measured) or "none"
        ideal = "ideal: forces act at every step without delay, from exact signals"
        yield "", "computer", ", ".join(vehicle.implementation.phrases).replace("_", " ") or ideal
