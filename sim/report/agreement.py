"""The sections of a report that compare MuJoCo with linear analysis over one road: responses, differences and force diagrams."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from operator import attrgetter
from typing import Any

import numpy as np

from models.document.document import Document, Pivot, Table, notes
from models.document.field import Field
from models.document.figure import Curve, Figure, Panel
from models.document.text import names_text
from sim.command.road_options import end_lines
from sim.linear.prediction import LINEAR, NONLINEAR
from sim.observers.results import DIFFERENCE, JOULES, WHEN, Energy
from sim.runs.agreement import SignalAgreement
from sim.runs.force_diagram import Diagram, diagrams
from sim.runs.record import SIZES
from sim.runs.report import ALLOWED, EXCHANGED, RESIDUAL, run_statements
from sim.runs.run import Run, run_controllers, sample_times
from sim.runs.time_histories import OF_LINE, history_figure
from sim.studies.ride.run_metrics import METRIC, MetricComparison, RunMetrics, measured_words
from sim.studies.study import Progress, Study
from sim.studies.subject import BUMP_DURATION, Subject

ENERGY: tuple[Field[Energy], ...] = (
    *(Field(name, attrgetter(name), JOULES.form, unit="J") for name in ("road", "actuators", "stored", "dissipated")),
    EXCHANGED,
    RESIDUAL,
    ALLOWED,
)
DIAGRAM_POINTS = 60  # approximate number of points that show a MuJoCo run in a diagram
ROOM = 1.15  # limit of both axes of a diagram, relative to the largest value
# largest number of controllers whose order of convergence is computed; each of them needs another run with twice as many steps
MOST_ORDERS = 4
Finer = Mapping[str, SignalAgreement]  # agreement of each signal when the run is repeated at half the timestep
NAME = Field[Run]("controller", lambda run: run.controller.name)


def suspension_figure(scope: Subject, runs: Sequence[Run], where: str) -> Figure | None:
    """Returns a figure of force against velocity for nonlinear and semi-active dampers, and against deflection for springs.

    Returns None if the vehicle has only linear springs and dampers.
    """
    panels = tuple(_panel(scope, diagram, runs) for diagram in diagrams(scope.vehicle))
    title = (
        f"Forces over {where}. Lines: characteristics or limits, and their linearisation. Points: MuJoCo, including the "
        "actuator force."
    )
    return Figure("suspension", title, panels, columns=min(2, len(panels))) if panels else None


def _panel(scope: Subject, diagram: Diagram, runs: Sequence[Run]) -> Panel:
    """Returns the panel of a force diagram: lines show the characteristics, and points show about `DIAGRAM_POINTS` samples of
    each run.
    """
    points, far, high = [], 1e-3, 0.0
    for run in runs:
        response = run.physics.until(run.broke_off[1]) if run.broke_off is not None else run.physics
        x = diagram.x(response)
        force, style = diagram.force(x, response), scope.styles[run.controller.name]
        some = slice(None, None, max(1, len(x) // DIAGRAM_POINTS))
        points.append(Curve(x[some], force[some], run.controller.name, style.color, "none", style.marker))
        far, high = max(far, float(np.abs(x).max(initial=0.0))), max(high, float(np.abs(force).max(initial=0.0)))
    x = np.linspace(-ROOM * far, ROOM * far, OF_LINE)
    lines = [Curve(x, one.force(x), one.label, "#000000", one.dash, width=one.width) for one in diagram.lines]
    high = ROOM * max(high, *(float(np.abs(line.y).max()) for line in lines if line.dash == "solid"))
    limits = (-ROOM * far, ROOM * far), (-high, high)
    return Panel(diagram.title, diagram.over, "force [N]", (*points, *lines), None, xlim=limits[0], ylim=limits[1])


@np.errstate(over="ignore")  # the squares of an unstable loop overflow; tables print "-" for infinity
def response_section(scope: Subject, runs: Sequence[Run], measured: Sequence[RunMetrics], when: str) -> Document:
    """Returns the section about the runs: plots of signals over time, and a table of peaks (for the bump) or metrics (for
    another road).

    Args:
        scope: subject of the report, with its vehicle, controllers and runs.
        runs: runs of all controllers over the road.
        measured: metrics of each run over the road; empty if the road is the bump.
        when: text that states in which part of the run the metrics are measured.
    """
    road, text, title = scope.own_road, (), "Response to the road"
    drawn = history_figure(runs, scope.where if road is None else scope.road_name)
    if road is None:
        title, table = "Response to the paper's bump", _peaks(scope, runs)
        drawn = drawn and replace(drawn, name="bump")
    else:
        about = f"{road.words}. The runs take {scope.duration:g} s; metrics are measured {when}."
        text = notes(" ".join([f"{about[0].upper()}{about[1:]}", *(line.strip() for line in end_lines(road, scope.duration))]))
        table = _metrics(runs, measured)
    figures = (one for one in (drawn, suspension_figure(scope, runs, scope.where)) if one is not None)
    return Document(title, (*text, *run_statements(runs, f"Over {scope.where}, "), *figures, table))


def _peaks(scope: Subject, runs: Sequence[Run]) -> Table:
    """Returns the table of peaks and rms values over the bump, for all weighted signals and all runs."""
    vehicle = scope.vehicle
    pairs = [(run, name) for name, weight in vehicle.performance.items() if weight > 0 for run in runs]
    columns: tuple[Field[tuple[Run, str]], ...] = (
        Field("signal", lambda of: of[1].replace("_", " ")),
        Field("unit", lambda of: vehicle.kind.signal(of[1]).unit),
        NAME.of(lambda of: of[0]),
        Field(
            "linear until",
            lambda of: min(BUMP_DURATION, of[0].agreement.until, *of[0].agreement.end_times.values()),
            WHEN.form,
            unit="s",
        ),
        *SIZES,
    )
    caption = "Peaks over the bump in MuJoCo. The full table adds both linear responses and rms values."
    return Table.of("bump", caption, columns, pairs, words=3, pivot=Pivot(("signal", "unit"), "controller", ("peak, MuJoCo",)))


def _metrics(runs: Sequence[Run], measured: Sequence[RunMetrics]) -> Table:
    """Returns the table of the metrics of all runs."""
    pairs = [(run, name, one) for run, each in zip(runs, measured, strict=True) for name, one in each.metrics.items()]
    columns: tuple[Field[tuple[Run, str, MetricComparison]], ...] = (
        Field("metric", lambda of: of[1].replace("_", " ")),
        METRIC[0].of(lambda of: of[2]),
        NAME.of(lambda of: of[0]),
        *(column.of(lambda of: of[2]) for column in METRIC[1:]),
    )
    caption = "Metrics in MuJoCo. The full table adds the sampled response and the mean over all such roads."
    return Table.of("road", caption, columns, pairs, words=3, pivot=Pivot(("metric", "unit"), "controller", ("MuJoCo",)))


def agreement_section(scope: Subject, runs: Sequence[Run], finer: Mapping[str, Finer]) -> Document:
    """Returns the section about the difference between MuJoCo and linear analysis, and the order of convergence of this
    difference.

    Args:
        scope: subject of the report, with its vehicle, controllers and runs.
        runs: runs of all controllers over the road.
        finer: agreement of MuJoCo with linear analysis in the runs at half the timestep, by controller and signal.
    """
    pairs = [(run, finer.get(run.controller.name), name) for run in runs for name in run.agreement.signals]
    reference = NONLINEAR if scope.vehicle.parts.nonlinear else LINEAR
    linear = not (scope.vehicle.parts.nonlinear or scope.vehicle.dampers)
    # If the implementation has no delay and no sample period, the sampled response converges to the continuous response
    prompt = scope.vehicle.implementation.undelayed

    def settles(run: Run) -> bool:
        return linear and run.controller.linear and (prompt or not run.controller.acts)

    columns: tuple[Field[tuple[Run, Finer | None, str]], ...] = (
        NAME.of(lambda of: of[0]),
        Field("signal", lambda of: of[2].replace("_", " ")),
        Field("to sampled", lambda of: of[0].agreement.signals[of[2]].sampled, DIFFERENCE.form),
        Field("allowed", lambda of: of[0].prediction.cause or of[0].agreement.signals[of[2]].allowed, DIFFERENCE.form),
        Field("its order", lambda of: _order(*of, "sampled"), ".2f"),
        *(
            [
                Field[tuple[Run, Finer | None, str]](
                    "of the linearisation", lambda of: of[0].line_errors.get(of[2]), DIFFERENCE.form
                )
            ]
            if scope.vehicle.parts.nonlinear
            else []
        ),
        Field("to continuous", lambda of: of[0].agreement.signals[of[2]].continuous if linear else None, DIFFERENCE.form),
        Field("order of that", lambda of: _order(*of, "continuous") if settles(of[0]) else None, ".2f"),
    )
    step, causes = 1e3 * scope.timestep, {run.prediction.cause for run in runs}
    texts = [
        "A run agrees if every MuJoCo step equals one RK4 step of the vehicle's equations, and every command equals the control "
        "law evaluated on the run's measurements.",
        f"The distance from {reference} is a measurement: the largest difference until linear analysis ends, relative to the "
        f"signal's peak. Its order is the power of the timestep with which this difference shrinks, from {step:g} to "
        f"{step / 2:g} ms.",
    ]
    if len(finer) < len(runs):
        texts.append(f"Orders are given for {names_text(finer)} only.")
    if "" in causes:
        texts.append("MuJoCo differs from the sampled response by RK4's error, of order 4. Differences below 1e-9 are rounding.")
    if any(run.prediction.is_blurred for run in runs):
        texts.append(f"The sampled response has no {scope.vehicle.implementation.noise_text}; this difference has no order.")
    if any(cause.startswith("geometry") for cause in causes):
        texts.append("Linear analysis assumes small rotations; this difference shrinks with the height of the road only.")
    if scope.vehicle.parts.nonlinear:
        texts.append(
            "Norms, margins and designs are those of the linearisation at equilibrium. Its error is the largest difference from "
            "MuJoCo, relative to the peak in MuJoCo."
        )
    if prompt and linear:
        texts.append(
            "The sampled response tends to the continuous one with order 1, because the force is held over a step. Without a "
            "control force, the order is 2."
        )
    caption = (
        "Distance of MuJoCo from the sampled response, relative to each peak. The full table adds allowed distances and orders."
    )
    table = Table.of("agreement", caption, columns, pairs, words=2, pivot=Pivot(("signal",), "controller", ("to sampled",)))
    return Document(f"Agreement with {reference.partition(' with')[0]}", (*notes(*texts), table, energy_table(runs, scope.where)))


def _order(run: Run, finer: Finer | None, name: str, to: str) -> float | None:
    """Returns the order of convergence of a difference; None if rounding, noise or geometry causes the difference.

    Args:
        run: simulated run whose timestep is that of the report.
        finer: agreement of MuJoCo with linear analysis in a run at half the timestep; None if no such run was simulated.
        name: name of the signal whose difference is evaluated.
        to: linear response with which the run is compared, "sampled" or "continuous".
    """
    if finer is None or run.prediction.cause:
        return None
    coarse, fine = (getattr(signals[name], to) for signals in (run.agreement.signals, finer))
    return math.log2(coarse / fine) if fine > 1e-9 and coarse > 1e-9 else None


class ResponseStudy(Study[None]):
    """Study that adds a section about the runs over the road to the page of a report."""

    def sections(self, scope: Subject, results: Mapping[str, Mapping[str, Any]]) -> list[Document]:
        """See `Study`."""
        return [response_section(scope, scope.runs, scope.run_metrics, measured_words(scope.time, scope.samples))]


class AgreementStudy(Study[dict[str, Finer]]):
    """Study of the difference between MuJoCo and linear analysis over the road that the page is about.

    Runs at half the timestep show the order of convergence of the difference.
    """

    def requests(self, scope: Subject) -> Mapping[str, Subject]:
        """See `Study`."""
        return {"": scope}

    def run(self, request: Subject, progress: Progress) -> dict[str, Finer]:
        """Returns the agreement of MuJoCo with linear analysis at half the timestep, by controller and signal, for at most
        `MOST_ORDERS` controllers.
        """
        halves = sample_times(request.vehicle, request.duration, request.timestep / 2)
        runs = run_controllers(request.vehicle, request.driven_controllers[:MOST_ORDERS], request.road, halves, balanced=False)
        return {run.controller.name: run.agreement.signals for run in runs}

    def sections(self, scope: Subject, results: Mapping[str, Mapping[str, Any]]) -> list[Document]:
        """See `Study`."""
        return [agreement_section(scope, scope.runs, results[self.name][""])]


def energy_table(runs: Sequence[Run], where: str) -> Table:
    """Returns the table of the energy balances of all runs."""
    known = [(run.controller.name, run.energy) for run in runs if run.energy is not None]
    name, get = Field[tuple[str, Energy]]("controller", lambda of: of[0]), lambda of: of[1]
    fields = (name, *(field.of(get) for field in ENERGY))
    return Table.of("energy", f"Energy balance over {where}.", fields, known)
