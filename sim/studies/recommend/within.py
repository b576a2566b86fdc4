"""Limits that a recommended controller must keep: stroke, force, stability margins, and contact of the tyres with the road."""

import math
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

from models.common.errors import InputError, alike
from models.common.printed import brief
from models.common.units import quantity

MOST_GAIN = 100.0  # a loop that is stable up to this gain factor counts as stable for all larger factors
# smallest and largest value of each margin, and an example
RANGES = {"gain_margin": (1.0, MOST_GAIN, "6dB"), "disk": (0.0, 2.0, "0.3")}
TAIL = 12  # if the tyre is off the ground about 0.1 % of the time, a 1 % larger dynamic load makes this time about 12 % longer
SHARE = (0.0, 1.0, "95%")


class Usage(NamedTuple):
    """Quantities of a candidate that are compared with the limits.

    Attributes:
        stroke: largest peak travel relative to the stroke in its direction (bump or rebound).
        force: largest peak force relative to the largest allowed force.
        gain_margin: smallest factor, up or down, on all forces at which the loop becomes unstable; at most `MOST_GAIN`.
        disk: symmetric disk margin, from 0 to 2.
        off_ground: share of the time in which a tyre does not touch the ground.
        passive_off_ground: share of this time for the passive vehicle, which any candidate may reach.
    """

    stroke: float
    force: float
    gain_margin: float
    disk: float
    off_ground: float
    passive_off_ground: float = 0.0


@dataclass(frozen=True)
class Within:
    """Limits on a recommended controller; None for a limit that is not used.

    Attributes:
        stroke, force: largest allowed share of the stroke, and of the largest force.
        gain_margin: smallest allowed gain margin, as a factor: the loop must be stable if all forces are multiplied or divided by
            less.
        disk: smallest allowed symmetric disk margin.
        off_ground: largest allowed share of the time in which a tyre does not touch the ground.
    """

    public_name = "limits of a Recommendation"

    stroke: float | None = 0.95
    force: float | None = 1.0
    gain_margin: float | None = 2.0
    disk: float | None = 0.3
    off_ground: float | None = 1e-3

    def used(self, usage: Usage, reserve: float = 0.0) -> dict[str, float]:
        """Returns the used share of each limit, 1 at the limit; `reserve` is the share of stroke and force kept in reserve.

        The time off the ground depends on rare tyre loads, so its reserve is larger: (1 - reserve) to the power of `TAIL`
            remains.
        """
        share, gain, least = 1 - reserve, math.log(max(usage.gain_margin, 1 + 1e-9)), 1e-9
        used = {
            "stroke": self.stroke and usage.stroke / (self.stroke * share),
            "force": self.force and usage.force / (self.force * share),
            "gain": self.gain_margin and math.log(self.gain_margin) / gain,
            "disk": self.disk and self.disk / max(usage.disk, least),
            "lift": self.off_ground and usage.off_ground / max(self.off_ground * share**TAIL, usage.passive_off_ground),
        }
        return {name: one for name, one in used.items() if one is not None}

    @property
    def text(self) -> str:
        """Text that lists the limits."""
        decibels = None if self.gain_margin is None else 20 * math.log10(self.gain_margin)
        pairs = {"stroke": (self.stroke, 100, " %"), "force": (self.force, 100, " %"), "gain margin": (decibels, 1, " dB")}
        pairs |= {"disk margin": (self.disk, 1, ""), "off the ground": (self.off_ground, 100, " %")}
        given = [f"{name} {brief(scale * one)}{unit}" for name, (one, scale, unit) in pairs.items() if one is not None]
        return ", ".join(given) or "none"


def read_within(text: str) -> Within:
    """Returns the limits from a text such as `stroke=90%,force,gain_margin=6dB,off_ground=none`; all others have their defaults.

    Raises:
        InputError: a name is unknown or given twice, or a value is not allowed.
    """
    names, given = [one.name for one in fields(Within)], dict[str, float | None]()
    for part in filter(None, map(str.strip, text.split(","))):
        name, _, value = (one.strip() for one in part.partition("="))
        if name not in names:
            raise InputError(f"--within: unknown limit {name!r}; known are {alike(name, names)}")
        if name in given:
            raise InputError(f"--within: {name} is given twice; give it once")
        given[name] = getattr(Within(), name) if not value else None if value == "none" else _value(name, value)
    return replace(Within(), **given)


def _value(name: str, text: str) -> float:
    low, high, example = RANGES.get(name, SHARE)
    decibels = text.endswith("dB") and name == "gain_margin"
    try:
        value = 10 ** (float(text.removesuffix("dB")) / 20) if decibels else quantity(text, "1")
    except ValueError:
        value = math.nan
    if not low < value <= high:
        raise InputError(f"--within: {name}={text} is not allowed; give {low:g} to {high:g}, as in {name}={example}, or none")
    return value
