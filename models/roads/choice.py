"""Roads by name: the text `KIND[:NAME=VALUE...]`, as on a command line or in a campaign file, becomes a road."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from models.common.errors import InputError, listing
from models.formats.road_name import FILE
from models.roads.iso8608 import Iso8608, long_enough, roughness
from models.roads.obstacles import OBSTACLES
from models.roads.opencrg import Surface, read_surface
from models.roads.profile import Profile
from models.roads.profile_file import read_profile, read_table
from models.roads.road import Road, track_width
from models.vehicle import Vehicle

KINDS = ("iso8608", *OBSTACLES)
SYNTAX = (
    f"give {', '.join(KINDS)}, each with :NAME=VALUE for its numbers, as in pothole:depth=0.03:length=2, or a .csv, .txt or .crg "
    "file, as in road.csv:height_unit=mm"
)
TABLE = ("distance_unit", "height_unit", "separator", "columns")  # of a .csv or .txt file


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
    file = FILE.fullmatch(text)
    if file and file["suffix"].lower() == "crg":
        if file["settings"]:
            raise InputError(f"road {text!r}: an OpenCRG file says its own units; leave {file['settings']!r} out")
        return RoadChoice(text, "profile", {}, surface=read_surface(folder / file["path"]))
    if file:
        try:
            table = read_table(_settings(file["settings"], TABLE))
        except InputError as error:
            raise InputError(f"road {text!r}: {error}") from error
        return RoadChoice(text, "profile", {}, read_profile(folder / file["path"], 20.0, table))
    kind, colon, rest = text.partition(":")
    if kind not in KINDS:
        raise InputError(f"unknown road {text!r}; {SYNTAX}")
    allowed = {"class": "C"} if kind == "iso8608" else _defaults(OBSTACLES[kind])
    try:
        settings = _settings(colon + rest, allowed)
    except InputError as error:
        raise InputError(f"road {text!r}: {error}") from error
    values: dict[str, Any] = {
        name: value if isinstance(allowed[name], str) else _number(text, name, value) for name, value in settings.items()
    }
    if values.get("track", "both") not in ("left", "right", "both"):
        raise InputError(f"road {text!r}: track = {values['track']!r} is not allowed; give left, right or both")
    if kind == "iso8608":
        values = {"class": "C"} | values
        roughness(values["class"])
    else:
        OBSTACLES[kind](**values)  # numbers that are not allowed at any speed
    return RoadChoice(text, kind, values)


def _settings(text: str, allowed: Iterable[str]) -> dict[str, str]:
    """`:NAME=VALUE:NAME=VALUE`, each name once.

    Raises:
        InputError: it is not that.
    """
    found: dict[str, str] = {}
    for setting in text.split(":")[1:]:
        name, equals, value = setting.partition("=")
        if not equals or name not in allowed:
            raise InputError(f"{setting!r} is not NAME=VALUE with a NAME out of {listing(allowed)}")
        if name in found:
            raise InputError(f"{name} is given twice, {found[name]!r} and {value!r}; give it once")
        found[name] = value
    return found


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
