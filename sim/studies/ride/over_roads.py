"""The study of ride on random roads of several classes, measured in MuJoCo and predicted from the spectra of the roads."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any

import numpy as np

from models.common.printed import as_name
from models.document.document import Document, Pivot, Table, notes
from models.document.field import Field
from models.document.figure import Curve, Figure, Panel, Style
from models.document.text import join_words
from models.roads.iri import roughness_of
from models.roads.iso8608 import Iso8608, long_enough
from models.roads.road import track_width
from models.vehicle.names import PASSIVE
from models.vehicle.vehicle import Vehicle
from sim.drive.case import Case
from sim.drive.regime import FLAT, REGIME_ENDS, end_times
from sim.observers.recorder import record
from sim.runs.run import sample_times
from sim.studies.ride.expected import expect, settling_time
from sim.studies.ride.metrics import Meter, compared_metrics, metrics_of, over_runs
from sim.studies.ride.scores import Score, score_of, score_over_runs
from sim.studies.study import Progress, Study
from sim.studies.subject import AVERAGE, SEEDS, SPEED, Subject
from synth.controller.controller import AnyController

CLASSES = "ABCD"
WINDOW = 10.0  # s, time over which a run is measured after the transient
LONGEST = 20.0  # s, longest transient that is awaited before the measurement


@dataclass(frozen=True)
class Ride:
    """A metric of one controller on the roads of one class. Values of the metric that do not exist are NaN.

    Attributes:
        road_class: road class according to ISO 8608.
        controller: name of the controller.
        metric, unit: name of the metric, and unit of its values.
        measured: root mean square of the metric's values on the roads of the class, measured in MuJoCo.
        predicted: value of the metric, predicted from the spectrum of the class.
        spread: predicted standard deviation of the metric from road to road.
        events: text that states the share of time in which a tyre is off the ground, and the number of aborted runs.
    """

    road_class: str
    controller: str
    metric: str
    unit: str
    measured: float
    predicted: float
    spread: float
    events: str

    @property
    def share(self) -> float | None:
        """Standard deviation from road to road, divided by the prediction; None if the deviation or the prediction is unknown."""
        share = self.spread / self.predicted if self.predicted else math.nan
        return share if math.isfinite(share) else None


MEASURED_RIDE = Field[Ride]("MuJoCo", lambda one: one.measured, ".4g")
LIFT_OFF = Field[float]("lift-off", float, ".2f", 100.0, unit="%")
IRI, IRI_SPREAD = Field[float]("IRI", float, ".3g"), Field[float]("spread", float, ".2g")
RIDE: tuple[Field[Ride], ...] = (
    Field("class", lambda one: one.road_class),
    Field("controller", lambda one: one.controller),
    Field("metric", lambda one: one.metric),
    Field("unit", lambda one: one.unit),
    MEASURED_RIDE,
    Field("predicted", lambda one: one.predicted, ".4g"),
    Field("road to road", lambda one: one.share, "+-{:.0f} %".format, 100.0),
    Field("lift-off", lambda one: one.events),
)


def ride_section(vehicle: Vehicle, rides: Sequence[Ride], style: Mapping[str, Style]) -> Document:
    """Returns the section about the ride, with the metrics of all controllers on the roads of all classes."""
    caption = f"Roughness of the roads over their first {SPEED * WINDOW:g} m."
    headings = ("class", "tracks", "IRI, all of the class [m/km]", "IRI of the roads driven [m/km]")
    rough = Table("roads", caption, headings, tuple(_roughness_row(vehicle, name) for name in CLASSES), detail="full")
    pivot = Pivot(("controller", "metric", "unit"), "class", ("MuJoCo",))
    caption = "Metrics of the ride in MuJoCo by road class. The full table adds predicted values and lift-off."
    table = Table.of("ride", caption, RIDE, sorted(rides, key=lambda one: (one.road_class, one.metric)), words=4, pivot=pivot)
    return Document("Ride over random roads", (*notes(*ride_texts(vehicle)), ride_figure(rides, style), table, rough))


def _roughness_row(vehicle: Vehicle, name: str) -> tuple[str, ...]:
    """Returns a row of the table of roads: road class, tracks, expected IRI of the class, and IRIs of the simulated roads."""
    distance, width = SPEED * WINDOW, track_width(vehicle)
    roughness = [roughness_of(Iso8608(name, seed, SPEED, width, long_enough(distance)), vehicle, distance) for seed in SEEDS]
    which = next(i for i, one in enumerate(roughness[0]) if one.name == ("mean" if width else "left"))
    first, driven = roughness[0][which], ", ".join(IRI.digits(each[which].iri) for each in roughness)
    expected = "-" if first.expected is None else f"{IRI.digits(first.expected)} +- {IRI_SPREAD.digits(first.spread)}"
    return name, "mean of both" if width else "one", expected, driven


def ride_figure(rides: Sequence[Ride], style: Mapping[str, Style]) -> Figure:
    """Returns the figure of all metrics against road class. Lines show predictions, and markers show MuJoCo results."""
    ticks = tuple(float(k) for k in range(len(CLASSES)))
    panels = []
    for metric, unit in dict.fromkeys((one.metric, one.unit) for one in rides):
        curves = []
        for name in dict.fromkeys(one.controller for one in rides):
            look, some = style[name], [one for one in rides if (one.metric, one.controller) == (metric, name)]
            x = np.array([float(CLASSES.index(one.road_class)) for one in some])
            predicted, measured = (np.array([get(one) for one in some]) for get in (attrgetter("predicted"), MEASURED_RIDE.value))
            if np.isfinite(predicted).any():  # the ride is not predicted for laws in Python
                curves.append(Curve(x, predicted, name, look.color, look.dash))
            if some:
                curves.append(Curve(x, measured, name, look.color, "none", look.marker, name=f"{name}, MuJoCo"))
        label = f"{metric} [{'of the static load' if unit == '-' else unit.replace('s2', 's²')}]"
        classes = {"xticks": ticks, "xnames": tuple(CLASSES), "xlim": (-0.3, len(CLASSES) - 0.7)}
        panels.append(Panel(metric, "road class", label, tuple(curves), ylog=True, **classes))
    title = (
        f"Ride at {SPEED:g} m/s by road class, from {CLASSES[0]} (very good) to {CLASSES[-1]} (poor); lower is better. "
        f"Lines: predicted from the spectrum. Markers: MuJoCo, {len(SEEDS)} roads each."
    )
    return Figure("ride", title, tuple(panels), min(len(panels), 2 if len(panels) <= 4 else 3), finding=_best_ride(rides))


def _best_ride(rides: Sequence[Ride]) -> str:
    """Returns a sentence about the controller with the best ride on roads of class `AVERAGE`; empty for fewer than two
    controllers.
    """
    some = [one for one in rides if (one.road_class, one.metric) == (AVERAGE, rides[0].metric) and math.isfinite(one.measured)]
    if len(some) < 2:
        return ""
    least = min(some, key=MEASURED_RIDE.value)
    size = f"{MEASURED_RIDE.cell(least)} {least.unit}"
    return f"{as_name(least.controller)} rides best over roads of class {AVERAGE}: {least.metric} {size}."


def ride_texts(vehicle: Vehicle) -> tuple[str, ...]:
    """Returns sentences that explain the table of the ride, and name the parts of the vehicle that the predictions omit."""
    ends, blur = replace(vehicle.limits, actuator_bandwidth=None), replace(vehicle.implementation, sample_period=None, delay=0)
    without = join_words([*ends.phrases(vehicle.kind.suspensions), *blur.phrases])
    curved = " Each characteristic is replaced by the line that has the same effect on average." * vehicle.parts.nonlinear
    return (
        f"MuJoCo drives {len(SEEDS)} random roads of each ISO 8608 class at {SPEED:g} m/s, {WINDOW:g} s each. "
        "'Weighted' is the rms acceleration of ISO 2631-1, Wk. 'Dynamic load' is the rms of the dynamic tyre force, relative "
        "to the static force.",
        f"Predictions use the road's spectrum and the sampled linear loop{f', without {without}' if without else ''}.{curved}",
        "Values are root mean squares, in MuJoCo over the roads driven, and predicted over all roads of the class. 'Road to "
        "road' is the standard deviation between roads of a class; MuJoCo's value differs from the prediction by about half "
        "of this deviation.",
        "'Lift-off' is the largest share of time for which a tyre leaves one of these roads. A run is omitted if it diverges, "
        "overflows the states of a law, or compresses a tyre fully.",
    )


class OverRoads:
    """MuJoCo runs of a controller over random roads of one or several classes."""

    def __init__(self, vehicle: Vehicle, controller: AnyController, timestep: float, classes: str | None = None) -> None:
        """Simulates the controller on the random roads of the classes.

        Args:
            vehicle: vehicle that the controller controls.
            controller: controller of this vehicle.
            timestep: timestep of the simulation [s].
            classes: road classes as one text, such as "AC"; None for all classes.
        """
        self.vehicle, self.controller, self.timestep, self.classes = vehicle, controller, timestep, classes or CLASSES
        start = min(settling_time(vehicle, controller), LONGEST)
        time = sample_times(vehicle, start + WINDOW, timestep)
        length, width = long_enough(SPEED * float(time[-1])), track_width(vehicle)
        self.roads = [Iso8608(name, seed, SPEED, width, length) for name in self.classes for seed in SEEDS]
        count = len(self.roads)
        runs = record([Case(vehicle, controller, road) for road in self.roads], time)
        values = np.stack([one.response.values[:, : len(vehicle.kind.signals)] for one in runs], axis=2)
        flat = [end_times(vehicle, one.response)[REGIME_ENDS.index(FLAT)] for one in runs]
        self.ended = np.minimum([one.diverged for one in runs], flat)
        self.law_diverged = np.array([one.response.law_diverged for one in runs])
        meter = Meter([vehicle] * count, float(time[1]), round(start / timestep), speeds=[SPEED] * count)
        meter.update(values)
        self.found = meter.result()

    def score(self) -> Score:
        """Returns the controller's score in the runs on roads of class `AVERAGE`; the score has no values if one of these runs
        was aborted.
        """
        runs = self._runs(AVERAGE)
        if not np.isinf(self.ended[runs]).all():
            return score_of(self.vehicle, self.controller.name, {})
        return score_over_runs(self.vehicle, self.controller.name, {name: each[runs] for name, each in self.found.items()})

    def _runs(self, road_class: str) -> slice:
        """Returns the indices of the runs on roads of a class."""
        first = self.classes.index(road_class) * len(SEEDS)
        return slice(first, first + len(SEEDS))

    def rides(self) -> Iterator[Ride]:
        """Yields all metrics on the roads of all classes."""
        vehicle, controller = self.vehicle, self.controller
        ideal = replace(vehicle, implementation=vehicle.implementation.without_noise)
        metrics = [one for one in metrics_of(vehicle) if one.headline and (controller.acts or not one.effort)]
        lifts = [one.name for one in compared_metrics(vehicle).get("off_ground", ())]
        for road_class in self.classes:
            runs = self._runs(road_class)
            through = np.isinf(self.ended[runs])
            some = {name: each[runs][through] for name, each in self.found.items()}
            expected = expect(ideal, controller, self.roads[runs.start].spectrum, self.timestep, WINDOW)
            lifted = max((float(some[name].max(initial=0.0)) for name in lifts), default=0.0)
            events = LIFT_OFF.text(lifted) if lifted else "none"
            if not through.all():
                broken = f"flat{', diverged or of an overflowing law' if self.law_diverged[runs].any() else ' or diverged'}"
                events = f"{np.sum(~through)} of {len(SEEDS)} {broken}" + (f", else {events}" if through.any() else "")
            for metric in metrics:
                name, unit = metric.name, metric.unit
                measured = over_runs(metric, some[name]) if through.any() else math.nan
                predicted, spread = (
                    (expected.mean[name], expected.spread.get(name, math.nan)) if expected else (math.nan, math.nan)
                )
                yield Ride(road_class, controller.name, metric.words, unit, measured, predicted, spread, events)


class RideStudy(Study[tuple[list[Ride], list[Score]]]):
    """Study that adds the ride on random roads to a report, and computes the controllers' scores on these roads."""

    seconds = 7.0

    def requests(self, scope: Subject) -> Mapping[str, Subject]:
        """See `Study`."""
        return {"": scope} if not scope.quick and (scope.stable or scope.laws) else {}

    def run(self, request: Subject, progress: Progress) -> tuple[list[Ride], list[Score]]:
        """Returns the ride results of all stable controllers and nonlinear laws, and their scores, including the score of the
        passive vehicle.
        """
        reported = (*request.stable, *request.laws)
        driven = [OverRoads(request.vehicle, one, request.timestep) for one in reported]
        passive = [] if any(one.name == PASSIVE for one in reported) else [request.designer.design(PASSIVE)]
        beside = [OverRoads(request.vehicle, one, request.timestep, AVERAGE) for one in passive]
        return [ride for one in driven for ride in one.rides()], [one.score() for one in (*beside, *driven)]

    def sections(self, scope: Subject, results: Mapping[str, Mapping[str, Any]]) -> list[Document]:
        """See `Study`."""
        return [ride_section(scope.vehicle, rides, scope.styles) for rides, _ in results[self.name].values() if rides]
