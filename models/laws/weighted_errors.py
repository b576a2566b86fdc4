"""Uncertainties of a controller's measurements and forces with frequency-dependent weights, as part of `tolerance`.

tolerance = { force = { weight = { numerator = [3.0, 18.5], denominator = [1.0, 46.3] } } }
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from models.laws.filter import Filter
from models.laws.goals import FORCE


@dataclass(frozen=True, eq=False)
class WeightedErrors:
    """Weights that bound dynamic uncertainties.

    A force u acts as u (1 + W Delta), and a measurement y is received as y (1 + W Delta), where Delta is any transfer function
    with |Delta| <= 1.

    Attributes:
        weights: weight W of each uncertain quantity; the keys are names of measured signals and of forces, or `FORCE` for all
            forces.
    """

    weights: Mapping[str, Filter]

    def of_readings(self, measured: Sequence[str]) -> list[Filter | None]:
        """Returns the weight of each measured signal; None for a signal without uncertainty."""
        return [self.weights.get(name) for name in measured]

    def of_forces(self, forces: Sequence[str], measured: Sequence[str]) -> list[Filter | None]:
        """Returns the weight of each force; None for a force without uncertainty.

        If a controller measures a force, the key with the name of the force gives the weight of this measurement.
        """
        return [self.weights.get(FORCE, None if name in measured else self.weights.get(name)) for name in forces]

    @property
    def record(self) -> dict[str, Any]:
        """The weights in the form of `tolerance` in a vehicle file."""
        return {name: {"weight": _record(one)} for name, one in self.weights.items()}


def _record(one: Filter) -> dict[str, Any]:
    """Returns a filter in the form in which it is written in a vehicle file."""
    if one.name:
        return {"filter": one.name}
    ((above, below),) = one.sections
    return {"numerator": list(above), "denominator": list(below)}
