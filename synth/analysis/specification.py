"""One thing that is promised of a controller beside its certificate, and the norm of a loop that a computer closes, enclosed."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.common.printed import finite

SAME = 1e-9  # relative: what rounding leaves of a bound that is met


@dataclass(frozen=True)
class Promise:
    """A number that a controller was designed for, or is judged by.

    Attributes:
        what: it is of, in words.
        value: the largest that is known to occur, or the least that is left of what has to be large.
        proved: what it proves to stay below; None where the value is exact to rounding.
        at_most: what is allowed; None where it is minimised, and nothing is.
        unit: of all three.
        where: it occurs, in words; empty where nothing is to say.
    """

    what: str
    value: float
    proved: float | None = None
    at_most: float | None = None
    unit: str = ""
    where: str = ""

    @property
    def holds(self) -> bool:
        """Whether what is proved, or the value itself where that is exact, keeps what is allowed."""
        known = self.value if self.proved is None else self.proved
        return bool(known < float("inf") if self.at_most is None else known <= self.at_most + SAME * abs(self.at_most))

    @property
    def text(self) -> str:
        """On one line."""
        unit = f" {self.unit}" if self.unit else ""
        proved = "" if self.proved is None else f", proved to be at most {digits(self.proved)}{unit}"
        if self.proved is not None and digits(self.proved) == digits(self.value):
            proved = ", proved"
        allowed = "" if self.at_most is None else f"; at most {digits(self.at_most)}{unit} is allowed"
        where = f" ({self.where})" if self.where else ""
        return f"{self.what} {digits(self.value)}{unit}{where}{proved}{allowed}"

    @property
    def record(self) -> dict[str, Any]:
        """As JSON has it; None for what is infinite or does not exist."""
        return {
            "promise": self.what,
            "value": finite(self.value),
            "proved": finite(self.proved) if self.proved is not None else None,
            "at_most": self.at_most,
            "unit": self.unit,
            "where": self.where,
            "holds": self.holds,
        }


def digits(value: float) -> str:
    """Seven digits, as norms have in the table."""
    return f"{value:.7g}"


ABOVE, BELOW = 1e-8, 1e-9  # relative: how far from the norm the levels are that are shown to lie on either side


@dataclass(frozen=True)
class SampledNorm:
    """The L2 gain of a sampled loop.

    Attributes:
        value: of it; infinite where the loop is not stable.
        lower: a level that it is above.
        upper: a level that it is below.
        angle: by which the worst disturbance turns from sample to sample [rad], 0 to pi; NaN where there is none such.
        reached: the gain of an actual disturbance, computed by another route (`sampled_norm.py`): it is no more than the norm.
        inside: whether what happens within one period, which no force answers, decides: no controller at this rate does better.
        by_sweep: whether `upper` was seen at frequencies alone, as there are too many states for eigenvalues.
    """

    value: float
    lower: float
    upper: float
    angle: float
    reached: float
    inside: bool = False
    by_sweep: bool = False

    @property
    def stable(self) -> bool:
        """Whether there is one."""
        return math.isfinite(self.value)

    @property
    def gap(self) -> float:
        """By how much what was reached falls short of the norm, relative: the distance of two routes."""
        return abs(self.value - self.reached) / self.value if 0 < self.value < np.inf else 0.0
