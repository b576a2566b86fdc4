"""`[samples]` of a campaign file: distributions of parameters of the vehicles, and of the keys of their controllers' laws.

Vehicles and laws are drawn apart, and every variant of a law meets every sample of the vehicle, over the same roads: what differs
between two variants is the law alone.
"""

import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.checks import check_keys, number_within
from models.common.errors import InputError, error_in, listing, quoted
from models.common.units import in_unit
from models.kinds.kind import Parameter
from models.roads.iso8608 import check_seed
from models.suspension.adjustable_dampers import Adjustable
from models.suspension.damper import CURVED, LARGEST
from models.vehicle.vehicle import Vehicle
from sim.campaign import MOST_RUNS
from sim.campaign.law_keys import check_key, drawn_entry

DRAWN = ("parameters", "controllers")
SAMPLES = ("count", "variants", "method", "seed", *DRAWN)
METHODS = ("latin_hypercube", "sobol")
DISTRIBUTIONS = ("uniform", "normal")
OF_DAMPERS = (*CURVED, "bandwidth")  # of [actuators], which are sampled, too
WIDEST = 3.0  # standard deviations; a normal distribution is cut there


@dataclass(frozen=True)
class Distribution:
    """Distribution of a parameter.

    Attributes:
        name: name of the parameter.
        shape: "uniform", from a to b, or "normal", of mean a and standard deviation b, cut at three of them.
        a, b: numbers of the distribution in SI units, or multiples of each vehicle's own value.
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


@dataclass(frozen=True)
class Draws:
    """The numbers that a campaign draws.

    Attributes:
        vehicles: parameters of every vehicle, by sample: values by name. One empty sample where none are drawn.
        laws: values by key for each variant, of every vehicle and controller whose law is drawn.
        seed: seed of the draws.
    """

    vehicles: Mapping[str, tuple[Mapping[str, float], ...]]
    laws: Mapping[str, Mapping[str, tuple[Mapping[str, float], ...]]]
    seed: int = 0


def read_samples(section: Any, vehicles: Mapping[str, Vehicle], controllers: Sequence[str] = ()) -> Draws:
    """Returns the samples of every vehicle, and the variants of the controllers' laws."""
    if section is None:
        return Draws({name: ({},) for name in vehicles}, {name: {} for name in vehicles})
    if not isinstance(section, dict):
        raise InputError("'samples' is not a section; write it as [samples]")
    check_keys("[samples]", section, SAMPLES)
    if "count" not in section:
        raise InputError(f"[samples] 'count' is missing; give how many samples, an integer from 1 to {MOST_RUNS}")
    count, method = _count(section, "count"), section.get("method", "latin_hypercube")
    if method not in METHODS:
        raise InputError(f"[samples] method = {quoted(method)} is unknown; give one of {listing(METHODS)}")
    drawn = [key for key in DRAWN if key in section]
    if not drawn or not all(isinstance(section[key], dict) and section[key] for key in drawn):
        raise InputError(
            "[samples] samples no parameters; write [samples.parameters] with NAME = { uniform = [low, high] }, or "
            "[samples.controllers.NAME] with keys of that controller's law"
        )
    if "variants" in section and len(drawn) < len(DRAWN):
        raise InputError(
            "[samples] variants is for samples of both parameters and controllers, and only one of both is sampled; omit it"
        )
    variants = _count(section, "variants") if "variants" in section else count
    seed = check_seed(section.get("seed", 0))
    of_vehicles = {name: ({},) for name in vehicles}
    if "parameters" in section:
        of_vehicles = _vehicle_samples(section["parameters"], vehicles, method, count, seed)
    of_laws: dict[str, dict[str, tuple[Mapping[str, float], ...]]] = {name: {} for name in vehicles}
    for written, table in section.get("controllers", {}).items():
        controller = unicodedata.normalize("NFC", written)
        if controller not in controllers:
            raise InputError(
                f"[samples.controllers] {quoted(controller)} is not a controller of the campaign; it has {listing(controllers)}"
            )
        for name, vehicle in vehicles.items():
            of_laws[name][controller] = _variants(controller, table, name, vehicle, method, variants, seed)
    return Draws(of_vehicles, of_laws, seed)


def _count(section: Mapping[str, Any], key: str) -> int:
    count = section[key]
    if isinstance(count, bool) or not isinstance(count, int) or not 1 <= count <= MOST_RUNS:
        raise InputError(f"[samples] {key} = {quoted(count)} is not allowed; give an integer from 1 to {MOST_RUNS}")
    return count


def _vehicle_samples(
    table: Mapping[str, Any], vehicles: Mapping[str, Vehicle], method: str, count: int, seed: int
) -> dict[str, tuple[Mapping[str, float], ...]]:
    """Returns the sampled parameters of every vehicle."""
    units = {part.name: part.unit for vehicle in vehicles.values() for part in vehicle.kind.parameters}
    distributions = [
        _distribution(f"[samples.parameters] {name}", name, entry, units.get(name, "")) for name, entry in table.items()
    ]
    for name, vehicle in vehicles.items():
        for distribution in distributions:
            _check_distribution(distribution, name, vehicle)
    samples = {}
    for name, vehicle in vehicles.items():
        samples[name] = _drawn(distributions, _values(vehicle), method, count, seed)
        for row in samples[name]:
            with error_in(f"[samples] a sample of vehicle {name!r} is not a valid vehicle:"):
                sampled = with_sample(vehicle, row)
                vehicle.kind.check(sampled.parameters)
                _ = sampled.adjustable  # which looks whether its dampers can be what they nominally are
    return samples


def _variants(
    controller: str, table: Any, name: str, vehicle: Vehicle, method: str, count: int, seed: int
) -> tuple[Mapping[str, float], ...]:
    """Returns the drawn keys of a controller's law."""
    where = f"[samples.controllers.{controller}]"
    if not isinstance(table, dict) or not table:
        raise InputError(f"{where} draws nothing; give keys of its law, as in sky_damping = {{ uniform = [500.0, 4000.0] }}")
    distributions = [_distribution(f"{where} {key}", key, entry) for key, entry in table.items()]
    own = {}
    for one in distributions:
        with error_in(f"{where} vehicle {name!r}:"):
            value = check_key(vehicle, controller, one.name)
        if one.relative and value is None:
            raise InputError(f"{where} {one.name} is relative, and vehicle {name!r} gives no {one.name}; omit relative")
        own[one.name] = value
        for end in one.ends:
            with error_in(f"{where} the distribution reaches an invalid value, for vehicle {name!r}:"):
                drawn_entry(vehicle, controller, {one.name: (value or 0.0) * end if one.relative else end})
    return _drawn(distributions, own, method, count, seed)


def _drawn(
    distributions: Sequence[Distribution], own: Mapping[str, float | None], method: str, count: int, seed: int
) -> tuple[Mapping[str, float], ...]:
    """Returns drawn values by name.

    Args:
        own: the vehicle file's values, of which relative ones are multiples.
    """
    unit = _unit_samples(method, len(distributions), count, seed)
    columns = [((own[one.name] or 0.0) if one.relative else 1.0) * one.value(unit[:, i]) for i, one in enumerate(distributions)]
    rows = np.stack(columns, axis=-1).tolist()
    return tuple(dict(zip([one.name for one in distributions], row, strict=True)) for row in rows)


def _unit_samples(method: str, dimensions: int, count: int, seed: int) -> Array:
    """Points of the unit cube, shape (count, dimensions)."""
    import warnings

    from scipy.stats import qmc  # half a second

    sampler = qmc.Sobol(dimensions, rng=np.random.default_rng(seed)) if method == "sobol" else None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # that counts are balanced only at powers of two
        return (sampler or qmc.LatinHypercube(dimensions, rng=np.random.default_rng(seed))).random(count)


def _distribution(where: str, name: str, entry: Any, unit: str = "") -> Distribution:
    example = f"as in {name} = {{ uniform = [0.8, 1.2], relative = true }}"
    if not isinstance(entry, dict):
        raise InputError(f"{where} = {quoted(entry)} is not a distribution; give one of {listing(DISTRIBUTIONS)}, {example}")
    shapes = [key for key in entry if key != "relative"]
    if len(shapes) != 1 or shapes[0] not in DISTRIBUTIONS or not isinstance(entry.get("relative", False), bool):
        raise InputError(
            f"{where} has {listing(entry)}; give one of {listing(DISTRIBUTIONS)}, and relative = true or false, {example}"
        )
    values = entry[shapes[0]]
    if not isinstance(values, list) or len(values) != 2:
        raise InputError(f"{where}: {shapes[0]} = {quoted(values)} is not two numbers, {example}")
    relative = entry.get("relative", False)
    a, b = (read_number(value, f"{where}: {shapes[0]}", -1e12, 1e12, "" if relative else unit) for value in values)
    if (a >= b) if shapes[0] == "uniform" else (b <= 0):
        raise InputError(
            f"{where}: {shapes[0]} = [{a:g}, {b:g}] spreads nothing; give low < high, or a standard deviation above 0"
        )
    return Distribution(name, shapes[0], a, b, relative)


def _check_distribution(distribution: Distribution, name: str, vehicle: Vehicle) -> None:
    """Refuses a parameter that a vehicle has not, and a distribution that reaches a value it cannot have."""
    parameters: dict[str, Parameter] = {parameter.name: parameter for parameter in vehicle.kind.parameters}
    own = _values(vehicle)
    if distribution.name not in own:
        raise InputError(f"[samples.parameters] vehicle {name!r} has no parameter {distribution.name!r}; it has {listing(own)}")
    scale = own[distribution.name] if distribution.relative else 1.0
    for end in distribution.ends:
        with error_in(f"[samples.parameters] the distribution reaches an invalid value, for vehicle {name!r}:"):
            if distribution.name in parameters:
                parameters[distribution.name].check(scale * end)
            else:
                read_number(scale * end, distribution.name, 0.0, LARGEST)


def _values(vehicle: Vehicle) -> dict[str, float]:
    """Returns the vehicle's values that can be sampled."""
    return {**vehicle.parameters, **{name: value for name, (value, _) in _of_dampers(vehicle).items()}}


def _of_dampers(vehicle: Vehicle) -> dict[str, tuple[float, list[str]]]:
    """Maps each sampled damper parameter to its value and forces: an entry per damper with a number, and one for all if equal."""
    quantities: dict[str, tuple[float, list[str]]] = {}
    for name in OF_DAMPERS:
        # A limit that is a curve is no number.
        curved = {one for one in vehicle.adjustable if name in CURVED and one.damper.pair is not None}
        values: dict[Adjustable, Any] = {one: None if one in curved else getattr(one.damper, name) for one in vehicle.adjustable}
        if len(set(values.values())) == 1:
            quantities[name] = (next(iter(values.values())), [one.force for one in values])
        quantities |= {f"{name}{one.ending}": (value, [one.force]) for one, value in values.items() if one.ending}
    return {name: (value, forces) for name, (value, forces) in quantities.items() if value is not None}


def read_number(value: Any, where: str, smallest: float, largest: float, unit: str = "") -> float:
    """Reads a number of a campaign file, within limits.

    Raises:
        InputError: the value is not a number, or beyond them.
    """
    return number_within(where, in_unit(value, unit, where), smallest, largest, unit)


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
