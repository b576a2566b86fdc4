"""Limits that a recommended controller keeps: stroke, force, stability margins, and contact of the tyres with the road.

A file without a stroke or without a largest force gets an assumed limit, which the recommendation prints: travel up to
`TRAVEL` times that of the passive car, and force up to `FORCE` times the static load of the suspension.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

from models.common.errors import InputError, alike
from models.common.units import quantity

TRAVEL, FORCE = 1.25, 0.5  # assumed limits: of passive's peak travel, and of the static load
MOST_GAIN = 100.0  # a loop that tolerates this factor tolerates any
NONE = "none"


@dataclass(frozen=True)
class Within:
    """Limits on a recommended controller; None for a limit that does not count.

    Attributes:
        stroke: largest peak travel, as a share of the stroke on each side.
        force: largest peak force, as a share of the actuators' largest force.
        gain_margin: smallest factor on all forces, up or down, at which the loop may become unstable.
        disk: smallest symmetric disk margin.
        off_ground: largest share of the time in which a tyre does not touch the ground.
    """

    stroke: float | None = 0.95
    force: float | None = 1.0
    gain_margin: float | None = 2.0
    disk: float | None = 0.3
    off_ground: float | None = 1e-3

    def used(self, usage: "Usage", reserve: float = 0.0) -> dict[str, float]:
        """Returns how much of each limit is used, 1 at the limit, by name.

        Args:
            usage: travel, force, margins and contact of a candidate.
            reserve: share of stroke and force that is kept for roads that were not driven.
        """
        room, shares = 1 - reserve, dict[str, float]()
        if self.stroke is not None:
            shares["stroke"] = usage.stroke / (self.stroke * room)
        if self.force is not None:
            shares["force"] = usage.force / (self.force * room)
        if self.gain_margin is not None:
            shares["gain"] = math.log(self.gain_margin) / max(math.log(usage.gain_margin), 1e-9)
        if self.disk is not None:
            shares["disk"] = self.disk / max(usage.disk, 1e-9)
        if self.off_ground is not None:
            shares["lift"] = usage.off_ground / self.off_ground if self.off_ground else math.inf * bool(usage.off_ground)
        return {name: 0.0 if math.isnan(share) else share for name, share in shares.items()}

    @property
    def text(self) -> str:
        """The limits in words."""
        words = {
            "stroke": lambda value: f"stroke {100 * value:g} %",
            "force": lambda value: f"force {100 * value:g} %",
            "gain_margin": lambda value: f"gain margin {20 * math.log10(value):.3g} dB",
            "disk": lambda value: f"disk margin {value:g}",
            "off_ground": lambda value: f"off the ground {100 * value:g} %",
        }
        given = [write(value) for name, write in words.items() if (value := getattr(self, name)) is not None]
        return ", ".join(given) or "no limits"


@dataclass(frozen=True)
class Usage:
    """What a candidate uses of its limits.

    Attributes:
        stroke: largest peak travel as a share of the stroke on its side.
        force: largest peak force as a share of the largest force.
        gain_margin: factor on all forces, or its inverse, at which the loop is unstable, up to `MOST_GAIN`.
        disk: symmetric disk margin, from 0 to 2.
        off_ground: share of the time in which a tyre does not touch the ground.
    """

    stroke: float
    force: float
    gain_margin: float
    disk: float
    off_ground: float


def read_within(text: str) -> Within:
    """Returns the limits of `--within`; limits that are not given keep their defaults.

    Args:
        text: limits such as `stroke=90%,force,gain_margin=6dB,disk=0.3,off_ground=none`; a name alone has its default.

    Raises:
        InputError: a name is unknown or given twice, or a value is not allowed.
    """
    names, given = [one.name for one in fields(Within)], dict[str, float | None]()
    for part in filter(None, (one.strip() for one in text.split(","))):
        name, _, value = (one.strip() for one in part.partition("="))
        if name not in names:
            raise InputError(f"--within: unknown limit {name!r}; known are {alike(name, names)}")
        if name in given:
            raise InputError(f"--within: {name} is given twice; give it once")
        given[name] = getattr(Within(), name) if not value else None if value == NONE else _value(name, value)
    return replace(Within(), **given)


def _value(name: str, text: str) -> float:
    """Returns the value of a limit: a number, a percentage or, for the gain margin, decibels."""
    low, high = {"gain_margin": (1.0, MOST_GAIN), "disk": (0.0, 2.0)}.get(name, (0.0, 1.0))
    try:
        if text.endswith("dB"):
            value = 10 ** (float(text.removesuffix("dB")) / 20)
        else:
            value = float(text.removesuffix("%")) / 100 if text.endswith("%") else quantity(text, "1")
    except ValueError:
        value = math.nan
    if not low <= value <= high or (name != "gain_margin" and text.endswith("dB")):
        example = {"gain_margin": "6dB", "disk": "0.3"}.get(name, "95%")
        raise InputError(f"--within: {name}={text} is not allowed; give {low:g} to {high:g}, as in {name}={example}, or {NONE}")
    return value


@dataclass(frozen=True)
class Room:
    """Limits of a vehicle's hardware, given in its file or assumed.

    Attributes:
        strokes: stroke in bump and in rebound [m], by deflection.
        forces: largest force [N], by force.
        assumed: sentences on the limits that the file lacks.
    """

    strokes: Mapping[str, tuple[float, float]]
    forces: Mapping[str, float]
    assumed: tuple[str, ...]
