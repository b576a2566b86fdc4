"""Loads in a controller's section: weighted disturbances of its norm, beside the road."""

from collections.abc import Mapping, Sequence
from typing import Any

from models.common.errors import InputError, listing, number_range, quoted
from models.kinds.kind import LARGEST, SMALLEST, is_within
from models.kinds.signals import HEAVE_LOAD


def weighed_loads(where: str, section: Mapping[str, Any], loads: Sequence[str]) -> tuple[tuple[str, float], ...]:
    """Returns the size of each load [N, N m] that counts as much as 1 m/s of w, by name, from a section with loads.

    Raises:
        InputError: a load is unknown, or a value is not allowed.
    """
    given = section["loads"]
    if not isinstance(given, Mapping) or not given:
        raise InputError(f"{where} loads = {quoted(given)} is no table; give {{ load = so much as counts as 1 m/s of road }}")
    for name, value in given.items():
        if name not in loads:
            raise InputError(f"{where} loads: unknown load {name!r}; this vehicle has {listing(loads)}")
        if not (is_within(value, LARGEST) and value >= SMALLEST):
            allowed = number_range(SMALLEST, LARGEST, "N" if name.startswith(HEAVE_LOAD.name) else "N m")
            raise InputError(f"{where} loads: {name} = {quoted(value)} is not allowed; give {allowed}")
    return tuple((name, float(value)) for name, value in given.items())
