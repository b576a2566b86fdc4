"""Specifications of a controller, and the norm of a sampled loop between two levels."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.common.printed import digits, finite
from models.document.field import Field

SAMPLED_NORM = "sampled_norm"  # of the sampled loop, in records; checked if the implementation is known
ROBUST = ROBUST_STABILITY, ROBUST_PERFORMANCE = "robust stability (mu)", "robust performance (mu)"  # of weighted errors
SAME = 1e-9  # relative: rounding of a bound that is just satisfied


@dataclass(frozen=True)
class Specification:
    """A quantity for which a controller was designed, or by which it is evaluated.

    Attributes:
        what: name of the quantity.
        value: largest known value.
        proved: upper bound that is proved; None if the value is exact to rounding.
        at_most: largest allowed value; None if the quantity is minimised.
        unit: unit of all three values.
        where: place where the value occurs, or empty.
        proof: kind of the proof, and if it is exact or computed twice; empty for other proofs than those of errors.
    """

    what: str
    value: float
    proved: float | None = None
    at_most: float | None = None
    unit: str = ""
    where: str = ""
    proof: str = ""

    @property
    def holds(self) -> bool:
        """True if the proved bound, or the exact value, is allowed."""
        known = self.value if self.proved is None else self.proved
        return bool(known < float("inf") if self.at_most is None else known <= self.at_most + SAME * abs(self.at_most))

    @property
    def proved_text(self) -> str:
        """The proved upper bound as text."""
        how = f" ({self.proof})" if self.proof else ""
        return "exact" if self.proved is None else "not proved" if self.proved == math.inf else f"{digits(self.proved)}{how}"

    @property
    def text(self) -> str:
        """The specification on one line."""
        unit = f" {self.unit}" if self.unit else ""
        proved = "" if self.proved is None else f", which is proved to be at most {digits(self.proved)}{unit}"
        if self.proved == math.inf:
            proved = ", but no bound is proved"
        elif self.proved is not None and digits(self.proved) == digits(self.value):
            proved = ", proved"
        proved += f" ({self.proof})" if self.proof and proved and self.proved != math.inf else ""
        allowed = "" if self.at_most is None else f"; at most {digits(self.at_most)}{unit} is allowed"
        where = f" ({self.where})" if self.where else ""
        return f"{self.what} is {digits(self.value)}{unit}{where}{proved}{allowed}"

    @property
    def record(self) -> dict[str, Any]:
        """The specification as JSON, None for absent or infinite numbers."""
        return {
            "promise": self.what,
            "value": finite(self.value),
            "proved": finite(self.proved) if self.proved is not None else None,
            "at_most": self.at_most,
            "unit": self.unit,
            "where": self.where,
            "holds": self.holds,
            "proof": self.proof or None,
        }


FREQUENCY = Field[float]("frequency", float, ".5g", unit="rad/s")  # of a peak or a crossover
ABOVE, BELOW = 1e-8, 1e-9  # relative distances of the enclosing levels from the norm


@dataclass(frozen=True)
class SampledNorm:
    """The L2 gain of a sampled loop.

    Attributes:
        value: the gain; infinite if the loop is not stable.
        lower: a level below the gain.
        upper: a level above the gain.
        angle: phase advance of the worst disturbance per sample [rad], 0 to pi; NaN if no angle is the worst.
        reached: gain of an actual disturbance, by a second route (`sampled_norm.py`); at most the norm.
        inside: True if the largest gain occurs within one period: no controller at this rate does better.
    """

    value: float
    lower: float
    upper: float
    angle: float
    reached: float
    inside: bool = False

    @property
    def stable(self) -> bool:
        """True if the loop is stable."""
        return math.isfinite(self.value)

    @property
    def gap(self) -> float:
        """Relative difference between the two routes."""
        return abs(self.value - self.reached) / self.value if 0 < self.value < np.inf else 0.0
