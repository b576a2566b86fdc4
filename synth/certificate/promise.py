"""One thing that is promised of a controller beside its certificate: how large it is, how far proved, what is allowed."""

from dataclasses import dataclass
from typing import Any

from models.common.numbers import finite

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
