"""The sections of a report that hold one road of MuJoCo against the analysis: the paper's bump, agreement, damper diagrams."""

import math
from collections.abc import Sequence
from itertools import zip_longest

import numpy as np

from models.common.printed import Column, as_name, cell
from models.figures.figure import Curve, Figure, Panel
from models.figures.page import Section, Table
from models.figures.reading import Pivot
from models.roads.road import Bump
from models.vehicle.names import PASSIVE
from sim.command.drive_options import end_lines
from sim.physics.energy import Energy
from sim.report.scope import BUMP_DURATION, Scope, change_text, names_text
from sim.runs.force_diagram import Diagram, diagrams
from sim.runs.report import verdict_lines
from sim.runs.run import Run
from sim.runs.time_histories import OF_LINE, acceleration_peaks, history_figure, history_panels, lines_text
from sim.studies.ride.run_metrics import METRIC, MetricComparison, RunMetrics
from synth.controller.controller import Controller

DIAGRAM_POINTS = 60  # of MuJoCo
ROOM = 1.15  # times what was reached, on both axes


def suspension_figure(scope: Scope, runs: Sequence[Run], where: str) -> Figure | None:
    """Force over velocity of every damper that has a curve or is adjustable, over deflection of every spring with a curve.

    Returns:
        The figure; None of a vehicle with neither.
    """
    drawn = diagrams(scope.vehicle)
    if not drawn:
        return None
    title = (
        f"What dampers and springs pull with {where}, beside their curves or limits, and the lines of linear analysis.\n"
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
def bump_section(scope: Scope, runs: Sequence[Run], road: Bump) -> Section:
    """The paper's Fig. 4, and the peaks in it."""
    vehicle = scope.vehicle
    signals = [name for name, weight in vehicle.performance.items() if weight > 0]
    simple = scope.prompt and not scope.is_nonlinear
    panels = history_panels(runs, scope.styles, lambda run: _bounded(scope, run), continuous=simple)
    lines = f"linear analysis of the continuous loop{scope.lag}"
    if scope.is_nonlinear:
        lines = f"{scope.analysis}, {scope.as_it_runs}"
    elif not scope.prompt:
        lines = f"linear analysis of the loop as it runs, {scope.as_it_runs}"
    title = (
        f"Response to the bump of {road.height:g} m height and {road.length:g} m length at {road.speed:g} m/s. "
        f"{lines_text(panels, lines, all(_bounded(scope, run) for run in runs))} at {1e3 * scope.timestep:g} ms"
    )
    figure = Figure("bump", title, tuple(panels), columns=2 if len(panels) <= 4 else 3, finding=_least_peak(scope, runs))
    columns: tuple[Column[tuple[str, Run]], ...] = (
        Column("signal", lambda of: of[0].replace("_", " ")),
        Column("unit", lambda of: vehicle.kind.signal(of[0]).unit),
        Column("controller", lambda of: of[1].controller.name),
        Column("linear until [s]", lambda of: min(of[1].agreement.until, *of[1].agreement.ended.values(), BUMP_DURATION), ".4g"),
        Column("peak, MuJoCo", lambda of: of[1].physics.peak(of[0]), ".5g"),
        Column("peak, sampled", lambda of: of[1].sampled.peak(of[0]), ".5g"),
        Column("peak, continuous", lambda of: of[1].continuous.peak(of[0]), ".5g"),
        Column("rms, MuJoCo", lambda of: of[1].physics.rms(of[0]), ".5g"),
        Column("rms, sampled", lambda of: of[1].sampled.rms(of[0]), ".5g"),
        Column("rms, continuous", lambda of: of[1].continuous.rms(of[0]), ".5g"),
    )
    caption = "Largest values over the bump in MuJoCo; below, and in the file, those of both linear analyses and all rms values."
    pivot = Pivot(("signal", "unit"), "controller", ("peak, MuJoCo",))
    table = Table.of("bump", caption, columns, [(name, run) for name in signals for run in runs], words=3, pivot=pivot)
    blur = scope.vehicle.implementation.noise_text.replace(" and ", " or ")
    unknown = f" or {blur}" if blur else ""
    response = "response" if scope.is_nonlinear else "linear response"
    if scope.is_nonlinear:
        response += scope.analysis.removeprefix("the analysis").replace("its", "the", 1)
    continuous = f"continuous {'linear ' * scope.is_nonlinear}loop{scope.lag}{scope.loop_qualifier}"
    another = "another" if scope.is_nonlinear else "an"
    about = (
        f"Over {BUMP_DURATION:g} s from rest. 'Sampled' is the exact {response} of the loop as it runs, {scope.as_it_runs}; "
        f"'continuous' is that of the {continuous}. Neither knows {another} end of the linear regime{unknown}, "
        f"so where that has ended before {BUMP_DURATION:g} s, MuJoCo's peaks are of something else than theirs."
    )
    diagram = suspension_figure(scope, runs, f"over the bump of {road.height:g} m")
    figures = (figure,) if diagram is None else (figure, diagram)
    return Section("What happens over a bump?", "the paper's bump, over time", (about, *verdicts_of(runs)), (table,), figures)


def verdicts_of(runs: Sequence[Run]) -> tuple[str, ...]:
    """Returns a sentence on the agreement of each run."""
    return tuple(f"{as_name(run.controller.name)}: {line}." for run in runs for line in verdict_lines(run))


def road_section(scope: Scope, runs: Sequence[Run], measured: Sequence[RunMetrics], when: str) -> Section:
    """Returns the section on the road of the report: its signals over time, and its metrics, measured when."""
    drawn = history_figure(runs, scope.road_name), suspension_figure(scope, runs, f"over {scope.road_name}")
    figures = tuple(one for one in drawn if one is not None)
    pairs = [(run, name, one) for run, each in zip(runs, measured, strict=True) for name, one in each.metrics.items()]
    columns: tuple[Column[tuple[Run, str, MetricComparison]], ...] = (
        Column("metric", lambda of: of[1].replace("_", " ")),
        METRIC[0].of(lambda of: of[2]),
        Column("controller", lambda of: of[0].controller.name),
        *(column.of(lambda of: of[2]) for column in METRIC[1:]),
    )
    caption = (
        "Every metric in MuJoCo; below, and in the file, that of the exact sampled response and what is expected of such roads."
    )
    table = Table.of("road", caption, columns, pairs, words=3, pivot=Pivot(("metric", "unit"), "controller", ("MuJoCo",)))
    about = f"Over {scope.duration:g} s from rest at {1e3 * scope.timestep:g} ms; metrics are measured {when}."
    about = " ".join([about, *(line.strip() for line in end_lines(scope.road, scope.duration))])
    return Section(
        "What happens over the road?", scope.road.words, (f"{about.removesuffix('.')}.", *verdicts_of(runs)), (table,), figures
    )


def _least_peak(scope: Scope, runs: Sequence[Run]) -> str:
    """Returns a sentence on the controller with the least peak of the body's acceleration, or an empty one without a choice."""
    name, peaks = acceleration_peaks(runs)
    if not name:
        return ""
    least = min(peaks, key=lambda one: peaks[one])
    against = change_text(peaks[least], peaks.get(PASSIVE, math.nan))
    words, unit = name.replace("_", " "), scope.vehicle.kind.signal(name).unit
    return f"Over the bump {as_name(least)} has the lowest peak of {words}: {peaks[least]:.3g} {unit}{against}."


def _bounded(scope: Scope, run: Run) -> bool:
    """Returns True if the motion after the linear regime is still a vehicle's, so that its line has a bound."""
    return not scope.unstable(run.controller) and run.broke_off is None


def agreement_section(scope: Scope, runs: Sequence[Run], finer: Sequence[Run]) -> Section:
    """Returns the section on the differences between MuJoCo and the analysis, and their order in the step."""
    rows, kinds = [], set()
    for run, fine in zip_longest(runs, finer):
        cause = run.prediction.cause
        kinds.add("noise" if run.prediction.is_blurred else "geometry" if cause else "exact")
        for name, signal in run.agreement.signals.items():
            half = None if fine is None or cause else fine.agreement.signals[name]
            # Of what does not go with the step there is no order: noise, geometry, a controller slower than the step.
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
        f"Largest difference over time as a share of the signal's peak, at a timestep of {h:g} ms, for as long as the comparison "
        f"applies; and the power of the step with which it shrinks, from {h:g} to {h / 2:g} ms."
    ]
    if len(finer) < len(runs):
        text.append(f"Orders are of {names_text(run.controller.name for run in finer)} alone.")
    if "exact" in kinds:
        text.append(
            "MuJoCo is the exact sampled response to within its integrator's error, order 4. Below 1e-9 there is only rounding, "
            "which has no order."
        )
    if "noise" in kinds:
        text.append(
            f"A controller that measures with {scope.vehicle.implementation.noise_text} moves MuJoCo away from the sampled "
            "response, which has no such errors. This difference has no order."
        )
    if "geometry" in kinds:
        text.append(
            "A body that turns is not linear. That difference does not shrink with the step, but with the height of the road."
        )
    if scope.is_nonlinear:
        text.append(
            f"The sampled response is that of {scope.analysis}; the continuous loop is linear{scope.loop_qualifier}, "
            "so that the one does "
            "not tend to the other, and they are not compared."
        )
    elif scope.prompt:
        text.append(
            "The sampled response tends to the continuous one with order 1, because the force is held over a step; without a "
            "force with order 2, because the road is."
        )
    else:
        text.append(
            f"The sampled response does not tend to the continuous one: it has "
            f"{', '.join(scope.vehicle.implementation.phrases)}, "
            "whatever the step."
        )
    text.append(
        "Energy is a check without analysis: what road and actuators put into a run is found again, stored or taken by the "
        "dampers. What is left over is a share of what was turned over. What the integrator explains of it is allowed."
    )
    caption = (
        "How far MuJoCo is from the sampled response, as a share of each signal's peak; below, what is allowed, and the orders."
    )
    pivot = Pivot(("signal",), "controller", ("to sampled",))
    tables = (Table("agreement", caption, headings, tuple(rows), words=2, pivot=pivot), energy_table(runs, scope.where))
    return Section("Does the physics do what the analysis says?", "agreement and its order, energy", tuple(text), tables)


def energy_table(runs: Sequence[Run], where: str) -> Table:
    """Returns the table of every run's energy balance."""
    columns: tuple[Column[tuple[str, Energy]], ...] = (
        Column("controller", lambda of: of[0]),
        Column("road [J]", lambda of: of[1].road, "{:.5g}".format),
        Column("actuators [J]", lambda of: of[1].actuators, "{:.5g}".format),
        Column("stored [J]", lambda of: of[1].stored, "{:.5g}".format),
        Column("dissipated [J]", lambda of: of[1].dissipated, "{:.5g}".format),
        Column("turned over [J]", lambda of: of[1].turnover, "{:.5g}".format),
        Column("left over", lambda of: of[1].residual, "{:.1e}".format),
        Column("allowed", lambda of: of[1].allowed, "{:.1e}".format),
    )
    energies = [(run.controller.name, run.energy) for run in runs if run.energy is not None]
    caption = f"Where the energy of every run over {where} came from, and where it went."
    return Table.of("energy", caption, columns, energies)


def _settles(scope: Scope, run: Run) -> bool:
    """Returns True if a run's sampled response tends to the continuous one with the step."""
    return not scope.is_nonlinear and isinstance(run.controller, Controller) and (scope.prompt or not run.controller.law.acts)


def _order(coarse: float, fine: float) -> str:
    """Power of the step with which an error shrinks; - where it is rounding."""
    return f"{math.log2(coarse / fine):.2f}" if fine > 1e-9 and coarse > 1e-9 else "-"
