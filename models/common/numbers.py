"""Numbers as JSON and tables have them, and as names with values are written down."""

import math
from collections.abc import Iterable
from typing import Any

from models.common.errors import InputError, listing


def finite(value: Any) -> float | None:
    """A number as JSON has it: None for what is infinite or does not exist."""
    return float(value) if value is not None and math.isfinite(value) else None


def finite_pairs(values: Iterable[complex]) -> list[list[float | None]]:
    """Complex numbers as JSON has them: [real, imaginary]."""
    return [[finite(value.real), finite(value.imag)] for value in values]


def cell(value: float | None, form: str, unit: str = "") -> str:
    """A number as a table has it, "-" for one that is infinite or does not exist."""
    return f"{value:{form}}{unit}" if value is not None and math.isfinite(value) else "-"


def percent(share: float) -> str:
    """A share in percent; what rounding leaves is 0."""
    if share <= 1e-9:
        return "0 %"
    return f"{100 * share:.2g} %" if share < 0.995 else f"{100 * share:.0f} %"


def settings(text: str, allowed: Iterable[str]) -> dict[str, str]:
    """`:NAME=VALUE:NAME=VALUE`, each name once.

    Raises:
        InputError: it is not that.
    """
    found: dict[str, str] = {}
    for setting in text.split(":")[1:]:
        name, equals, value = setting.partition("=")
        if not equals or name not in allowed:
            raise InputError(f"{setting!r} is not NAME=VALUE with a NAME out of {listing(allowed)}")
        if name in found:
            raise InputError(f"{name} is given twice, {found[name]!r} and {value!r}; give it once")
        found[name] = value
    return found
