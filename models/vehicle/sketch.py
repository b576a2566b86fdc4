"""A vehicle file as a sketch: what its kind, its parameters, its limits and its computer are, drawn and in words."""

import re
from collections.abc import Sequence

from models.figures.sketch import Sketch, Strut, View
from models.kinds.kind import VehicleKind, Wheel
from models.kinds.signals import TYRE_DEFLECTION
from models.vehicle.limits_and_implementation import Implementation
from models.vehicle.vehicle import Vehicle

AXLES = ("_front", "_rear")
FIRST_WORD = re.compile(r"[A-Za-z]_\w+|[a-z](?=,)")  # of a parameter's meaning, if that is a symbol


def vehicle_sketch(vehicle: Vehicle, computer: bool = True) -> Sketch:
    """Returns the sketch of a vehicle of any kind: from the side and, if it has two tracks, from behind.

    Kinds without the usual names of parameters are drawn by their wheels and suspensions, with the symbols k, c and m.

    Args:
        vehicle: the vehicle.
        computer: False leaves out sensors and computer.
    """
    kind = vehicle.kind
    symbols = {one.name: word[0] for one in kind.parameters if (word := FIRST_WORD.match(one.meaning)) is not None}
    axles = {wheel.behind(vehicle.parameters): wheel for wheel in reversed(kind.wheels)}  # the first wheel of each
    places = sorted(axles, reverse=True)
    box = _box(vehicle.implementation) if computer else ()
    side = View(
        tuple(_strut(vehicle, axles[place], -place, _axle(axles[place]), symbols) for place in places),
        _body(vehicle, symbols, "pitch_inertia"),
        spans=_spans(vehicle, symbols),
        computer=box,
    )
    views = [side]
    across = [wheel for wheel in kind.wheels if wheel.side and wheel.behind(vehicle.parameters) == places[0]]
    if len(across) > 1:
        right = {wheel: -wheel.lateral(vehicle.parameters) for wheel in sorted(across, key=lambda one: one.side)}
        views.append(
            View(
                tuple(_strut(vehicle, wheel, place, wheel.side, symbols) for wheel, place in right.items()),
                _body(vehicle, symbols, "roll_inertia"),
                spans=((min(right.values()), max(right.values()), symbols.get("track", "")),),
                bar=symbols.get("anti_roll_stiffness_rear", "") * bool(vehicle.parameters.get("anti_roll_stiffness_rear")),
            )
        )
    title = f"{kind.name.replace('_', ' ')}{', from the side and from behind' if len(views) > 1 else ''}"
    return Sketch(title, tuple(views), (*_parameters(vehicle, symbols), *_hardware(vehicle, computer)))


def _axle(wheel: Wheel) -> str:
    return wheel.road_body.removeprefix("road").removeprefix("_").removesuffix(wheel.side).replace("_", " ").strip()


def _body(vehicle: Vehicle, symbols: dict[str, str], inertia: str) -> str:
    masses = [name for name in ("sprung_mass", "mass") if name in vehicle.parameters]
    return ", ".join([*(symbols.setdefault(name, "m") for name in masses), *filter(None, [symbols.get(inertia)])])


def _strut(vehicle: Vehicle, wheel: Wheel, place: float, name: str, symbols: dict[str, str]) -> Strut:
    """Returns a wheel and its suspension; gives symbols to parameters that have none."""
    kind: VehicleKind = vehicle.kind
    ending = wheel.tyre_deflection.removeprefix(TYRE_DEFLECTION.name)
    found = [one for one in kind.suspensions if one.ending == ending or one.deflection == wheel.tyre_deflection]
    stands = any(one.deflection == wheel.tyre_deflection for one in found)  # the suspension itself is on the road

    def symbol(parameter: str, letter: str) -> str:
        there = vehicle.parameters.get(parameter) or parameter in vehicle.curves
        return symbols.setdefault(parameter, letter) if there else ""

    corner = found[0].ending if found else ending
    tyre = kind.of_corner("tyre_stiffness", ending) or kind.of_corner("stiffness", ending)
    one = found[0] if found else None
    return Strut(
        place,
        name,
        spring=symbol(one.stiffness or kind.of_corner("stiffness", corner), "k") if one else "",
        damper=symbol(one.damping or kind.of_corner("damping", corner), "c") if one else "",
        force="u" if one and one.force else "",
        adjustable=one is not None and one.force in vehicle.dampers,
        stopped=one is not None and vehicle.limits.stops_at(one.corner) is not None,
        mass=(symbol(kind.of_corner("unsprung_mass", ending), "m") or "m") if one and not stands else "",
        tyre="" if stands else symbol(tyre, "k") or "k",
        tyre_damper=symbol(kind.of_corner("tyre_damping", ending), "c"),
    )


def _spans(vehicle: Vehicle, symbols: dict[str, str]) -> tuple[tuple[float, float, str], ...]:
    """Returns the distances of the centre of mass from the axles."""
    front, rear = (vehicle.parameters.get(f"axle_distance{axle}") for axle in AXLES)
    if front is None or rear is None:
        return ()
    letters = [symbols.get(f"axle_distance{axle}", "") for axle in AXLES]
    return ((-front - rear, -front, letters[1]), (-front, 0.0, letters[0]))


def _box(how: Implementation) -> tuple[str, ...]:
    """Returns the computer in a few letters."""
    period, late = how.sample_period, how.delay
    lines = [f"every {1e3 * period:g} ms"] if period is not None else []
    if late:
        lines.append(f"{1e3 * late * period:g} ms late" if period is not None else f"{late:g} samples late")
    lines += [how.noise_text] if how.noise_text and " " not in how.noise_text else ["noise, steps"] * bool(how.noise_text)
    return ("computer", *(lines or ["ideal"]))


def _parameters(vehicle: Vehicle, symbols: dict[str, str]) -> list[tuple[str, str, str]]:
    """Returns a row for each parameter, of both axles together."""
    known, groups = {one.name: one for one in vehicle.kind.parameters}, dict[str, dict[str, str]]()
    for name, value in vehicle.parameters.items():
        if value or known[name].usual != 0:
            axle = next((axle for axle in AXLES if name.endswith(axle)), "")
            unit = known[name].unit.replace("m2", "m²").replace(" ", "·").removesuffix("1")
            text = f"{value:g} {unit}".rstrip() + " with a curve" * (name in vehicle.curves)
            groups.setdefault(name.removesuffix(axle), {})[axle.replace("_", " ")] = text
    rows = []
    for stem, texts in groups.items():
        symbol = next((symbols[name] for name in (stem, f"{stem}{AXLES[0]}", f"{stem}{AXLES[1]}") if name in symbols), "")
        alike = len({*texts.values()}) == 1
        value = next(iter(texts.values())) if alike else ", ".join(f"{text}{axle}" for axle, text in texts.items())
        rows.append((symbol, stem.replace("_", " "), value))
    return rows


def _hardware(vehicle: Vehicle, computer: bool) -> list[tuple[str, str, str]]:
    """Returns rows on strokes and other limits, adjustable dampers, sensors and the computer."""
    dampers = dict.fromkeys(damper.words for damper in vehicle.dampers.values())
    rows = [("u", "force", "; ".join(dampers))] if dampers else []
    rows.append(("", "strokes and limits", _listed(vehicle.limits.phrases(vehicle.kind.suspensions)) or "none"))
    if computer:
        measured = dict.fromkeys(name for entry in vehicle.controllers.values() for name in entry.measured)
        rows.append(("y", "sensors", _listed([name.replace("_", " ") for name in measured]) or "none"))
        ideal = "ideal: a force at every step at once, from exact signals"
        rows.append(("", "computer", _listed([one.replace("_", " ") for one in vehicle.implementation.phrases]) or ideal))
    return rows


def _listed(words: Sequence[str]) -> str:
    return ", ".join(words)
