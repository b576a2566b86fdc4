"""`[performance]` of a vehicle file: the rows of the controlled output z (34).

Each row of z is a weighted signal or a weighted sum of signals.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from models.common.checks import is_finite
from models.common.errors import InputError, list_names
from models.common.extensions import FEATURES
from models.common.schema import SI, read

if TYPE_CHECKING:
    from models.laws.filter import Filter

ROAD = "road"  # name of the filter from the disturbance w to the road velocity
# Allowed range of the ratio of two weights; outside this range, rounding errors dominate
SMALLEST_WEIGHT, LARGEST_WEIGHT = 1e-12, 1e12


@dataclass(frozen=True)
class WeightedSum:
    """Row of z: a weighted sum of signals, optionally with a filter.

    Attributes:
        name: name of the sum; for a single signal, name of the signal.
        weight: weight of the sum, above 0.
        terms: factor of each signal in the sum.
        filter: filter from the weighted sum to z; None for a row without a filter.
    """

    public_name = "a weighted sum, such as one of vehicle.sums"

    name: str
    weight: float
    terms: Mapping[str, float]
    filter: "Filter | None" = None

    @property
    def text(self) -> str:
        """The weighted sum as a formula with the names of the signals."""
        return " + ".join(f"{factor:g} {signal}" for signal, factor in self.terms.items()).replace("+ -", "- ")


class Weight(SI):
    """Key whose value is a weight: 0, or a number in the allowed range of weights."""

    def number(self, what: str, value: Any) -> float:
        """Returns the weight. `what` is the name of the weight in error messages."""
        least = 0.0 if is_finite(value) and value == 0 else SMALLEST_WEIGHT
        more = ', or 0, or a weight with a filter, as in { weight = 1.0, filter = "iso2631_wk" }'
        return SI(self.unit, "", least, self.high, more).number(what, value)


WEIGHT = Weight("", "weight in the performance output, per SI unit of the signal", 0.0, LARGEST_WEIGHT)


def read_performance(section: Mapping[str, Any], outputs: Sequence[str]) -> dict[str, Any]:
    """Reads `[performance]` and returns the attributes `performance`, `filters`, `sums` and `road_filter` of a `Vehicle`.

    Args:
        section: the section `[performance]`.
        outputs: names of the signals that can be weighted.

    Raises:
        InputError: a signal is unknown, a weight or filter is not allowed, or no weight is above 0.
    """
    weights, filters, sums, road_filter = dict[str, float](), dict[str, "Filter"](), list[WeightedSum](), None
    for name, given in section.items():
        where = f"[performance] {name}"
        if name == ROAD:
            road_filter = read(where, FEATURES.load("weights with filters").FilterSection, given).shape
            continue
        if not isinstance(given, Mapping):
            weights[name] = WEIGHT.number(where, given)
            continue
        one = read(where, FEATURES.load("weights with filters").WeightSection, given, outputs=outputs)
        if one.sum is None:
            weights[name] = one.weight
            filters |= {name: one.shape} if one.shape is not None and one.weight else {}
        elif name in outputs:
            raise InputError(f"{where} is already the name of a signal; give the sum a different name")
        elif one.weight:
            sums.append(WeightedSum(name, one.weight, one.sum, one.shape))
    check_weights(weights, sums, outputs)
    return {"performance": weights, "filters": filters, "sums": tuple(sums), "road_filter": road_filter}


def check_weights(weights: Mapping[str, float], sums: Sequence[WeightedSum], outputs: Sequence[str]) -> None:
    """Raises InputError if a weighted signal is unknown, or if no weight is above 0."""
    for name in weights:
        if name not in outputs:
            raise InputError(
                f"[performance] unknown signal {name!r}; give one of {list_names(outputs)}. To filter the road "
                f"velocity, give a table called {ROAD!r}, and to weight a sum of signals, give a table with the key sum under "
                "a new name"
            )
    if not any(weights.values()) and not sums:
        raise InputError(
            "[performance] has no weight above 0, so no signal counts; give a weight above 0 to at least one of "
            f"{list_names(outputs)}"
        )
