"""Road holding: the load F = k_u (static - t) of a tyre that is extended by t, which is never negative."""

from collections.abc import Sequence

import numpy as np

from models.common.arrays import Array
from models.kinds.signals import TYRE_DEFLECTION
from models.vehicle.vehicle import Vehicle
from sim.studies.ride.gaussian import RandomSignals
from sim.studies.ride.metrics import (
    Column,
    Metric,
    RootMeanSquare,
    Samples,
    Share,
    Totals,
    Window,
    named_after,
    squares,
)


class Tyre(Metric):
    """A number of the load of a tyre."""

    unit, of = "-", "tyres"

    @property
    def name(self) -> str:
        """Column name in files."""
        return named_after(self.source, TYRE_DEFLECTION, self.what)

    @classmethod
    def sources(cls, vehicle: Vehicle) -> Sequence[str]:
        """Returns the deflections of the tyres."""
        return tuple(wheel.tyre_deflection for wheel in vehicle.kind.wheels)


class DynamicLoad(RootMeanSquare, Tyre):
    """Dynamic load coefficient: rms(F - F_static) / F_static; with loads on the body, the standard deviation of F instead."""

    what, headline = "dynamic_load", "load"
    column = Column("dynamic load [-]", change="tyre load", praise=("hold", " the road"), bars="Dynamic tyre load")

    def update(self, samples: Samples, totals: Totals) -> None:
        """Adds a block."""
        carried = np.minimum(*samples.tyre(self.source))
        totals.add(squares(carried))
        shift = carried.sum(axis=1)
        totals.shift = shift if totals.shift is None else totals.shift + shift

    def result(self, totals: Totals, window: Window) -> Array:
        """Returns the coefficient."""
        shift = np.where(window.pushed, totals.shift / window.count, 0.0)
        return np.sqrt(np.maximum(totals.sum / window.count - shift * shift, 0.0)) / window.static[self.source]

    def expected(self, random: RandomSignals) -> tuple[float, float | None]:
        """Returns the root of the expected mean square."""
        static = random.static[self.source]
        return random.rms(random.signal(self.source), static, 1 / static)


class OffGround(Share, Tyre):
    """Share of time off the ground."""

    what = "off_ground"
    column = Column("off the ground", "%", 100.0)

    def update(self, samples: Samples, totals: Totals) -> None:
        """Adds a block."""
        totals.add(np.count_nonzero(np.greater_equal(*samples.tyre(self.source)), axis=1))

    def expected(self, random: RandomSignals) -> tuple[float, float | None]:
        """Returns the expected share of time."""
        return random.signal(self.source).beyond(random.static[self.source]), None
