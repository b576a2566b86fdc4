"""Specifications of a controller, and the norm of a sampled-data loop with two levels that enclose this norm."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.common.printed import digits, finite
from models.document.field import Field

# key of the norm of the sampled-data loop in records; the norm is checked if the file describes an implementation
SAMPLED_NORM = "sampled_norm"
# names of the specifications for frequency-weighted uncertainties
ROBUST = ROBUST_STABILITY, ROBUST_PERFORMANCE = "robust stability (mu)", "robust performance (mu)"
SAME = 1e-9  # relative tolerance for rounding when a value is compared with its limit


@dataclass(frozen=True)
class Specification:
    """Quantity for which a controller was designed or by which a controller is evaluated, with the value and the limit of this
    quantity.

    Attributes:
        what: name of the quantity.
        value: largest known value of the quantity.
        proved: proved upper bound on the quantity; None if `value` is exact up to rounding.
        at_most: largest allowed value of the quantity; None if the quantity is minimised.
        unit: unit of `value`, `proved` and `at_most`.
        where: description of the case in which `value` occurs; may be empty.
        proof: type of the proof, and whether the proof is exact or was computed twice; empty unless the quantity concerns
            uncertainties.
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
        """True if the proved bound does not exceed the limit; without a bound, the exact value is compared with the limit."""
        known = self.value if self.proved is None else self.proved
        return bool(known < float("inf") if self.at_most is None else known <= self.at_most + SAME * abs(self.at_most))

    @property
    def proved_text(self) -> str:
        """Proved upper bound on the quantity, as text."""
        how = f" ({self.proof})" if self.proof else ""
        return "exact" if self.proved is None else "not proved" if self.proved == math.inf else f"{digits(self.proved)}{how}"

    @property
    def text(self) -> str:
        """One-line description of the specification."""
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
        """Specification as JSON; absent and infinite numbers are None."""
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


FREQUENCY = Field[float]("frequency", float, ".5g", unit="rad/s")  # frequency of the peak or of the crossover
ABOVE, BELOW = 1e-8, 1e-9  # relative distances of the two levels above and below the norm


@dataclass(frozen=True)
class SampledNorm:
    """L2 gain of a sampled-data loop.

    Attributes:
        value: L2 gain; infinite if the loop is not stable.
        lower: level of the gain just below `value`.
        upper: level of the gain just above `value`.
        angle: phase advance of the worst disturbance per sample [rad], from 0 to pi; NaN if the worst disturbance has no such
            angle.
        reached: gain for an actual disturbance, computed by a second method (`sampled_norm.py`); this gain does not exceed the
            norm.
        inside: True if a disturbance within one period already causes the largest gain; then no controller with this sample
            rate can reduce the gain.
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
        """Relative difference between the results of the two methods."""
        return abs(self.value - self.reached) / self.value if 0 < self.value < np.inf else 0.0
