"""Roads by name: the text `KIND[:NAME=VALUE...]`, as on a command line or in a campaign file, becomes a road."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from models.errors import InputError, known
from models.vehicle import Vehicle
from sim.iso8608 import Iso8608, long_enough, roughness
from sim.obstacles import Pothole, SineSweep, Step, WattsHump
from sim.opencrg import Surface, read_surface
from sim.profile import Profile, read_profile
from sim.road import Bump, Road, track_width

OBSTACLES: Mapping[str, type] = {
    "bump": Bump,
    "watts_hump": WattsHump,
    "step": Step,
    "pothole": Pothole,
    "sweep": SineSweep,
}
KINDS = ("iso8608", *OBSTACLES)
SYNTAX = (
    f"give {', '.join(KINDS)}, each with :NAME=VALUE for its numbers, as in pothole:depth=0.03:length=2, or a .csv or .crg file"
)


@dataclass(frozen=True, eq=False)
class RoadChoice:
    """A road that was asked for, without the speed, seed and vehicle that make it one.

    Attributes:
        text: as it was asked for.
        kind: one of `KINDS`, or "profile".
        values: what was given for it.
        profile: of a CSV file.
        surface: of an OpenCRG file.
    """

    text: str
    kind: str
    values: Mapping[str, Any]
    profile: Profile | None = None
    surface: Surface | None = None

    @property
    def random(self) -> bool:
        """Whether its seed matters."""
        return self.kind == "iso8608"

    def build(self, vehicle: Vehicle, speed: float, seed: int, distance: float) -> Road:
        """The road.

        Args:
            vehicle: its track width counts.
            speed: [m/s].
            seed: of a random road.
            distance: how far it is driven [m]; a random road does not repeat on it.

        Raises:
            InputError: a number that is not allowed.
        """
        if self.kind == "iso8608":
            return Iso8608(self.values["class"], seed, speed, track_width(vehicle), long_enough(distance))
        if self.profile is not None:
            return replace(self.profile, speed=speed)
        if self.surface is not None:
            return self.surface.profile(track_width(vehicle), speed)
        return OBSTACLES[self.kind](**self.values, speed=speed)


def choose_road(text: str, folder: Path = Path()) -> RoadChoice:
    """A road from its text: `iso8608:class=C`, `pothole:depth=0.03`, `profile.csv`.

    Args:
        text: the text.
        folder: where a relative file name begins.

    Raises:
        InputError: an unknown kind or name, a value that is not allowed, a file that is no profile.
    """
    if text.lower().endswith((".csv", ".txt")):
        return RoadChoice(text, "profile", {}, read_profile(folder / text, 20.0))
    if text.lower().endswith(".crg"):
        return RoadChoice(text, "profile", {}, surface=read_surface(folder / text))
    kind, *settings = text.split(":")
    if kind not in KINDS:
        raise InputError(f"unknown road {text!r}; {SYNTAX}")
    values: dict[str, Any] = {}
    allowed = {"class": "C"} if kind == "iso8608" else _defaults(OBSTACLES[kind])
    for setting in settings:
        name, equals, value = setting.partition("=")
        if not equals or name not in allowed:
            raise InputError(f"road {text!r}: {setting!r} is not NAME=VALUE with a NAME out of {known(allowed)}")
        values[name] = value if isinstance(allowed[name], str) else _number(text, name, value)
    if values.get("track", "both") not in ("left", "right", "both"):
        raise InputError(f"road {text!r}: track = {values['track']!r} is not allowed; give left, right or both")
    if kind == "iso8608":
        values = {"class": "C"} | values
        roughness(values["class"])
    else:
        OBSTACLES[kind](**values)  # numbers that are not allowed at any speed
    return RoadChoice(text, kind, values)


def _defaults(road: type) -> dict[str, Any]:
    """What can be given for an obstacle, with its default: all but the speed."""
    return {field.name: field.default for field in fields(road) if field.name != "speed"}


def _number(text: str, name: str, value: str) -> float:
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise InputError(f"road {text!r}: {name} = {value!r} is not a finite number")
    return number
