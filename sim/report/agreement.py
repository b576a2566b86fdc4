"""The sections of a report that compare MuJoCo with analysis over one road: the paper's bump, agreement, damper diagrams."""

import math
from collections.abc import Sequence
from itertools import zip_longest

import numpy as np

from models.common.printed import as_name, cell
from models.document.document import Document, Statement, Table, notes
from models.document.field import Field
from models.document.figure import Curve, Figure, Panel
from models.document.reading import Pivot
from models.document.text import names_text
from models.roads.road import Bump
from models.vehicle.names import PASSIVE
from sim.command.drive_options import end_lines
from sim.physics.energy import Energy
from sim.report.scope import BUMP_DURATION, Scope, change_text
from sim.runs.force_diagram import Diagram, diagrams
from sim.runs.report import verdict_lines
from sim.runs.run import Run
from sim.runs.time_histories import OF_LINE, acceleration_peaks, history_figure, history_panels, lines_text
from sim.studies.ride.run_metrics import METRIC, MetricComparison, RunMetrics
from synth.controller.controller import Controller

DIAGRAM_POINTS = 60  # of MuJoCo
ROOM = 1.15  # times what was reached, on both axes


def suspension_figure(scope: Scope, runs: Sequence[Run], where: str) -> Figure | None:
    """Returns force over velocity of nonlinear and semi-active dampers, and over deflection of nonlinear springs.

    It is None for a vehicle without such parts.
    """
    drawn = diagrams(scope.vehicle)
    if not drawn:
        return None
    title = (
        f"Forces of dampers and springs {where}, with their curves or limits, and the lines of linear analysis.\n"
        "Points: MuJoCo, a damper with its actuator"
    )
    panels = tuple(_panel(scope, diagram, runs) for diagram in drawn)
    return Figure("suspension", title, panels, columns=min(2, len(panels)))


def _panel(scope: Scope, diagram: Diagram, runs: Sequence[Run]) -> Panel:
    """The panel of a diagram: its lines as far as any run went, and a point at every so many samples."""
    points, far, high = [], 1e-3, 0.0
    for run in runs:
        response = run.physics.until(run.broke_off[1]) if run.broke_off is not None else run.physics
        x = diagram.x(response)
        force, style = diagram.force(x, response), scope.styles[run.controller.name]
        every = max(1, len(x) // DIAGRAM_POINTS)
        points.append(Curve(x[::every], force[::every], run.controller.name, style.color, "none", style.marker))
        far, high = max(far, float(np.abs(x).max(initial=0.0))), max(high, float(np.abs(force).max(initial=0.0)))
    x = np.linspace(-ROOM * far, ROOM * far, OF_LINE)
    lines = [Curve(x, one.force(x), one.label, "#000000", one.dash, width=one.width) for one in diagram.lines]
    high = ROOM * max(high, *(float(np.abs(line.y).max()) for line in lines if line.dash == "solid"))
    limits = (-ROOM * far, ROOM * far), (-high, high)
    return Panel(diagram.title, diagram.over, "force [N]", (*points, *lines), None, xlim=limits[0], ylim=limits[1])


@np.errstate(over="ignore")  # an unstable loop's squares overflow; what is infinite is -
def bump_section(scope: Scope, runs: Sequence[Run], road: Bump) -> Document:
    """The paper's Fig. 4, and the peaks in it."""
    vehicle = scope.vehicle
    signals = [name for name, weight in vehicle.performance.items() if weight > 0]
    simple = scope.prompt and not scope.is_nonlinear
    panels = history_panels(runs, scope.styles, lambda run: _bounded(scope, run), continuous=simple)
    lines = f"linear analysis of the continuous loop{scope.lag}"
    if not simple:
        lines = f"{scope.analysis} of the loop as it runs, {scope.as_it_runs}"
    title = (
        f"Response to the bump of {road.height:g} m height and {road.length:g} m length at {road.speed:g} m/s. "
        f"{lines_text(panels, lines, all(_bounded(scope, run) for run in runs))} at {1e3 * scope.timestep:g} ms"
    )
    figure = Figure("bump", title, tuple(panels), columns=2 if len(panels) <= 4 else 3, finding=_least_peak(scope, runs))
    columns: tuple[Field[tuple[str, Run]], ...] = (
        Field("signal", lambda of: of[0].replace("_", " ")),
        Field("unit", lambda of: vehicle.kind.signal(of[0]).unit),
        Field("controller", lambda of: of[1].controller.name),
        Field("linear until [s]", lambda of: min(of[1].agreement.until, *of[1].agreement.ended.values(), BUMP_DURATION), ".4g"),
        Field("peak, MuJoCo", lambda of: of[1].physics.peak(of[0]), ".5g"),
        Field("peak, sampled", lambda of: of[1].sampled.peak(of[0]), ".5g"),
        Field("peak, continuous", lambda of: of[1].continuous.peak(of[0]), ".5g"),
        Field("rms, MuJoCo", lambda of: of[1].physics.rms(of[0]), ".5g"),
        Field("rms, sampled", lambda of: of[1].sampled.rms(of[0]), ".5g"),
        Field("rms, continuous", lambda of: of[1].continuous.rms(of[0]), ".5g"),
    )
    caption = "Peaks over the bump in MuJoCo; below, and in the file, peaks of both linear responses, and all rms values."
    pivot = Pivot(("signal", "unit"), "controller", ("peak, MuJoCo",))
    table = Table.of("bump", caption, columns, [(name, run) for name in signals for run in runs], words=3, pivot=pivot)
    blur = scope.vehicle.implementation.noise_text
    response = "response with the curves" if vehicle.is_curved else "linear response"
    continuous = f"continuous {'linear ' * scope.is_nonlinear}loop{scope.lag}{scope.loop_qualifier}"
    about = (
        f"The runs start in equilibrium and take {BUMP_DURATION:g} s. 'Sampled' is the exact {response} of the loop as it runs, "
        f"{scope.as_it_runs}; 'continuous' is the response of the {continuous}. Neither includes "
        f"{f'{blur}, or ' if blur else ''}the events that end the linear regime, after which MuJoCo's peaks differ."
        f"{' A controller that sets semi-active dampers has no sampled response.' * bool(vehicle.dampers)}"
    )
    diagram = suspension_figure(scope, runs, f"over the bump of {road.height:g} m")
    figures = (figure,) if diagram is None else (figure, diagram)
    return Document("Response to the paper's bump", (*notes(about), *verdicts_of(runs), *figures, table))


def verdicts_of(runs: Sequence[Run]) -> tuple[Statement, ...]:
    """Returns a sentence on the agreement of each run."""
    return notes(*(f"{as_name(run.controller.name)}: {line}." for run in runs for line in verdict_lines(run)))


def road_section(scope: Scope, runs: Sequence[Run], measured: Sequence[RunMetrics], when: str) -> Document:
    """Returns the section on the road of the report: its signals over time, and its metrics, measured when."""
    drawn = history_figure(runs, scope.road_name), suspension_figure(scope, runs, f"over {scope.road_name}")
    figures = tuple(one for one in drawn if one is not None)
    pairs = [(run, name, one) for run, each in zip(runs, measured, strict=True) for name, one in each.metrics.items()]
    columns: tuple[Field[tuple[Run, str, MetricComparison]], ...] = (
        Field("metric", lambda of: of[1].replace("_", " ")),
        METRIC[0].of(lambda of: of[2]),
        Field("controller", lambda of: of[0].controller.name),
        *(column.of(lambda of: of[2]) for column in METRIC[1:]),
    )
    caption = "Every metric in MuJoCo; below, and in the file, in the sampled response, and the mean over all such roads."
    table = Table.of("road", caption, columns, pairs, words=3, pivot=Pivot(("metric", "unit"), "controller", ("MuJoCo",)))
    about = f"The runs take {scope.duration:g} s at {1e3 * scope.timestep:g} ms; metrics are measured {when}."
    about = " ".join([about, *(line.strip() for line in end_lines(scope.road, scope.duration))])
    about = f"{scope.road.words}. {about.removesuffix('.')}."
    return Document("Response to the road", (*notes(f"{about[0].upper()}{about[1:]}"), *verdicts_of(runs), *figures, table))


def _least_peak(scope: Scope, runs: Sequence[Run]) -> str:
    """Returns a sentence on the controller with the smallest peak acceleration of the body; empty without a choice."""
    name, peaks = acceleration_peaks(runs)
    if not name:
        return ""
    least = min(peaks, key=lambda one: peaks[one])
    against = change_text(peaks[least], peaks.get(PASSIVE, math.nan))
    words, unit = name.replace("_", " "), scope.vehicle.kind.signal(name).unit
    return f"Over the bump {as_name(least)} has the lowest peak of {words}: {peaks[least]:.3g} {unit}{against}."


def _bounded(scope: Scope, run: Run) -> bool:
    """Returns True if the motion after the linear regime is bounded, so that its line has a bound."""
    return not scope.unstable(run.controller) and run.broke_off is None


def agreement_section(scope: Scope, runs: Sequence[Run], finer: Sequence[Run]) -> Document:
    """Returns the section on the differences between MuJoCo and the analysis, and their order in the step."""
    rows, kinds = [], set()
    for run, fine in zip_longest(runs, finer):
        cause = run.prediction.cause
        kinds |= {"noise"} if run.prediction.is_blurred else set()
        kinds.add("geometry" if cause.startswith("geometry") else cause or "exact")
        for name, signal in run.agreement.signals.items():
            half = None if fine is None or cause else fine.agreement.signals[name]
            # Differences that do not shrink with the step have no order: noise, geometry, a controller slower than the step.
            rows.append(
                (
                    run.controller.name,
                    name.replace("_", " "),
                    cell(signal.sampled, ".1e"),
                    cause or cell(signal.allowed, ".1e"),
                    _order(signal.sampled, half.sampled) if half is not None else "-",
                    f"{signal.continuous:.1e}" if not scope.is_nonlinear else "-",
                    _order(signal.continuous, half.continuous)
                    if half is not None and not cause and _settles(scope, run)
                    else "-",
                )
            )
    headings = ("controller", "signal", "to sampled", "allowed", "its order", "to continuous", "order of that")
    h = 1e3 * scope.timestep
    text = [
        "A run agrees if every MuJoCo step equals one RK4 step of the vehicle's equations from the same state. Every command "
        "must also equal the control law evaluated on the run's measurements.",
        "The distance from linear analysis is a measurement: the largest difference over time, relative to the signal's peak, at "
        f"a timestep of {h:g} ms, until linear analysis ends. Its order is the power of the step with which it shrinks, from "
        f"{h:g} to {h / 2:g} ms.",
    ]
    if len(finer) < len(runs):
        text.append(f"Orders are given for {names_text(run.controller.name for run in finer)} only.")
    if "exact" in kinds:
        text.append(
            "MuJoCo differs from the sampled response by its integrator's error, order 4. Below 1e-9 there is only rounding, "
            "which has no order."
        )
    if "noise" in kinds:
        text.append(f"The sampled response has no {scope.vehicle.implementation.noise_text}; this difference has no order.")
    if "geometry" in kinds:
        text.append("Linear analysis assumes small rotations; this difference shrinks with the height of the road only.")
    if scope.is_nonlinear:
        text.append(f"The continuous loop is linear{scope.loop_qualifier}, so that MuJoCo is not compared with it.")
    elif scope.prompt:
        text.append(
            "The sampled response tends to the continuous one with order 1, because the force is held over a step. Without a "
            "force the order is 2, because the road is held."
        )
    else:
        text.append(
            "The sampled response does not tend to the continuous one: it has "
            f"{', '.join(scope.vehicle.implementation.phrases)}, at any step."
        )
    text.append(
        "Energy is a check without analysis: the work of road and actuators is stored or dissipated. The residual is relative to "
        "the energy turned over; the integrator's error is allowed."
    )
    caption = "Distance of MuJoCo from the sampled response, relative to each peak; below, its allowed value or cause, and order."
    pivot = Pivot(("signal",), "controller", ("to sampled",))
    tables = (Table("agreement", caption, headings, tuple(rows), words=2, pivot=pivot), energy_table(runs, scope.where))
    return Document("Agreement with linear analysis", (*notes(*text), *tables))


def energy_table(runs: Sequence[Run], where: str) -> Table:
    """Returns the table of every run's energy balance."""
    columns: tuple[Field[tuple[str, Energy]], ...] = (
        Field("controller", lambda of: of[0]),
        Field("road [J]", lambda of: of[1].road, "{:.5g}".format),
        Field("actuators [J]", lambda of: of[1].actuators, "{:.5g}".format),
        Field("stored [J]", lambda of: of[1].stored, "{:.5g}".format),
        Field("dissipated [J]", lambda of: of[1].dissipated, "{:.5g}".format),
        Field("turned over [J]", lambda of: of[1].turnover, "{:.5g}".format),
        Field("left over", lambda of: of[1].residual, "{:.1e}".format),
        Field("allowed", lambda of: of[1].allowed, "{:.1e}".format),
    )
    energies = [(run.controller.name, run.energy) for run in runs if run.energy is not None]
    caption = f"Energy of every run over {where}: its sources, and where it went."
    return Table.of("energy", caption, columns, energies)


def _settles(scope: Scope, run: Run) -> bool:
    """Returns True if a run's sampled response tends to the continuous one with the step."""
    return not scope.is_nonlinear and isinstance(run.controller, Controller) and (scope.prompt or not run.controller.law.acts)


def _order(coarse: float, fine: float) -> str:
    """Returns the power of the step with which an error shrinks; - for rounding."""
    return f"{math.log2(coarse / fine):.2f}" if fine > 1e-9 and coarse > 1e-9 else "-"
