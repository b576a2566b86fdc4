"""Bisection on growth or decay: the smallest amount of something that makes a loop unstable in MuJoCo.

Runs on either side of what is expected come first; where one decays and the other grows, that is the answer. Else runs all around
it, and the two neighbours that differ are brought together: physics decides. All of one round run side by side.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from sim.studies.stability.growth_test import Growth, Trial, grows, no_progress

GAIN_WIDTH = 2e-3  # relative; how far a real number is narrowed down
AROUND = 0.25, 0.6, 0.9, 0.98, 1.02, 1.2  # times what is expected


@dataclass(eq=False)
class Bisection:
    """For the smallest amount of something that makes the loop unstable.

    Attributes:
        trial: amount -> the run that tells.
        expected: amount to start from; infinite if no amount is expected to matter.
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
    def decided(self) -> bool:
        """Returns False if a run next to the answer does not show its slowest mode."""
        return all(one.decided for amount, one in self.tried.items() if amount in (self.stable, self.unstable))

    @property
    def found(self) -> float:
        """The middle of the two, for a real number; NaN if no run decides it."""
        return math.nan if not self.decided else math.sqrt(self.stable * self.unstable)

    def next(self) -> list[float]:
        """The amounts to try next; none where the answer is known."""
        if math.isinf(self.expected) and not self.tried:
            return self._multiples(np.geomspace(self.step or self.most / 32, self.most, 4)[1:].tolist())
        narrow = self.step * 1.5 if self.step else GAIN_WIDTH * self.unstable
        if math.isfinite(self.unstable) and self.unstable - self.stable <= narrow:
            return []
        if math.isfinite(self.expected):
            # Where physics says otherwise on either side of what is expected, all around it is looked at.
            around = self._sides() or self._multiples([share * self.expected for share in AROUND])
            if around:
                return around
        if math.isinf(self.unstable):
            reach = max(self.tried)
            return self._multiples([1.5 * reach, 2.5 * reach, 4 * reach]) if reach < min(8 * self.expected, self.most) else []
        return self._multiples(np.linspace(self.stable, self.unstable, 10)[1:-1].tolist())

    def _sides(self) -> list[float]:
        """Returns the untried values on either side of the expected one, within the resolution of the search."""
        if self.step:
            below = math.floor(self.expected / self.step)
            return self._multiples([below * self.step, (below + 1) * self.step])
        near = GAIN_WIDTH / 2.1 * self.expected
        return self._multiples([self.expected - near, self.expected + near])

    def _multiples(self, amounts: Sequence[float]) -> list[float]:
        if self.step:
            amounts = [max(1, round(amount / self.step)) * self.step for amount in amounts]
        return sorted(set(amounts) - set(self.tried))


def run_searches(searches: Sequence[Bisection], timestep: float, progress: Callable[[str], None] = no_progress) -> None:
    """Runs searches to their ends, one round of all of them in one batch."""
    while due := [(search, amount) for search in searches for amount in search.next()]:
        for (search, amount), growth in zip(due, grows([s.trial(a) for s, a in due], timestep, progress), strict=True):
            search.tried[amount] = growth
