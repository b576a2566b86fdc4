"""`[payload]` of a vehicle file: point masses on the body, including their inertia.

The unladen body has the mass M and the moments of inertia I_pitch and I_roll about its centre of mass. A point mass m at (x, z)
relative to the body's centre of mass (ISO 8855: x forward, z up) changes the moments of inertia to

    M' = M + m,    I_pitch' = I_pitch + mu (x^2 + z^2),    I_roll' = I_roll + mu z^2,    mu = M m / (M + m),

where the moments of inertia I_pitch' and I_roll' are about the centre of mass of body and payload, at m / (M + m) (x, z).
Because the springs are linear, the laden car has the same equations of motion as the unladen car, with the changed parameters.
The equations describe the motion of the laden car about its equilibrium, in which the weight of the payload compresses the
suspensions. The table of a motion ratio that depends on travel is shifted to the laden equilibrium.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar

import numpy as np

from models.characteristics import SIDES
from models.characteristics.curve import ForceCurve
from models.characteristics.surface import ForceSurface
from models.common.errors import InputError, error_in
from models.common.schema import SI, Section, read
from models.kinds.kind import GRAVITY, VehicleKind
from models.kinds.linear_model import LinearModel
from models.kinds.signals import HEAVE_LOAD, PITCH_LOAD, ROLL_LOAD
from models.parts.stops.section import StopPair, StopSection
from models.parts.stops.stop import Stop
from models.vehicle.limits_and_implementation import Limits

PLACE = ("x", "z")
TURNS = (PITCH_LOAD.name, ROLL_LOAD.name)


@dataclass(frozen=True)
class PayloadSection(Section):
    """Section that describes a point mass on the body."""

    hints: ClassVar[Mapping[str, str]] = {
        "y": "is not allowed, as the mass must be on the centre line; use --load payload:y=... for a weight there"
    }

    mass: Annotated[float, SI("kg", "point mass on the body", high=1e5)]
    x: Annotated[float, SI("m", "position of the point mass, forward of the unladen body's centre of mass", -20.0, 20.0)] = 0.0
    z: Annotated[float, SI("m", "height of the point mass above the unladen body's centre of mass", -20.0, 20.0)] = 0.0


def apply_payload(
    section: Mapping[str, Any], kind: VehicleKind, parameters: dict[str, float], limits: Limits, curves: Mapping[str, ForceCurve]
) -> tuple[dict[str, float], Limits, VehicleKind]:
    """Reads `[payload]` and returns parameters, limits and type of the vehicle with the point masses.

    The section describes one point mass, or contains a section for each of several point masses. The payload changes mass,
    inertia and centre of mass of the body. The payload also compresses the springs, which shortens the bump strokes and
    lengthens the rebound strokes.

    Args:
        section: the section `[payload]`.
        kind: vehicle type.
        parameters: parameters of the unladen vehicle [SI], by name.
        limits: limits of the unladen vehicle.
        curves: characteristics, by the parameter that each characteristic replaces.

    Raises:
        InputError: a key or value is not allowed, or the vehicle cannot carry the payload.
    """
    several = any(isinstance(one, Mapping) for one in section.values())
    if several and (own := [key for key, one in section.items() if not isinstance(one, Mapping)]):
        raise InputError(
            f"[payload] contains both {own[0]} and sections for other masses; move {own[0]} into a section "
            "[payload.NAME] of its own"
        )
    named = {f"[payload.{name}]": one for name, one in section.items()} if several else {"[payload]": section}
    model, load = kind.full_model(parameters), dict.fromkeys((HEAVE_LOAD.name, PITCH_LOAD.name), 0.0)
    heavier, laden_kind = dict(parameters), kind
    shift: dict[str, float] = dict.fromkeys(PLACE, 0.0)
    if "sprung_mass" not in parameters or HEAVE_LOAD.name not in model.loads:
        raise InputError("[payload]: this vehicle has no sprung_mass that moves vertically; omit the section")
    about_rest = [part.stiffness for part in kind.suspensions if part.stiffness in curves]
    about_rest += [part.damping for part in kind.suspensions if isinstance(curves.get(part.damping), ForceSurface)]
    if about_rest:
        raise InputError(
            f"[payload] changes the ride height, from which the curve {about_rest[0]} starts, so the curve is wrong for the "
            "laden car; omit [payload], and give the curve, mass and inertias of the laden car"
        )
    for where, given in named.items():
        payload = read(where, PayloadSection, given)
        for key, turns, words in (("x", TURNS[:1], "does not pitch"), ("z", TURNS, "does not turn")):
            if getattr(payload, key) and not {*turns} & {*model.loads}:
                raise InputError(f"{where} {key} has no effect, because this vehicle {words}; omit {key}")
        mass, x, z = payload.mass, payload.x - shift["x"], payload.z - shift["z"]
        whole = heavier["sprung_mass"] + mass
        reduced = heavier["sprung_mass"] * mass / whole
        heavier["sprung_mass"] = whole
        for name, arm in (("pitch_inertia", x * x + z * z), ("roll_inertia", z * z)):
            if name in heavier:
                heavier[name] += reduced * arm
        for axis, part in (("x", x), ("z", z)):
            shift[axis] += mass / whole * part
        load[HEAVE_LOAD.name] -= mass * GRAVITY
        load[PITCH_LOAD.name] += mass * GRAVITY * payload.x
    forward = {"axle_distance_front": -shift["x"], "axle_distance_rear": shift["x"], "seat_x": -shift["x"]}
    for name, moved in {**forward, "centre_height": shift["z"]}.items():
        if name in heavier:
            heavier[name] += moved
    turning = [part for part in kind.suspensions if part.ratio in kind.ratios]
    before, after = (kind.static_loads(one) if turning else {} for one in (parameters, heavier))
    # Compression [m] of the springs whose motion ratio varies with travel; the keys are the deflections
    sunk = dict[str, float]()
    for part in turning:
        table, name = kind.ratios[part.ratio], part.deflection
        rest = table.rest_at_load(parameters.get(part.stiffness, 0.0), before[name], after[name])
        sunk[name] = float(table.travel(np.array(rest)))
        with error_in(f"[payload] {part.ratio}:"):
            laden_kind = replace(laden_kind, ratios={**laden_kind.ratios, part.ratio: table.shifted_to(rest)})
        heavier[part.ratio] = laden_kind.ratios[part.ratio].at_rest
    with error_in("[payload]: with this payload,"):
        checked = laden_kind.check(heavier)
    return checked, _limits_at_laden_rest(kind, model, load, limits, parameters, sunk), laden_kind


def _limits_at_laden_rest(
    kind: VehicleKind,
    model: LinearModel,
    load: Mapping[str, float],
    limits: Limits,
    parameters: Mapping[str, float],
    known: Mapping[str, float],
) -> Limits:
    """Returns the limits with strokes relative to the laden equilibrium.

    Args:
        kind: vehicle type.
        model: linear model of the unladen vehicle.
        load: loads of the payload [N, N m], by name.
        limits: limits of the unladen vehicle.
        parameters: parameters of the vehicle [SI], by name.
        known: deflections of springs that are already known [m], by name; all other deflections are computed from the linear
            model.
    """
    stops = limits.stops(kind.suspensions)
    if not stops:
        return limits
    rest = np.linalg.solve(model.A, -model.Bl @ np.array([load.get(name, 0.0) for name in model.loads]))
    common, places = limits, dict(limits.places)
    for part in kind.suspensions:
        if part.deflection not in stops:
            continue
        pair = dict[str, Stop](zip(SIDES, stops[part.deflection], strict=True))
        stretched = part.motion_ratio(parameters) * float(model.rows([part.deflection])[0][0] @ rest)
        stretched = known.get(part.deflection, stretched)
        left = {"bump": pair["bump"].stroke + stretched, "rebound": pair["rebound"].stroke - stretched}
        if short := next((side for side in SIDES if left[side] <= 0), ""):
            raise InputError(
                f"[payload] moves {part.deflection} by {stretched:.3g} m, beyond the {short} stroke of "
                f"{pair[short].stroke:g} m; give a smaller mass, or a different position of the payload"
            )
        some = [side for side in SIDES if math.isfinite(pair[side].stroke)]
        strokes = StopPair(*(left[side] if side in some else None for side in SIDES))
        stiffness = StopPair(*(pair[side].stiffness if side in some else None for side in SIDES))
        if part.corner:
            places[part.corner] = StopSection(strokes, stiffness)
        else:
            common = replace(common, suspension_stroke=strokes, stop_stiffness=stiffness)
    return replace(common, places=tuple(places.items()))
