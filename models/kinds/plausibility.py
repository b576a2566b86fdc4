"""Rules that find implausible quantities of vehicles and roads, which probably have the wrong unit or are swapped.

If the usual values of a quantity differ between trucks, bicycles and model-scale test benches, its limit depends on other
quantities of the vehicle. `models.parts.plausibility` contains the warnings about characteristics.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from models.common.printed import about, entry
from models.kinds.kind import GRAVITY

if TYPE_CHECKING:
    from models.kinds.kind import Suspension


class KnownQuantity(NamedTuple):
    """Quantity of a vehicle or road as a warning shows it: name, value and unit."""

    name: str
    value: float
    unit: str

    def __str__(self) -> str:
        return f"{self.name} ({entry(self.value)} {self.unit})"

    @property
    def rough(self) -> str:
        """Text of the quantity's value, rounded to a few digits."""
        return about(self.value) if self.value < 100 else str(round(self.value))


@dataclass(frozen=True)
class Rule:
    """Rule that warns about improbable quantities of a vehicle or road.

    Attributes:
        of: names of the quantities that the rule compares. The rule applies at a place of the vehicle if all quantities in `of`
            are known there.
        odd: function of the quantities' values that returns True if the values are improbable.
        words: text of the warning, with the names of the quantities in braces.
        rank: priority of the rule, 1 for the highest; a rule with rank 0 always applies. A rule gives no warning if another
            rule, whose rank is smaller but not 0, has already given a warning.
    """

    of: str
    odd: Callable[..., bool]
    words: str
    rank: int = 0


# Largest plausible rms noise, or resolution, of a sensor with this unit
MOST_ERROR = {"m": 0.05, "m/s": 1.0, "m/s2": 10.0, "rad": 0.1, "rad/s": 1.0}
KG, STIFFNESS, DAMPING = "check that masses are in kg", "check that stiffness is in N/m", "check that the damping is in N s/m"
# All quantities of one rule belong to the same place: a suspension, a pair of axles, a sensor or a road.
RULES = (
    Rule("times high low", lambda times, *_: times > 50,
         "{high.name} is {times.rough} times {low.name}; are both in {low.unit}?", 1),
    Rule("frequency", lambda hertz: not 0.15 <= hertz <= 15, "the body's natural frequency is about {frequency.rough} Hz; "
         "check that sprung_mass is in kg and stiffness in N/m", 2),
    Rule("wheel body", lambda wheel, body: wheel > body, f"{{wheel}} is heavier than {{body}}; {KG}, and not swapped", 3),
    Rule("tyre spring", lambda tyre, spring: tyre < spring,
         f"{{tyre}} is softer than {{spring}}; {STIFFNESS}, and not swapped", 3),
    Rule("roll pitch", lambda roll, pitch: roll > pitch, "{roll} is larger than {pitch}; check that they are not swapped"),
    Rule("ratio", lambda ratio: ratio > 2, "{ratio.name} is {ratio.value:g}; check that it is spring travel over wheel travel"),
    Rule("front rear", lambda front, rear: front > 1.8 * rear,
         "{front} is far above {rear}; check that front and rear are not swapped", 4),
    Rule("wheel body", lambda wheel, body: wheel < body / 500, f"{{wheel}} is light for {{body}}; {KG}", 4),
    Rule("squeeze", lambda squeeze: squeeze < 3e-5,
         f"{{squeeze.name}} lets the tyre deflect by {{squeeze.rough}} m at rest; {STIFFNESS}", 4),
    Rule("damping", lambda ratio: not 0.002 <= ratio <= 10,
         f"the body's damping ratio is about {{damping.rough}}; {DAMPING}", 4),
    Rule("adjustable", lambda ratio: not 0.01 <= ratio <= 30,
         f"the body's damping ratio at c_max is about {{adjustable.rough}}; {DAMPING}", 4),
    Rule("tyre_damping", lambda ratio: ratio > 1, f"the tyre's damping ratio is about {{tyre_damping.rough}}; {DAMPING}"),
    Rule("seat", lambda hertz: not 0.3 <= hertz <= 30, "the person's natural frequency on the seat is about {seat.rough} Hz; "
         "check that seat mass is in kg and stiffness in N/m"),
    Rule("stroke", lambda stroke: stroke > 2, "{stroke.name} is {stroke.value:g} m; check that its value is in m"),
    Rule("rebound bump static", lambda rebound, bump, static: rebound > 1.5 * max(bump, static),
         "{rebound} is longer than {bump} and {static}; check that bump and rebound are not swapped"),
    Rule("stop", lambda stop: stop < 1e3, "{stop.name} is {stop.value:g} N/m; check that its value is in N/m"),
    Rule("force load", lambda force, load: force < min(100, 0.05 * load), "{force} is small for {load}; check that it is in N"),
    Rule("force load", lambda force, load: force > 100 * load, "{force} is large for {load}; check that it is in N", 4),
    Rule("rate load", lambda rate, load: rate < min(500, 0.2 * load), "{rate} is low for {load}; check that it is in N/s"),
    Rule("rate load", lambda rate, load: rate > 1e3 * load, "{rate} is high for {load}; check that it is in N/s", 4),
    Rule("bandwidth", lambda hertz: hertz < 2,
         '{bandwidth} is low; a number without a unit is in rad/s, so give "8 Hz", for example'),
    Rule("period", lambda period: period > 0.05, '{period} is long; check that it is in s, or give "5 ms", for example'),
    Rule("delay", lambda delay: delay > 0.01 + 1e-9, '{delay} is long; delay is a number of samples, or a time such as "5 ms"'),
    *(Rule(f"error_{unit}", most.__lt__, f"{{error_{unit}}} is large for a sensor; check that it is in {unit}")
      for unit, most in MOST_ERROR.items()),
    Rule("speed", lambda speed: speed > 70, '{speed} is above 70 m/s; check that it is in m/s, or give "90 km/h", for example'),
    Rule("obstacle", lambda height: height > 0.5, "{obstacle} is above 0.5 m; check that it is in m"),
)  # fmt: skip
# Names of the quantities that each rule compares, in the order of the rule's arguments
NAMES = [dict.fromkeys(rule.of.split()) for rule in RULES]


def remarks(places: Iterable[Mapping[str, KnownQuantity]]) -> list[str]:
    """Returns a warning for each rule that finds improbable quantities, about the first place at which they are found.

    Args:
        places: known quantities at each place of the vehicle, such as a suspension or sensor; the keys are the names in the
            rules.
    """
    places, said, first = list(places), list[str](), 9
    for rule, names in zip(RULES, NAMES, strict=True):
        for known in places if rule.rank <= first else ():
            if known.keys() >= names.keys() and rule.odd(*[known[name].value for name in names]):
                said.append(rule.words.format(**known))
                first = min(first, rule.rank or first)
                break
    return said


def vehicle_remarks(vehicle: Any) -> list[str]:
    """Returns warnings about improbable quantities of a `Vehicle`."""
    return remarks(known_quantities(vehicle))


def road_remarks(road: Any) -> list[str]:
    """Returns warnings about an improbable speed, or an improbable height of an obstacle, of a `Road`."""
    heights = ({"obstacle": KnownQuantity(name, abs(getattr(road, name)), "m")} for name in getattr(road, "tall", ()))
    return remarks([{"speed": KnownQuantity("speed", road.speed, "m/s")}, *heights])


CORNER = {  # quantities of a suspension: how the name of the parameter begins, and the unit
    "spring": ("suspension_stiffness", "N/m"), "damper": ("suspension_damping", "N s/m"), "wheel": ("unsprung_mass", "kg"),
    "tyre": ("tyre_stiffness", "N/m"), "tyre_damper": ("tyre_damping", "N s/m"),
}  # fmt: skip


def known_quantities(vehicle: Any) -> Iterator[dict[str, KnownQuantity]]:
    """Yields the quantities of a vehicle at one place after another; the keys are the names that `RULES` uses.

    The first place of the vehicle is the body. For the body, the springs and dampers of all corners are added, so its frequency
    and damping ratio are approximate. Dampers with a characteristic in `[curves]` are omitted; `suspension_doubts` checks these
    dampers.

    Args:
        vehicle: `Vehicle` whose quantities are returned.
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
    # If several suspensions have the same parameters, only one suspension is checked
    firsts = {part.stiffness: part.deflection for part in reversed(kind.suspensions)}.values()
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
    """Returns the linearised stiffness [N/m] and damping [N s/m] of the elements of `[parts]` that act at a suspension."""
    lines = [one.added_line for one in vehicle.parts if one.element and one.deflection == deflection] if vehicle.elements else []
    return sum(float(line.stiffness) for line in lines), sum(float(line.damping) for line in lines)


def _at_suspension(vehicle: Any, part: "Suspension", p: Mapping[str, float]) -> dict[str, KnownQuantity]:
    """Returns the quantities at a suspension. The mapping `p` contains the parameters at the wheel that are not 0."""
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
    """Returns the quantities by name, without those whose value is None or 0. Each argument contains the name, value and unit
    of a quantity.
    """
    return {of: KnownQuantity(name, value, unit) for of, (name, value, unit) in quantities.items() if value}


def _ratio(of: float, to: float) -> float:
    """Returns the ratio of two numbers; 0 if the ratio is unknown."""
    return of / to if to else 0.0
