"""Errors of a controller's readings and forces that are weighted by frequency: a part of `tolerance` in its section.

tolerance = { force = { weight = { numerator = [3.0, 18.5], denominator = [1.0, 46.3] } } }
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from models.common.checks import number_within
from models.common.errors import InputError, listing, quoted
from models.common.schema import read
from models.laws.filter import Filter, FilterSection
from models.laws.goals import FORCE

SMALLEST, LARGEST = 1e-6, 1e6  # of a weight that is the same at all frequencies


@dataclass(frozen=True, eq=False)
class WeightedErrors:
    """Weights of dynamic errors: a force acts as u (1 + W Delta), and a reading as y (1 + W Delta), with any |Delta| <= 1.

    Attributes:
        weights: W by name of a measured signal or a force, or by `FORCE` for all forces.
    """

    weights: Mapping[str, Filter]

    def of_readings(self, measured: Sequence[str]) -> list[Filter | None]:
        """Returns the weight of each measured signal, or None if it has no error."""
        return [self.weights.get(name) for name in measured]

    def of_forces(self, forces: Sequence[str], measured: Sequence[str]) -> list[Filter | None]:
        """Returns the weight of each force, or None if it has no error. The name of a measured force is that of its reading."""
        return [self.weights.get(FORCE, None if name in measured else self.weights.get(name)) for name in forces]

    @property
    def record(self) -> dict[str, Any]:
        """The weights as in `tolerance` of a vehicle file."""
        return {name: {"weight": _record(one)} for name, one in self.weights.items()}


def read_weighted_errors(
    where: str, given: Mapping[str, Mapping[str, Any]], measured: Sequence[str], forces: Sequence[str], others: Collection[str]
) -> WeightedErrors:
    """Reads the entries of a `tolerance` that are tables.

    Args:
        given: entries of the section.
        others: names of its other entries.

    Raises:
        InputError: a name is unknown, or a weight is not allowed.
    """
    allowed = (*measured, *(force for force in forces if force not in measured), FORCE)
    weights = {}
    for name, table in given.items():
        if name not in allowed:
            raise InputError(f"{where} tolerance: unknown key {quoted(name)}; give {listing(allowed)} ({FORCE} is all forces)")
        if set(table) != {"weight"}:
            raise InputError(
                f"{where} tolerance of {name} = {quoted(dict(table))} is not allowed; give the largest relative error (0.1 for "
                "10 %), or { weight = { numerator = [...], denominator = [...] } } with coefficients in descending powers of s"
            )
        weights[name] = _weight(f"{where} tolerance of {name}", table["weight"])
    names = {*weights, *others}
    if FORCE in names and any(force in names for force in forces if force not in measured):
        raise InputError(f"{where} tolerance has both {FORCE}, which means all forces, and a single force; give one of the two")
    return WeightedErrors(weights)


def _weight(where: str, given: Any) -> Filter:
    if isinstance(given, Mapping):
        return read(f"{where} weight", FilterSection, given).shape
    more = ", or numerator and denominator as coefficients in descending powers of s"
    return Filter((((number_within(f"{where} weight", given, SMALLEST, LARGEST, more=more),), (1.0,)),))


def _record(one: Filter) -> dict[str, Any]:
    """Returns a filter as in a vehicle file."""
    if one.name:
        return {"filter": one.name}
    ((above, below),) = one.sections
    return {"numerator": list(above), "denominator": list(below)}
