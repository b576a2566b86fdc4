"""Bisection on growth or decay: the smallest amount of something that makes a loop unstable in MuJoCo.

Runs on either side of it, all of one round in one batch; the two neighbours that differ are brought together. What is expected
only says where to look first: it is given up where physics says otherwise.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from sim.stability.growth import Growth, Trial, grow, silent

GAIN_WIDTH = 2e-3  # relative; how far a real number is narrowed down


@dataclass(eq=False)
class Search:
    """For the smallest amount of something that makes the loop unstable.

    Attributes:
        trial: amount -> the run that tells.
        expected: where to look first; infinite where no amount is expected to matter.
        most: the largest amount to try then.
        step: amounts are its multiples; 0 where they are real numbers.
        tried: amount -> what became of it. Zero is taken to decay: that is the loop as it is.
    """

    trial: Callable[[float], Trial]
    expected: float
    most: float
    step: float = 0.0
    tried: dict[float, Growth] = field(default_factory=dict)

    @property
    def stable(self) -> float:
        """The largest amount below every one that grows that is known to decay."""
        return max((amount for amount, one in self.tried.items() if not one.grows and amount < self.unstable), default=0.0)

    @property
    def unstable(self) -> float:
        """The smallest amount that grows; infinite where none does."""
        return min((amount for amount, one in self.tried.items() if one.grows), default=math.inf)

    @property
    def found(self) -> float:
        """The middle of the two, for a real number."""
        return math.sqrt(self.stable * self.unstable)

    def next(self) -> list[float]:
        """The amounts to try next; none where the answer is known."""
        if not self.tried:
            if math.isfinite(self.expected):
                near = 1.2 * self.step or GAIN_WIDTH / 2.1 * self.expected
                amounts = [share * self.expected for share in (0.25, 0.6, 0.9, 0.98, 1.02, 1.2)]
                # On the verge itself nothing is to be seen, and its two neighbours are near enough to each other.
                verge = [self.expected] if self.step else []
                return self._multiples([*amounts, self.expected - near, *verge, self.expected + near])
            smallest = self.step or self.most / 32
            return self._multiples(np.geomspace(smallest, self.most, 7).tolist())
        if math.isinf(self.unstable):
            reach = max(self.tried)
            return self._multiples([1.5 * reach, 2.5 * reach, 4 * reach]) if reach < min(8 * self.expected, self.most) else []
        narrow = self.step * 1.5 if self.step else GAIN_WIDTH * self.unstable
        if self.unstable - self.stable <= narrow:
            return []
        return self._multiples(np.linspace(self.stable, self.unstable, 10)[1:-1].tolist())

    def _multiples(self, amounts: Sequence[float]) -> list[float]:
        if self.step:
            amounts = [max(1, round(amount / self.step)) * self.step for amount in amounts]
        return sorted(set(amounts) - set(self.tried))


def run_searches(searches: Sequence[Search], timestep: float, progress: Callable[[str], None] = silent) -> None:
    """Runs searches to their ends, one round of all of them in one batch."""
    while asked := [(search, amount) for search in searches for amount in search.next()]:
        for (search, amount), growth in zip(asked, grow([s.trial(a) for s, a in asked], timestep, progress), strict=True):
            search.tried[amount] = growth
