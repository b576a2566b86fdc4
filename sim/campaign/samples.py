"""The samples of a campaign: parameters of a vehicle that vary, by which distribution, and the vehicles that come of it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, listing, quoted
from models.damping.adjustable import Adjustable
from models.damping.damper import CURVED, LARGEST
from models.kind import Parameter
from models.roads.iso8608 import check_seed
from models.vehicle import Vehicle

SAMPLES = ("count", "method", "seed", "parameters")
METHODS = ("latin_hypercube", "sobol")
DISTRIBUTIONS = ("uniform", "normal")
OF_DAMPERS = (*CURVED, "bandwidth")  # of [actuators], which are sampled, too
WIDEST = 3.0  # standard deviations; a normal distribution is cut there
MOST_RUNS = 10_000_000


@dataclass(frozen=True)
class Distribution:
    """How a parameter is spread.

    Attributes:
        name: of the parameter.
        shape: "uniform", from a to b, or "normal", of mean a and standard deviation b, cut at three of them.
        a, b: in SI; multiples of each vehicle's own value where relative.
        relative: whether they are.
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
        """Its quantiles, for shares in 0 to 1."""
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
    """What can be sampled of a vehicle, and what it has."""
    return {**vehicle.parameters, **{name: value for name, (value, _) in _of_dampers(vehicle).items()}}


def _of_dampers(vehicle: Vehicle) -> dict[str, tuple[float, list[str]]]:
    """What can be sampled of adjustable dampers, and the forces whose it is: of each that has a number, of all that share one."""
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
    """A number of a campaign file, within limits.

    Raises:
        InputError: it is none, or beyond them.
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
    """Of the names at the suspension that a force belongs to."""
    return next(one.ending for one in vehicle.adjustable if one.force == force)
