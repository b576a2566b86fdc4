"""Limits that a recommended controller must keep: stroke, force, stability margins, and tyre contact with the ground."""

import math
from dataclasses import asdict, dataclass
from typing import Annotated, NamedTuple

from models.common.checks import CheckedFields
from models.common.errors import InputError, alike, error_in
from models.common.printed import brief
from models.common.schema import SI
from models.common.units import setting

MOST_GAIN = 100.0  # a loop that is stable up to this gain factor counts as stable for all larger factors
LIFT_RESERVE = 0.93  # reserve of the time off the ground: on one road of 10 s, this time can be 11 times its mean over 20 roads
TAIL = 12  # if the tyre is off the ground about 0.1 % of the time, a 1 % larger dynamic load makes this time about 12 % longer
Share = Annotated[float, SI(high=1.0, more=", as in stroke=95%, or none")]


class Usage(NamedTuple):
    """Quantities of a candidate controller that are compared with the limits.

    Attributes:
        stroke: largest peak travel relative to the available stroke in the same direction (bump or rebound).
        force: largest peak force of an actuator, relative to the largest allowed force.
        gain_margin: smallest factor by which all forces must be multiplied or divided to make the loop unstable; at most
            `MOST_GAIN`.
        disk: symmetric disk margin of the loop, from 0 to 2.
        off_ground: share of the measured time in which a tyre does not touch the ground.
        passive_off_ground: value of `off_ground` for the passive vehicle; a candidate may always reach this share.
    """

    stroke: float
    force: float
    gain_margin: float
    disk: float
    off_ground: float
    passive_off_ground: float = 0.0


@dataclass(frozen=True)
class Within(CheckedFields):
    """Limits that a recommended controller must keep; None for a limit that is not used.

    Attributes:
        stroke, force: largest share of the available stroke, and of the largest force, that a controller may use.
        gain_margin: smallest allowed gain margin: the loop must remain stable if all forces are multiplied or divided by any
            smaller factor.
        disk: smallest allowed value of the symmetric disk margin.
        off_ground: largest allowed share of the measured time in which a tyre does not touch the ground.

    Raises:
        InputError: the value of a limit is not allowed.
    """

    public_name = "limits of a Recommendation"

    stroke: Share | None = 0.95
    force: Share | None = 1.0
    gain_margin: Annotated[float, SI(low=1.0, high=MOST_GAIN, more=", as in gain_margin=6dB, or none")] | None = 2.0
    disk: Annotated[float, SI(high=2.0, more=", as in disk=0.3, or none")] | None = 0.3
    off_ground: Share | None = 1e-3

    def used(self, usage: Usage, reserve: float = 0.0) -> dict[str, float]:
        """Returns the used share of each limit, which is 1 if the limit is reached; `reserve` is the share of stroke and force
        to keep unused.

        The time off the ground depends on rare tyre loads, so its reserve is larger: `LIFT_RESERVE` if there is any reserve.
        """
        share, lift = 1 - reserve, 1 - LIFT_RESERVE * bool(reserve)
        gain, least = math.log(max(usage.gain_margin, 1 + 1e-9)), 1e-9
        used = {
            "stroke": self.stroke and usage.stroke / (self.stroke * share),
            "force": self.force and usage.force / (self.force * share),
            "gain": self.gain_margin and math.log(self.gain_margin) / gain,
            "disk": self.disk and self.disk / max(usage.disk, least),
            "lift": self.off_ground and usage.off_ground / max(self.off_ground * lift, usage.passive_off_ground),
        }
        return {name: one for name, one in used.items() if one is not None}

    @property
    def text(self) -> str:
        """Text that lists all limits."""
        decibels = None if self.gain_margin is None else 20 * math.log10(self.gain_margin)
        pairs = {"stroke": (self.stroke, 100, " %"), "force": (self.force, 100, " %"), "gain margin": (decibels, 1, " dB")}
        pairs |= {"disk margin": (self.disk, 1, ""), "off the ground": (self.off_ground, 100, " %")}
        given = [f"{name} {brief(scale * one)}{unit}" for name, (one, scale, unit) in pairs.items() if one is not None]
        return ", ".join(given) or "none"


def read_within(text: str) -> Within:
    """Returns the limits from a text such as `stroke=90%,force,disk=3dB,off_ground=none`; limits that are not named have
    default values.

    Raises:
        InputError: the name of a limit is unknown or appears twice, or a value is not allowed.
    """
    usual, given = asdict(Within()), dict[str, float | None]()
    with error_in("--within:"):
        for part in filter(None, map(str.strip, text.split(","))):
            name, _, value = map(str.strip, part.partition("="))
            if name not in usual:
                raise InputError(f"unknown limit {name!r}; known are {alike(name, usual)}")
            if name in given:
                raise InputError(f"{name} is given twice; give it once")
            if name in ("gain_margin", "disk") and value.endswith("dB"):  # a gain factor in dB, as in the table
                factor = 10 ** (setting(name, value.removesuffix("dB")) / 20)
                given[name] = factor if name == "gain_margin" else 2 * (factor - 1) / (factor + 1)
            else:
                given[name] = None if value == "none" else setting(name, value) if value else usual[name]
            try:
                Within(**{name: given[name]})
            except InputError as error:  # the message repeats the text of the user, such as 200%
                raise InputError(f"{part} is not allowed; {str(error).partition('; ')[2]}") from error
        return Within(**given)
