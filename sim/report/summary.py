"""First screen of a report: requirements, comparison of controllers; and the table of claims and their checks."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from models.common.printed import as_name, cell
from models.document.document import Document, Table
from models.document.field import Field
from models.document.figure import Bars, Figure, Panel, styles
from models.vehicle.names import PASSIVE
from sim.report.best import DIVE, headline, requirements_table
from sim.report.headline import unclaimed
from sim.report.ride import AVERAGE, SEEDS, SPEED, Ride
from sim.report.scope import LEAST, Scope, percents
from sim.runs.report import verdict
from sim.runs.run import Run
from sim.studies.ride.standing import LOAD, MEASURES, RIDE, TRAVEL, Standing, best, compared_columns, digits
from sim.studies.validity.regime_end import RegimeEnd
from synth.controller.controller import Controller

PANELS = {  # of the first figure, by measure
    RIDE: "Acceleration of the body",
    TRAVEL: "Travel of the suspension",
    LOAD: "Change of the tyre load",
    "force_peak": "Largest force",
}


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
    tables = (*((wanted,) if wanted is not None else ()), compared_table(compared, dive, where))
    return Document("", (*tables, compared_figure(scope, compared, dive, where)))


def compared_figure(scope: Scope, compared: Sequence[Standing], dive: Mapping[str, float], where: str) -> Figure:
    """Returns bars of ride, travel, tyre load, force and dive of every controller in MuJoCo."""
    names = tuple(one.controller for one in compared)
    look = {**styles((PASSIVE,)), **scope.styles}
    colors = tuple(look[name].color for name in names)
    marked = best(compared)
    panels = []
    for measure in (one for one in MEASURES if one.key in PANELS):
        found = {one.controller: one.values[measure.key] for one in compared}
        if not any(found.values()):
            continue
        words, lengths = [], []
        for name in names:
            value = found[name]
            lengths.append(math.nan if value is None else value * measure.scale)
            size = "-" if value is None else digits(value * measure.scale)
            change = _against(value, found.get(PASSIVE) or math.nan) if measure.against and value is not None else ""
            words.append(f"{size}{change}{' ★' if name in marked[measure.key] else ''}")
        bars = Bars(names, np.array(lengths, dtype=float), tuple(words), colors)
        panels.append(Panel(PANELS[measure.key], measure.heading, "", (), bars))
    if dive:
        values = np.array([dive.get(name, math.nan) for name in names])
        words = tuple(f"{value:.2g}°" if math.isfinite(value) else "-" for value in values.tolist())
        panels.append(Panel("Dive under 0.5 g of braking", "largest dive [deg]", "", (), Bars(names, values, words, colors)))
    title = f"Shorter bars are better, ★ is the best. {where}. Percentages are against {as_name(PASSIVE)}."
    return Figure("summary", title, tuple(panels), columns=min(len(panels), 4), finding=f"{headline(compared)}.")


def trust_section(
    scope: Scope, runs: Sequence[Run], ends: Sequence[tuple[Controller, RegimeEnd | None]], rides: Sequence[Ride]
) -> Document:
    """Returns the section on the claims about every controller, and up to which bump they are true."""
    norms = {one.name: one.certificate.norm.value for one in scope.controllers if one.certificate.stable}
    roughness, label, unit = _roughness(scope, runs, rides)
    wrong = unclaimed(ends, runs)
    stated = dict.fromkeys(wrong, "none claimed")
    for one, end in ends:
        if one.name not in wrong:
            stated[one.name] = "at any height" if end is None else _metres(end)
    neither = (None, None)
    columns: tuple[Field[Run], ...] = (
        Field("controller", lambda run: run.controller.name),
        Field("H-infinity norm", lambda run: norms.get(run.controller.name), ".4g"),
        Field(f"{label} [{unit}], predicted", lambda run: roughness.get(run.controller.name, neither)[0], ".3g"),
        Field("in MuJoCo", lambda run: roughness.get(run.controller.name, neither)[1], ".3g"),
        Field(f"analysis true up to{scope.noise_qualifier}", lambda run: stated.get(run.controller.name, "-")),
        Field(f"over {scope.where}", lambda run: verdict(run).text),
    )
    caption = "Norm and prediction for each controller, MuJoCo's result, and the height of the bump up to which analysis is true."
    table = Table.of("summary", caption, columns, runs)
    return Document("Verification", (table,))


def compared_on(scope: Scope, compared: Sequence[Standing], rides: bool, when: str) -> str:
    """Describes the roads that controllers are compared on: the report's own, measured when, random ones, or the bump."""
    where = f"{len(SEEDS)} roads of class {AVERAGE} at {SPEED:g} m/s, largest peaks" if rides else "the paper's bump"
    if scope.own_road is not None:
        where = f"{scope.road_name}, {when}"
    absent = "; -: unstable, or a run broke off" if any(not any(one.values.values()) for one in compared) else ""
    return f"MuJoCo, {where}{absent}"


def compared_table(compared: Sequence[Standing], dive: Mapping[str, float], where: str) -> Table:
    """Returns the table of who is best at what, with the dive [deg] where there is one."""
    columns, legend = compared_columns(compared)
    cells: dict[str, Sequence[str]] = {"controller": [one.controller for one in compared]}
    for column in columns:
        cells[column.measure.heading] = [number.rstrip() for number in column.numbers]
        if column.changes is not None:
            cells[f"{column.measure.title}, %"] = [change or "-" for change in column.changes]
    if dive:
        cells[DIVE] = [cell(dive.get(one.controller), ".2g") for one in compared]
    caption = f"Who is best at what, at the vehicle's worst point. {legend}{where}."
    return Table("compared", caption, tuple(cells), tuple(zip(*cells.values(), strict=True)))


def _roughness(scope: Scope, runs: Sequence[Run], rides: Sequence[Ride]) -> tuple[dict[str, tuple[float, float]], str, str]:
    """Returns the body's acceleration with stable loops, predicted and in MuJoCo: of the ride if there is one, else over the
    bump.
    """
    if rides:
        metric, unit = rides[0].metric, rides[0].unit
        some = [one for one in rides if (one.road_class, one.metric) == (AVERAGE, metric)]
        values = {one.controller: (one.predicted, one.measured) for one in some}
        return values, metric, unit.replace("s2", "s²")
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
    unit = vehicle.kind.signal(name).unit.replace("s2", "s²")
    return values, f"{name.replace('_', ' ')}, rms", unit


def _metres(end: RegimeEnd) -> str:
    """Returns the height at which a linear regime ends in MuJoCo, with a remark if it is not the predicted one."""
    return f"{end.found:.3g} m" if end.confirmed else f"NOT as predicted, {end.predicted:.3g} m"


def _against(value: float, passive: float) -> str:
    """By how much it is more or less than the passive suspension's."""
    if not (math.isfinite(value) and math.isfinite(passive) and passive > 0) or value == passive:
        return ""
    share = value / passive - 1
    return f" {'+' if share > 0 else '−'}{percents(share)} %" if abs(share) >= LEAST else ""
