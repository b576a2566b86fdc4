"""Ride: vertical accelerations a of the body, also weighted by W_k of ISO 2631-1 to a_w."""

from collections.abc import Sequence

import numpy as np

from models.common.arrays import Array
from models.vehicle.vehicle import Vehicle
from sim.studies.ride.gaussian import RandomSignals
from sim.studies.ride.metrics import (
    LARGEST,
    RUNNING,
    Column,
    Metric,
    RootMeanSquare,
    Samples,
    Totals,
    WeightedSamples,
    Window,
    squares,
)


class Acceleration(Metric):
    """A number of a vertical acceleration of the body."""

    unit, of, over_runs = "m/s2", "accelerations", LARGEST

    @classmethod
    def sources(cls, vehicle: Vehicle) -> Sequence[str]:
        """Returns the accelerations of the body, those of points with a person first."""
        return vehicle.ride_points.all

    @classmethod
    def compared(cls, vehicle: Vehicle) -> Sequence[str]:
        """Returns the accelerations of points with a person, or all without any."""
        return vehicle.ride_points.worst_of


class Rms(RootMeanSquare, Acceleration):
    """Root mean square of the acceleration."""

    what = "rms"

    def update(self, samples: Samples, totals: Totals) -> None:
        """Adds a block; of both sides of jumps: of their mean, and of half their difference."""
        totals.add(squares(samples.accelerations[self.source]))
        if self.source in samples.jumps:
            totals.add(squares(samples.jumps[self.source] / 2))

    def expected(self, random: RandomSignals) -> tuple[float, float | None]:
        """Returns the root of the expected mean square."""
        return random.rms(random.signal(self.source))


class Weighted(RootMeanSquare, Acceleration):
    """Weighted rms (6.1): root mean square of a_w."""

    what, headline = "weighted", "ride"
    column = Column("ride", "m/s²", change="ride", praise=("ride", ""), bars="Acceleration of the body")

    @classmethod
    def shown_apart(cls, vehicle: Vehicle) -> Sequence[str]:
        """Returns all accelerations of a vehicle with a person."""
        return vehicle.ride_points.all if vehicle.ride_points.people else ()

    def update_weighted(self, samples: WeightedSamples, totals: Totals) -> None:
        """Adds a block."""
        totals.add(samples.squares.sum(axis=1))

    def expected(self, random: RandomSignals) -> tuple[float, float | None]:
        """Returns the root of the expected mean square."""
        return random.rms(random.weighted(self.source))


class VibrationDose(Acceleration):
    """Vibration dose value, VDV (6.3.2): (integral of a_w^4 over time)^(1/4)."""

    what, unit = "vdv", "m/s1.75"
    expectation, accuracy = "for a VDV: the fourth root of its expected fourth power", "vdv is up to 8 % too high"

    def update_weighted(self, samples: WeightedSamples, totals: Totals) -> None:
        """Adds a block."""
        totals.add(squares(samples.squares))

    def result(self, totals: Totals, window: Window) -> Array:
        """Returns the fourth root of the integral."""
        return (totals.sum / window.count * window.duration) ** 0.25

    def expected(self, random: RandomSignals) -> tuple[float, float | None]:
        """Returns the fourth root of the expected integral."""
        return (random.window * random.weighted(self.source).mean_fourth_power) ** 0.25, None


class LargestRunning(Acceleration):
    """Maximum transient vibration value, MTVV (6.3.1): largest running rms of a_w, averaged exponentially over 1 s."""

    what, accuracy = "mtvv", "mtvv is up to 9 % too high"

    def update_weighted(self, samples: WeightedSamples, totals: Totals) -> None:
        """Adds a block."""
        totals.keep(samples.running)

    def result(self, totals: Totals, window: Window) -> Array:
        """Returns the root of the largest running mean square."""
        return np.sqrt(totals.largest)

    def expected(self, random: RandomSignals) -> tuple[float, float | None]:
        """Returns the expected root of the largest running mean square."""
        return random.weighted(self.source).largest_running(random.window, RUNNING), None


class Crest(Acceleration):
    """Crest factor (6.2): largest |a_w| over its root mean square."""

    what, unit, accuracy = "crest", "-", "crest is from 7 % too low to 14 % too high"

    def update_weighted(self, samples: WeightedSamples, totals: Totals) -> None:
        """Adds a block."""
        totals.add(samples.squares.sum(axis=1))
        totals.keep(samples.values)

    def result(self, totals: Totals, window: Window) -> Array:
        """Returns the ratio, 0 for a body at rest."""
        weighted = np.sqrt(totals.sum / window.count)
        still = weighted == 0
        return np.where(still, 0.0, totals.largest / np.where(still, 1.0, weighted))

    def expected(self, random: RandomSignals) -> tuple[float, float | None]:
        """Returns the expected largest magnitude over the standard deviation."""
        return random.weighted(self.source).largest(random.window), None
