"""The printed table that compares controllers.

The table has a row for each controller, shows changes relative to the passive vehicle, and marks the best values.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from models.characteristics import SIDES
from models.common.printed import GAP, wrap_text
from models.document.document import Table
from models.document.field import Field
from models.document.text import BEST, CHANGE, names_text, table_lines
from models.vehicle.names import PASSIVE
from sim.studies.ride.scores import COLUMNS, FIELDS, FORCES, Score, best, score_field

STROKE = Field[float]("stroke", float, ".4g", 1e3, unit="mm")
USED_TRAVEL = Field[tuple[float, float]]("used", lambda side: side[0], ".1f", 1e3, unit="mm")
SHARE_USED = Field[tuple[float, float]]("used", lambda side: side[0] / side[1], ".0f", 100.0, unit="%")
# Columns that show changes relative to the passive vehicle
CHANGES = {one: change for one in FIELDS if (change := COLUMNS[one.key].change)}
MANY = 4  # largest number of names that a sentence lists
MOST_POINTS = 2  # largest number of columns for the ride at points without a person


def headline(scores: Sequence[Score]) -> str:
    """Returns a line that names the controllers with the best ride and the best road holding."""
    marked = best(scores)
    praised = [(COLUMNS[key].praise, names) for key, names in marked.items() if COLUMNS[key].praise[0] and names]
    said: dict[tuple[str, ...], list[str]] = {}
    for (verb, what), names in praised:
        said.setdefault(tuple(names), []).append(f"{verb}{'s' * (len(names) == 1)}{what}")
    texts = [f"{some_names(names)} {' and '.join(verbs)} best" for names, verbs in said.items()]
    if not texts and (faults := _faults(scores)):
        return f"No controller is called best: {', '.join(f'{some_names(names)} ({fault})' for fault, names in faults.items())}"
    return ", ".join(texts) or "All controllers have the same values"


def _faults(scores: Sequence[Score]) -> dict[str, list[str]]:
    """Returns, for each fault, the labels of the controllers with this fault."""
    return {
        fault: [one.label for one in scores if one.fault == fault]
        for fault in dict.fromkeys(one.fault for one in scores if one.fault)
    }


def best_of_all(scores: Sequence[Score]) -> str:
    """Returns "best", followed by the controllers that a fault excludes, such as "best without I (disk margin below 0.3)"."""
    excluded = ", ".join(f"{', '.join(names)} ({fault})" for fault, names in _faults(scores).items())
    return f"best without {excluded}" if excluded else "best"


def some_names(names: Sequence[str]) -> str:
    """Returns the names of controllers for use in a sentence, or only the number of controllers if there are more than `MANY`."""
    return names_text(names) if len(names) <= MANY else f"{len(names)} controllers"


def compared_table(scores: Sequence[Score], about: str, more: Sequence[Field[Score]] = ()) -> Table:
    """Returns the table that compares controllers. Changes are relative to the passive vehicle of the same vehicle file.

    Args:
        scores: scores of the controllers, one for each row.
        about: text that describes which part of the runs was measured.
        more: additional columns, which follow the columns of metrics.
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
    star = f"*: {best_of_all(scores)}" if any(marked.values()) else ""
    legend = "; ".join(filter(None, [star, "%: change from passive" if passive and there else ""]))
    caption = f"Worst point of the vehicle in {about}{strokes}.{f' {legend}.' if legend else ''}"
    if not there:
        caption = "No controller can be compared, because each has a run that ended early."
    return Table.of("compared", caption, (*columns, *more), scores, words=1 + several)


def score_lines(scores: Sequence[Score], about: str, below: Sequence[Mapping[str, str]] = ()) -> list[str]:
    """Returns the printed lines of the table, followed by the caption.

    Args:
        scores: scores of the controllers, one for each row.
        about: text that describes which part of the runs was measured.
        below: cells of additional rows that follow the rows of the controllers, by heading of the column.
    """
    one = compared_table(scores, about)
    one = replace(one, rows=(*one.rows, *(tuple(cells.get(heading, "") for heading in one.headings) for cells in below)))
    return [*(table_lines(one) if len(one.headings) > one.words else []), *wrap_text(one.caption, GAP, len(GAP))]


def _mark_best(quantity: Field[Score], names: Sequence[str]) -> Field[Score]:
    """Returns the table column that shows a quantity of the controllers. The controllers in `names` are marked as the best
    ones.
    """
    return replace(quantity, value=lambda one: f"{quantity.cell(one)}{BEST if one.label in names else ''}")


def _change(quantity: Field[Score], passive: Mapping[str, Score]) -> Field[Score]:
    """Returns the column of changes relative to the passive vehicle. A cell is "-" if a value is missing, if the passive value
    is zero, or if both values are equal.
    """

    def change(one: Score) -> str | None:
        value, usual = quantity.value(one), quantity.value(passive[one.vehicle])
        if not usual or value is None or value == usual:
            return None
        share = round(100 * (value / usual - 1))
        return f"{share:+d}" if share else "0"

    return Field(f"{CHANGES[quantity]}{CHANGE}", change, column=f"{CHANGES[quantity]}, %")


def _at_points(quantity: Field[Score], scores: Sequence[Score]) -> list[Field[Score]]:
    """Returns the table columns for a quantity: one for the vehicle and, if the vehicle carries a person, one for each
    additional point.

    If there are more than `MOST_POINTS` additional points, they share one column, which contains the largest value.
    """
    begin = f"{quantity.key}_"
    points = dict.fromkeys(key for one in scores for key in one.values if key not in COLUMNS and key.startswith(begin))
    same = [key for key in points if all(one.values.get(key) == quantity.value(one) for one in scores)]
    names = {key: key.removeprefix(begin).replace("_acceleration", "").replace("_", " ") for key in points}
    labels = {key: f"{quantity.label}, {name}" for key, name in names.items()}
    first = replace(quantity, label=labels[same[0]] if same else quantity.label)
    others = [key for key in points if key not in same]
    if len(others) <= MOST_POINTS:
        return [first, *(score_field(key, labels[key], quantity.unit, quantity.scale) for key in others)]
    label = f"{quantity.label}, body"
    return [first, replace(quantity, label=label, value=lambda one: max(one.values.get(key) or 0.0 for key in others) or None)]


def _travel(quantity: Field[Score], scores: Sequence[Score]) -> tuple[list[Field[Score]], str]:
    """Returns the columns of suspension travel, and a text for the caption that states the strokes.

    If all runs have stops, bump and rebound have separate columns, in mm if all strokes are equal, otherwise in per cent of the
    stroke.
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
