"""Angles of a body under loads, in degrees."""

from collections.abc import Sequence

import numpy as np

from models.vehicle.vehicle import Vehicle
from sim.studies.ride.metrics import DEGREES, PITCH, ROLL, ROOT_MEAN_SQUARE, Largest, Samples, Totals, angles_of


class Angle(Largest):
    """A number of an angle of the body."""

    unit, of, loaded, approximate = "deg", "angles", True, False


class PitchAngle(Angle):
    """A number of the pitch angle."""

    @classmethod
    def sources(cls, vehicle: Vehicle) -> Sequence[str]:
        """Returns the pitch angle, if the body can pitch."""
        return (PITCH,) if PITCH in angles_of(vehicle) else ()


class Dive(PitchAngle):
    """Largest pitch angle, nose down."""

    what = "dive"

    def update(self, samples: Samples, totals: Totals) -> None:
        """Adds a block."""
        totals.keep_largest(DEGREES * np.maximum(samples.angle(self.source).max(axis=1), 0.0))


class Squat(PitchAngle):
    """Largest pitch angle, nose up."""

    what = "squat"

    def update(self, samples: Samples, totals: Totals) -> None:
        """Adds a block."""
        totals.keep_largest(DEGREES * np.maximum(-samples.angle(self.source).min(axis=1), 0.0))


class Roll(Angle):
    """Largest roll angle to either side."""

    what, approximate = "peak", True

    @classmethod
    def sources(cls, vehicle: Vehicle) -> Sequence[str]:
        """Returns the roll angle, if the body can roll."""
        return (ROLL,) if ROLL in angles_of(vehicle) else ()

    def update(self, samples: Samples, totals: Totals) -> None:
        """Adds a block."""
        angle = samples.angle(self.source)
        totals.keep_largest(DEGREES * np.maximum(angle.max(axis=1), -angle.min(axis=1)))


class AtEnd(Angle):
    """Angle at the end of the window, with its sign."""

    what, over_runs = "at_end", ROOT_MEAN_SQUARE

    @classmethod
    def sources(cls, vehicle: Vehicle) -> Sequence[str]:
        """Returns every angle of the body."""
        return tuple(angles_of(vehicle))

    def update(self, samples: Samples, totals: Totals) -> None:
        """Keeps the last sample."""
        totals.largest = DEGREES * samples.angle(self.source)[:, -1]
