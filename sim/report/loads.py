"""The sections of a report on what pushes the body, and what a workshop's plate finds."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from models.common.arrays import Array
from models.common.printed import as_name
from models.document.document import Document, Statement, Table, notes
from models.document.field import Field
from models.document.figure import Curve, Figure, Panel, thinned
from models.document.reading import Pivot
from models.document.text import names_text
from models.kinds.links import left_out
from models.roads.load import Load
from models.roads.loaded import RoadWithLoads
from models.roads.obstacles import Flat
from models.vehicle.names import PLUS
from sim.report.scope import Scope
from sim.runs.forces import pushed
from sim.runs.report import reasons
from sim.runs.run import Run, run_controllers, sample_times
from sim.studies.ride.metrics import DEGREES, Metric, angles_of, metrics_of
from sim.studies.ride.run_metrics import METRIC, MUJOCO, RunMetrics, measure_run

DURATION = 5.0  # s; longer where the loads come later
AFTER = 2.0  # s that are looked at after the last load has come
LONGEST = 60.0  # s
POINTS, LINE = 24, 600  # of MuJoCo, and of a line
STILL = 1e-6  # an angle [deg] or travel [m]: less is rounding
SPEED = 20.0  # m/s, which does not matter on a flat road
Leaning = tuple[str, Metric, RunMetrics]


def loaded_road(loads: Sequence[Load]) -> RoadWithLoads:
    """A flat road with loads on the body of what drives there."""
    return RoadWithLoads(Flat(SPEED), tuple(loads))


def duration_of(loads: Sequence[Load]) -> float:
    """Returns the duration of the runs under loads [s]."""
    last = max((kink for load in loads for kink in load.kinks), default=0.0)
    return min(max(DURATION, math.ceil(last + AFTER)), LONGEST)


def loads_section(scope: Scope) -> Document:
    """Returns the section on loads on a flat road: their course, the body's angles and rest."""
    vehicle, loads = scope.vehicle, scope.loads
    road = loaded_road(loads)
    time = sample_times(vehicle, duration_of(loads), scope.timestep)
    runs = run_controllers(vehicle, [*scope.stable, *scope.laws], road, time)
    shown = [one for one in metrics_of(vehicle, loaded=True) if one.source in angles_of(vehicle)]
    shown += [one for one in metrics_of(vehicle) if one.source in _travels(scope) and one.what == "peak"]
    found = {run.controller.name: measure_run(run, 0) for run in runs}
    rows = [(name, one, of_run) for name, of_run in found.items() for one in shown]
    columns: tuple[Field[Leaning], ...] = (
        Field("controller", lambda row: row[0]),
        Field("metric", lambda row: row[1].words),
        *(one.of(lambda row: row[2].metrics[row[1].name]) for one in METRIC[:3]),
        Field("at rest, linear", lambda row: (row[2].static or {}).get(row[1].name.removesuffix("_at_end")), ".4g"),
    )
    caption = "Angles of the body and travel of its suspensions under the loads, and the equilibrium of the linear loop."
    names = PLUS.join(load.label for load in loads)
    carried = "there is no anti-dive: springs, bars and tyres carry it all"
    if vehicle.kind.wheel_loads(vehicle.parameters):
        carried = "links carry the part of roll centres and anti-dive, and springs, bars and tyres carry the rest"
    lacking = left_out(vehicle.parameters, angles_of(vehicle))
    text = [
        f"The runs take {time[-1]:g} s on a flat road, at {1e3 * scope.timestep:g} ms, with {names}. Controllers know only what "
        "they measure of the loads. Dive is nose down, squat nose up.",
        f"Braking and cornering turn the body by a moment of its weight at the height of its centre of mass; {carried}.",
        *((f"{lacking[0].upper()}{lacking[1:]}.",) if lacking else ()),
    ]
    wrong = [run.controller.name for run in runs if not run.passed]
    under = "Under" if scope.own_road is None else "On a flat road, under"
    agreed = names_text(run.controller.name for run in runs)
    finding = Statement(f"{under} {names} MuJoCo agrees for {agreed}: {_leaning(shown, found)}.", "holds")
    if wrong:
        finding = Statement(f"Under the loads MuJoCo DOES NOT AGREE for {names_text(wrong)}.", "fails")
    pivot = Pivot(("metric", "unit"), "controller", ("MuJoCo",))
    table = Table.of("loads", caption, columns, rows, words=3, pivot=pivot)
    verdicts = notes(*(f"{as_name(run.controller.name)}: {line.text}." for run in runs for line in reasons(run)))
    title = f"Loads and response: {names}. Lines: the exact sampled response. Markers: MuJoCo"
    figure = Figure("loads", title, tuple(_panels(scope, road, runs)), columns=2)
    return Document("Response to loads", (finding, *notes(*text), *verdicts, figure, table))


def _travels(scope: Scope) -> tuple[str, ...]:
    return tuple(one.deflection for one in scope.vehicle.kind.suspensions)


def _leaning(shown: Sequence[Metric], found: Mapping[str, RunMetrics]) -> str:
    """The largest angle or, of a body that has none, travel of every controller, in words."""
    said = []
    for one in [one for one in shown if one.unit == "deg" and one.what != "at_end"] or shown:
        values = {name: MUJOCO.value(of_run.metrics[one.name]) for name, of_run in found.items()}
        if any((value or 0.0) > STILL for value in values.values()):
            each = ", ".join(f"{as_name(name)} {MUJOCO.digits(value)}" for name, value in values.items())
            said.append(f"{one.words} [{one.unit}] {each}")
    return "; ".join(said) or "nothing moves"


def _panels(scope: Scope, road: RoadWithLoads, runs: Sequence[Run]) -> list[Panel]:
    """The loads over time, then angles, then suspensions."""
    vehicle = scope.vehicle
    acting = pushed(vehicle, road, runs[0].physics.time)
    assert acting is not None, "a road with loads"

    panels, kinds = [], {load.name for load in vehicle.kind.loads}
    for one in (one for one in acting.signals if one.name in kinds):
        curve = Curve(*_line(acting.time, acting[one.name]), "load", "#666666")
        panels.append(_panel(one.name, one.unit, [curve], f", {one.symbol}"))
    sums = {name: (parts, DEGREES, "degrees") for name, parts in angles_of(vehicle).items()}
    sums |= {name: ({name: 1.0}, 1.0, "m") for name in _travels(scope)}
    for name, (parts, scale, unit) in sums.items():
        curves = []
        for run in runs:
            who, style = run.controller.name, scope.styles[run.controller.name]
            line, points = (
                np.sum([share * response[part] for part, share in parts.items()], axis=0) * scale
                for response in (run.sampled, run.physics)
            )
            each = slice(None, None, max(1, len(points) // POINTS))
            curves.append(Curve(*_line(run.sampled.time, line), who, style.color, style.dash))
            marked = run.physics.time[each], points[each], who, style.color
            curves.append(Curve(*marked, "none", style.marker, name=f"{who}, MuJoCo"))
        panels.append(_panel(name, unit, curves))
    return panels


def _line(time: Array, values: Array) -> tuple[Array, Array]:
    some = thinned(values, max(1, len(values) // LINE))
    return time[some], values[some]


def _panel(name: str, unit: str, curves: Sequence[Curve], symbol: str = "") -> Panel:
    words = name.replace("_", " ")
    return Panel(f"{words}{symbol}", "time [s]", f"{words} [{unit}]", tuple(curves))
