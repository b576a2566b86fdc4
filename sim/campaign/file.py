"""Reads a campaign file in TOML format.

The file lists vehicles, controllers, roads, speeds and seeds, all of which the campaign combines, and the parameters to sample.
"""

import hashlib
import itertools
import unicodedata
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from models.common.arrays import Array
from models.common.checks import HERE
from models.common.command import print_remarks
from models.common.errors import InputError, error_in, list_names, short_repr
from models.common.files import parse_toml, path_from, read_text
from models.common.schema import MOST_SEED, SI, AnyTable, Integer, ListedValues, ReadBy, Section, Text, read
from models.roads.choice import RoadChoice, choose_road
from models.roads.description import read_road
from models.roads.obstacles import OBSTACLES
from models.roads.opencrg import Surface
from models.roads.profile import Profile
from models.roads.rig import Rig
from models.vehicle.names import ROAD_KINDS
from models.vehicle.vehicle import Vehicle, read_vehicle
from sim.campaign import MOST_RUNS
from sim.campaign.samples import Values, read_samples
from sim.runs.run import sample_times
from sim.runs.sampled_vehicle import with_sample

SETTLE = 5.0  # s; within this time, the variance of a mode that decays at 0.5 1/s reaches 99 % of its final value
Texts = tuple[str, ...]
# examples of valid values, which error messages quote
EXAMPLES = (', as in ["quarter_car"]', ', as in ["passive"]', ', as in ["bump:height=0.05"]', ", as in [20.0]")
FILE_POINTS = {
    Profile: ("distance", "heights"),
    Rig: ("time", "heights"),
    Surface: ("u", "v", "z"),
}  # types of roads that are read from files, and the attributes that contain their points


def _seeds(value: Any, context: Mapping[str, Any]) -> tuple[int, ...]:
    """Returns the seeds in a list, or the seeds 0, 1, ..., n - 1 for an integer n."""
    if not isinstance(value, list) or not value:
        return tuple(range(Integer("", 1, MOST_RUNS, ", or a list of seeds").read(value, context)))
    return ListedValues("", Integer("", high=MOST_SEED)).read(value, context)


def _road(value: Any, context: Mapping[str, Any]) -> str:
    """Converts a road in the campaign file, either text in the syntax of `--road` or a table with the key `type`, to this
    syntax.
    """
    if isinstance(value, Mapping):
        if value.get("type") not in ROAD_KINDS or value["type"] in OBSTACLES:
            read_road(HERE, value)
        value = ":".join([value["type"], *(f"{name}={one}" for name, one in value.items() if name != "type")])
    return Text().read(value, context)


@dataclass(frozen=True)
class CampaignFile(Section):
    """The keys of a campaign file, with types, units and defaults."""

    vehicles: Annotated[
        Texts, ListedValues("vehicle files next to this file, or names of built-in vehicles", Text(), EXAMPLES[0])
    ]
    controllers: Annotated[Texts, ListedValues("names of controllers; every vehicle must have all of them", Text(), EXAMPLES[1])]
    roads: Annotated[
        Texts,
        ListedValues("roads, as `roadproof drive --road` takes them, or tables with `type`", ReadBy("", _road), EXAMPLES[2]),
    ]
    speeds: Annotated[tuple[float, ...], ListedValues("speeds of the vehicles", SI("m/s", low=0.1, high=200.0), EXAMPLES[3])]
    seeds: Annotated[tuple[int, ...], ReadBy("seeds of the random roads, or their number; other roads run once", _seeds)] = (0,)
    duration: Annotated[float, SI("s", "duration of every run", 0.0, 1e6)] = 10.0
    settle: (
        Annotated[float, SI("s", "time at the start of a run over a random road that is left out of the metrics", 0.0, 1e6)]
        | None
    ) = None
    timestep: Annotated[float, SI("s", "timestep of the simulation", 0.0, 1.0)] = 1e-3
    samples: Annotated[Mapping[str, Any], AnyTable("section with distributions of parameters, `[samples]`")] | None = None


@dataclass(frozen=True, eq=False)
class Campaign:
    """Content of a campaign file, as an object. The campaign has one run for each combination of vehicle, controller, road,
    speed, seed and sample.

    Attributes:
        vehicles: vehicles of the campaign, by their names in the campaign file.
        controllers: names of the controllers, all of which every vehicle must have.
        roads: requested roads.
        speeds: speeds at which all vehicles drive [m/s].
        seeds: seeds of the random roads. A road that is not random is simulated only once, whatever the seeds.
        duration: duration of every run [s].
        settle: time from the start of a run over a random road until measurement starts [s]. Runs over roads that are not
            random are measured from the start.
        timestep: timestep of the simulation [s].
        samples: samples of each vehicle's parameters, each with values [SI] by name of the parameter; a single empty sample if
            nothing is sampled.
        variants: variants of each control law with sampled parameters, by vehicle and controller; a variant maps keys of the
            law to sampled values.
        sample_seed: seed of the random numbers from which samples and variants are drawn.
        text: text of the campaign file.
        earlier: True to repeat a campaign that was begun with an earlier version of Roadproof, see `RoadInput.earlier`.
    """

    vehicles: Mapping[str, Vehicle]
    controllers: tuple[str, ...]
    roads: tuple[RoadChoice, ...]
    speeds: tuple[float, ...]
    seeds: tuple[int, ...]
    duration: float
    settle: float
    timestep: float
    samples: Mapping[str, tuple[Values, ...]]
    variants: Mapping[str, Mapping[str, tuple[Values, ...]]]
    sample_seed: int
    text: str
    earlier: bool = False

    @property
    def time(self) -> Array:
        """Sample times [s], shape (T,)."""
        return np.arange(round(self.duration / self.timestep) + 1) * self.timestep

    @property
    def loaded(self) -> bool:
        """True if external loads act on the vehicle's body on at least one road of the campaign. If external loads act on the
        vehicle's body, the angles of the body are measured in all runs.
        """
        return any(road.loads for road in self.roads)

    @property
    def first(self) -> int:
        """Index of the first time step that is measured in a run over a random road."""
        return round(self.settle / self.timestep)

    @property
    def digest(self) -> str:
        """Checksum of all files on which the results depend: the campaign file, the vehicle files and the files of roads."""
        # OpenCRG roads always come last, whatever their order in the file, because the checksums in existing results folders
        # were computed in this order.
        roads = sorted(self.roads, key=lambda road: isinstance(road.road, Surface))
        measured = [line for road in roads for line in _file_checksums(road)]
        sources = "\n".join([self.text, *(vehicle.text for vehicle in self.vehicles.values()), *measured])
        return hashlib.sha256(sources.encode()).hexdigest()


def read_campaign(path: Path) -> Campaign:
    """Reads a campaign file.

    Raises:
        InputError: the file cannot be read, a key is missing, unknown or has an invalid value, or a road cannot be driven.
    """
    return parse_campaign(read_text(path, "campaign file", "give a TOML file"), path)


def parse_campaign(text: str, path: Path) -> Campaign:
    """Builds a campaign from the text of a campaign file.

    Args:
        text: text of the campaign file.
        path: path of the campaign file. Relative paths in the campaign file are relative to the folder of this file.
    """
    with error_in(f"campaign file {path}:"):
        return _parse(text, path.parent)


def _parse(text: str, folder: Path) -> Campaign:
    data = parse_toml(text)
    given = read("", CampaignFile, data)
    files = {name: path_from(name, folder) for name in given.vehicles}
    vehicles = {name: print_remarks(read_vehicle(file if file.is_file() else name)) for name, file in files.items()}
    _check_once("vehicles", given.vehicles, [Path(vehicles[name].source).resolve() for name in given.vehicles])
    controllers = tuple(unicodedata.normalize("NFC", name) for name in given.controllers)
    _check_once("controllers", controllers, controllers)
    for name, vehicle in vehicles.items():
        for controller in controllers:
            if controller not in vehicle.controller_names:
                raise InputError(
                    f"vehicle {name!r} has no controller {controller!r}; it has {list_names(vehicle.controller_names)}"
                )
    vehicles = {name: vehicle.with_common_actuators(controllers) for name, vehicle in vehicles.items()}
    roads = tuple(choose_road(road, folder) for road in given.roads)
    a_vehicle = next(iter(vehicles.values()))
    _check_once("roads", given.roads, [_what_it_is(road, a_vehicle) for road in roads])
    _check_once("speeds", data["speeds"], given.speeds)
    if isinstance(data.get("seeds"), list):
        _check_once("seeds", data["seeds"], given.seeds)
    duration, timestep = given.duration, given.timestep
    for name, vehicle in vehicles.items():
        with error_in(f"vehicle {name!r}:"):
            sample_times(vehicle, duration, timestep)
    settle = min(SETTLE, duration / 2) if given.settle is None else given.settle
    if settle > duration / 2:
        raise InputError(f"settle = {settle:g} s is too long for runs of {duration:g} s; give at most half of the duration")
    drawn = read_samples(given.samples, vehicles, controllers)
    campaign = Campaign(vehicles, controllers, roads, given.speeds, given.seeds, duration, settle, timestep, *drawn, text)
    for (name, vehicle), road, speed in itertools.product(vehicles.items(), roads, given.speeds):
        built = print_remarks(road.build(vehicle, speed, campaign.seeds[0], speed * duration))
        with error_in(f"road {road.text!r} at {speed:g} m/s under vehicle {name!r}:"):
            built.check(vehicle, campaign.time)
    for name, vehicle in vehicles.items():
        # A remark is printed if a distribution seems to have the wrong unit
        print_remarks(with_sample(vehicle, campaign.samples[name][0]))
    return campaign


def _check_once(key: str, written: Sequence[Any], read: Sequence[Hashable]) -> None:
    """Checks that a list contains no duplicates, not even two spellings of the same entry, because duplicate runs would count
    twice.

    Args:
        key: key of the list in the campaign file.
        written: entries of the list as they are written in the campaign file.
        read: entries of the list in a normal form, in which two spellings of the same entry are equal.
    """
    first: dict[Hashable, str] = {}
    for value, meant in zip(written, read, strict=True):
        if meant in first:
            raise InputError(f"{key}: {first[meant]} and {short_repr(value)} are the same; list only one of them")
        first[meant] = short_repr(value)


def _what_it_is(road: RoadChoice, vehicle: Vehicle) -> Hashable:
    """Returns a key that identifies a road; two texts that describe the same road have the same key."""
    alone = replace(road, loads=())
    of_road = _file_checksums(alone) or sorted(alone.build(vehicle, 20.0, 0, 1.0).describe().items())
    return (*of_road, *(load.content for load in road.loads))


def _file_checksums(road: RoadChoice) -> list[str]:
    """Returns lines with the checksums of all files from which a road and its loads are read; empty if no file is read."""
    measured = road.road
    arrays = [getattr(measured, name) for name in FILE_POINTS.get(type(measured), ())]
    named = [*measured.posts] if isinstance(measured, Rig) else [measured.join] if isinstance(measured, Profile) else []
    named += [load.content for load in road.loads if load.content != load.text]
    return [*named, *(f"{array.shape} {hashlib.sha256(np.ascontiguousarray(array).data).hexdigest()}" for array in arrays)]
