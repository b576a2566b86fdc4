"""The first section of a report, which shows requirements and the comparison of controllers, and the section about
verification.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from models.common.printed import as_name, digits, three_digits
from models.document.document import Document, Pivot, Table
from models.document.field import Field
from models.document.figure import Bars, Figure, Panel, styles
from models.document.text import CHANGE
from models.vehicle.names import PASSIVE
from sim.drive.regime import BUMP_STOP, RATE_LIMIT, REGIME_ENDS, SATURATION, end_times
from sim.observers.results import WHEN
from sim.runs.record import SIZE
from sim.runs.report import verdict
from sim.runs.run import Run
from sim.studies.ride.score_table import CHANGES, best_of_all, compared_table, headline
from sim.studies.ride.scores import COLUMNS, FIELDS, Score, best
from sim.studies.subject import AVERAGE, NAME, SEEDS, SPEED, Subject
from sim.studies.validity.edges import HEIGHT
from sim.studies.validity.regime_end import RegimeEnd
from sim.studies.validity.report import OneEnd
from synth.controller.report import NORM

# title of each panel in the first figure, by quantity
PANELS = {one: bars for one in FIELDS if (bars := COLUMNS[one.key].bars)}


def first_screen(
    scope: Subject, runs: Sequence[Run], compared: Sequence[Score], dive: Mapping[str, float], where: str
) -> Document:
    """Returns the first section of the page: the requirements (if present), and the comparison of controllers as a table and as
    bars.

    Args:
        scope: subject of the report, with its vehicle, controllers and runs.
        runs: runs of all controllers over the road.
        compared: scores of the controllers for the table that compares them.
        dive: dive angle under braking [deg], by controller; empty if the vehicle cannot pitch.
        where: text that describes the roads over which the controllers are compared; see `compared_on`.
    """
    more = [Field[Score]("dive under 0.5 g", lambda one: dive.get(one.controller), three_digits, unit="deg")] if dive else []
    table, wanted = compared_table(compared, where, more), requirements_table(scope, runs)
    return Document("", (*([wanted] if wanted else []), table, _bars(scope, compared, more, table, where)))


def _bars(scope: Subject, compared: Sequence[Score], dives: Sequence[Field[Score]], table: Table, where: str) -> Figure:
    """Returns a bar chart of ride, travel, tyre load, force and dive for all controllers, with the changes relative to the
    passive vehicle.
    """
    names = tuple(one.controller for one in compared)
    look, marked = {**styles((PASSIVE,)), **scope.styles}, best(compared)
    columns, panels = dict(zip(table.headings, zip(*table.rows, strict=True), strict=True)), []
    for quantity, title in {**PANELS, **dict.fromkeys(dives, "Dive under 0.5 g of braking")}.items():
        values = [quantity.value(one) for one in compared]
        if any(values):
            changes = columns.get(f"{CHANGES.get(quantity)}{CHANGE}", ("-",) * len(names))
            stars = (" ★" * (name in marked.get(quantity.key, ())) for name in names)
            words = tuple(
                f"{quantity.cell(one)}{f' {change} %'.replace('-', '−') if change != '-' else ''}{star}"
                for one, change, star in zip(compared, changes, stars, strict=True)
            )
            lengths = quantity.scale * np.array([math.nan if value is None else value for value in values])
            panels.append(
                Panel(title, quantity.title, "", (), Bars(names, lengths, words, tuple(look[name].color for name in names)))
            )
    title = f"Shorter bars are better, ★: {best_of_all(compared)}. {where}. Percentages are changes from {as_name(PASSIVE)}."
    return Figure("summary", title, tuple(panels), columns=min(len(panels), 4), finding=f"{headline(compared)}.")


def requirements_table(scope: Subject, runs: Sequence[Run]) -> Table | None:
    """Returns a table of the vehicle file's goals and limits, with the controllers that meet them; None if the file has no
    goals or limits.

    A goal is compared with the proved value, and a limit is compared with the run over the road.
    """
    rows = []
    for one in scope.controllers:
        for goal in (goal for goal in one.specifications if goal.at_most is not None):
            what = f"{goal.what.replace('_', ' ')}, at most {digits(goal.at_most)} {goal.unit}".rstrip()
            rows.append((what, one.name, f"{'✓' if goal.holds else '✗'} {digits(goal.value)} {goal.unit}".rstrip()))
    road = "road" if scope.own_road is not None else "bump"
    for run in runs:
        ended = end_times(scope.vehicle, run.physics)
        for end in (one for one in (BUMP_STOP, SATURATION, RATE_LIMIT) if one.thresholds(scope.vehicle)):
            when = float(ended[REGIME_ENDS.index(end)])
            kept = "✓ not reached" if math.isinf(when) else f"✗ at {WHEN.text(when)}"
            rows.append((f"{end.name}, not over the {road}", run.controller.name, kept))
    caption = "Requirements of the vehicle file, met (✓) or not met (✗). A goal is met if the proved value is within it."
    pivot = Pivot(("requirement",), "controller", ("result",))
    return Table("requirements", caption, ("requirement", "controller", "result"), tuple(rows), 2, pivot) if rows else None


@np.errstate(over="ignore")  # the squares of an unstable loop overflow
def trust_section(scope: Subject, runs: Sequence[Run], ends: Sequence[OneEnd], wrong: Sequence[str]) -> Document:
    """Returns the section that compares predictions of linear analysis with MuJoCo, and states up to which bump height linear
    analysis is valid.

    Args:
        scope: subject of the report, with its vehicle, controllers and runs.
        runs: runs of all controllers over the road.
        ends: bump height at which the linear regime ends, for each controller.
        wrong: names of the controllers whose runs disagree with linear analysis. The section states no bump height for
            controllers whose runs disagree with linear analysis.
    """
    vehicle = scope.vehicle
    certificates = {one.name: one.certificate for one in scope.controllers if one.certificate.stable}
    heights = {one.name: _height(end) if end else "at any height" for one, end in ends} | dict.fromkeys(wrong, "none claimed")
    name = next((name for name in vehicle.performance if name.endswith("acceleration")), next(iter(vehicle.performance)))
    label, unit = name.replace("_", " "), vehicle.kind.signal(name).unit.replace("s2", "s²")

    def linear(run: Run) -> float | None:
        return None if scope.unstable(run.controller) or not run.controller.linear else float(run.sampled.rms(name))

    columns: tuple[Field[Run], ...] = (
        NAME.of(lambda run: run.controller),
        NORM.of(lambda run: certificates.get(run.controller.name), "H-infinity norm"),
        Field(f"{label}, rms [{unit}], predicted", linear, SIZE.form),
        Field("in MuJoCo", lambda run: None if scope.unstable(run.controller) else float(run.physics.rms(name)), SIZE.form),
        Field(f"analysis true up to{scope.noise_qualifier}", lambda run: heights.get(run.controller.name, "-")),
        Field(f"over {scope.where}", lambda run: verdict(run).text),
    )
    caption = f"{label.capitalize()} over {scope.where}, and the bump height up to which linear analysis is valid."
    return Document("Verification", (Table.of("summary", caption, columns, runs),))


def compared_on(scope: Subject, compared: Sequence[Score], rides: bool, when: str) -> str:
    """Returns a text that describes the roads over which controllers are compared: the road of the report, random roads, or the
    paper's bump.

    Args:
        scope: subject of the report, with its vehicle, controllers and runs.
        compared: scores of the controllers for the table that compares them.
        rides: True if the controllers are compared over random roads.
        when: text that states in which part of the run the metrics are measured.
    """
    where = f"{len(SEEDS)} roads of class {AVERAGE} at {SPEED:g} m/s, largest peaks" if rides else "the paper's bump"
    if scope.own_road is not None:
        where = f"{scope.road_name}, {when}"
    absent = "; -: unstable, or a run ended early" if any(not any(one.values.values()) for one in compared) else ""
    return f"MuJoCo, {where}{absent}"


def _height(end: RegimeEnd) -> str:
    """Returns a text with the bump height at which the linear regime ends, with a remark if MuJoCo does not confirm this
    height.
    """
    return HEIGHT.text(end.found) if end.confirmed else f"NOT as predicted, {HEIGHT.text(end.predicted)}"
