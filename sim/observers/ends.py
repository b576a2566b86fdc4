"""Observer that finds the end of the linear regime of each run, and events after which a run is invalid."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from models.common.arrays import Array
from sim.drive.case import Batch
from sim.drive.loop import Block
from sim.drive.regime import DIVERGENCE, END_NAMES, FLAT, LAW_OVERFLOW, REGIME_ENDS, EndDetector


@dataclass(frozen=True, eq=False)
class RunEnd:
    """Events that end the linear regime of one run, and the time at which the run diverged.

    Attributes:
        times: time at which each event in `REGIME_ENDS` first occurs [s], shape (E,); infinity for an event that does not
            occur.
        diverged: time at which the run diverged [s]; infinity if the run did not diverge.
        law_diverged: True if the run diverged only because the states of its control law diverged.
    """

    times: Array
    diverged: float
    law_diverged: bool

    @property
    def flat(self) -> float:
        """Time at which a tyre is first fully compressed [s]; infinity if no tyre is ever fully compressed."""
        return float(self.times[REGIME_ENDS.index(FLAT)])

    @cached_property
    def until(self) -> float:
        """Time until which the run is linear [s]; infinity if the run is linear to the end."""
        return min(float(self.times.min()), self.diverged)

    @property
    def by(self) -> str | None:
        """Name of the event that ended the linear regime; None if the regime did not end."""
        if math.isinf(self.until):
            return None
        broken = LAW_OVERFLOW if self.law_diverged else DIVERGENCE
        return broken if self.diverged <= self.times.min() else END_NAMES[int(self.times.argmin())]

    @property
    def broke_off(self) -> str | None:
        """Event after which all results of the run are meaningless: a flat tyre, `DIVERGENCE` or `LAW_OVERFLOW`; None without
        such an event.
        """
        if self.flat < self.diverged:
            return FLAT.name
        return None if math.isinf(self.diverged) else LAW_OVERFLOW if self.law_diverged else DIVERGENCE


class Ends:
    """Detects the events that end the linear regime in N runs."""

    def __init__(self, batch: Batch) -> None:
        """Prepares the detection of events for the runs of a batch."""
        laws = [one.has_anti_windup for one in batch.drivers]
        self._batch, self._detector = batch, EndDetector(batch.vehicles, batch.time, anti_windup=laws)

    @property
    def until(self) -> Array:
        """Time until which each run is linear [s], according to the blocks of samples received so far, shape (N,); infinity if
        no limit was reached.
        """
        return np.minimum(self._detector.first, self._batch.diverged)

    def take(self, block: Block) -> None:
        """Receives the next block of samples."""
        self._detector.update(block.start, block.values)

    def result(self) -> list[RunEnd]:
        """Returns the `RunEnd` of each run."""
        each = zip(self._detector.times, self._batch.diverged.tolist(), self._batch.law_diverged.tolist(), strict=True)
        return [RunEnd(*one) for one in each]
