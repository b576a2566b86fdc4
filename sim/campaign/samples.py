"""Section `[samples]` of a campaign file: distributions of vehicle parameters and of parameters of control laws.

Vehicle parameters and the parameters of control laws are sampled independently. Every variant of a control law is simulated
with every sample of the vehicle over the same roads, so that only the law differs between variants.
"""

import unicodedata
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, error_in, list_names, short_repr
from models.common.schema import MOST_SEED, SI, AnyTable, Choice, Integer, Section, read
from models.vehicle.vehicle import Vehicle
from sim.campaign import MOST_RUNS
from sim.campaign.law_keys import drawn_entry, law_values
from sim.runs.sampled_vehicle import damper_numbers, with_sample

METHODS = ("latin_hypercube", "sobol")
DISTRIBUTIONS = ("uniform", "normal")
WIDEST = 3.0  # normal distributions are truncated at this many standard deviations

Values = Mapping[str, float]  # maps the name of each sampled quantity to its value


@dataclass(frozen=True)
class SamplesSection(Section):
    """Keys of the section `[samples]` of a campaign file."""

    count: Annotated[int, Integer("number of samples of every vehicle", 1, MOST_RUNS)]
    variants: Annotated[int, Integer("number of variants of every law; default: count", 1, MOST_RUNS)] | None = None
    method: Annotated[str, Choice("method of drawing", METHODS)] = METHODS[0]
    seed: Annotated[int, Integer("seed of samples and variants", high=MOST_SEED)] = 0
    parameters: Annotated[Mapping[str, Any], AnyTable("distributions of parameters of the vehicles")] | None = None
    controllers: Annotated[Mapping[str, Any], AnyTable("distributions of the keys of laws, by controller")] | None = None


@dataclass(frozen=True)
class Sampler:
    """Random sampling of vehicle and control-law parameters.

    Attributes:
        count: number of samples to draw.
        method: sampling method, one of `METHODS`.
        seed: seed of the random numbers from which samples are drawn.
    """

    count: int
    method: str
    seed: int

    def draw(
        self,
        where: str,
        table: Mapping[str, Any],
        own: Mapping[str, float | None],
        check: Callable[[str, float], object],
        units: Mapping[str, str],
    ) -> tuple[Values, ...]:
        """Returns `count` samples of the parameters in a table, each with values by name.

        Args:
            where: section that contains the table, and name of the vehicle, for error messages.
            table: distributions of the sampled parameters, by name of the parameter.
            own: value in the vehicle file for each parameter that can be sampled; None for a parameter without a value in this
                file. Relative distributions are multiples of the values in the vehicle file.
            check: function that raises InputError if a sampled value is not allowed.
            units: units of the parameters that have a unit, by name.

        Raises:
            InputError: the table contains an unknown parameter or an invalid distribution, or a distribution contains invalid
                values.
        """
        quantiles: dict[str, Callable[[Array], Array]] = {}
        scales: dict[str, float] = {}
        for name, entry in table.items():
            relative, ends, quantiles[name] = _distribution(f"{where} {name}", name, entry, units.get(name, ""))
            if name not in own:
                raise InputError(f"{where} {short_repr(name)} cannot be sampled; sample one of {list_names(own)}")
            value = own[name]
            if relative and value is None:
                raise InputError(
                    f"{where} the vehicle file gives no value of {name}, so the distribution cannot be relative to this "
                    "value; omit relative"
                )
            scales[name] = value if relative and value is not None else 1.0
            for end in ends:
                with error_in(f"{where} the distribution of {name} contains a value that is not allowed:"):
                    check(name, scales[name] * end)
        columns = zip(scales, self._unit_samples(len(scales)).T, strict=True)
        rows = np.stack([scales[name] * quantiles[name](unit) for name, unit in columns], axis=-1).tolist()
        return tuple(dict(zip(scales, row, strict=True)) for row in rows)

    def _unit_samples(self, dimensions: int) -> Array:
        """Returns the points at which the quantile functions are evaluated, in the unit cube, shape (count, dimensions)."""
        from scipy.stats import qmc  # imported here because the import takes half a second

        engine = qmc.Sobol if self.method == "sobol" else qmc.LatinHypercube
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # SciPy warns if the count is not a power of two
            return engine(dimensions, rng=np.random.default_rng(self.seed)).random(self.count)


def read_samples(
    section: Any, vehicles: Mapping[str, Vehicle], controllers: Sequence[str] = ()
) -> tuple[dict[str, tuple[Values, ...]], dict[str, dict[str, tuple[Values, ...]]], int]:
    """Reads the section `[samples]`.

    Args:
        section: content of the section `[samples]`; None if the campaign file does not have this section.
        vehicles: vehicles of the campaign by name.
        controllers: names of the controllers of the campaign.

    Returns:
        Samples by vehicle (a single empty sample if no parameter is sampled), variants by vehicle and controller (only for laws
        with sampled parameters), and the seed.
    """
    of_vehicles: dict[str, tuple[Values, ...]] = {name: ({},) for name in vehicles}
    of_laws: dict[str, dict[str, tuple[Values, ...]]] = {name: {} for name in vehicles}
    if section is None:
        return of_vehicles, of_laws, 0
    given = read("[samples]", SamplesSection, section)
    if not (given.parameters or given.controllers) or given.parameters == {} or given.controllers == {}:
        raise InputError(
            "[samples] names no quantity to sample; write [samples.parameters] with NAME = "
            "{ uniform = [low, high] }, or [samples.controllers.NAME] with keys of this controller's law"
        )
    sampler = Sampler(given.count, given.method, given.seed)
    for name in vehicles if given.parameters else ():
        of_vehicles[name] = _vehicle_samples(given.parameters or {}, name, vehicles[name], sampler)
    sampler = replace(sampler, count=given.count if given.variants is None else given.variants)
    for written, table in (given.controllers or {}).items():
        controller = unicodedata.normalize("NFC", written)
        if controller not in controllers:
            raise InputError(
                f"[samples.controllers] the campaign has no controller {short_repr(controller)}; it has {list_names(controllers)}"
            )
        for name, vehicle in vehicles.items():
            of_laws[name][controller] = _variants(controller, table, name, vehicle, sampler)
    return of_vehicles, of_laws, sampler.seed


def _vehicle_samples(table: Mapping[str, Any], name: str, vehicle: Vehicle, sampler: Sampler) -> tuple[Values, ...]:
    """Returns the samples of a vehicle's parameters."""
    parameters = {parameter.name: parameter for parameter in vehicle.kind.parameters}
    elements = {key: one for element in vehicle.elements for key, one in element.numbers.items()}
    own = {**vehicle.parameters, **{damper: value for damper, (value, _) in damper_numbers(vehicle).items()}}
    own |= {key: value for key, (value, _) in elements.items()}

    def check(key: str, value: float) -> None:
        if key in parameters:
            parameters[key].check(value)
        elif key in elements:
            elements[key][1].number(key, value)
        else:
            SI("", low=0.0).number(key, value)

    units = {key: parameter.unit for key, parameter in parameters.items()}
    units |= {key: one.unit for key, (_, one) in elements.items()}
    samples = sampler.draw(f"[samples.parameters] vehicle {name!r}:", table, own, check, units)
    for sample in samples:
        with error_in(f"[samples] vehicle {name!r}: sampled values do not fit together:"):
            sampled = with_sample(vehicle, sample)
            vehicle.kind.check(sampled.parameters)
            _ = sampled.parts  # raises InputError if a semi-active damper cannot produce its nominal damping coefficient
    return samples


def _variants(controller: str, table: Any, name: str, vehicle: Vehicle, sampler: Sampler) -> tuple[Values, ...]:
    """Returns the variants of a control law: for each variant, the sampled values by key."""
    where = f"[samples.controllers.{controller}]"
    if not isinstance(table, dict) or not table:
        raise InputError(
            f"{where} gives no key of the law to sample; add a key with its distribution, as in sky_damping = {{ "
            "uniform = [500.0, 4000.0] }"
        )
    where += f" vehicle {name!r}:"
    with error_in(where):
        own = law_values(vehicle, controller)
    return sampler.draw(where, table, own, lambda key, value: drawn_entry(vehicle, controller, {key: value}), {})


def _distribution(where: str, name: str, entry: Any, unit: str) -> tuple[bool, tuple[float, float], Callable[[Array], Array]]:
    """Reads a distribution.

    Returns:
        Whether the distribution is relative to the value in the vehicle file; the smallest and largest value of the
        distribution; and its quantile function.
    """
    give = f"give {name} = {{ uniform = [low, high] }} or {{ normal = [mean, deviation] }}; relative = true may be added"
    relative = entry.get("relative", False) if isinstance(entry, dict) else None
    shapes = [key for key in entry if key != "relative"] if isinstance(relative, bool) else []
    relative = bool(relative)
    values = entry[shapes[0]] if len(shapes) == 1 and shapes[0] in DISTRIBUTIONS else None
    if not isinstance(values, list) or len(values) != 2:
        raise InputError(f"{where} = {short_repr(entry)} is not a distribution; {give}")
    a, b = (SI("" if relative else unit, low=-1e12, high=1e12).number(f"{where}: {shapes[0]}", value) for value in values)
    if (a >= b) if shapes[0] == "uniform" else (b <= 0):
        empty = "is an empty range; give a low value below the high value"
        fault = empty if shapes[0] == "uniform" else "has no positive deviation; give a standard deviation above 0"
        raise InputError(f"{where}: {shapes[0]} = [{a:g}, {b:g}] {fault}")
    from scipy import stats  # imported here because the import takes half a second

    if shapes[0] == "uniform":
        return relative, (a, b), stats.uniform(a, b - a).ppf
    return relative, (a - WIDEST * b, a + WIDEST * b), stats.truncnorm(-WIDEST, WIDEST, a, b).ppf
