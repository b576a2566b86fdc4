"""Effort of actuators: force, and power and energy from the work of each step.

The work is exactly u[k] (s[k+1] - s[k]) for a force u that is held while the travel s changes. For a lagging force, which changes
too, the mean of u[k] and u[k+1] counts.
"""

from collections.abc import Sequence

import numpy as np

from models.common.arrays import Array
from models.kinds.signals import CONTROL_FORCE
from models.vehicle.vehicle import Vehicle
from sim.studies.ride.gaussian import RandomSignals
from sim.studies.ride.metrics import (
    MEAN,
    Column,
    Largest,
    Metric,
    RootMeanSquare,
    Samples,
    Totals,
    Window,
    named_after,
    squares,
)


class Force(Metric):
    """A number of the force of an actuator."""

    unit, of, effort = "N", "actuators", True

    @classmethod
    def sources(cls, vehicle: Vehicle) -> Sequence[str]:
        """Returns the forces."""
        return vehicle.linear_model.inputs


class Rms(RootMeanSquare, Force):
    """Root mean square of the force."""

    what, headline = "rms", "force"
    column = Column("force, rms", "N")

    def update(self, samples: Samples, totals: Totals) -> None:
        """Adds a block; of both sides of jumps."""
        force = samples[self.source]
        totals.add(squares(force))
        if self.source in samples.jumps:
            totals.add((squares(force - samples.jumps[self.source]) - squares(force)) / 2)

    def expected(self, random: RandomSignals) -> tuple[float, float | None]:
        """Returns the root of the expected mean square."""
        return random.rms(random.signal(self.source), offset=random.offset(self.source))


class Peak(Largest, Force):
    """Largest force."""

    what, accuracy = "peak", "peaks are up to 23 % too high"
    column = Column("force, peak", "N", bars="Largest force")

    def update(self, samples: Samples, totals: Totals) -> None:
        """Adds a block; of both sides of jumps."""
        force = samples[self.source]
        totals.keep(force)
        if self.source in samples.jumps:
            totals.keep(force - samples.jumps[self.source])

    def expected(self, random: RandomSignals) -> tuple[float, float | None]:
        """Returns the expected largest magnitude."""
        return random.peak(self.source), None


class Work(Force):
    """A number of the work of an actuator that acts in a suspension."""

    over_runs, approximate = MEAN, False

    @property
    def name(self) -> str:
        """Column name in files."""
        return named_after(self.source, CONTROL_FORCE, f"control_{self.what}")

    @classmethod
    def sources(cls, vehicle: Vehicle) -> Sequence[str]:
        """Returns the forces that act in a suspension."""
        return tuple(force for force in super().sources(vehicle) if vehicle.kind.pushed(force))


class Power(Work):
    """Mean power into the suspension."""

    what, unit = "power", "W"

    def update(self, samples: Samples, totals: Totals) -> None:
        """Adds a block."""
        totals.add(samples.work(self.source).sum(axis=1))

    def result(self, totals: Totals, window: Window) -> Array:
        """Returns the work over the time from the first sample to the last."""
        return totals.sum / window.passed

    def expected(self, random: RandomSignals) -> tuple[float, float | None]:
        """Returns the expected power."""
        return random.works[self.source][0] / random.timestep, None


class Energy(Work):
    """Energy put in, without recovery of what is taken out."""

    what, unit = "energy", "J"

    def update(self, samples: Samples, totals: Totals) -> None:
        """Adds a block."""
        totals.add(np.maximum(samples.work(self.source), 0.0).sum(axis=1))

    def result(self, totals: Totals, window: Window) -> Array:
        """Returns the sum of the positive work of all steps."""
        return totals.sum

    def expected(self, random: RandomSignals) -> tuple[float, float | None]:
        """Returns the expected energy; n samples are n - 1 steps."""
        return random.works[self.source][1] / random.timestep * (random.window - random.timestep), None
