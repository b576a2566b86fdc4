"""Comparison of controllers, a row each: ride, travel, tyre load and force, with the change from passive, and the best marked.

For a vehicle with several wheels, suspensions or actuators, each column has the worst one.
"""

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from models.characteristics import SIDES
from models.common.arrays import Array
from models.common.printed import GAP, wrap_text
from models.document.document import Table
from models.document.field import Field, Record, if_any
from models.document.text import BEST, CHANGE, names_text, table_lines
from models.vehicle.names import PASSIVE, variant
from models.vehicle.vehicle import Vehicle
from sim.drive.response import Response
from sim.studies.ride.metrics import compared_metrics, metrics_of, over_runs
from sim.studies.ride.registry import metric_classes


@dataclass(frozen=True)
class Score:
    """A row of the comparison: a controller's metrics on a road, in MuJoCo.

    Attributes:
        controller: name of the controller.
        values: values by key of `FIELDS`, in SI units; None if the vehicle lacks it or the run broke off.
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


def digits(value: float) -> str:
    """Returns a number with three significant digits, or more if it has more before the point."""
    return f"{value:.0f}" if value >= 99.95 or not value else f"{value:#.3g}"


def _of(key: str, label: str, unit: str = "", scale: float = 1.0) -> Field[Score]:
    return Field(label, lambda one: one.values.get(key), digits, scale, key, unit)


COLUMNS = {name: one.column for name, one in metric_classes().items() if one.column}
FIELDS = tuple(_of(name, one.label, one.unit, one.scale) for name, one in COLUMNS.items())
FORCES = tuple(one for one in FIELDS if metric_classes()[one.key].effort)  # passive has none
STROKE = Field[float]("stroke", float, ".4g", 1e3, unit="mm")
USED_TRAVEL = Field[tuple[float, float]]("used", lambda side: side[0], ".1f", 1e3, unit="mm")
SHARE_USED = Field[tuple[float, float]]("used", lambda side: side[0] / side[1], ".0f", 100.0, unit="%")
CHANGES = {one: change for one in FIELDS if (change := COLUMNS[one.key].change)}  # of which the change from passive is shown
MANY = 4  # names in a sentence
MOST_POINTS = 2  # columns of ride at other points than those with a person
KEYS = tuple(one.key for one in FIELDS)


def strokes_used(vehicle: Vehicle, response: Response, first: int, end: int | None = None) -> dict[str, tuple[float, float]]:
    """Returns `Score.strokes` of a response between two samples; arguments as for `sim.studies.ride.metrics.measure`."""
    used: dict[str, tuple[float, float]] = {}
    for name, strokes in vehicle.parts.strokes.items():
        for side, stroke in strokes.items():
            sign = -1.0 if side == SIDES[0] else 1.0
            most = max(0.0, float((sign * response[name][first:end]).max())), stroke
            used[side] = max(used.get(side, most), most, key=lambda one: one[0] / one[1])
    return used


def without_unsound(scores: Iterable[Score], unsound: Collection[str]) -> list[Score]:
    """Returns the rows with those marked whose controller is among the unsound ones: unstable by itself, or winding up."""
    return [replace(one, sound=False) if one.controller in unsound else one for one in scores]


def columns_of(vehicle: Vehicle) -> dict[str, tuple[str, ...]]:
    """Returns, for each of `KEYS`, the metrics of which it is the largest; empty if the vehicle has no such metrics.

    A vehicle with a person has the key `ride_...` of every point, too, those with a person first; `ride` is that of persons.
    """
    columns: dict[str, tuple[str, ...]] = {}
    for key, metrics in compared_metrics(vehicle).items():
        if key in COLUMNS:
            kind = metric_classes()[key]
            columns[key] = tuple(one.name for one in metrics)
            columns |= {f"{key}_{source}": (kind(source).name,) for source in kind.shown_apart(vehicle)}
    return columns


def score_of(vehicle: Vehicle, controller: str, metrics: Mapping[str, float | None]) -> Score:
    """Returns a controller's row from the metrics of its run, by name; all None without metrics, for a run that broke off."""
    values = {key: [metrics.get(name) for name in names] for key, names in columns_of(vehicle).items()}
    largest = {
        key: max((one for one in some if one is not None and math.isfinite(one)), default=None) for key, some in values.items()
    }
    return Score(controller, largest)


def score_over_runs(vehicle: Vehicle, controller: str, metrics: Mapping[str, Array], distances: Array | None = None) -> Score:
    """Returns a controller's row over several runs; each metric is an array with a number for every run.

    Numbers are those of `over_runs`, with its distances. Those are None that a run lacks.
    """
    names = {name for some in columns_of(vehicle).values() for name in some}
    over = {one.name: over_runs(one, metrics[one.name], distances) for one in metrics_of(vehicle) if one.name in names}
    return score_of(vehicle, controller, over)


def best(scores: Iterable[Score]) -> dict[str, list[str]]:
    """Returns the names of the best controllers by key: those with the smallest number, to the digits of the table.

    Passive is not compared in forces, and an unsound law in nothing. If all numbers are equal, none is best.
    """
    names: dict[str, list[str]] = {}
    sound = [one for one in scores if one.sound]
    for quantity in FIELDS:
        compared = [one for one in sound if quantity not in FORCES or one.controller != PASSIVE]
        values = {one.label: value for one in compared if (value := quantity.value(one)) is not None}
        shown = {name: quantity.digits(value) for name, value in values.items()}
        least = shown[min(values, key=values.__getitem__)] if values else ""
        names[quantity.key] = [name for name in shown if shown[name] == least] if len(set(shown.values())) > 1 else []
    return names


def headline(scores: Sequence[Score]) -> str:
    """Returns in a line who is best at ride and at road holding."""
    marked = best(scores)
    praised = [(COLUMNS[key].praise, names) for key, names in marked.items() if COLUMNS[key].praise[0] and names]
    said: dict[tuple[str, ...], list[str]] = {}
    for (verb, what), names in praised:
        said.setdefault(tuple(names), []).append(f"{verb}{'s' * (len(names) == 1)}{what}")
    texts = [f"{some_names(names)} {' and '.join(verbs)} best" for names, verbs in said.items()]
    return ", ".join(texts) or "All controllers have the same values"


def some_names(names: Sequence[str]) -> str:
    """Returns names of controllers in a sentence, or their number if they are many."""
    return names_text(names) if len(names) <= MANY else f"{len(names)} controllers"


ROW = Record[Score](
    Record(
        controller=lambda one: one.controller, vehicle=if_any(lambda one: one.vehicle), without=if_any(lambda one: one.without)
    ),
    *FIELDS,
    lambda one: {key: value for key, value in one.values.items() if key not in COLUMNS},
    strokes=if_any(lambda one: {side: {"used": used, "of": of} for side, (used, of) in one.strokes.items()}),
)


def scores_record(scores: Sequence[Score]) -> dict[str, Any]:
    """Returns the table as a JSON object, in SI units, with the best of each column."""
    return {"controllers": [ROW(one) for one in scores], "best": best(scores)}


def compared_table(scores: Sequence[Score], about: str, more: Sequence[Field[Score]] = ()) -> Table:
    """Returns the comparison of controllers; changes are from passive of the same vehicle.

    Args:
        about: the measurement in words.
        more: further columns.
    """
    passive = {one.vehicle: one for one in scores if one.controller == PASSIVE and not one.without and len(scores) > 1}
    marked, several = best(scores), any(one.vehicle for one in scores)
    columns = [Field[Score]("vehicle", lambda one: one.vehicle)] if several else []
    columns.append(Field("controller", lambda one: one.name))
    there = [one for one in FIELDS if {one.value(each) for each in scores} - {None, *([0.0] if one in FORCES else [])}]
    strokes = ""
    for quantity in there:
        first, *others = _at_points(quantity, scores)
        shown = [first]
        if COLUMNS[quantity.key].by_side:
            shown, strokes = _travel(quantity, scores)
        columns += [_mark_best(one, marked[quantity.key]) for one in shown]
        if quantity in CHANGES and passive:
            columns.append(_change(quantity, passive))
        columns += others
    unsound = ", ".join(one.label for one in scores if not one.sound)
    star = f"*: best{f' without {unsound}' if unsound else ''}" if any(marked.values()) else ""
    legend = "; ".join(filter(None, [star, "%: change from passive" if passive and there else ""]))
    caption = f"Worst point of the vehicle in {about}{strokes}.{f' {legend}.' if legend else ''}"
    if not there:
        caption = "No controller can be compared, because each has a run that broke off."
    return Table.of("compared", caption, (*columns, *more), scores, words=1 + several)


def score_lines(scores: Sequence[Score], about: str) -> list[str]:
    """Returns the comparison for a terminal, with its caption below."""
    one = compared_table(scores, about)
    return [*(table_lines(one) if len(one.headings) > one.words else []), *wrap_text(one.caption, GAP, len(GAP))]


def _mark_best(quantity: Field[Score], names: Sequence[str]) -> Field[Score]:
    """Returns the column of a quantity in which those of these names have a mark."""
    return replace(quantity, value=lambda one: f"{quantity.cell(one)}{BEST if one.label in names else ''}")


def _change(quantity: Field[Score], passive: Mapping[str, Score]) -> Field[Score]:
    """Returns the column of changes from passive of the same vehicle, "-" for a missing, zero or equal number."""

    def change(one: Score) -> str | None:
        value, usual = quantity.value(one), quantity.value(passive[one.vehicle])
        if not usual or value is None or value == usual:
            return None
        share = round(100 * (value / usual - 1))
        return f"{share:+d}" if share else "0"

    return Field(f"{CHANGES[quantity]}{CHANGE}", change, column=f"{CHANGES[quantity]}, %")


def _at_points(quantity: Field[Score], scores: Sequence[Score]) -> list[Field[Score]]:
    """Returns the columns of a quantity: that of the vehicle, then of other points of vehicles with a person.

    If there are more than `MOST_POINTS` other points, their column has the largest value.
    """
    begin = f"{quantity.key}_"
    points = dict.fromkeys(key for one in scores for key in one.values if key not in COLUMNS and key.startswith(begin))
    same = [key for key in points if all(one.values.get(key) == quantity.value(one) for one in scores)]
    names = {key: key.removeprefix(begin).replace("_acceleration", "").replace("_", " ") for key in points}
    labels = {key: f"{quantity.label}, {name}" for key, name in names.items()}
    first = replace(quantity, label=labels[same[0]] if same else quantity.label)
    others = [key for key in points if key not in same]
    if len(others) <= MOST_POINTS:
        return [first, *(_of(key, labels[key], quantity.unit, quantity.scale) for key in others)]
    label = f"{quantity.label}, body"
    return [first, replace(quantity, label=label, value=lambda one: max(one.values.get(key) or 0.0 for key in others) or None)]


def _travel(quantity: Field[Score], scores: Sequence[Score]) -> tuple[list[Field[Score]], str]:
    """Returns the columns of travel, and the strokes for the caption: a column for each side if every run has strokes.

    A side is in mm if all runs have the same strokes, else in per cent of its stroke.
    """
    whole = [one for one in scores if quantity.value(one) is not None]
    sides = [side for side in SIDES if any(side in one.strokes for one in whole)]
    if not all(one.strokes for one in whole) or not sides:
        return [quantity], ""
    strokes = {side: {one.strokes[side][1] if side in one.strokes else None for one in whole} for side in sides}
    alike = all(len(some) == 1 for some in strokes.values())
    of = ", ".join(f"{STROKE.text(next(iter(some)))} in {side}" for side, some in strokes.items())
    used, label = (USED_TRAVEL, "{} travel") if alike else (SHARE_USED, "{} used")

    def of_side(side: str) -> Field[Score]:
        return used.of(lambda one: one.strokes.get(side), label.format(side))

    return [of_side(side) for side in sides], f"; stroke {of}" if alike else "; used: of the stroke"
