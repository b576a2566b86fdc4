"""First screen of a report: requirements, comparison of controllers; and the table of claims and their checks."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from models.common.printed import as_name
from models.document.document import Document, Table
from models.document.field import Field
from models.document.figure import Bars, Figure, Panel, styles
from models.document.reading import Pivot
from models.vehicle.names import PASSIVE
from sim.report.best import DIVE, NORM
from sim.report.headline import unclaimed
from sim.report.ride import AVERAGE, SEEDS, SPEED, Ride
from sim.report.scope import NAME, Scope, change
from sim.response.regime import BUMP_STOP, REGIME_ENDS, SATURATION, reached
from sim.runs.report import verdict
from sim.runs.run import Run
from sim.studies.ride.standing import CHANGES, FORCE, LOAD, RIDE, TRAVEL, Standing, best, compared_table, headline
from sim.studies.validity.regime_end import RegimeEnd
from synth.controller.controller import Controller

PANELS = {  # of the first figure
    RIDE: "Acceleration of the body",
    TRAVEL: "Travel of the suspension",
    LOAD: "Change of the tyre load",
    FORCE: "Largest force",
}
UNTIL = Field[float]("linear until", float, ".3g", unit="s")
HEIGHT = Field[float]("height", float, ".3g", unit="m")


def first_screen(
    scope: Scope, runs: Sequence[Run], compared: Sequence[Standing], dive: Mapping[str, float], where: str
) -> Document:
    """Returns what is seen first: requirements where there are some, who is best at what, and the same as bars.

    Args:
        compared: the controllers' standings, over the roads of `compared_on`.
        dive: dive angle of every controller under braking [deg]; empty for a vehicle that cannot pitch.
        where: roads of the comparison, in words.
    """
    wanted = requirements_table(scope, runs)
    dives: tuple[Field[Standing], ...] = (DIVE.of(lambda one: dive.get(one.controller)),) if dive else ()
    tables = (*((wanted,) if wanted is not None else ()), compared_table(compared, where, dives))
    return Document("", (*tables, compared_figure(scope, compared, dives, where)))


def compared_figure(scope: Scope, compared: Sequence[Standing], dives: Sequence[Field[Standing]], where: str) -> Figure:
    """Returns bars of ride, travel, tyre load, force and dive of every controller in MuJoCo."""
    names = tuple(one.controller for one in compared)
    look = {**styles((PASSIVE,)), **scope.styles}
    colors, marked = tuple(look[name].color for name in names), best(compared)
    passive = next((one for one in compared if one.controller == PASSIVE), None)
    panels = []
    for quantity, title in {**PANELS, **dict.fromkeys(dives, "Dive under 0.5 g of braking")}.items():
        values = [quantity.value(one) for one in compared]
        if not any(values):
            continue
        usual = quantity.value(passive) if passive is not None and quantity in CHANGES else None
        words = tuple(
            f"{quantity.cell(one)} {change(value, usual)}".rstrip() + " ★" * (one.controller in marked.get(quantity.key, ()))
            for one, value in zip(compared, values, strict=True)
        )
        lengths = quantity.scale * np.array([math.nan if value is None else value for value in values])
        panels.append(Panel(title, quantity.title, "", (), Bars(names, lengths, words, colors)))
    title = f"Shorter bars are better, ★ is the best. {where}. Percentages are changes from {as_name(PASSIVE)}."
    return Figure("summary", title, tuple(panels), columns=min(len(panels), 4), finding=f"{headline(compared)}.")


def requirements_table(scope: Scope, runs: Sequence[Run]) -> Table | None:
    """Returns the goals and limits of the vehicle file, and who keeps them; None without any.

    Goals are compared with what is proved, limits with the run over the road.
    """
    rows = []
    for one in scope.controllers:
        for goal in one.specifications:
            if goal.at_most is not None:
                value = Field[float]("value", float, ".4g", unit=goal.unit)
                what = f"{goal.what.replace('_', ' ')}, at most {goal.at_most:.6g} {goal.unit}".rstrip()
                rows.append((what, one.name, f"{'✓' if goal.holds else '✗'} {value.text(goal.value)}"))
    road = "road" if scope.own_road is not None else "bump"
    for run in runs:
        ended = reached(scope.vehicle, run.physics)
        for end in (one for one in (BUMP_STOP, SATURATION) if one.thresholds(scope.vehicle)):
            when = float(ended[REGIME_ENDS.index(end)])
            kept = "✓ not reached" if math.isinf(when) else f"✗ at {UNTIL.text(when)}"
            rows.append((f"{end.name}, not over the {road}", run.controller.name, kept))
    caption = "Requirements of the vehicle file, met (✓) or not met (✗). A goal is met if the proved value is within it."
    pivot = Pivot(("requirement",), "controller", ("result",))
    return Table("requirements", caption, ("requirement", "controller", "result"), tuple(rows), 2, pivot) if rows else None


def trust_section(
    scope: Scope, runs: Sequence[Run], ends: Sequence[tuple[Controller, RegimeEnd | None]], rides: Sequence[Ride]
) -> Document:
    """Returns the section on the claims about every controller, and up to which bump they are true."""
    norms = {one.name: one.certificate.norm.value for one in scope.controllers if one.certificate.stable}
    roughness, label, unit = _roughness(scope, runs, rides)
    wrong, neither = unclaimed(ends, runs), (None, None)
    stated = {one.name: "at any height" if end is None else _height(end) for one, end in ends}
    stated |= dict.fromkeys(wrong, "none claimed")
    columns: tuple[Field[Run], ...] = (
        NAME.of(lambda run: run.controller),
        NORM.of(lambda run: norms.get(run.controller.name)),
        Field(f"{label} [{unit}], predicted", lambda run: roughness.get(run.controller.name, neither)[0], ".3g"),
        Field("in MuJoCo", lambda run: roughness.get(run.controller.name, neither)[1], ".3g"),
        Field(f"analysis true up to{scope.noise_qualifier}", lambda run: stated.get(run.controller.name, "-")),
        Field(f"over {scope.where}", lambda run: verdict(run).text),
    )
    caption = "Predicted and simulated ride of each controller, and the height of the bump up to which analysis is true."
    return Document("Verification", (Table.of("summary", caption, columns, runs),))


def compared_on(scope: Scope, compared: Sequence[Standing], rides: bool, when: str) -> str:
    """Describes the roads that controllers are compared on: the report's own, measured when, random ones, or the bump."""
    where = f"{len(SEEDS)} roads of class {AVERAGE} at {SPEED:g} m/s, largest peaks" if rides else "the paper's bump"
    if scope.own_road is not None:
        where = f"{scope.road_name}, {when}"
    absent = "; -: unstable, or a run broke off" if any(not any(one.values.values()) for one in compared) else ""
    return f"MuJoCo, {where}{absent}"


def _roughness(scope: Scope, runs: Sequence[Run], rides: Sequence[Ride]) -> tuple[dict[str, tuple[float, float]], str, str]:
    """Returns the body's acceleration with stable loops, predicted and in MuJoCo: of the ride if there is one, else over the
    bump.
    """
    if rides:
        metric, unit = rides[0].metric, rides[0].unit
        some = [one for one in rides if (one.road_class, one.metric) == (AVERAGE, metric)]
        return {one.controller: (one.predicted, one.measured) for one in some}, metric, unit.replace("s2", "s²")
    vehicle = scope.vehicle
    name = next((name for name in vehicle.performance if name.endswith("acceleration")), next(iter(vehicle.performance)))
    values = {
        run.controller.name: (
            float(run.sampled.rms(name)) if isinstance(run.controller, Controller) else math.nan,
            float(run.physics.rms(name)),
        )
        for run in runs
        if not scope.unstable(run.controller)
    }
    return values, f"{name.replace('_', ' ')}, rms", vehicle.kind.signal(name).unit.replace("s2", "s²")


def _height(end: RegimeEnd) -> str:
    """Returns the height at which a linear regime ends in MuJoCo, with a remark if it is not the predicted one."""
    return HEIGHT.text(end.found) if end.confirmed else f"NOT as predicted, {HEIGHT.text(end.predicted)}"
