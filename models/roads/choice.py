"""Roads by name: converts the text `KIND[:NAME=VALUE...]` of a command line or campaign file to a road."""

import re
from dataclasses import dataclass, replace
from pathlib import Path

from models.common.errors import InputError, error_in, short_repr
from models.common.files import path_from
from models.common.schema import keys, read_text
from models.roads.description import ROADS
from models.roads.iso8608 import Iso8608, long_enough
from models.roads.loads.choice import choose_load
from models.roads.loads.load import Load
from models.roads.loads.road_with_loads import RoadWithLoads
from models.roads.opencrg import Surface, read_surface
from models.roads.profile import Profile
from models.roads.rig import Rig
from models.roads.road import Obstacle, Road, track_width
from models.vehicle.names import FILE, RIG, ROAD_KINDS, ROAD_SYNTAX, split_off
from models.vehicle.vehicle import Vehicle

READ = (
    "readable are .csv, .txt, .xlsx and .mat files with columns of distance and height, .erd files, .rdf files with a poly_line "
    "and .crg files (OpenCRG)"
)
RPC = "; RPC III files (.rsp, .drv) cannot be read, so export their channels as text"


@dataclass(frozen=True, eq=False)
class RoadChoice:
    """Road that a user has chosen, before speed, seed and vehicle are known.

    Attributes:
        text: text with which the user chose the road.
        road: the road at its default speed; for an OpenCRG file, the surface in the file.
        loads: loads on the body, in addition to the road.
    """

    text: str
    road: Road | Surface
    loads: tuple[Load, ...] = ()

    @property
    def random(self) -> bool:
        """True if the road depends on the seed."""
        return isinstance(self.road, Iso8608)

    @property
    def stationary(self) -> bool:
        """True if the vehicle's response to the road becomes stationary.

        If the response becomes stationary, measurement starts after the transient response has decayed.
        """
        return self.random and not self.loads

    @property
    def profile(self) -> Profile | None:
        """The measured profile if the road was read from a table in a file; None for other roads."""
        return self.road if isinstance(self.road, Profile) else None

    def build(self, vehicle: Vehicle, speed: float, seed: int, distance: float) -> Road:
        """Returns the chosen road as driven by a vehicle.

        Args:
            vehicle: the vehicle that drives on the road; a road with two tracks needs the vehicle's track width.
            speed: vehicle speed [m/s].
            seed: seed of a random road.
            distance: driven distance [m]; a random road does not repeat within this distance.

        Returns:
            The road with its loads on the body.

        Raises:
            InputError: a number of the road, such as its height or speed, is not allowed.
        """
        road = self.road
        if isinstance(road, Iso8608):
            road = replace(road, seed=seed, speed=speed, track_width=track_width(vehicle), length=long_enough(distance))
        elif isinstance(road, Surface):
            road = road.profile(track_width(vehicle), speed)
        elif isinstance(road, Profile | Obstacle):
            road = replace(road, speed=speed)
        return RoadWithLoads(road, self.loads) if self.loads else road


def choose_road(text: str, folder: Path = Path()) -> RoadChoice:
    """Reads a road from a text, such as "bump:height=0.05" or "road.csv".

    Args:
        text: name of a road and its numbers, or name of a file. Loads follow after " + ". Examples: `iso8608:class=C`,
            `profile.csv`, `rig:file=drive.csv`, `bump + brake:g=0.3`.
        folder: folder to which file names are relative.

    Returns:
        The chosen road. The method `build` of the returned object returns a `Road` for a vehicle, a speed, a seed and a
        distance.

    Raises:
        InputError: the name of a road or of a number is unknown, a value is not allowed, or a file is not a profile.

    Example:
        >>> from models import choose_road, read_vehicle
        >>> road = choose_road("bump:height=0.05").build(read_vehicle("quarter_car"), speed=10.0, seed=0, distance=50.0)
        >>> road.describe()["height"]
        0.05
    """
    road, loads = split_off(text)
    choice = _choose(road, folder)
    return replace(choice, text=text, loads=tuple(choose_load(load, folder) for load in loads)) if loads else choice


def _choose(text: str, folder: Path) -> RoadChoice:
    """Reads a road without loads; see `choose_road`."""
    where, file, (kind, colon, rest) = f"road {text!r}:", FILE.fullmatch(text), text.partition(":")
    if kind == "rig":
        return RoadChoice(text, _rig(where, text, folder))
    if file:
        return RoadChoice(text, _road_of_file(where, file["path"], file["suffix"].lower() == "crg", file["settings"], folder))
    if kind not in ROAD_KINDS:
        raise InputError((text and _unread(text, folder)) or f"unknown road {text!r}; {ROAD_SYNTAX}")
    names = Iso8608.settings if kind == "iso8608" else [name for name in keys(ROADS[kind]) if name != "speed"]
    return RoadChoice(text, read_text(where, ROADS[kind], colon + rest, names))


def _unread(text: str, folder: Path) -> str:
    """Returns an error message if a text is the name of an existing file that cannot be read; empty otherwise."""
    path = path_from(text, folder)
    if not path.exists():
        path = path_from(re.sub(r"(:\w+=[^:]*)+$", "", text), folder)
    if not path.exists():
        return ""
    if path.is_dir():
        return f"road {text!r} is a folder ({READ}); give a file in this folder"
    what = f"{short_repr(path.suffix)} files cannot be read" if path.suffix else "its name has no ending"
    rpc = RPC if path.suffix.lower() in (".rsp", ".drv") else ""
    return f"road {text!r}: the file exists, but {what} ({READ}); rename or convert the file{rpc}"


def _road_of_file(where: str, name: str, crg: bool, settings: str, folder: Path) -> Profile | Surface:
    """Returns the road in a file."""
    from models.roads.profile_file import TableSettings, read_profile

    path, own = path_from(name, folder), " an OpenCRG file contains its own units and interpolation, and" * crg
    names = ["from"] if crg else [{"start": "from"}.get(key, key) for key in keys(TableSettings)]
    given = read_text(f"{where}{own}", TableSettings, settings, names)
    road = read_surface(path) if crg else replace(read_profile(path, 20.0, given), join=given.join)
    with error_in(where):
        return road if given.start is None else road.begun_at(given.start)


def _rig(where: str, text: str, folder: Path) -> Rig:
    """Returns the posts of a rig from a drive file."""
    file = RIG.fullmatch(text)
    if file is None:
        raise InputError(
            f"{where} a test rig needs a file with the heights of its posts; give a .csv or .txt file, as in "
            f"rig:file=drive.csv{RPC}"
        )
    from models.roads.rig_file import RigSettings, read_rig

    return read_rig(path_from(file["path"], folder), read_text(where, RigSettings, file["settings"]))
