"""Comparison of controllers, a line each: ride, travel, tyre load and force, relative to passive, with the best marked.

For a vehicle with several wheels, suspensions or actuators, each column has the worst one.
"""

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.printed import GAP, finite, table, wrapped
from models.suspension.bump_stops import SIDES
from models.vehicle.names import PASSIVE, variant
from models.vehicle.vehicle import Vehicle
from sim.response.response import Response
from sim.studies.ride.metrics import Metric, dynamic_load, metrics_of, off_ground, points


@dataclass(frozen=True)
class Measure:
    """A column of the table.

    Attributes:
        key: name in JSON.
        title, unit: heading on the terminal, two lines.
        heading: heading on a page.
        scale: factor from SI units to those of the table.
        against: True if the change against passive is shown.
        effort: True for forces, which passive does not have.
    """

    key: str
    title: str
    unit: str
    heading: str
    scale: float = 1.0
    against: bool = False
    effort: bool = False


RIDE, TRAVEL, LOAD = "ride", "peak_travel", "dynamic_load"
MEASURES = (
    Measure(RIDE, "ride", "m/s2", "ride [m/s²]", against=True),
    Measure(TRAVEL, "travel", "peak mm", "peak travel [mm]", 1e3, against=True),
    Measure(LOAD, "tyre load", "dynamic", "dynamic load [-]", against=True),
    Measure("off_ground", "off", "road %", "off the ground [%]", 100.0),
    Measure("force_rms", "force", "rms N", "force, rms [N]", effort=True),
    Measure("force_peak", "force", "peak N", "force, peak [N]", effort=True),
    Measure("at_stops", "at", "stops %", "at stops [%]", 100.0),
)
KEYS = tuple(one.key for one in MEASURES)


@dataclass(frozen=True)
class Standing:
    """A row of the comparison: a controller's metrics on a road, in MuJoCo.

    Attributes:
        controller: name of the controller.
        values: values by key of `MEASURES`, in SI units; None if the vehicle lacks it or the run broke off.
        sound: False for a law that is unstable by itself or winds up; it is never called the best.
        vehicle: the name of its vehicle, for rows of several; empty if there is one.
        without: part of the vehicle that this run omits, see `Vehicle.without`; empty for the implemented loop.
        strokes: travel used and stroke [m] in bump and in rebound, of the suspension that uses the largest share of the stroke.
            A side without a stop is left out; empty without strokes or a run.
    """

    controller: str
    values: Mapping[str, float | None]
    sound: bool = True
    vehicle: str = ""
    without: str = ""
    strokes: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The controller, and what its run leaves out."""
        return f"{self.controller}{variant(self.without)}"

    @property
    def label(self) -> str:
        """The vehicle, if there are several, and the name."""
        return f"{self.vehicle}:{self.name}".removeprefix(":")


def strokes_used(vehicle: Vehicle, response: Response, first: int, end: int | None = None) -> dict[str, tuple[float, float]]:
    """Returns `Standing.strokes` of a response between two samples; arguments as for `sim.studies.ride.metrics.measure`."""
    used: dict[str, tuple[float, float]] = {}
    for name, stops in vehicle.limits.stops(vehicle.kind.suspensions).items():
        for side, (sign, stop) in stops.sides.items():
            most = max(0.0, float((sign * response[name][first:end]).max())), stop.stroke
            used[side] = max(used.get(side, most), most, key=lambda one: one[0] / one[1])
    return used


def without_unsound(standings: Iterable[Standing], unsound: Collection[str]) -> list[Standing]:
    """Returns the rows with those marked whose controller is among the unsound ones: unstable by itself, or winding up."""
    return [replace(one, sound=False) if one.controller in unsound else one for one in standings]


def columns_of(vehicle: Vehicle) -> dict[str, tuple[str, ...]]:
    """Returns, for each of `KEYS`, the metrics of which it is the largest; empty if the vehicle has no such metrics."""
    where, stops = points(vehicle), vehicle.limits.stops(vehicle.kind.suspensions)
    forces = [name for name, *_ in where.actuators]
    return {
        RIDE: tuple(f"{name}_weighted" for name in where.accelerations),
        TRAVEL: tuple(f"{name}_peak" for name in where.suspensions),
        LOAD: tuple(dynamic_load(name) for name in where.tyres),
        "off_ground": tuple(off_ground(name) for name in where.tyres),
        "force_rms": tuple(f"{name}_rms" for name in forces),
        "force_peak": tuple(f"{name}_peak" for name in forces),
        "at_stops": tuple(f"{name}_at_stops" for name in where.suspensions if name in stops),
    }


def standing(vehicle: Vehicle, controller: str, metrics: Mapping[str, float | None]) -> Standing:
    """Returns a controller's row from the metrics of its run, by name; all None without metrics, for a run that broke off."""
    values = {key: [metrics.get(name) for name in names] for key, names in columns_of(vehicle).items()}
    return Standing(
        controller,
        {key: max((one for one in some if one is not None), default=None) for key, some in values.items()},
    )


LARGEST_OF = ("peak", "mtvv", "vdv", "crest", "dive", "squat")  # what is largest over the runs; shares and work are means
MEAN_OF = ("at_stops", "off_ground", "power", "energy")  # all else are root mean squares


def over_runs(metric: Metric, values: Array) -> float:
    """Returns a metric over all runs: the largest of peaks, the mean of shares and work, the root mean square of all else."""
    if metric.what in LARGEST_OF:
        return float(values.max())
    return float(values.mean()) if metric.what in MEAN_OF else float(np.sqrt(np.mean(values**2)))


def standing_over_runs(vehicle: Vehicle, controller: str, metrics: Mapping[str, Array]) -> Standing:
    """Returns a controller's row over several runs; each metric is an array with a number for every run.

    Numbers are those of `over_runs`. All are None if a run has no metrics.
    """
    names = {name for some in columns_of(vehicle).values() for name in some}
    over = {one.name: over_runs(one, metrics[one.name]) for one in metrics_of(vehicle) if one.name in names}
    return standing(vehicle, controller, over if all(map(math.isfinite, over.values())) else {})


def best(standings: Sequence[Standing]) -> dict[str, list[str]]:
    """Returns the names of the best controllers by key: those with the smallest number, to the digits of the table.

    Passive is not compared in forces, and an unsound law in nothing. If all numbers are equal, none is best.
    """
    names: dict[str, list[str]] = {}
    for one in MEASURES:
        compared = [each for each in standings if each.sound and not (one.effort and each.controller == PASSIVE)]
        values = {each.label: value for each in compared if (value := each.values[one.key]) is not None}
        shown = {name: digits(value * one.scale) for name, value in values.items()}
        least = shown[min(values, key=values.__getitem__)] if values else ""
        names[one.key] = [name for name in shown if shown[name] == least] if len(set(shown.values())) > 1 else []
    return names


def digits(value: float) -> str:
    """Returns a number with three significant digits, or more if it has more before the point."""
    return f"{value:.0f}" if value >= 99.95 or not value else f"{value:#.3g}"


def standings_object(standings: Sequence[Standing]) -> dict[str, Any]:
    """Returns the table for JSON, in SI units, with the best of each column."""
    rows = [
        {"controller": one.controller}
        | {key: text for key, text in (("vehicle", one.vehicle), ("without", one.without)) if text}
        | {key: finite(one.values[key]) for key in KEYS}
        | ({"strokes": {side: {"used": used, "of": of} for side, (used, of) in one.strokes.items()}} if one.strokes else {})
        for one in standings
    ]
    return {"controllers": rows, "best": best(standings)}


@dataclass(frozen=True)
class ComparedColumn:
    """The cells of a column.

    Attributes:
        measure: the column.
        numbers: numbers of the controllers, the best marked.
        changes: differences from passive [%]; None if they are not shown.
    """

    measure: Measure
    numbers: list[str]
    changes: list[str] | None


def compared_columns(standings: Sequence[Standing]) -> tuple[list[ComparedColumn], str]:
    """Returns the columns that have numbers, and a legend of their marks; changes are against passive of the same vehicle."""
    passive = {one.vehicle: one for one in standings if one.controller == PASSIVE and not one.without and len(standings) > 1}
    marked, travel = best(standings), _travel(standings)
    columns = []
    for one in MEASURES:
        if not any(_is_there(one, each.values[one.key]) for each in standings):
            continue
        measure, sides = travel if one.key == TRAVEL and travel is not None else (one, None)
        shown = sides or [_shown(one, each) for each in standings]
        numbers = [f"{cell}{'*' if each.label in marked[one.key] else ' '}" for cell, each in zip(shown, standings, strict=True)]
        changes = None
        if one.against and passive:
            changes = [_change(each.values[one.key], passive[each.vehicle].values[one.key]) for each in standings]
        columns.append(ComparedColumn(measure, numbers, changes))
    unsound = ", ".join(one.label for one in standings if not one.sound)
    star = f"the best without {unsound}" if unsound else "the best"
    legend = f"*: {star}; " if any(marked[column.measure.key] for column in columns) else ""
    legend += "%: against passive; " if any(column.changes is not None for column in columns) else ""
    return columns, legend


def standing_lines(standings: Sequence[Standing], about: str) -> list[str]:
    """Returns the table, with a note below on what is measured."""
    columns, legend = compared_columns(standings)
    if not columns:
        return ["no ride to compare: of every controller a run broke off"]
    first, second, *cells = zip(["", "", *(one.name for one in standings)], *map(_cells, columns), strict=True)
    rows: list[Sequence[str] | str] = [first, second]
    for one, row, before in zip(standings, cells, ("", *(each.vehicle for each in standings)), strict=False):
        rows += [one.vehicle, row] if one.vehicle != before else [row]
    return [*table(rows, tight=True), *wrapped(f"{legend}{about}", GAP, 4)]


def _travel(standings: Sequence[Standing]) -> tuple[Measure, list[str]] | None:
    """Returns the column of travel in bump and rebound with its cells, if every run has strokes: in mm if all have the same
    strokes, else in per cent of them.
    """
    usual, whole = (
        next(one for one in MEASURES if one.key == TRAVEL),
        [one for one in standings if one.values[TRAVEL] is not None],
    )
    if not whole or not all(one.strokes for one in whole):
        return None
    strokes = {tuple(one.strokes[side][1] if side in one.strokes else None for side in SIDES) for one in whole}
    alike = len(strokes) == 1
    of = "/".join("-" if stroke is None else f"{1e3 * stroke:.4g}" for stroke in next(iter(strokes)))
    what = f"of {of} mm" if alike else "% of stroke"
    cells = [
        "/".join(
            f"{1e3 * one.strokes[side][0] if alike else 100 * one.strokes[side][0] / one.strokes[side][1]:.0f}"
            if side in one.strokes
            else "-"
            for side in SIDES
        )
        for one in standings
    ]
    heading = f"travel in bump/rebound, {what}"
    return replace(usual, title=what, unit="bump/reb.", heading=heading), cells


def _is_there(one: Measure, value: float | None) -> bool:
    """Returns True if a number is worth a column: a force of zero is not."""
    return bool(value) if one.effort else value is not None


def _cells(column: ComparedColumn) -> list[str]:
    """Returns a column on the terminal: its title, its unit, and a cell for each controller."""
    one = column.measure
    if column.changes is None:
        return [f"{one.title} ", f"{one.unit} ", *column.numbers]
    width = max(map(len, column.changes))
    pairs = zip(column.numbers, column.changes, strict=True)
    return [one.title, f"{one.unit} %", *(f"{number} {change:>{width}}" for number, change in pairs)]


def _shown(one: Measure, standing: Standing) -> str:
    value = standing.values[one.key]
    return "-" if value is None else digits(value * one.scale)


def _change(value: float | None, passive: float | None) -> str:
    """Returns by how many per cent a number exceeds passive's; empty if either is missing, zero or equal."""
    if not passive or value is None or value == passive:
        return ""
    change = round(100 * (value / passive - 1))
    return f"{change:+d}" if change else "0"
