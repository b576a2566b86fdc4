"""Scores of controllers, which compare ride, travel, tyre load and force, and the best controller for each quantity.

If a vehicle has several wheels, suspensions or actuators, each value belongs to the worst wheel, suspension or actuator.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from models.characteristics import SIDES
from models.common.arrays import Array
from models.common.extensions import METRICS
from models.common.printed import three_digits
from models.document.field import Field, Record, if_any
from models.vehicle.names import PASSIVE, variant
from models.vehicle.vehicle import Vehicle
from sim.drive.regime import FLAT, REGIME_ENDS, end_times
from sim.drive.response import Response
from sim.studies.ride.metrics import compared_metrics, measure, metrics_of, over_runs
from synth.controller.controller import AnyController
from synth.controller.law_margins import law_fault

if TYPE_CHECKING:
    from sim.runs.run import Run
    from sim.studies.ride.run_metrics import RunMetrics


@dataclass(frozen=True)
class Score:
    """A row of the comparison, with the metrics of one controller on a road in MuJoCo.

    Attributes:
        controller: name of the controller.
        values: values of the metrics by key of `FIELDS`, in SI units; None if the vehicle has no such metric or the run was
            aborted.
        fault: reason why the controller is never marked as best, see `law_fault`; empty for a controller that has no fault.
        vehicle: name of the vehicle if several vehicles are compared; otherwise empty.
        without: name of the part of the vehicle that the run omits, see `Vehicle.without`; empty for the whole vehicle.
        strokes: largest travel [m] and available stroke [m] in bump and in rebound, for the suspension that uses the largest
            share of its stroke. A direction without a stop is omitted. `strokes` is empty if the vehicle has no stops or there
            was no run.
    """

    controller: str
    values: Mapping[str, float | None]
    fault: str = ""
    vehicle: str = ""
    without: str = ""
    strokes: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Name of the controller, followed by the name of the omitted part of the vehicle."""
        return f"{self.controller}{variant(self.without)}"

    @property
    def label(self) -> str:
        """Name of the row, preceded by the name of the vehicle if several vehicles are compared."""
        return f"{self.vehicle}:{self.name}".removeprefix(":")


def score_field(key: str, label: str, unit: str = "", scale: float = 1.0) -> Field[Score]:
    """Returns the field of a score that has this key."""
    return Field(label, lambda one: one.values.get(key), three_digits, scale, key, unit)


COLUMNS = {name: one.column for name, one in METRICS.load_all().items() if one.column}
FIELDS = tuple(score_field(name, one.label, one.unit, one.scale) for name, one in COLUMNS.items())
FORCES = tuple(one for one in FIELDS if METRICS.load(one.key).effort)  # fields that are omitted for the passive vehicle
KEYS = tuple(one.key for one in FIELDS)


def strokes_used(vehicle: Vehicle, response: Response, first: int, end: int | None = None) -> dict[str, tuple[float, float]]:
    """Returns `Score.strokes` for a response; the arguments are those of `sim.studies.ride.metrics.measure`."""
    used: dict[str, tuple[float, float]] = {}
    for name, strokes in vehicle.parts.strokes.items():
        for side, stroke in strokes.items():
            sign = -1.0 if side == SIDES[0] else 1.0
            most = max(0.0, float((sign * response[name][first:end]).max())), stroke
            used[side] = max(used.get(side, most), most, key=lambda one: one[0] / one[1])
    return used


def with_faults(scores: Iterable[Score], vehicle: Vehicle, controllers: Iterable[AnyController]) -> list[Score]:
    """Returns the rows of a vehicle after the field `fault` was filled in for each controller."""
    faults = {one.name: law_fault(vehicle, one) for one in controllers}
    return [replace(one, fault=faults.get(one.controller, "")) for one in scores]


def columns_of(vehicle: Vehicle) -> dict[str, tuple[str, ...]]:
    """Returns the names of the metrics whose largest value is shown in a column, by key; empty if the vehicle has none of these
    metrics.

    If the vehicle carries a person, `ride` contains the points with a person. For a vehicle with a person, there is an
    additional key `ride_...` for each point.
    """
    columns: dict[str, tuple[str, ...]] = {}
    for key, metrics in compared_metrics(vehicle).items():
        if key in COLUMNS:
            kind = METRICS.load(key)
            columns[key] = tuple(one.name for one in metrics)
            columns |= {f"{key}_{source}": (kind(source).name,) for source in kind.shown_apart(vehicle)}
    return columns


def score_of(vehicle: Vehicle, controller: str, metrics: Mapping[str, float | None]) -> Score:
    """Returns the score of a controller, computed from the metrics of its run.

    Args:
        vehicle: vehicle that the controller controls.
        controller: name of the controller.
        metrics: values of the metrics by name; empty for an aborted run, whose score contains only None.
    """
    values = {key: [metrics.get(name) for name in names] for key, names in columns_of(vehicle).items()}
    largest = {
        key: max((one for one in some if one is not None and math.isfinite(one)), default=None) for key, some in values.items()
    }
    return Score(controller, largest)


def score_over_runs(vehicle: Vehicle, controller: str, metrics: Mapping[str, Array], distances: Array | None = None) -> Score:
    """Returns the score of a controller, computed from R runs; see `over_runs`. If a run does not have a metric, the combined
    value is None.

    Args:
        vehicle: vehicle that the controller controls.
        controller: name of the controller.
        metrics: values in all runs by name of the metric, each of shape (R,).
        distances: measured distance of each run [m], shape (R,); None if all distances are equal.
    """
    names = {name for some in columns_of(vehicle).values() for name in some}
    over = {one.name: over_runs(one, metrics[one.name], distances) for one in metrics_of(vehicle) if one.name in names}
    return score_of(vehicle, controller, over)


def best(scores: Iterable[Score]) -> dict[str, list[str]]:
    """Returns the names of the best controllers by key, which are those with the smallest value, rounded to the digits of the
    table.

    The comparison of forces does not include the passive vehicle. A controller with a fault is never one of the best. If all
    values are equal, no controller is the best.
    """
    names: dict[str, list[str]] = {}
    sound = [one for one in scores if not one.fault]
    for quantity in FIELDS:
        compared = [one for one in sound if quantity not in FORCES or one.controller != PASSIVE]
        values = {one.label: value for one in compared if (value := quantity.value(one)) is not None}
        shown = {name: quantity.digits(value) for name, value in values.items()}
        least = shown[min(values, key=values.__getitem__)] if values else ""
        names[quantity.key] = [name for name in shown if shown[name] == least] if len(set(shown.values())) > 1 else []
    return names


ROW = Record[Score](
    Record(
        controller=lambda one: one.controller, vehicle=if_any(lambda one: one.vehicle), without=if_any(lambda one: one.without)
    ),
    *FIELDS,
    lambda one: {key: value for key, value in one.values.items() if key not in COLUMNS},
    strokes=if_any(lambda one: {side: {"used": used, "of": of} for side, (used, of) in one.strokes.items()}),
)


def scores_record(scores: Sequence[Score]) -> dict[str, Any]:
    """Returns the table as a JSON object in SI units, with the best controllers for each column."""
    return {"controllers": [ROW(one) for one in scores], "best": best(scores)}


def scores_of_runs(
    runs: "Sequence[Run]",
    passive: Response,
    samples: tuple[int, int | None] = (0, None),
    measured: "Sequence[RunMetrics]" = (),
    without: Sequence[str] = (),
    title: str = "",
) -> list[Score]:
    """Returns the scores of runs, in the order of the rows.

    The score of the passive vehicle comes first. The score of a run that omits a part of the vehicle follows the score of the
    run with the whole vehicle.

    Args:
        runs: runs of the controllers over the same road.
        passive: MuJoCo response of the passive vehicle.
        samples: index of the first measured sample, and index after the last measured sample; None for the end of the runs.
        measured: metrics of the runs between the two samples in `samples`; empty if the metrics have not been measured yet.
        without: name of the part of the vehicle that each run omits; empty if no run omits a part.
        title: title of the vehicle if several vehicles are compared; otherwise empty.
    """
    road, (first, end) = runs[0].road, samples
    known: dict[int, Mapping[str, float | None]] = {
        id(run.physics): {name: one.mujoco for name, one in of_run.metrics.items()}
        for run, of_run in zip(runs, measured, strict=False)
    }
    rows = [(PASSIVE, "", runs[0].vehicle, passive)]
    parts = without or [""] * len(runs)
    rows += [
        (run.controller.name, part, run.vehicle, run.physics)
        for run, part in zip(runs, parts, strict=True)
        if run.physics is not passive
    ]
    order, scores = [name for name, *_ in rows], []
    for name, part, vehicle, response in sorted(rows, key=lambda row: order.index(row[0])):
        values = known.get(id(response))
        if values is None:
            broken = math.isfinite(response.diverged) or math.isfinite(end_times(vehicle, response)[REGIME_ENDS.index(FLAT)])
            values = {} if broken else measure(vehicle, response, first, road.loaded, end, speed=road.speed)
        one = score_of(vehicle, name, values)
        strokes = {} if set(one.values.values()) == {None} else strokes_used(runs[0].vehicle, response, first, end)
        scores.append(replace(one, vehicle=title, without=part, strokes=strokes))
    return with_faults(scores, runs[0].vehicle, [run.controller for run in runs])
