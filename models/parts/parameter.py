"""A number of a vehicle file: its unit, its range, and how far it varies from vehicle to vehicle."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from models.common.errors import InputError, quoted

SMALLEST, LARGEST = 1e-6, 1e12  # SI; beyond these a parameter is a slip of the pen, and rounding decides


@dataclass(frozen=True)
class Variation:
    """How far other vehicles of a kind may be from the one that a controller was designed for.

    Attributes:
        name: of what varies, in words. Parameters with the same variation vary together.
        smallest, largest: factors on the parameter, at most 1 and at least 1.

    Raises:
        InputError: they are none.
    """

    name: str
    smallest: float
    largest: float

    def __post_init__(self) -> None:
        if not (0 < self.smallest <= 1 <= self.largest <= LARGEST and self.smallest < self.largest):
            raise InputError(
                f"{self.name} varies by factors from {self.smallest:g} to {self.largest:g}; give one above 0 and at most 1, and "
                "a larger one that is at least 1"
            )

    def __str__(self) -> str:
        low, high = (100 * (factor - 1) for factor in (self.smallest, self.largest))
        return f"{self.name} {low:+.4g} to {high:+.4g} %"


@dataclass(frozen=True)
class Parameter:
    """One number of a vehicle file.

    Attributes:
        name: key under `[parameters]`.
        unit: SI unit.
        meaning: one line.
        positive: whether zero is refused too. Negative, infinite, NaN and absurdly large values always are.
        varied: how far it varies where a controller's robustness is asked for; None where it is taken as it is.
        largest: that is allowed.
        usual: what it is where a vehicle file does not say; None where every file must.
    """

    name: str
    unit: str
    meaning: str
    positive: bool = True
    varied: Variation | None = None
    largest: float = LARGEST
    usual: float | None = None

    def check(self, value: Any) -> float:
        """The value as a float.

        Raises:
            InputError: not a number of the allowed range.
        """
        smallest = SMALLEST if self.positive else 0.0
        allowed = f"a number from {smallest:g} to {self.largest:g} {self.unit}"
        if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
            raise InputError(f"{self.name} = {quoted(value)} is not a number; give {allowed}")
        if not smallest <= value <= self.largest:  # NaN is in no range
            raise InputError(f"{self.name} = {quoted(value)} is not allowed; give {allowed}")
        return float(value)


def is_number(value: Any) -> bool:
    """Whether it is a number that a vehicle file may hold."""
    return is_within(value, LARGEST)


def is_within(value: Any, most: float) -> bool:
    """Whether it is a number of at most that size."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and -most <= value <= most  # NaN is not
