"""`[performance]` of a vehicle file: what shall be small, by signal, and how much by frequency."""

from collections.abc import Mapping, Sequence
from typing import Any

from models.common.errors import InputError, listing, quoted
from models.filters.filter import KEYS, Filter, read_filter

ROAD = "road"  # the filter from the disturbance w to the road's velocity
SMALLEST_WEIGHT, LARGEST_WEIGHT = 1e-12, 1e12  # relative to one another; beyond these rounding decides


def read_performance(
    section: Mapping[str, Any], outputs: Sequence[str]
) -> tuple[dict[str, float], dict[str, Filter], Filter | None]:
    """The weights by signal, the filters of those that have one, and that of the road.

    Args:
        section: as it was read.
        outputs: the signals that can be weighed.

    Raises:
        InputError: a signal that is unknown, a weight or filter that is not allowed, or no weight at all.
    """
    weights, filters, road_filter = {}, {}, None
    for signal, given in section.items():
        where, weight = f"[performance] {signal}", given
        if signal == ROAD:
            if not isinstance(given, Mapping) or "weight" in given:
                raise InputError(f"{where} = {quoted(given)} is no filter; give it a numerator and a denominator, and no weight")
            _known_keys(where, given)
            road_filter = read_filter(where, given)
            continue
        if signal not in outputs:
            raise InputError(
                f"[performance] unknown signal {signal!r}; this vehicle has {listing(outputs)}; {ROAD!r} is the road's filter"
            )
        if isinstance(given, Mapping):
            _known_keys(where, given)
            filters[signal], weight = read_filter(where, given), given.get("weight", 1.0)
        real = isinstance(weight, (int, float)) and not isinstance(weight, bool)
        if not real or not (weight == 0 or SMALLEST_WEIGHT <= weight <= LARGEST_WEIGHT):
            raise InputError(
                f"{where} = {quoted(weight)} is not allowed; give 0 or a weight from {SMALLEST_WEIGHT:g} to {LARGEST_WEIGHT:g}, "
                'or one with a filter, as in { weight = 1.0, filter = "iso2631_wk" }'
            )
        weights[signal] = float(weight)
    if not any(weights.values()):
        raise InputError(f"[performance] weighs nothing; give at least one weight above 0 to: {listing(outputs)}")
    return weights, {signal: one for signal, one in filters.items() if weights[signal]}, road_filter


def _known_keys(where: str, given: Mapping[str, Any]) -> None:
    for key in given:
        if key not in KEYS:
            raise InputError(f"{where} unknown key {key!r}; a weight with a filter has {listing(KEYS)}")
