"""The sections of a report on what pushes the body, and what a workshop's plate finds."""

import math
from collections.abc import Sequence

import numpy as np

from models.common.printed import as_name, cell
from models.document.document import Document, Statement, Table, notes
from models.document.field import cells, titles
from models.document.figure import Curve, Figure, Panel, thinned
from models.document.reading import Pivot
from models.kinds.links import left_out
from models.roads.load import Load
from models.roads.loaded import RoadWithLoads
from models.roads.obstacles import Flat
from models.vehicle.names import PLUS
from models.vehicle.vehicle import Vehicle
from sim.report.scope import Scope, names_text
from sim.runs.forces import pushed
from sim.runs.report import reasons
from sim.runs.run import Run, run_controllers, sample_times
from sim.studies.ride.metrics import DEGREES, angles_of
from sim.studies.ride.run_metrics import METRIC, measure_run

DURATION = 5.0  # s; longer where the loads come later
AFTER = 2.0  # s that are looked at after the last load has come
LONGEST = 60.0  # s
POINTS = 24  # of MuJoCo
SPEED = 20.0  # m/s, which does not matter on a flat road


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
    angles = angles_of(vehicle)
    rows = []
    for run in runs:
        run_metrics = measure_run(run, 0)
        for name, one in run_metrics.metrics.items():
            what = next((end for end in (*angles, *_travels(scope)) if name.startswith(f"{end}_")), "")
            if not what or (what in _travels(scope) and not name.endswith("_peak")):
                continue
            static = run_metrics.static or {}
            rest = static.get(what) if name.endswith("at_end") else None
            rows.append((run.controller.name, name.replace("_", " "), *cells(METRIC[:3], [one])[0], cell(rest, ".4g")))
    headings = ("controller", "metric", *titles(METRIC[:3]), "at rest, linear")
    caption = "How far the body leans under the loads, and how far its suspensions travel; where the linear loop would rest."
    names = PLUS.join(load.label for load in loads)
    text = [
        f"On a flat road, over {time[-1]:g} s at {1e3 * scope.timestep:g} ms: {names}. Brakes and curves are moments of the "
        f"body's weight at the height of its centre of mass; {_carried(vehicle)}Dive is nose down, squat nose up; of the loads "
        "controllers know what they measure."
    ]
    text += [f"{as_name(run.controller.name)}: {line.text}." for run in runs for line in reasons(run)]
    wrong = [run.controller.name for run in runs if not run.passed]
    findings = [Statement(f"Under the loads MuJoCo DOES NOT AGREE for {names_text(wrong)}.", "fails")] if wrong else []
    if not wrong:
        under = "Under" if scope.own_road is None else "On a flat road, under"
        agreed = names_text(run.controller.name for run in runs)
        findings = [Statement(f"{under} {names} MuJoCo agrees for {agreed}: {_leaning(rows)}.", "holds")]
    pivot = Pivot(("metric", "unit"), "controller", ("MuJoCo",))
    table = Table("loads", caption, headings, tuple(rows), words=3, pivot=pivot)
    figure = Figure("loads", _title(names), tuple(_panels(scope, road, runs)), columns=2)
    return Document("Response to loads", (*findings, *notes(*text), figure, table))


def _carried(vehicle: Vehicle) -> str:
    """Returns sentences on what carries the moments, and on which are left out."""
    if vehicle.kind.wheel_loads(vehicle.parameters):
        said = "links carry to the wheels what roll centres and anti-dive say, and springs, bars and tyres the rest. "
    else:
        said = "there is no anti-dive, and springs, bars and tyres carry all of it. "
    lacking = left_out(vehicle.parameters, angles_of(vehicle))
    return said + (f"T{lacking[1:]}. " if lacking else "")


def _travels(scope: Scope) -> tuple[str, ...]:
    return tuple(one.deflection for one in scope.vehicle.kind.suspensions)


def _leaning(rows: Sequence[Sequence[str]]) -> str:
    """The largest angle or, of a body that has none, travel of every controller, in words."""
    kinds = [kind for kind in ("pitch angle dive", "pitch angle squat", "roll angle peak") if any(row[1] == kind for row in rows)]
    kinds = kinds or list(dict.fromkeys(row[1] for row in rows))
    said = []
    for kind in kinds:
        values = [f"{as_name(row[0])} {row[3]}" for row in rows if row[1] == kind]
        if any(float(row[3]) > 1e-6 for row in rows if row[1] == kind and row[3] != "-"):
            unit = next(row[2] for row in rows if row[1] == kind)
            said.append(f"{kind} [{unit}] {', '.join(values)}")
    return "; ".join(said) or "nothing moves"


def _title(names: str) -> str:
    return f"What acts, and what it does: {names}. Lines: the exact sampled response. Markers: MuJoCo"


def _panels(scope: Scope, road: RoadWithLoads, runs: Sequence[Run]) -> list[Panel]:
    """The loads over time, then angles, then suspensions."""
    vehicle, panels = scope.vehicle, []
    acting = pushed(vehicle, road, runs[0].physics.time)
    assert acting is not None, "a road with loads"
    for signal in acting.signals[: sum(signal.name in {load.name for load in vehicle.kind.loads} for signal in acting.signals)]:
        every = thinned(acting[signal.name], max(1, len(acting.time) // 600))
        curve = Curve(acting.time[every], acting[signal.name][every], "load", "#666666", "solid")
        words = signal.name.replace("_", " ")
        panels.append(Panel(f"{words}, {signal.symbol}", "time [s]", f"{words} [{signal.unit}]", (curve,)))
    sums = {name: (parts, DEGREES, "degrees") for name, parts in angles_of(vehicle).items()}
    sums |= {name: ({name: 1.0}, 1.0, "m") for name in _travels(scope)}
    for name, (parts, scale, unit) in sums.items():
        curves = []
        for run in runs:
            style = scope.styles[run.controller.name]
            line, points = (
                np.sum([share * response[part] for part, share in parts.items()], axis=0) * scale
                for response in (run.sampled, run.physics)
            )
            some = thinned(line, max(1, len(line) // 600))
            each = slice(None, None, max(1, len(points) // POINTS))
            curves.append(Curve(run.sampled.time[some], line[some], run.controller.name, style.color, style.dash))
            seen = f"{run.controller.name}, MuJoCo"
            at = run.physics.time[each], points[each], run.controller.name
            curves.append(Curve(*at, style.color, "none", style.marker, name=seen))
        words = name.replace("_", " ")
        panels.append(Panel(words, "time [s]", f"{words} [{unit}]", tuple(curves)))
    return panels
