"""Travel of suspensions: rms, peak, and time at the bump stops."""

from collections.abc import Sequence

import numpy as np

from models.vehicle.vehicle import Vehicle
from sim.studies.ride.gaussian import RandomSignals
from sim.studies.ride.metrics import (
    Column,
    Largest,
    Metric,
    RootMeanSquare,
    Samples,
    Share,
    Totals,
    squares,
)


class Travel(Metric):
    """A number of the deflection of a suspension."""

    unit, of = "m", "suspensions"

    @classmethod
    def sources(cls, vehicle: Vehicle) -> Sequence[str]:
        """Returns the deflections of the suspensions."""
        return tuple(one.deflection for one in vehicle.kind.suspensions)


class Rms(RootMeanSquare, Travel):
    """Root mean square of the travel."""

    what, headline = "rms", "travel"

    def update(self, samples: Samples, totals: Totals) -> None:
        """Adds a block."""
        totals.add(squares(samples[self.source]))

    def expected(self, random: RandomSignals) -> tuple[float, float | None]:
        """Returns the root of the expected mean square."""
        return random.rms(random.signal(self.source), offset=random.offset(self.source))


class Peak(Largest, Travel):
    """Largest travel, in bump or in rebound."""

    what, accuracy = "peak", "peaks are up to 23 % too high"
    column = Column("peak travel", "mm", 1e3, change="travel", bars="Travel of the suspension", by_side=True)

    def update(self, samples: Samples, totals: Totals) -> None:
        """Adds a block."""
        totals.keep(samples[self.source])

    def expected(self, random: RandomSignals) -> tuple[float, float | None]:
        """Returns the expected largest magnitude."""
        return random.peak(self.source), None


class AtStops(Share, Travel):
    """Share of time at the bump stops."""

    what = "at_stops"
    column = Column("at stops", "%", 100.0)

    @classmethod
    def sources(cls, vehicle: Vehicle) -> Sequence[str]:
        """Returns the deflections of the suspensions with stops."""
        return tuple(name for name in super().sources(vehicle) if name in vehicle.parts.strokes)

    def update(self, samples: Samples, totals: Totals) -> None:
        """Adds a block."""
        totals.add(np.count_nonzero(samples.beyond_stops(self.source), axis=1))

    def expected(self, random: RandomSignals) -> tuple[float, float | None]:
        """Returns the expected share of time."""
        signal, offset, (bump, rebound) = random.signal(self.source), random.offset(self.source), random.strokes[self.source]
        return signal.beyond(bump + offset) + signal.beyond(rebound - offset), None
