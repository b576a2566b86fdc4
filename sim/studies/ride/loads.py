"""The study of loads on the body, which simulates body angles and suspension travel on a flat road, and dive under braking."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.extensions import METRICS
from models.document.document import Document, Pivot, Table, notes
from models.document.field import Field
from models.document.figure import Curve, Figure, Panel, drawn_indices
from models.kinds.links import left_out
from models.roads.loads.choice import choose_load
from models.roads.loads.load import Load
from models.roads.loads.road_with_loads import RoadWithLoads
from models.roads.obstacles import Flat
from models.vehicle.names import PLUS
from models.vehicle.vehicle import Vehicle
from sim.drive.case import Case
from sim.observers.recorder import record
from sim.runs.forces import load_histories
from sim.runs.report import run_statements
from sim.runs.run import Run, run_controllers, sample_times
from sim.runs.time_histories import OF_LINE, POINTS
from sim.studies.ride.metrics import DEGREES, Metric, angles_of, compared_metrics, measure, metrics_of
from sim.studies.ride.run_metrics import METRIC, RunMetrics, measure_run
from sim.studies.study import Progress, Study
from sim.studies.subject import Subject

DURATION = 5.0  # s, shortest duration of a run under loads
AFTER = 2.0  # s, time that a run continues after the last change of a load
LONGEST = 60.0  # s, longest duration of a run under loads
SPEED = 20.0  # m/s; the speed has no effect on a flat road
BRAKE, BRAKED = "brake:g=0.5", 3.0  # load of the braking run, and duration of this run [s], in which the vehicle settles
LeaningRow = tuple[str, Metric, RunMetrics]


def loaded_road(loads: Sequence[Load]) -> RoadWithLoads:
    """Returns a flat road with loads on the body of the vehicle."""
    return RoadWithLoads(Flat(SPEED), tuple(loads))


def duration_of(loads: Sequence[Load]) -> float:
    """Returns the duration of the runs with loads on the body [s]."""
    last = max((kink for load in loads for kink in load.kinks), default=0.0)
    return min(max(DURATION, math.ceil(last + AFTER)), LONGEST)


def _dive(vehicle: Vehicle) -> Metric | None:
    """Returns the metric that evaluates dive; None for a vehicle that cannot pitch."""
    return next(iter(compared_metrics(vehicle, loaded=True).get("dive", ())), None)


def dives(scope: Subject) -> dict[str, float]:
    """Returns the largest dive angle under braking in MuJoCo [deg], by controller; empty for a vehicle that cannot pitch.

    Controllers whose run was aborted are omitted.
    """
    vehicle, controllers = scope.vehicle, [*scope.stable, *scope.laws]
    if (dive := _dive(vehicle)) is None:
        return {}
    road, time = loaded_road((choose_load(BRAKE),)), sample_times(vehicle, BRAKED, scope.map_timestep)
    runs = record([Case(vehicle, each, road) for each in controllers], time, threads=0)
    return {
        controller.name: measure(vehicle, run.response, 0, loaded=True)[dive.name]
        for controller, run in zip(controllers, runs, strict=True)
        if math.isinf(run.diverged)
    }


def loads_section(scope: Subject) -> Document:
    """Returns the section about loads on a flat road, with figures of loads, body angles and suspension travel against time."""
    vehicle, road, names = scope.vehicle, loaded_road(scope.loads), PLUS.join(load.label for load in scope.loads)
    time, angles = sample_times(vehicle, duration_of(scope.loads), scope.timestep), angles_of(vehicle)
    runs = run_controllers(vehicle, [*scope.stable, *scope.laws], road, time)
    travels = [one.deflection for one in vehicle.kind.suspensions]
    shown, at_end = [one for one in metrics_of(vehicle, loaded=True) if one.loaded], METRICS.load_if_known("final_angle") or ()
    shown += compared_metrics(vehicle).get("peak_travel", ())
    found = [(run.controller.name, measure_run(run, 0)) for run in runs]
    columns: tuple[Field[LeaningRow], ...] = (
        Field("controller", lambda row: row[0]),
        Field("metric", lambda row: row[1].words),
        *(one.of(lambda row: row[2].metrics[row[1].name]) for one in METRIC[:3]),
        Field(
            "at rest, linear", lambda row: (row[2].static or {}).get(row[1].source if isinstance(row[1], at_end) else ""), ".4g"
        ),
    )
    carried = "without anti-dive, springs, bars and tyres carry all of it"
    if vehicle.kind.wheel_loads(vehicle.parameters):
        carried = "suspension links carry a part (roll centres, anti-dive), and springs, bars and tyres carry the rest"
    lacking = left_out(vehicle.parameters, angles)
    texts = [
        f"The runs take {time[-1]:g} s on a flat road, at {1e3 * scope.timestep:g} ms. Controllers receive measurements, but "
        "not the loads. Dive is nose down, squat nose up.",
        f"Braking and cornering cause a moment on the body: inertial force times height of the centre of mass; {carried}.",
        *([f"{lacking[0].upper()}{lacking[1:]}."] if lacking else []),
    ]
    caption = "Angles of the body and travel of its suspensions under the loads, and the equilibrium of the linear loop."
    rows, pivot = (
        [(name, one, of_run) for name, of_run in found for one in shown],
        Pivot(("metric", "unit"), "controller", ("MuJoCo",)),
    )
    title = f"Loads and response: {names}. Lines: the exact sampled response. Markers: MuJoCo"
    figure = Figure("loads", title, tuple(_panels(scope, road, runs, travels)), columns=2)
    said = run_statements(runs, f"Under {names}{' on a flat road' if scope.own_road is not None else ''}, ")
    return Document(
        "Response to loads", (*said, *notes(*texts), figure, Table.of("loads", caption, columns, rows, words=3, pivot=pivot))
    )


def _panels(scope: Subject, road: RoadWithLoads, runs: Sequence[Run], travels: Sequence[str]) -> Iterator[Panel]:
    """Yields panels with time axes: first the loads, then the body angles, then the suspension deflections."""
    vehicle = scope.vehicle
    acting = load_histories(vehicle, road, runs[0].physics.time)
    assert acting is not None, "a road with loads"
    kinds = {load.name for load in vehicle.kind.loads}
    for one in (one for one in acting.signals if one.name in kinds):
        curve = Curve(*_line(acting.time, acting[one.name]), "load", "#666666")
        yield _panel(one.name, one.unit, [curve], f", {one.symbol}")
    sums = {name: (parts, DEGREES, "degrees") for name, parts in angles_of(vehicle).items()}
    sums |= {name: ({name: 1.0}, 1.0, "m") for name in travels}
    for name, (parts, scale, unit) in sums.items():
        curves = []
        for run in runs:
            who, style = run.controller.name, scope.styles[run.controller.name]
            line, points = (
                np.sum([share * response[part] for part, share in parts.items()], axis=0) * scale
                for response in (run.sampled, run.physics)
            )
            some = slice(None, None, max(1, len(points) // POINTS))
            curves.append(Curve(*_line(run.sampled.time, line), who, style.color, style.dash))
            marked = run.physics.time[some], points[some], who, style.color
            curves.append(Curve(*marked, "none", style.marker, name=f"{who}, MuJoCo"))
        yield _panel(name, unit, curves)


def _line(time: Array, values: Array) -> tuple[Array, Array]:
    some = drawn_indices(values, max(1, len(values) // OF_LINE))
    return time[some], values[some]


def _panel(name: str, unit: str, curves: Sequence[Curve], symbol: str = "") -> Panel:
    words = name.replace("_", " ")
    return Panel(f"{words}{symbol}", "time [s]", f"{words} [{unit}]", tuple(curves))


BRAKING_SUBJECT = "braking"  # subject of the request that computes the pitch angle (dive) under braking


class LoadsStudy(Study[Any]):
    """Study that adds the response to loads on the body to a report, and computes each controller's dive under braking."""

    seconds = 2.0

    def check_page(self, scope: Subject) -> None:
        """See `Study`."""
        if scope.loads:
            time = sample_times(scope.vehicle, duration_of(scope.loads), scope.timestep)
            loaded_road(scope.loads).check(scope.vehicle, time)

    def requests(self, scope: Subject) -> Mapping[str, tuple[str, Subject]]:
        """See `Study`."""
        some = bool(scope.stable or scope.laws)
        wanted = {"": bool(scope.loads), BRAKING_SUBJECT: _dive(scope.vehicle) is not None}
        return {name: (name, scope) for name, one in wanted.items() if one and some}

    def run(self, request: tuple[str, Subject], progress: Progress) -> Document | dict[str, float]:
        """Returns the section about loads on the body, or the dive of each controller."""
        name, scope = request
        return dives(scope) if name == BRAKING_SUBJECT else loads_section(scope)

    def sections(self, scope: Subject, results: Mapping[str, Mapping[str, Any]]) -> list[Document]:
        """See `Study`."""
        return [one for name, one in results[self.name].items() if name != BRAKING_SUBJECT]
