"""Loads in a controller's section: weighted disturbances of its norm, beside the road."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from models.common.errors import InputError, listing, quoted
from models.kinds.kind import LARGEST, SMALLEST, is_within

ALONE = ("design", "law", "semi_active", "sampled")  # keys of designs that know no loads


def weighed_loads(
    where: str, section: Mapping[str, Any], loads: Sequence[str], goals: Collection[str]
) -> tuple[tuple[str, float], ...]:
    """Returns the size of each load [N, N m] that counts as much as 1 m/s of w, by name, from a section with loads.

    Args:
        loads: the vehicle's loads.
        goals: keys of goals, whose designs know no loads either.

    Raises:
        InputError: a load is unknown, a value is not allowed, or the design knows no loads.
    """
    given = section["loads"]
    if not isinstance(given, Mapping) or not given:
        raise InputError(f"{where} loads = {quoted(given)} is no table; give {{ load = so much as counts as 1 m/s of road }}")
    for name, value in given.items():
        if name not in loads:
            raise InputError(f"{where} loads: unknown load {name!r}; this vehicle has {listing(loads)}")
        if not (is_within(value, LARGEST) and value >= SMALLEST):
            raise InputError(
                f"{where} loads: {name} = {quoted(value)} is not allowed; give a number from {SMALLEST:g} to {LARGEST:g}"
            )
    if others := [key for key in (*ALONE, *goals) if section.get(key)]:
        raise InputError(f"{where} has loads and {others[0]}, which knows no loads; leave one out")
    return tuple((name, float(value)) for name, value in given.items())
