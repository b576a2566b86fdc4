"""`[curves]` of a vehicle file: characteristics of springs and dampers, and motion ratios as a function of travel.

Each entry of `[curves]` has the name of the parameter that it replaces.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from models.characteristics import SIDES
from models.characteristics.curve import ForceCurve
from models.characteristics.ratio_table import RatioTable
from models.common.errors import InputError, error_in
from models.common.extensions import FEATURES
from models.kinds.kind import VehicleKind, nothing

ROUNDING = 1e-9  # a force difference below this share of the load counts as a rounding error
# There is a warning if a spring's force in equilibrium differs from the static load by more than this share of the load.
STATIC_LOAD_TOLERANCE = 0.01


def curves_and_parameters(
    section: Mapping[str, Any], parameters: Mapping[str, Any], kind: VehicleKind
) -> tuple[dict[str, ForceCurve], dict[str, Any], VehicleKind]:
    """Reads `[curves]`.

    Args:
        section: the section `[curves]`.
        parameters: the section `[parameters]`.
        kind: vehicle type.

    Returns:
        The characteristics, the parameters with the values of the characteristics at equilibrium, and the vehicle type with
        motion ratios.

    Raises:
        InputError: a table is not allowed, or a parameter is in both `[curves]` and `[parameters]`.
    """
    over, ratios = FEATURES.load("lines of parts").curvable(kind.suspensions), _ratios(section, kind)
    at_rest = {name: table.at_rest for name, table in ratios.items()}
    entries = {name: entry for name, entry in section.items() if name not in ratios}
    # These entries have arbitrary values, because the static loads do not depend on them
    anything = {name: 1.0 for name in entries if name in over} | at_rest
    with_any, own = {**parameters, **anything}, kind
    curves = FEATURES.load("curves in files").read_curves(
        entries, over, lambda name: static_loads(own, own.check_each(with_any)).get(name)
    )
    kind = replace(kind, ratios=ratios) if ratios else kind
    slopes = {name: curve.slope for name, curve in curves.items()} | at_rest
    if twice := [name for name in slopes if name in parameters]:
        raise InputError(f"{twice[0]} is in both [parameters] and [curves]; omit {twice[0]} in [parameters]")
    return curves, {**parameters, **slopes}, kind


def _ratios(section: Mapping[str, Any], kind: VehicleKind) -> dict[str, RatioTable]:
    """Returns the motion ratios that `[curves]` gives as a function of travel, by the name of the parameter."""
    names = {part.ratio for part in kind.suspensions} & {*section}
    if not names:
        return {}
    ratio_table = FEATURES.load("motion ratios over travel").ratio_table
    if kind.static_loads is nothing:
        raise InputError(
            f"[curves] {min(names)}: a motion ratio that is a curve needs the static loads, but this vehicle type has "
            "no function static_loads; add this function to the vehicle type"
        )
    for part in kind.suspensions:
        if part.ratio in names and not part.damping:
            raise InputError(
                f"[curves] {part.ratio}: a motion ratio that is a curve needs a damping parameter, but the suspension "
                f"of {part.deflection} has none; in the vehicle type, give `damping` in this Suspension"
            )
    ratios = {}
    for parameter in kind.parameters:
        if parameter.name in names:
            where = f"[curves] {parameter.name}"
            ratios[parameter.name] = ratio_table(where, section[parameter.name], parameter.check)
    return ratios


def static_loads(kind: VehicleKind, parameters: Mapping[str, float]) -> dict[str, float]:
    """Returns the static load of each spring [N], by the name of its stiffness parameter; empty if the loads are unknown."""
    loads = kind.static_loads(parameters)
    springs = {part.stiffness: part for part in kind.suspensions if part.stiffness and part.deflection in loads}
    return {name: loads[part.deflection] / part.motion_ratio(parameters) for name, part in springs.items()}


def rebalanced_curves(
    kind: VehicleKind, curves: Mapping[str, ForceCurve], before: Mapping[str, float], parameters: dict[str, float]
) -> dict[str, ForceCurve]:
    """Returns the characteristics of a vehicle whose parameters have changed, and updates the stiffnesses of shifted springs.

    If the table of a spring carries the static load, as with `preload = true`, the equilibrium moves along the table to the new
    static load. A motion ratio that depends on travel remains a function of the travel from equilibrium, as in a vehicle file
    with the new parameters.

    Args:
        kind: vehicle type.
        curves: characteristics before the change.
        before: parameters before the change [SI], by name.
        parameters: parameters after the change [SI], by name. The function also writes the stiffnesses of shifted springs into
            `parameters`.
    """
    settled = dict(curves)
    if not any(curve.at_rest for curve in curves.values()):
        return settled
    loads, now = static_loads(kind, before), static_loads(kind, parameters)
    for name, curve in curves.items():
        if name in loads and now[name] != loads[name] and abs(curve.at_rest + loads[name]) <= ROUNDING * loads[name]:
            with error_in(f"[curves] {name}:"):
                settled[name] = curve.scaled(parameters[name] / curve.slope).about_load(now[name] - loads[name])
            parameters[name] = settled[name].slope
    return settled


def curve_notes(curves: Mapping[str, ForceCurve], kind: VehicleKind, parameters: Mapping[str, float]) -> list[str]:
    """Returns notes about characteristics: how their tables were processed, and which springs do not carry the static load."""
    slope_words = FEATURES.load("measured loops").slope_words
    loads = static_loads(kind, parameters) if any(curve.at_rest for curve in curves.values()) else {}
    notes = []
    for name, curve in curves.items():
        carried, load = -curve.at_rest, loads.get(name)
        notes += [f"{name}: {curve.note}{slope_words(curve)}"] if curve.note else []
        if carried and load is not None and abs(carried - load) > STATIC_LOAD_TOLERANCE * load:
            notes.append(
                f"{name}: the table's force at rest is {round(carried, 1):g} N, but the static load is {round(load, 1):g} N, a "
                f"difference of {round(load - carried, 1):+g} N; with preload = true, the equilibrium is where the table "
                "carries the static load"
            )
    return notes


def ratio_doubts(kind: VehicleKind, strokes: Mapping[str, Mapping[str, float]]) -> list[str]:
    """Returns warnings about bump stops that begin beyond the end of a motion-ratio table, where the ratio is constant."""
    doubts = dict[str, None]()
    for part in kind.suspensions:
        if (table := kind.ratios.get(part.ratio)) is None:
            continue
        for side, stroke in strokes.get(part.deflection, {}).items():
            sign = -1.0 if side == SIDES[0] else 1.0
            end = float(max(sign * table.x))
            if stroke > end:
                begins = f"the {side} stop begins at {sign * round(stroke, 4):g} m at the wheel"
                said = f"{part.ratio}: its table ends at {sign * end:g} m, but {begins}; the ratio is constant beyond the table"
                doubts[f"{said}, so extend the table to the stop"] = None
    return list(doubts)
