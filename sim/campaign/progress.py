"""How far a campaign is."""

import time
from collections.abc import Callable

from sim.campaign.plan import Plan

LOST = 3.0  # s of a worker's time in a batch, about: what an interruption may lose
FEWEST = 16  # runs in a batch all the same; 16 cost 11 % more than 192, each, 32 cost 5 %, 64 cost 2 %


class Progress:
    """How many runs are done, how fast, how long it will take, and how many the next batch should have."""

    def __init__(self, plan: Plan, total: int, most: int, tell: Callable[[str], None]) -> None:
        self.steps, self.total, self.done, self.began = len(plan.campaign.time), total, 0, time.monotonic()
        self._most, self._next, self._tell = most, min(FEWEST, most), tell

    @property
    def rate(self) -> float:
        """Run-steps a second."""
        return self.done * self.steps / max(time.monotonic() - self.began, 1e-9)

    def next_batch(self) -> int:
        """How many runs the next batch has: as many as a worker does in the time that an interruption may cost."""
        return self._next

    def add(self, runs: int, took: float) -> None:
        """Shows that some more are done, by one worker in so many seconds."""
        self._next = min(self._most, max(FEWEST, round(LOST * runs / max(took, 1e-9))))
        self.done += runs
        left = (self.total - self.done) * self.steps / self.rate
        clock = f"{int(left // 3600)}:{int(left // 60 % 60):02d}:{int(left % 60):02d}"
        self._tell(f"{self.done} of {self.total} runs, {self.rate:.3g} steps/s, {clock} left")
