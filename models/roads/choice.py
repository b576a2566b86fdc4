"""Roads by name: converts the text `KIND[:NAME=VALUE...]` of a command line or a campaign file to a road."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, TypeVar

from models.common.checks import SETTINGS
from models.common.errors import InputError, error_in, listing, quoted
from models.common.files import path_from
from models.common.printed import settings
from models.roads.iso8608 import Iso8608, long_enough
from models.roads.load import Load
from models.roads.load_choice import choose_load, setting
from models.roads.loaded import RoadWithLoads
from models.roads.obstacles import OBSTACLES
from models.roads.opencrg import Surface, read_surface
from models.roads.profile import JOINS, Profile
from models.roads.rig import Rig
from models.roads.road import Road, track_width
from models.vehicle.names import FILE, RIG, ROAD_KINDS, ROAD_SYNTAX, split_off
from models.vehicle.vehicle import Vehicle

UNITS = {**SETTINGS, "waviness": "", "band": "cycle/m"}
RANDOM = {"class": "C", "iri": 0.0, "gd": 0.0, "waviness": 2.0, "band": ""}  # settings of a random road
TABLE = ("distance_unit", "height_unit", "unit", "separator", "columns", "step")  # of a file with a table
DRIVEN = ("from", "join")  # of such a file: where the vehicle starts, and how points are joined
READ = (
    "readable are .csv, .txt, .xlsx and .mat files with columns of distance and height, .erd files, .rdf files with a poly_line "
    "and .crg files (OpenCRG)"
)
Measured = TypeVar("Measured", Profile, Surface)
RPC = "; RPC III files (.rsp, .drv) cannot be read, so export their channels as text"


@dataclass(frozen=True, eq=False)
class RoadChoice:
    """Chosen road, before speed, seed and vehicle are known.

    Attributes:
        text: text of the choice.
        kind: kind of the road: one of `ROAD_KINDS`, or "profile".
        values: the given numbers and names.
        profile: profile of a CSV file; None for other roads.
        surface: surface of an OpenCRG file; None for other roads.
        rig: rig of a drive file; None for other roads.
        loads: loads on the body, in addition to the road.
    """

    text: str
    kind: str
    values: Mapping[str, Any]
    profile: Profile | None = None
    surface: Surface | None = None
    rig: Rig | None = None
    loads: tuple[Load, ...] = ()

    @property
    def random(self) -> bool:
        """True if the road depends on the seed."""
        return self.kind == "iso8608"

    @property
    def stationary(self) -> bool:
        """True if the response becomes stationary, so that measurement starts once a vehicle has forgotten its start."""
        return self.random and not self.loads

    def build(self, vehicle: Vehicle, speed: float, seed: int, distance: float) -> Road:
        """Returns the road.

        Args:
            speed: vehicle speed [m/s].
            distance: distance driven [m], over which a random road does not repeat.

        Raises:
            InputError: a number that is not allowed.
        """
        road = self._road(vehicle, speed, seed, distance)
        return RoadWithLoads(road, self.loads) if self.loads else road

    def _road(self, vehicle: Vehicle, speed: float, seed: int, distance: float) -> Road:
        if self.kind == "iso8608":
            return _random(self.values, seed, speed, track_width(vehicle), long_enough(distance))
        if self.profile is not None:
            return replace(self.profile, speed=speed)
        if self.rig is not None:
            return self.rig
        if self.surface is not None:
            return self.surface.profile(track_width(vehicle), speed)
        return OBSTACLES[self.kind](**self.values, speed=speed)


def choose_road(text: str, folder: Path = Path()) -> RoadChoice:
    """Returns the `RoadChoice` of a text; its `build` makes the road for a vehicle.

    Args:
        text: `iso8608:class=C`, `profile.csv`, `rig:file=drive.csv`, `bump + brake:g=0.3`.
        folder: base of relative file names.

    Raises:
        InputError: an unknown kind or name, a value that is not allowed, a file that is not a profile.

    Example:
        >>> from models import choose_road, read_vehicle
        >>> road = choose_road("bump:height=0.05").build(read_vehicle("quarter_car"), speed=10.0, seed=0, distance=50.0)
        >>> road.describe()["height"]
        0.05
    """
    road, loads = split_off(text)
    choice = _choose(road, folder)
    return replace(choice, text=text, loads=tuple(choose_load(load, folder) for load in loads)) if loads else choice


def driven(text: str) -> dict[str, float | str]:
    """Returns the settings of a file's road that its description repeats: where it begins [m], and how points are joined."""
    file = FILE.fullmatch(text)
    given = settings(file["settings"], (*TABLE, *DRIVEN)) if file else {}
    return {name: setting(name, given[name], "m") if name == "from" else given[name] for name in DRIVEN if name in given}


def _choose(text: str, folder: Path) -> RoadChoice:
    """Returns a road without loads, as `choose_road`."""
    if text.partition(":")[0] == "rig":
        return _rig(text, folder)
    file = FILE.fullmatch(text)
    if file and file["suffix"].lower() == "crg":
        with error_in(f"road {text!r}: an OpenCRG file contains its own units and interpolation, and"):
            given = settings(file["settings"], DRIVEN[:1])
        return RoadChoice(text, "profile", {}, surface=_begun(text, given, read_surface(path_from(file["path"], folder))))
    if file:
        from models.roads.profile_file import read_profile

        with error_in(f"road {text!r}:"):
            given = settings(file["settings"], (*TABLE, *DRIVEN))
            join = given.get("join", JOINS[0])
            if join not in JOINS:
                raise InputError(f"join = {join!r} is unknown; give one of {listing(JOINS)}")
        profile = replace(read_profile(path_from(file["path"], folder), 20.0, given), join=join)
        return RoadChoice(text, "profile", {}, _begun(text, given, profile))
    kind, colon, rest = text.partition(":")
    if kind not in ROAD_KINDS:
        raise InputError((text and _unread(text, folder)) or f"unknown road {text!r}; {ROAD_SYNTAX}")
    allowed = RANDOM if kind == "iso8608" else _defaults(OBSTACLES[kind])
    with error_in(f"road {text!r}:"):
        given = settings(colon + rest, allowed)
    values: dict[str, Any] = {
        name: value if isinstance(allowed[name], str) else setting(f"road {text!r}: {name}", value, UNITS.get(name, "m"))
        for name, value in given.items()
    }
    if kind == "iso8608":
        values = _random_values(text, values)
        _random(values)
    else:
        OBSTACLES[kind](**values)  # numbers that are not allowed at any speed
    return RoadChoice(text, kind, values)


def _begun(text: str, given: Mapping[str, str], road: Measured) -> Measured:
    """Returns a road from the distance on that its settings give, or the whole of it."""
    if "from" not in given:
        return road
    with error_in(f"road {text!r}:"):
        return road.begun_at(setting("from", given["from"], "m"))


def _unread(text: str, folder: Path) -> str:
    """Returns a message on a text that is an existing file of another type; else an empty text."""
    path = path_from(text, folder)
    if not path.exists():
        path = path_from(re.sub(r"(:\w+=[^:]*)+$", "", text), folder)
    if not path.exists():
        return ""
    if path.is_dir():
        return f"road {text!r} is a folder ({READ}); give a file in this folder"
    what = f"{quoted(path.suffix)} files cannot be read" if path.suffix else "its name has no ending"
    rpc = RPC if path.suffix.lower() in (".rsp", ".drv") else ""
    return f"road {text!r}: the file exists, but {what} ({READ}); rename or convert the file{rpc}"


def _rig(text: str, folder: Path) -> RoadChoice:
    """Returns the posts of a rig from a drive file."""
    file = RIG.fullmatch(text)
    if file is None:
        raise InputError(f"road {text!r}: a rig needs a drive file; give a .csv or .txt file, as in rig:file=drive.csv{RPC}")
    from models.roads.rig_file import UNITS, read_rig

    try:
        given = settings(file["settings"], UNITS)
    except InputError as error:
        raise InputError(f"road {text!r}: {error}") from error
    return RoadChoice(text, "rig", {}, rig=read_rig(path_from(file["path"], folder), given))


def _random(values: Mapping[str, Any], *rest: Any) -> Iso8608:
    """Returns a random road of a class, an IRI or a G_d(n0); class C by default."""
    others = {name: value for name, value in values.items() if name != "class"}
    return Iso8608(values.get("class", "" if {"iri", "gd"} & values.keys() else "C"), *rest, **others)


def _random_values(text: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the settings of a random road with its band as two numbers [cycle/m]."""
    others = {name: value for name, value in values.items() if name != "band"}
    if "band" in values:
        low, dots, high = values["band"].partition("..")
        if not dots:
            raise InputError(f"road {text!r}: band = {values['band']!r} is not allowed; give both ends, as in band=0.011..2.83")
        ends = zip(("lowest", "highest"), (low, high), strict=True)
        others |= {name: setting(f"road {text!r}: band", end, UNITS["band"]) for name, end in ends}
    return others


def _defaults(road: type) -> dict[str, Any]:
    """Returns the settings of an obstacle with their defaults: all but the speed."""
    return {field.name: field.default for field in fields(road) if field.name != "speed"}
