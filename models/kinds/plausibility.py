"""Numbers of vehicles and roads that are probably in another unit, or swapped: a table of rules.

Limits are relative to the vehicle where trucks, bicycles and model-scale test benches differ. `models.parts.plausibility`
has the remarks on curves.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from models.common.printed import about, entry


class KnownQuantity(NamedTuple):
    """Quantity of a vehicle or a road, as a remark shows it: its name, value and unit."""

    name: str
    value: float
    unit: str

    def __str__(self) -> str:
        return f"{self.name} ({entry(self.value)} {self.unit})"

    @property
    def rough(self) -> str:
        """The value with few digits."""
        return about(self.value) if self.value < 100 else str(round(self.value))


@dataclass(frozen=True)
class Rule:
    """Condition under which quantities are remarked.

    Attributes:
        of: names of the quantities, which are known at a place of the vehicle.
        odd: their values -> True if they are improbable.
        words: remark, with the quantities by name.
        rank: a rule is silent if another rule, whose rank is lower but not 0, has a remark.
    """

    of: str
    odd: Callable[..., bool]
    words: str
    rank: int = 0


MOST_ERROR = {"m": 0.05, "m/s": 1.0, "m/s2": 10.0, "rad": 0.1, "rad/s": 1.0}  # rms or resolution of a sensor, by unit
KG, STIFFNESS, DAMPING = "check that masses are in kg", "check that stiffness is in N/m", "check that the damping is in N s/m"
# The quantities of a rule belong to the same place: a suspension, a pair of axles, a sensor, a road.
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
NAMES = [dict.fromkeys(rule.of.split()) for rule in RULES]  # of the quantities of each rule, in their order


def remarks(places: Iterable[Mapping[str, KnownQuantity]]) -> list[str]:
    """Returns a remark for each rule that holds at a place: that of the first such place.

    Args:
        places: the known quantities at each place, by the names that rules have for them.
    """
    places, said, first = list(places), list[str](), 9
    for rule, names in zip(RULES, NAMES, strict=True):
        for known in places if rule.rank <= first else ():
            if known.keys() >= names.keys() and rule.odd(*[known[name].value for name in names]):
                said.append(rule.words.format(**known))
                first = min(first, rule.rank or first)
                break
    return said
