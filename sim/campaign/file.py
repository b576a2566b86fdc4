"""A campaign file (TOML): which vehicles, controllers, roads, speeds and seeds are combined, and which parameters are sampled."""

import hashlib
import unicodedata
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, listing, quoted
from models.common.files import TEXT, parse_toml, read_text
from models.kinds.kind import Parameter
from models.roads.choice import RoadChoice, choose_road
from models.roads.iso8608 import check_seed
from models.suspension.adjustable_dampers import Adjustable
from models.suspension.damper import CURVED, LARGEST
from models.vehicle.vehicle import Vehicle, read_vehicle
from sim.campaign import MOST_RUNS
from sim.runs.run import sample_times

SAMPLES = ("count", "method", "seed", "parameters")
METHODS = ("latin_hypercube", "sobol")
DISTRIBUTIONS = ("uniform", "normal")
OF_DAMPERS = (*CURVED, "bandwidth")  # of [actuators], which are sampled, too
WIDEST = 3.0  # standard deviations; a normal distribution is cut there


@dataclass(frozen=True)
class Distribution:
    """Distribution of a parameter.

    Attributes:
        name: of the parameter.
        shape: "uniform", from a to b, or "normal", of mean a and standard deviation b, cut at three of them.
        a, b: in SI, or multiples of each vehicle's own value.
        relative: True for multiples.
    """

    name: str
    shape: str
    a: float
    b: float
    relative: bool

    @property
    def ends(self) -> tuple[float, float]:
        """The least and the most that it gives."""
        return (self.a, self.b) if self.shape == "uniform" else (self.a - WIDEST * self.b, self.a + WIDEST * self.b)

    def value(self, quantile: Array) -> Array:
        """Returns the quantiles for shares from 0 to 1."""
        if self.shape == "uniform":
            return self.a + (self.b - self.a) * quantile
        from scipy import special

        cut = special.ndtr(-WIDEST)
        return self.a + self.b * special.ndtri(cut + (1 - 2 * cut) * quantile)


def read_samples(section: Any, vehicles: Mapping[str, Vehicle]) -> dict[str, tuple[Mapping[str, float], ...]]:
    """The sampled parameters of every vehicle."""
    if section is None:
        return {name: ({},) for name in vehicles}
    if not isinstance(section, dict):
        raise InputError("'samples' is not a section; write it as [samples]")
    for key in section:
        if key not in SAMPLES:
            raise InputError(f"[samples] unknown key {key!r}; known: {listing(SAMPLES)}")
    if "count" not in section:
        raise InputError(f"[samples] 'count' is missing; give how many samples, a whole number from 1 to {MOST_RUNS}")
    count, method = section["count"], section.get("method", "latin_hypercube")
    if isinstance(count, bool) or not isinstance(count, int) or not 1 <= count <= MOST_RUNS:
        raise InputError(f"[samples] count = {quoted(count)} makes no runs; give a whole number from 1 to {MOST_RUNS}")
    if method not in METHODS:
        raise InputError(f"[samples] method = {quoted(method)} is unknown; give one of {listing(METHODS)}")
    table = section.get("parameters")
    if not isinstance(table, dict) or not table:
        raise InputError("[samples] samples no parameters; write [samples.parameters] with NAME = { uniform = [low, high] }")
    distributions = [_distribution(name, entry) for name, entry in table.items()]
    for name, vehicle in vehicles.items():
        for distribution in distributions:
            _check_distribution(distribution, name, vehicle)
    unit = _unit_samples(method, len(distributions), count, check_seed(section.get("seed", 0)))
    found = {}
    for name, vehicle in vehicles.items():
        columns = [distribution.value(unit[:, i]) for i, distribution in enumerate(distributions)]
        own = _values(vehicle)
        scales = [own[one.name] if one.relative else 1.0 for one in distributions]
        rows = np.stack([scale * column for scale, column in zip(scales, columns, strict=True)], axis=-1).tolist()
        found[name] = tuple(dict(zip([one.name for one in distributions], row, strict=True)) for row in rows)
        for row in found[name]:
            try:
                made = with_sample(vehicle, row)
                vehicle.kind.check(made.parameters)
                _ = made.adjustable  # which looks whether its dampers can be what they nominally are
            except InputError as error:
                raise InputError(f"[samples] a sample of vehicle {name!r} is no vehicle: {error}") from error
    return found


def _unit_samples(method: str, dimensions: int, count: int, seed: int) -> Array:
    """Points of the unit cube, shape (count, dimensions)."""
    import warnings

    from scipy.stats import qmc  # half a second

    sampler = qmc.Sobol(dimensions, rng=np.random.default_rng(seed)) if method == "sobol" else None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # that counts are balanced only at powers of two
        return (sampler or qmc.LatinHypercube(dimensions, rng=np.random.default_rng(seed))).random(count)


def _distribution(name: str, entry: Any) -> Distribution:
    where = f"[samples.parameters] {name}"
    example = f"as in {name} = {{ uniform = [0.8, 1.2], relative = true }}"
    if not isinstance(entry, dict):
        raise InputError(f"{where} = {quoted(entry)} is no distribution; give one of {listing(DISTRIBUTIONS)}, {example}")
    shapes = [key for key in entry if key != "relative"]
    if len(shapes) != 1 or shapes[0] not in DISTRIBUTIONS or not isinstance(entry.get("relative", False), bool):
        raise InputError(
            f"{where} has {listing(entry)}; give one of {listing(DISTRIBUTIONS)}, and relative = true or false, {example}"
        )
    values = entry[shapes[0]]
    if not isinstance(values, list) or len(values) != 2:
        raise InputError(f"{where}: {shapes[0]} = {quoted(values)} is not two numbers, {example}")
    a, b = (read_number(value, f"{where}: {shapes[0]}", -1e12, 1e12) for value in values)
    if (a >= b) if shapes[0] == "uniform" else (b <= 0):
        raise InputError(
            f"{where}: {shapes[0]} = [{a:g}, {b:g}] spreads nothing; give low < high, or a standard deviation above 0"
        )
    return Distribution(name, shapes[0], a, b, entry.get("relative", False))


def _check_distribution(distribution: Distribution, name: str, vehicle: Vehicle) -> None:
    """Refuses a parameter that a vehicle has not, and a distribution that reaches a value it cannot have."""
    parameters: dict[str, Parameter] = {parameter.name: parameter for parameter in vehicle.kind.parameters}
    own = _values(vehicle)
    if distribution.name not in own:
        raise InputError(f"[samples.parameters] vehicle {name!r} has no parameter {distribution.name!r}; it has {listing(own)}")
    scale = own[distribution.name] if distribution.relative else 1.0
    for end in distribution.ends:
        try:
            if distribution.name in parameters:
                parameters[distribution.name].check(scale * end)
            else:
                read_number(scale * end, distribution.name, 0.0, LARGEST)
        except InputError as error:
            raise InputError(
                f"[samples.parameters] the distribution reaches a value that is none, for vehicle {name!r}: {error}"
            ) from error


def _values(vehicle: Vehicle) -> dict[str, float]:
    """Returns the vehicle's values that can be sampled."""
    return {**vehicle.parameters, **{name: value for name, (value, _) in _of_dampers(vehicle).items()}}


def _of_dampers(vehicle: Vehicle) -> dict[str, tuple[float, list[str]]]:
    """Maps each sampled damper parameter to its value and forces: an entry per damper with a number, and one for all if equal."""
    found: dict[str, tuple[float, list[str]]] = {}
    for name in OF_DAMPERS:
        # A limit that is a curve is no number.
        curved = {one for one in vehicle.adjustable if name in CURVED and one.damper.pair is not None}
        values: dict[Adjustable, Any] = {one: None if one in curved else getattr(one.damper, name) for one in vehicle.adjustable}
        if len(set(values.values())) == 1:
            found[name] = (next(iter(values.values())), [one.force for one in values])
        found |= {f"{name}{one.ending}": (value, [one.force]) for one, value in values.items() if one.ending}
    return {name: (value, forces) for name, (value, forces) in found.items() if value is not None}


def read_number(value: Any, where: str, smallest: float, largest: float) -> float:
    """Reads a number of a campaign file, within limits.

    Raises:
        InputError: the value is not a number, or beyond them.
    """
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not smallest <= value <= largest:
        raise InputError(f"{where}: {quoted(value)} is not allowed; give a number from {smallest:g} to {largest:g}")
    return float(value)


def with_sample(vehicle: Vehicle, sample: Mapping[str, float]) -> Vehicle:
    """The vehicle with sampled parameters, and numbers of its adjustable dampers."""
    if not sample:
        return vehicle
    known, dampers = _of_dampers(vehicle), dict(vehicle.dampers)
    for name in (one for one in known if one in sample):
        for force in known[name][1]:
            dampers[force] = replace(dampers[force], **{name.removesuffix(_ending(vehicle, force)): sample[name]})
    parameters = {name: value for name, value in sample.items() if name not in known}
    return replace(vehicle, parameters={**vehicle.parameters, **parameters}, dampers=dampers)


def _ending(vehicle: Vehicle, force: str) -> str:
    """Returns the suffix of signal names at the suspension of this force."""
    return next(one.ending for one in vehicle.adjustable if one.force == force)


KEYS = ("vehicles", "controllers", "roads", "speeds", "seeds", "duration", "settle", "timestep", "samples")
SETTLE = 5.0  # s; by then a mode of 0.5 rad/s has 99 % of its variance


@dataclass(frozen=True, eq=False)
class Campaign:
    """A campaign, as its file says.

    Attributes:
        vehicles: as they are read, by the name that the file has for them.
        controllers: names; every vehicle has them all.
        roads: what was asked for.
        speeds: [m/s].
        seeds: of the random roads; other roads run once.
        duration: of every run [s].
        settle: beginning of a run over a random road that is not measured [s]; others are measured from the start.
        timestep: [s].
        samples: parameters of every vehicle, by sample: values by name. One empty sample where none are sampled.
        text: the file.
    """

    vehicles: Mapping[str, Vehicle]
    controllers: tuple[str, ...]
    roads: tuple[RoadChoice, ...]
    speeds: tuple[float, ...]
    seeds: tuple[int, ...]
    duration: float
    settle: float
    timestep: float
    samples: Mapping[str, tuple[Mapping[str, float], ...]]
    text: str

    @property
    def time(self) -> Array:
        """Sample times [s], shape (T,)."""
        return np.arange(round(self.duration / self.timestep) + 1) * self.timestep

    @property
    def loaded(self) -> bool:
        """Returns True if any of its roads has loads: then the angles of all bodies are measured."""
        return any(road.loads for road in self.roads)

    @property
    def first(self) -> int:
        """The sample from which is measured."""
        return round(self.settle / self.timestep)

    @property
    def sources(self) -> str:
        """Everything that decides the numbers, as text: the file, and those that it names."""
        # Tables before surfaces, whatever their order: folders that are there know a campaign by this.
        roads = sorted(self.roads, key=lambda road: road.surface is not None)
        measured = [line for road in roads for line in _measured(road)]
        return "\n".join([self.text, *(vehicle.text for vehicle in self.vehicles.values()), *measured])


def read_campaign(path: Path) -> Campaign:
    """Reads a campaign file.

    Raises:
        InputError: the file cannot be read, something in it is missing, unknown or not allowed, or it makes no runs.
    """
    return parse_campaign(read_text(path, "campaign file", TEXT, "give a TOML file"), path)


def parse_campaign(text: str, path: Path, own_kinds: bool = True) -> Campaign:
    """A campaign from the text of its file, wherever that is kept; what it names lies beside `path`.

    Args:
        own_kinds: as for `read_vehicle`.
    """
    try:
        return _parse(text, path.parent, own_kinds)
    except InputError as error:
        raise InputError(f"campaign file {path}: {error}") from error


def _parse(text: str, folder: Path, own_kinds: bool) -> Campaign:
    data = parse_toml(text)
    for key in data:
        if key not in KEYS:
            raise InputError(f"unknown key {key!r}; known: {listing(KEYS)}")
    names = _texts(data, "vehicles", "quarter_car")
    vehicles = {name: read_vehicle(folder / name if (folder / name).is_file() else name, own_kinds) for name in names}
    _check_once("vehicles", names, [Path(vehicles[name].source).resolve() for name in names])
    controllers = tuple(unicodedata.normalize("NFC", name) for name in _texts(data, "controllers", "I"))
    _check_once("controllers", controllers, controllers)
    for name, vehicle in vehicles.items():
        for controller in controllers:
            if controller not in vehicle.controller_names:
                raise InputError(f"vehicle {name!r} has no controller {controller!r}; it has {listing(vehicle.controller_names)}")
    roads = tuple(choose_road(road, folder) for road in _texts(data, "roads", "iso8608:class=C"))
    a_vehicle = next(iter(vehicles.values()))
    _check_once("roads", [road.text for road in roads], [_what_it_is(road, a_vehicle) for road in roads])
    written = _list(data, "speeds", "20.0")
    speeds = tuple(read_number(speed, "speeds", 0.1, 200.0) for speed in written)
    _check_once("speeds", written, speeds)
    duration, timestep = read_number(data.get("duration", 10.0), "duration", 0.0, 1e6), data.get("timestep", 1e-3)
    timestep = read_number(timestep, "timestep", 0.0, 1.0)
    for name, vehicle in vehicles.items():
        try:
            sample_times(vehicle, duration, timestep)
        except InputError as error:
            raise InputError(f"vehicle {name!r}: {error}") from error
    settle = read_number(data.get("settle", min(SETTLE, duration / 2)), "settle", 0.0, 1e6)
    if settle > duration / 2:
        raise InputError(f"settle = {settle:g} s leaves too little of a run of {duration:g} s; give at most half of it")
    campaign = Campaign(
        vehicles=vehicles,
        controllers=controllers,
        roads=roads,
        speeds=speeds,
        seeds=_seeds(data),
        duration=duration,
        settle=settle,
        timestep=timestep,
        samples=read_samples(data.get("samples"), vehicles),
        text=text,
    )
    for name, vehicle in vehicles.items():
        for road in roads:
            for speed in speeds:
                _check_road(name, vehicle, road, speed, campaign)
    return campaign


def _check_road(name: str, vehicle: Vehicle, road: RoadChoice, speed: float, campaign: Campaign) -> None:
    built = road.build(vehicle, speed, campaign.seeds[0], speed * campaign.duration)
    try:
        built.check(vehicle, campaign.time)
    except InputError as error:
        raise InputError(f"road {road.text!r} at {speed:g} m/s under vehicle {name!r}: {error}") from error


def _seeds(data: Mapping[str, Any]) -> tuple[int, ...]:
    """A list of seeds, or how many: 0, 1, ..."""
    seeds = data.get("seeds", 1)
    if isinstance(seeds, int) and not isinstance(seeds, bool):
        if not 1 <= seeds <= MOST_RUNS:
            raise InputError(
                f"seeds = {seeds} makes no runs, or far too many; give how many, from 1 to {MOST_RUNS}, or a list of them"
            )
        return tuple(range(seeds))
    if not isinstance(seeds, list) or not seeds:
        raise InputError(f"seeds = {quoted(seeds)} is no number of seeds, nor a list of whole numbers")
    found = tuple(check_seed(seed) for seed in seeds)
    if len(set(found)) < len(found):
        raise InputError("seeds has one twice; name each once")
    return found


def _list(data: Mapping[str, Any], key: str, example: str) -> list[Any]:
    give = f"give a list, as in {key} = [{example}]"
    if key not in data:
        raise InputError(f"{key!r} is missing, so there are no runs; {give}")
    values = data[key]
    if not isinstance(values, list):
        raise InputError(f"{key} = {quoted(values)} is not a list; {give}")
    if not values:
        raise InputError(f"{key} = [] names none, so there are no runs; {give}")
    return values


def _check_once(key: str, written: Sequence[Any], read: Sequence[Hashable]) -> None:
    """Checks that nothing is named twice, in the same words or in others: its runs would count twice."""
    first: dict[Hashable, str] = {}
    for value, meant in zip(written, read, strict=True):
        if meant in first:
            twice = f" names {first[meant]} twice" if first[meant] == quoted(value) else None
            raise InputError(f"{key}{twice or f': {first[meant]} and {quoted(value)} are the same'}; name each once")
        first[meant] = quoted(value)


def _what_it_is(road: RoadChoice, vehicle: Vehicle) -> Hashable:
    """Returns a key that is equal for equal roads, whatever their text."""
    alone = replace(road, loads=())
    of_road = _measured(alone) or sorted(alone.build(vehicle, 20.0, 0, 1.0).describe().items())
    return (*of_road, *(load.content for load in road.loads))


def _measured(road: RoadChoice) -> list[str]:
    """Checksums of the file that a road was measured in, and loads that are files; none of a road that is computed."""
    arrays = [road.profile.distance, road.profile.heights] if road.profile else []
    arrays += [road.rig.time, road.rig.heights] if road.rig else []
    named = [*road.rig.posts] if road.rig else []
    named += [load.content for load in road.loads if load.content != load.text]
    arrays += [road.surface.u, road.surface.v, road.surface.z] if road.surface else []
    return [*named, *(f"{array.shape} {hashlib.sha256(np.ascontiguousarray(array).data).hexdigest()}" for array in arrays)]


def _texts(data: Mapping[str, Any], key: str, example: str) -> Sequence[str]:
    values = _list(data, key, f'"{example}"')
    for value in values:
        if not isinstance(value, str):
            raise InputError(f"{key}: {quoted(value)} is not text in quotes")
    return values
