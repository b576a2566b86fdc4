"""Sections of a vehicle file: `[performance]`, and rare ones, whose readers are loaded only if the file has them."""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from models.characteristics import SIDES
from models.common.checks import is_finite
from models.common.errors import InputError, error_in, list_names, short_repr
from models.common.extensions import FEATURES
from models.common.schema import HERE, SI, ReadBy, read
from models.kinds.kind import GRAVITY, VehicleKind, is_number, nothing
from models.kinds.plausibility import KnownQuantity
from models.laws.filter import Filter, FilterSection

if TYPE_CHECKING:
    from models.characteristics.curve import ForceCurve
    from models.characteristics.ratio_table import RatioTable
    from models.kinds.kind import Suspension


PUSHING_ACTUATORS = "force"  # value of `actuators` in a controller's section
ROAD = "road"  # the filter from the disturbance w to the road's velocity
SMALLEST_WEIGHT, LARGEST_WEIGHT = 1e-12, 1e12  # relative to one another; beyond these rounding decides
ROUNDING = 1e-9  # of a load
STATIC_LOAD_TOLERANCE = 0.01  # of the static load: a larger difference from the force that a spring carries at rest is remarked


@dataclass(frozen=True)
class WeightedSum:
    """Row of z: a weight times a sum of signals, through a filter.

    Attributes:
        name: name of the sum, or of its only signal.
        weight: weight of the sum, above 0.
        terms: factor of each signal.
        filter: filter from the weighted sum to z; None for no filter.
    """

    public_name = "a weighted sum, such as one of vehicle.sums"

    name: str
    weight: float
    terms: Mapping[str, float]
    filter: Filter | None = None

    @property
    def text(self) -> str:
        """The sum in words."""
        return " + ".join(f"{factor:g} {signal}" for signal, factor in self.terms.items()).replace("+ -", "- ")


class Weight(SI):
    """0, or a number in the range of weights."""

    def number(self, what: str, value: Any) -> float:
        """Returns the weight; `what` names it in the message."""
        least = 0.0 if is_finite(value) and value == 0 else SMALLEST_WEIGHT
        more = ', or 0, or a weight with a filter, as in { weight = 1.0, filter = "iso2631_wk" }'
        return SI(self.unit, "", least, self.high, more).number(what, value)


FACTORS = "factors of the signals in a weighted sum"
WEIGHT = Weight("", "weight in the performance output, per SI unit of the signal", 0.0, LARGEST_WEIGHT)


def _terms(value: Any, context: Mapping[str, Any]) -> dict[str, float]:
    """Returns the factors of signals in a sum. The context has `outputs`, the names of the signals."""
    outputs = context["outputs"]
    if not isinstance(value, Mapping) or not value or not all(is_number(one) and one for one in value.values()):
        raise InputError(
            f"{HERE} = {short_repr(value)} is not allowed; give signals with factors other than 0, as in sum = "
            f"{{ {outputs[0]} = 1.0, {outputs[1]} = -1.0 }}"
        )
    if unknown := [signal for signal in value if signal not in outputs]:
        raise InputError(f"{HERE} has the unknown signal {unknown[0]!r}; the signals are {list_names(outputs)}")
    return {signal: float(one) for signal, one in value.items()}


@dataclass(frozen=True)
class WeightSection(FilterSection):
    """A signal or a sum of signals in `[performance]`. A number is its weight."""

    integrates: ClassVar[bool] = True

    weight: Annotated[float, WEIGHT] = 1.0
    sum: Annotated[Mapping[str, float], ReadBy(FACTORS, _terms, allowed={"type": "object"})] | None = None

    @cached_property
    def shape(self) -> Filter | None:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The filter; None for a sum of constant weight."""
        unshaped = self.filter is self.numerator is self.denominator is None
        return None if unshaped and self.sum is not None else super().shape


def read_performance(section: Mapping[str, Any], outputs: Sequence[str]) -> dict[str, Any]:
    """Returns the attributes `performance`, `filters`, `sums` and `road_filter` of a `Vehicle`, from `[performance]`.

    Args:
        outputs: the signals that can be weighted.

    Raises:
        InputError: a signal is unknown, a weight or filter is not allowed, or no weight is above 0.
    """
    weights, filters, sums, road_filter = dict[str, float](), dict[str, Filter](), list[WeightedSum](), None
    for name, given in section.items():
        where = f"[performance] {name}"
        if name == ROAD:
            road_filter = read(where, FilterSection, given).shape
            continue
        if not isinstance(given, Mapping):
            weights[name] = WEIGHT.number(where, given)
            continue
        one = read(where, WeightSection, given, outputs=outputs)
        if one.sum is None:
            weights[name] = one.weight
            filters |= {name: one.shape} if one.shape is not None and one.weight else {}
        elif name in outputs:
            raise InputError(f"{where} is the name of a signal; give the sum another name")
        elif one.weight:
            sums.append(WeightedSum(name, one.weight, one.sum, one.shape))
    check_weights(weights, sums, outputs)
    return {"performance": weights, "filters": filters, "sums": tuple(sums), "road_filter": road_filter}


def check_weights(weights: Mapping[str, float], sums: Sequence[WeightedSum], outputs: Sequence[str]) -> None:
    """Raises an InputError if a weighted signal is unknown, or no weight is above 0."""
    for name in weights:
        if name not in outputs:
            raise InputError(
                f"[performance] unknown signal {name!r}; give one of {list_names(outputs)}, or {ROAD!r} for a filter of the "
                "road, or a new name for a sum of signals"
            )
    if not any(weights.values()) and not sums:
        raise InputError(f"[performance] has no weight above 0; give a weight to at least one of {list_names(outputs)}")


def resolved_text(text: str, folder: Path) -> tuple[str, tuple[Path, ...]]:
    """Returns a vehicle file's text with the contents of other files instead of their names, and those files.

    Raises:
        InputError: the text is not TOML, or one of these files is missing or wrong.
    """
    if not re.search(r"\bfamily\b|\b(file|stop)\b[\"']?\s*[=\]]", text):
        return text, ()

    return FEATURES.load("files named in vehicle files").with_contents(text, folder)


def curves_and_parameters(
    section: Mapping[str, Any], parameters: Mapping[str, Any], kind: VehicleKind
) -> tuple[dict[str, "ForceCurve"], dict[str, float], VehicleKind]:
    """Reads `[curves]`, and `[parameters]` with the curves' values at rest. Returns the kind with motion ratios over travel."""
    curves = dict[str, "ForceCurve"]()
    if section:
        over, ratios = FEATURES.load("lines of parts").curvable(kind.suspensions), _ratios(section, kind)
        at_rest = {name: table.at_rest for name, table in ratios.items()}
        entries = {name: entry for name, entry in section.items() if name not in ratios}
        anything = {name: 1.0 for name in entries if name in over} | at_rest  # the loads do not depend on it
        with_any, own = {**parameters, **anything}, kind
        curves = FEATURES.load("curves in files").read_curves(
            entries, over, lambda name: static_loads(own, own.check_each(with_any)).get(name)
        )
        kind = replace(kind, ratios=ratios) if ratios else kind
        slopes = {name: curve.slope for name, curve in curves.items()} | at_rest
        if twice := [name for name in slopes if name in parameters]:
            raise InputError(f"{twice[0]} is in both [parameters] and [curves]; omit {twice[0]} in [parameters]")
        parameters = {**parameters, **slopes}
    with error_in("[parameters]"):
        checked = kind.check_each(parameters)
    return curves, kind.check(checked), kind


def _ratios(section: Mapping[str, Any], kind: VehicleKind) -> "dict[str, RatioTable]":
    """Returns the motion ratios over travel of `[curves]`, by parameter."""
    names = {part.ratio for part in kind.suspensions} & {*section}
    if not names:
        return {}
    ratio_table = FEATURES.load("motion ratios over travel").ratio_table
    if kind.static_loads is nothing:
        raise InputError(f"[curves] {min(names)}: a curve needs static_loads, which this vehicle type does not have; add them")
    for part in kind.suspensions:
        if part.ratio in names and not part.damping:
            raise InputError(f"[curves] {part.ratio}: {part.deflection} has no damping parameter; set that of its Suspension")
    ratios = {}
    for parameter in kind.parameters:
        if parameter.name in names:
            where = f"[curves] {parameter.name}"
            ratios[parameter.name] = ratio_table(where, section[parameter.name], parameter.check)
    return ratios


def static_loads(kind: VehicleKind, parameters: Mapping[str, float]) -> dict[str, float]:
    """Returns the load of the body's weight in a spring [N], by the spring's parameter; empty if it is not known."""
    loads = kind.static_loads(parameters)
    springs = {part.stiffness: part for part in kind.suspensions if part.stiffness and part.deflection in loads}
    return {name: loads[part.deflection] / part.motion_ratio(parameters) for name, part in springs.items()}


CORNER = {  # quantities at a suspension: the beginning of a parameter's name, and its unit
    "spring": ("suspension_stiffness", "N/m"), "damper": ("suspension_damping", "N s/m"), "wheel": ("unsprung_mass", "kg"),
    "tyre": ("tyre_stiffness", "N/m"), "tyre_damper": ("tyre_damping", "N s/m"),
}  # fmt: skip


def known_quantities(vehicle: Any) -> Iterator[dict[str, KnownQuantity]]:
    """Yields the quantities of a vehicle by place, with the names that `models.kinds.plausibility.RULES` has for them.

    For the body, springs and dampers of all corners count together first, so its frequency and damping ratio are rough. Curves of
    dampers do not count: `suspension_doubts` remarks on them.

    Args:
        vehicle: the `Vehicle`, whose module imports this one.
    """
    kind, limits, how, axles = (
        vehicle.kind,
        vehicle.force_limits or vehicle.limits,
        vehicle.implementation,
        dict[str, KnownQuantity](),
    )
    bent = {part.damping for part in kind.suspensions} & {*vehicle.curves}
    p = {name: value for name, value in kind.at_wheels(vehicle.parameters).items() if value and name not in bent}
    for start, unit in CORNER.values():
        if corners := sorted((value, name) for name, value in p.items() if name.startswith(start)):
            (low, low_name), (high, high_name) = corners[0], corners[-1]
            yield _known_quantities(high=(high_name, high, unit), low=(low_name, low, unit), times=("", high / low, ""))
    firsts = {part.stiffness: part.deflection for part in reversed(kind.suspensions)}.values()  # of those with the same numbers
    lines = [_of_elements(vehicle, deflection) for deflection in firsts]
    k, c = (
        sum(value for name, value in p.items() if name.startswith(CORNER[of][0])) + sum(line[i] for line in lines)
        for i, of in enumerate(("spring", "damper"))
    )
    if k and (mass := p.get("sprung_mass")):
        yield _known_quantities(
            frequency=("", math.sqrt(k / mass) / (2 * math.pi), ""), damping=("", c / (2 * math.sqrt(k * mass)), "")
        )
    yield _known_quantities(
        seat=("", math.sqrt(_ratio(p.get("seat_stiffness", 0.0), p.get("seat_mass", 0.0))) / (2 * math.pi), "")
    )
    yield _known_quantities(**{way: (f"{way}_inertia", p.get(f"{way}_inertia"), "kg m2") for way in ("roll", "pitch")})
    for part in kind.suspensions:
        place = _at_suspension(vehicle, part, p)
        if "body_frequency" in place:
            axles.setdefault(part.corner.partition("_")[0], place["body_frequency"])
        yield place
    yield axles
    for key, of in (("suspension_stroke", "stroke"), ("stop_stiffness", "stop")):
        written = {name: text for name, text in vehicle.limits.written.items() if key in name and text[0] not in "[t"}
        yield from (_known_quantities(**{of: (name, float(text), "")}) for name, text in written.items())
    for bandwidth in (limits.actuator_bandwidth, *(damper.bandwidth for damper in vehicle.dampers.values())):
        yield _known_quantities(bandwidth=("bandwidth", (bandwidth or 0.0) / (2 * math.pi), "Hz"))
    period, units = how.sample_period or 0.0, {signal.name: signal.unit for signal in kind.signals}
    yield _known_quantities(period=("sample_period", period, "s"), delay=("delay times sample_period", how.delay * period, "s"))
    for name, errors in (("noise", how.noise), ("quantisation", how.quantisation)):
        for signal, size in errors.items():
            yield _known_quantities(**{f"error_{units.get(signal)}": (f"{name} of {signal}", size, units.get(signal, ""))})


def _of_elements(vehicle: Any, deflection: str) -> tuple[float, float]:
    """Returns stiffness [N/m] and damping [N s/m] of the elements of `[parts]` at a suspension, by their lines at rest."""
    lines = [one.added for one in vehicle.parts if one.element and one.deflection == deflection] if vehicle.elements else []
    return sum(float(line.stiffness) for line in lines), sum(float(line.damping) for line in lines)


def _at_suspension(vehicle: Any, part: "Suspension", p: Mapping[str, float]) -> dict[str, KnownQuantity]:
    """Returns the quantities at a suspension; `p` has the parameters at the wheel that are not 0."""
    kind, damper, strokes = vehicle.kind, vehicle.dampers.get(part.force), vehicle.parts.strokes.get(part.deflection, {})
    r, load = part.motion_ratio(vehicle.parameters), kind.static_loads(vehicle.parameters).get(part.deflection, 0.0)
    names = {of: kind.of_corner(start, part.ending) for of, (start, _) in CORNER.items()}
    names |= {"spring": part.stiffness, "damper": part.damping}
    k, c, wheel, tyre, tyre_damper = (p.get(name, 0.0) for name in names.values())
    more = _of_elements(vehicle, part.deflection)
    k, c = k + more[0], c + more[1]
    critical, hop = 2 * math.sqrt(k * load / GRAVITY), 2 * math.sqrt(tyre * wheel)
    return _known_quantities(
        **{of: (name, p.get(name), CORNER[of][1] + " at the wheel" * (r != 1 and of == "spring")) for of, name in names.items()},
        **{side: (f"the {side} stroke", stroke, "m") for side, stroke in strokes.items()},
        damping=("", _ratio(c, critical), ""),
        adjustable=("", _ratio(r**2 * damper.c_max if damper and damper.pair is None else 0.0, critical), ""),
        tyre_damping=("", _ratio(tyre_damper, hop), ""),
        ratio=(part.ratio, vehicle.parameters.get(part.ratio), ""),
        body=("the body on it", load / GRAVITY, "kg"),
        load=("the static load", load, "N"),
        static=("the static deflection", _ratio(load, k), "m"),
        squeeze=(names["tyre"], _ratio(load, tyre), "m"),
        body_frequency=(f"the body's frequency at {part.corner}", math.sqrt(_ratio(k * GRAVITY, load)) / (2 * math.pi), "Hz"),
        force=("actuator_force", (vehicle.force_limits or vehicle.limits).actuator_force, "N"),
        rate=("force_rate", (vehicle.force_limits or vehicle.limits).force_rate, "N/s"),
    )


def _known_quantities(**quantities: tuple[str, float | None, str]) -> dict[str, KnownQuantity]:
    """Returns quantities, each with its name, value and unit, without those that are None or 0."""
    return {of: KnownQuantity(name, value, unit) for of, (name, value, unit) in quantities.items() if value}


def _ratio(of: float, to: float) -> float:
    """Returns a ratio; 0 if it is unknown."""
    return of / to if to else 0.0


def suspension_doubts(vehicle: Any) -> list[str]:
    """Returns remarks on tables of springs, dampers and stops that are probably in another unit or of the other sign."""
    kind, parameters, curves, dampers = vehicle.kind, vehicle.parameters, vehicle.curves, vehicle.dampers
    if not (curves or dampers or vehicle.limits.stopped):
        return []
    plausibility = FEATURES.load("doubts about parts")
    loads, wheel, stops = kind.static_loads(parameters), kind.at_wheels(parameters), vehicle.limits.stops(kind.suspensions)
    doubts = dict[str, None]()
    for part in kind.suspensions:
        load, k, ratio = loads.get(part.deflection), wheel.get(part.stiffness), part.motion_ratio(parameters)
        critical = 2 * math.sqrt(k * load / GRAVITY) / ratio**2 if k and load else None
        pair = dampers[part.force].pair if part.force in dampers else None
        pairs = {"[actuators]": (pair.soft, pair.hard)} if pair is not None else {}
        pairs |= {part.damping: (one, one)} if (one := curves.get(part.damping)) is not None else {}
        for name, both in pairs.items():
            doubts |= dict.fromkeys(f"{name}: {said}" for said in plausibility.damper_doubts(*both, critical))
        if (spring := curves.get(part.stiffness)) is not None:
            doubts |= dict.fromkeys(
                f"{part.stiffness}: {said}" for said in plausibility.length_doubts(max(-spring.x[0], spring.x[-1]))
            )
        for side, stop in zip(SIDES, stops.get(part.deflection, ()), strict=False):
            doubts |= dict.fromkeys(
                f"[limits] {side} stop: {said}" for said in plausibility.stop_doubts(stop, load and load / ratio)
            )
    return list(doubts)


def rebalanced_curves(
    kind: VehicleKind, curves: Mapping[str, "ForceCurve"], before: Mapping[str, float], parameters: dict[str, float]
) -> dict[str, "ForceCurve"]:
    """Returns the curves of a vehicle whose parameters have changed, and writes the slopes of springs that have moved.

    A spring whose table carries the static load, as with `preload = true`, moves to where it carries the new one. A motion ratio
    over travel stays about the equilibrium, as in a file with the new parameters.
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


def curve_notes(curves: Mapping[str, "ForceCurve"], kind: VehicleKind, parameters: Mapping[str, float]) -> list[str]:
    """Returns remarks on curves: what was done to their tables, and springs that do not carry the load on them."""
    if not curves:
        return []
    slope_words = FEATURES.load("measured loops").slope_words
    loads = static_loads(kind, parameters) if any(curve.at_rest for curve in curves.values()) else {}
    notes = []
    for name, curve in curves.items():
        carried, load = -curve.at_rest, loads.get(name)
        notes += [f"{name}: {curve.note}{slope_words(curve)}"] if curve.note else []
        if carried and load is not None and abs(carried - load) > STATIC_LOAD_TOLERANCE * load:
            notes.append(
                f"{name}: the table's force at rest is {round(carried, 1):g} N, but the static load is {round(load, 1):g} N, a "
                f"difference of {round(load - carried, 1):+g} N; preload = true begins where the table carries the static load"
            )
    return notes


def ratio_doubts(kind: VehicleKind, strokes: Mapping[str, Mapping[str, float]]) -> list[str]:
    """Returns warnings on bump stops that begin beyond the table of a motion ratio, where the ratio is constant."""
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
