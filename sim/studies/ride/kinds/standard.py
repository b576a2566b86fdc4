"""Metrics of ride, travel, road holding, actuator effort and body angles, with a base class for each group of signals.

Ride metrics evaluate vertical accelerations of the body, unweighted or with the weighting W_k of ISO 2631-1 (a_w). If a force u
is held during a step while the travel s changes, the actuator's work in this step is exactly u[k] (s[k+1] - s[k]). If the
actuator has a lag, the force also changes during the step, so the mean of u[k] and u[k+1] is used.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from models.kinds.signals import CONTROL_FORCE, TYRE_DEFLECTION, Signal
from models.vehicle.vehicle import Vehicle
from sim.studies.ride.metrics import (
    DEGREES,
    LARGEST,
    MEAN,
    PITCH,
    ROLL,
    ROOT_MEAN_SQUARE,
    RUNNING_TIME_CONSTANT,
    Column,
    Expectation,
    Meter,
    Metric,
    Totals,
    angles_of,
    squares,
)

if TYPE_CHECKING:
    from sim.studies.ride.gaussian import RandomSignals


class RootMeanSquare(Metric):
    """Metric that is the root mean square of a signal."""

    what, over_runs, approximate = "rms", ROOT_MEAN_SQUARE, False

    def update(self, meter: Meter, totals: Totals) -> None:
        totals.add(squares(meter[self.source]))

    def result(self, totals: Totals, meter: Meter) -> Array:
        return np.sqrt(totals.sum / meter.samples)

    def expected(self, random: "RandomSignals") -> Expectation:
        return random.rms(random.signal(self.source), offset=random.offset(self.source))


class Share(Metric):
    """Metric that is the share of time in which a condition holds."""

    unit, over_runs, approximate = "-", MEAN, False

    def result(self, totals: Totals, meter: Meter) -> Array:
        return totals.sum / meter.samples


class Largest(Metric):
    """Metric that is the largest magnitude of a signal."""

    what, over_runs = "peak", LARGEST
    accuracy = "peaks are up to 23 % too high"

    def update(self, meter: Meter, totals: Totals) -> None:
        totals.keep(meter[self.source])

    def result(self, totals: Totals, meter: Meter) -> Array:
        return totals.largest

    def expected(self, random: "RandomSignals") -> Expectation:
        signal = random.signal(self.source)
        return signal.largest(random.window) * signal.sigma + abs(random.offset(self.source)), None


class Angle(Metric):
    """Base class for metrics of a body angle under loads."""

    unit, of, over_runs, loaded, approximate = "deg", "angles", LARGEST, True, False
    angles: tuple[str, ...] = (PITCH, ROLL)

    @classmethod
    def sources(cls, vehicle: Vehicle) -> Sequence[str]:
        return [name for name in angles_of(vehicle) if name in cls.angles]

    def result(self, totals: Totals, meter: Meter) -> Array:
        return totals.largest


class Dive(Angle):
    """Largest pitch angle in the nose-down direction."""

    what, angles = "dive", (PITCH,)

    def update(self, meter: Meter, totals: Totals) -> None:
        totals.keep_largest(DEGREES * np.maximum(meter.angle(self.source).max(axis=1), 0.0))


class Squat(Angle):
    """Largest pitch angle in the nose-up direction."""

    what, angles = "squat", (PITCH,)

    def update(self, meter: Meter, totals: Totals) -> None:
        totals.keep_largest(DEGREES * np.maximum(-meter.angle(self.source).min(axis=1), 0.0))


class Roll(Angle):
    """Largest roll angle to either side."""

    what, angles, approximate = "peak", (ROLL,), True

    def update(self, meter: Meter, totals: Totals) -> None:
        angle = meter.angle(self.source)
        totals.keep_largest(DEGREES * np.maximum(angle.max(axis=1), -angle.min(axis=1)))


class FinalAngle(Angle):
    """Body angle at the end of the measurement, with its sign."""

    what, over_runs = "at_end", ROOT_MEAN_SQUARE

    def update(self, meter: Meter, totals: Totals) -> None:
        totals.largest = DEGREES * meter.angle(self.source)[:, -1]


class Acceleration(Metric):
    """Base class for metrics of a vertical acceleration of the body.

    Controllers are compared at the points that carry a person, or at all points if there is no person.
    """

    unit, of, over_runs = "m/s2", "accelerations", LARGEST

    @classmethod
    def sources(cls, vehicle: Vehicle) -> Sequence[str]:
        return vehicle.ride_points.all

    @classmethod
    def compared(cls, vehicle: Vehicle) -> Sequence[str]:
        return vehicle.ride_points.worst_of


class RmsAcceleration(RootMeanSquare, Acceleration):
    """Root mean square of an acceleration. At a jump of the acceleration, the mean square of the values before and after the
    jump is used.
    """

    def update(self, meter: Meter, totals: Totals) -> None:
        totals.add(squares(meter.midway[self.source]))
        if self.source in meter.both_sides:
            totals.add(squares(meter.both_sides[self.source] / 2))

    def expected(self, random: "RandomSignals") -> Expectation:
        return random.rms(random.signal(self.source))


class WeightedRms(RootMeanSquare, Acceleration):
    """Weighted rms (6.1): root mean square of the weighted acceleration a_w."""

    what, headline = "weighted", "ride"
    column = Column("ride", "m/s²", change="ride", praise=("ride", ""), bars="Acceleration of the body")

    @classmethod
    def shown_apart(cls, vehicle: Vehicle) -> Sequence[str]:
        return vehicle.ride_points.all if vehicle.ride_points.people else ()

    def update(self, meter: Meter, totals: Totals) -> None:
        return None

    def update_weighted(self, weighted: Array, running: Array, totals: Totals) -> None:
        totals.add(squares(weighted))

    def expected(self, random: "RandomSignals") -> Expectation:
        return random.rms(random.weighted_signal(self.source))


class VibrationDose(Acceleration):
    """Vibration dose value, VDV (6.3.2): fourth root of the integral of the weighted acceleration's fourth power a_w^4 over
    time.
    """

    what, unit = "vdv", "m/s1.75"
    expectation, accuracy = "for a VDV: the fourth root of its expected fourth power", "vdv is up to 8 % too high"

    def update_weighted(self, weighted: Array, running: Array, totals: Totals) -> None:
        totals.add(squares(weighted * weighted))

    def result(self, totals: Totals, meter: Meter) -> Array:
        return (totals.sum / meter.samples * meter.duration) ** 0.25

    def expected(self, random: "RandomSignals") -> Expectation:
        return (random.window * random.weighted_signal(self.source).mean_fourth_power) ** 0.25, None


class TransientVibration(Acceleration):
    """Maximum transient vibration value, MTVV (6.3.1): largest running rms of the weighted acceleration a_w, averaged
    exponentially over 1 s.
    """

    what, accuracy = "mtvv", "mtvv is up to 9 % too high"

    def update_weighted(self, weighted: Array, running: Array, totals: Totals) -> None:
        totals.keep(running)

    def result(self, totals: Totals, meter: Meter) -> Array:
        return np.sqrt(totals.largest)

    def expected(self, random: "RandomSignals") -> Expectation:
        return random.weighted_signal(self.source).largest_running(random.window, RUNNING_TIME_CONSTANT), None


class Crest(Acceleration):
    """Crest factor (6.2): largest magnitude of the weighted acceleration a_w, relative to its root mean square; 0 for a body at
    rest.
    """

    what, unit, accuracy = "crest", "-", "crest is from 7 % too low to 14 % too high"

    def update_weighted(self, weighted: Array, running: Array, totals: Totals) -> None:
        totals.add(squares(weighted))
        totals.keep(weighted)

    def result(self, totals: Totals, meter: Meter) -> Array:
        rms = np.sqrt(totals.sum / meter.samples)
        still = rms == 0
        return np.where(still, 0.0, totals.largest / np.where(still, 1.0, rms))

    def expected(self, random: "RandomSignals") -> Expectation:
        return random.weighted_signal(self.source).largest(random.window), None


class Travel(Metric):
    """Base class for metrics of a suspension deflection."""

    unit, of = "m", "suspensions"

    @classmethod
    def sources(cls, vehicle: Vehicle) -> Sequence[str]:
        return [one.deflection for one in vehicle.kind.suspensions]


class RmsTravel(RootMeanSquare, Travel):
    """Root mean square of the suspension deflection."""

    headline = "travel"


class PeakTravel(Largest, Travel):
    """Largest suspension deflection, in bump or in rebound."""

    column = Column("peak travel", "mm", 1e3, change="travel", bars="Travel of the suspension", by_side=True)


class AtStops(Share, Travel):
    """Share of time in which the suspension touches a bump stop."""

    what = "at_stops"
    column = Column("at stops", "%", 100.0)

    @classmethod
    def sources(cls, vehicle: Vehicle) -> Sequence[str]:
        return [name for name in super().sources(vehicle) if name in vehicle.parts.strokes]

    def update(self, meter: Meter, totals: Totals) -> None:
        deflection, (bump, rebound) = meter[self.source], meter.strokes[self.source]
        totals.add(np.count_nonzero((deflection <= -bump) | (deflection >= rebound), axis=1))

    def expected(self, random: "RandomSignals") -> Expectation:
        signal, offset, (bump, rebound) = random.signal(self.source), random.offset(self.source), random.strokes[self.source]
        return signal.beyond(bump + offset) + signal.beyond(rebound - offset), None


class TyreLoad(Metric):
    """Base class for metrics of a tyre load F = k_u (t_0 - t), with static deflection t_0 and extension t, where F >= 0."""

    unit, of = "-", "tyres"

    @property
    def name(self) -> str:
        return _named_after(self.source, TYRE_DEFLECTION, self.what)

    @classmethod
    def sources(cls, vehicle: Vehicle) -> Sequence[str]:
        return [wheel.tyre_deflection for wheel in vehicle.kind.wheels]


class DynamicLoad(RootMeanSquare, TyreLoad):
    """Dynamic load coefficient: rms(F - F_static) / F_static for the tyre load F; under loads on the body, the standard
    deviation of F / F_static.
    """

    what, headline = "dynamic_load", "load"
    column = Column("dynamic load [-]", change="tyre load", praise=("hold", " the road"), bars="Dynamic tyre load")

    def update(self, meter: Meter, totals: Totals) -> None:
        carried = np.minimum(*meter.tyre(self.source))
        totals.add(squares(carried))
        totals.shift = totals.shift + carried.sum(axis=1)

    def result(self, totals: Totals, meter: Meter) -> Array:
        shift = np.where(meter.pushed, totals.shift / meter.samples, 0.0)
        return np.sqrt(np.maximum(totals.sum / meter.samples - shift * shift, 0.0)) / meter.static[self.source]

    def expected(self, random: "RandomSignals") -> Expectation:
        static = random.static[self.source]
        return random.rms(random.signal(self.source), static, 1 / static)


class OffGround(Share, TyreLoad):
    """Share of time in which the tyre does not touch the ground."""

    what = "off_ground"
    column = Column("off the ground", "%", 100.0)

    def update(self, meter: Meter, totals: Totals) -> None:
        totals.add(np.count_nonzero(np.greater_equal(*meter.tyre(self.source)), axis=1))

    def expected(self, random: "RandomSignals") -> Expectation:
        return random.signal(self.source).beyond(random.static[self.source]), None


class Force(Metric):
    """Base class for metrics of an actuator force. At a jump of the force, the values before and after the jump are included."""

    unit, of, effort = "N", "actuators", True

    @classmethod
    def sources(cls, vehicle: Vehicle) -> Sequence[str]:
        return vehicle.linear_model.inputs


class RmsForce(RootMeanSquare, Force):
    """Root mean square of an actuator force."""

    headline = "force"
    column = Column("force, rms", "N")

    def update(self, meter: Meter, totals: Totals) -> None:
        super().update(meter, totals)
        if self.source in meter.both_sides:
            force = meter[self.source]
            totals.add((squares(force - meter.both_sides[self.source]) - squares(force)) / 2)


class PeakForce(Largest, Force):
    """Largest force."""

    column = Column("force, peak", "N", bars="Largest force")

    def update(self, meter: Meter, totals: Totals) -> None:
        super().update(meter, totals)
        if self.source in meter.both_sides:
            totals.keep(meter[self.source] - meter.both_sides[self.source])


class Work(Force):
    """Base class for metrics of the work of an actuator in a suspension."""

    over_runs, approximate = MEAN, False

    @property
    def name(self) -> str:
        return _named_after(self.source, CONTROL_FORCE, f"control_{self.what}")

    @classmethod
    def sources(cls, vehicle: Vehicle) -> Sequence[str]:
        return [force for force in super().sources(vehicle) if vehicle.kind.deflection_of(force)]


class ControlPower(Work):
    """Mean power that the actuator supplies to the suspension."""

    what, unit = "power", "W"

    def update(self, meter: Meter, totals: Totals) -> None:
        totals.add(meter.work(self.source).sum(axis=1))

    def result(self, totals: Totals, meter: Meter) -> Array:
        # The mean is taken over the time from the first to the last sample
        return totals.sum / (max(meter.samples - 1, 1) * meter.timestep)

    def expected(self, random: "RandomSignals") -> Expectation:
        return random.works[self.source][0] / random.timestep, None


class ControlEnergy(Work):
    """Energy that the actuator supplies to the suspension; energy that flows back to the actuator is not subtracted."""

    what, unit = "energy", "J"

    def update(self, meter: Meter, totals: Totals) -> None:
        totals.add(np.maximum(meter.work(self.source), 0.0).sum(axis=1))

    def result(self, totals: Totals, meter: Meter) -> Array:
        return totals.sum

    # The time is one step shorter than the window, because n samples have n - 1 steps
    def expected(self, random: "RandomSignals") -> Expectation:
        return random.works[self.source][1] / random.timestep * (random.window - random.timestep), None


def _named_after(signal: str, common: Signal, metric: str) -> str:
    """Returns the full name of a metric: `metric` replaces the common prefix of the signal's name, or is appended if the prefix
    is missing.

    Args:
        signal: name of the signal to which the metric belongs.
        common: name of the signal whose name is the common prefix.
        metric: part of the full name that describes the metric.
    """
    return f"{metric}{signal.removeprefix(common.name)}" if signal.startswith(common.name) else f"{signal}_{metric}"
