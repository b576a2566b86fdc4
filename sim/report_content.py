"""What a report says: every section of it, computed."""

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from models.reality import Implementation
from models.vehicle import Vehicle
from sim.broken import ENDS
from sim.envelope import grid, read_axes
from sim.envelope_picture import envelope_figure
from sim.figure import Curve, Figure, Panel, styles
from sim.identification import Lines, identify
from sim.loop_margins import find_margins
from sim.margins_picture import margins_figure
from sim.page import Page, Section, Table
from sim.paper import PRINTED, entry_of, is_the_papers, ours
from sim.report_ride import ride_section
from sim.robustness import robustness
from sim.run import Run, run_all, sample_times
from sim.sweep import Sweep, failures, sweep
from sim.sweep_picture import sweep_figure
from sim.validity import Cells, validity
from sim.verdict import gain_text, verdict_lines
from synth.controller import Controller, Designer
from synth.table import percent

BUMP_DURATION = 3.0  # s
AMPLITUDE = 1e-4  # m, of the roads that frequency responses are identified on
POINTS = 60  # of MuJoCo in a time history
MAP = ("height:0.02:0.3:20", "speed:3:30:20")
THRESHOLD = 0.05  # of a peak, where linear analysis is said to hold


@dataclass(frozen=True, eq=False)
class Scope:
    """What a report is about.

    Attributes:
        vehicle: the vehicle.
        designer: its designs.
        controllers: those that are reported.
        timestep: of the physics [s].
        quick: without margins, map and ride.
        progress: is told what is being done.
    """

    vehicle: Vehicle
    designer: Designer
    controllers: tuple[Controller, ...]
    timestep: float
    quick: bool
    progress: Callable[[str], None]

    @property
    def active(self) -> list[Controller]:
        """Those that do something, and are stable."""
        return [one for one in self.controllers if np.any(one.gain) and one.certificate.stable]


def page(scope: Scope, provenance: dict[str, str]) -> Page:
    """The whole report.

    Args:
        scope: what it is about.
        provenance: where it comes from, in words.
    """
    from sim.road import Bump

    vehicle = scope.vehicle
    scope.progress("a bump")
    road = Bump()
    time = sample_times(vehicle, BUMP_DURATION, scope.timestep)
    runs = run_all(vehicle, scope.controllers, road, time)
    finer = run_all(vehicle, scope.controllers, road, sample_times(vehicle, BUMP_DURATION, scope.timestep / 2))
    scope.progress("frequency responses")
    stable = [one for one in scope.controllers if one.certificate.stable]
    if scope.quick:
        sweeps, lines = [], identify(vehicle, stable, AMPLITUDE, scope.timestep, road.speed)
    else:
        sweeps = sweep(vehicle, stable, AMPLITUDE, scope.timestep, road.speed)
        lines = [one.lines for one in sweeps]

    sections = [_design(scope), _frequency(scope, lines, sweeps, road.speed), _bump(scope, runs), _agreement(scope, runs, finer)]
    answer = _answer(scope, runs, lines, sweeps)
    if not scope.quick:
        sections.append(_margins(scope))
        validity_section, sentence = _validity(scope)
        sections.append(validity_section)
        answer.append(sentence)
        scope.progress("random roads")
        sections.append(ride_section(vehicle, stable, scope.timestep))
    if is_the_papers(vehicle):
        sections.append(_paper(scope))
    sections.append(_provenance(scope, provenance))
    title = f"{vehicle.kind.name.replace('_', ' ').capitalize()}: suspension control from linear analysis to physics"
    return Page(title, tuple(answer), tuple(sections))


def _answer(scope: Scope, runs: Sequence[Run], lines: Sequence[Lines], sweeps: Sequence[Sweep]) -> list[str]:
    best = min(scope.active, key=lambda one: one.certificate.norm.value, default=None)
    sentences = []
    if best is not None:
        passive = scope.designer.design("passive").certificate.norm.value
        norms = ", ".join(f"{one.name} {one.certificate.norm.value:.4g}" for one in scope.controllers if one.certificate.stable)
        sentences.append(
            f"H-infinity norms: {norms}. The least is {best.name}'s, {100 * (1 - best.certificate.norm.value / passive):.0f} % "
            "below the passive suspension's."
        )
    good = [run.controller.name for run in runs if run.agreement.agrees]
    bad = [run.controller.name for run in runs if not run.agreement.agrees]
    worst = max(one.error(one.sampled).max() for one in lines)
    sentences.append(
        f"MuJoCo agrees with the linear analysis over the paper's bump for {', '.join(good) or 'no controller'}"
        + (f"; it DOES NOT for {', '.join(bad)}" if bad else "")
        + f". Every frequency response is within {worst:.0e} of the sampled loop's."
    )
    failed = [f"{one.lines.controller.name}: {text}" for one in sweeps if not one.ended for text in failures(one)]
    return sentences + [f"A claim fails. {text}." for text in failed]


def _design(scope: Scope) -> Section:
    rows = []
    for one in scope.controllers:
        certificate, norm = one.certificate, one.certificate.norm
        rows.append(
            (
                one.name,
                ", ".join(one.measured).replace("_", " ") or "nothing",
                gain_text(one.gain) if one.measured else "0",
                _number(certificate.bound, ".7g"),
                _number(norm.value, ".7g"),
                _number(norm.peak_frequency, ".5g"),
                _number(certificate.lower.gamma, ".7g") if certificate.lower is not None and certificate.lower.gamma > 0 else "-",
                percent(certificate.gap) if certificate.gap is not None else "-",
                _number(float(np.real(certificate.poles).max()), ".4g"),
                "; ".join(certificate.failures) or "holds",
            )
        )
    headings = (
        "controller",
        "measures",
        "gain",
        "bound",
        "norm",
        "peak [rad/s]",
        "no one below",
        "above it",
        "slowest pole [1/s]",
        "certificate",
    )
    text = (
        "The bound is the gamma that the linear matrix inequality proves for this very gain; the norm is recomputed by two other "
        "routes. A certificate holds if all poles are stable, X > 0, the inequality (20) is negative definite and norm <= bound, "
        "checked without the solver that found the gain. No controller of its kind, of whatever order, can have a norm below "
        "'no one below'.",
    )
    return Section("Designs", text, (Table("designs", headings, tuple(rows), words=3),))


def _frequency(scope: Scope, lines: Sequence[Lines], sweeps: Sequence[Sweep], speed: float) -> Section:
    figure = replace(sweep_figure(scope.vehicle, lines, AMPLITUDE, scope.timestep, speed), name="frequency-responses")
    rows = [
        (
            one.controller.name,
            f"{one.error(one.sampled).max():.1e}",
            f"{one.error(one.continuous).max():.1e}",
            _number(one.order, ".2f"),
        )
        for one in lines
    ]
    headings = ("controller", "error to sampled", "to continuous", "order of the two")
    tables = [Table("frequency-responses", headings, tuple(rows))]
    text = ["Identified from MuJoCo runs, 0.1 to 25 Hz. The errors are the largest over all lines and signals."]
    if sweeps:
        text.append(
            "The norm is a physical fact: the worst sinusoid reaches it from below, and the L2 gain of no other road exceeds it."
        )
        gains = tuple(
            (
                one.lines.controller.name,
                f"{one.extremes.worst.gain:.6g}",
                f"{one.gains['worst sinusoid']:.6g}",
                f"{100 * one.gains['worst sinusoid'] / one.extremes.worst.gain:.3f} %",
                *(f"{one.gains[name]:.4g}" for name in ("bump", "chirp", "random")),
            )
            for one in sweeps
        )
        names = ("controller", "norm, sampled loop", "worst sinusoid", "of the norm", "bump", "chirp", "random")
        tables.append(Table("gains", names, gains))
    return Section("Frequency responses", tuple(text), tuple(tables), (figure,))


def _bump(scope: Scope, runs: Sequence[Run]) -> Section:
    vehicle = scope.vehicle
    signals = [name for name, weight in vehicle.performance.items() if weight > 0]
    style = styles(tuple(run.controller.name for run in runs))
    panels = []
    for name in signals:
        curves = []
        for run in runs:
            color, dash = style[run.controller.name]
            if float(run.physics.peak(name)) < run.physics.scale(name):
                continue  # no control force, or no roll on a road that is the same on both sides
            every = max(1, len(run.physics.time) // POINTS)
            thin = slice(None, None, max(1, every // 6))
            curves.append(Curve(run.continuous.time[thin], run.continuous[name][thin], run.controller.name, color, dash))
            curves.append(Curve(run.physics.time[::every], run.physics[name][::every], "", color, "none", "o"))
        if not curves:
            continue
        if not panels:
            curves.append(Curve(np.zeros(0), np.zeros(0), "MuJoCo", "#666666", "none", "o"))
        signal = vehicle.kind.signal(name)
        unit = signal.unit.replace("s2", "s²")
        panels.append(
            Panel(f"{name.replace('_', ' ')}, {signal.symbol}", "time [s]", f"[{unit}]", tuple(curves), xlim=(0.0, BUMP_DURATION))
        )
    title = (
        "Response to the bump of 0.1 m height and 5 m length at 12.5 m/s. Lines: linear analysis, continuous. "
        f"Points: MuJoCo at {1e3 * scope.timestep:g} ms"
    )
    figure = Figure("bump", title, tuple(panels), columns=2 if len(signals) <= 4 else 3)
    rows = []
    for name in signals:
        rows += [
            (
                name.replace("_", " "),
                vehicle.kind.signal(name).unit,
                run.controller.name,
                f"{float(run.physics.peak(name)):.5g}",
                f"{float(run.sampled.peak(name)):.5g}",
                f"{float(run.continuous.peak(name)):.5g}",
                f"{float(run.physics.rms(name)):.5g}",
                f"{float(run.continuous.rms(name)):.5g}",
            )
            for run in runs
        ]
    headings = (
        "signal",
        "unit",
        "controller",
        "peak, MuJoCo",
        "peak, sampled",
        "peak, continuous",
        "rms, MuJoCo",
        "rms, continuous",
    )
    table = Table("bump", headings, tuple(rows), words=3)
    verdicts = tuple(f"{run.controller.name}: {line}." for run in runs for line in verdict_lines(run))
    return Section("Over the paper's bump", verdicts, (table,), (figure,))


def _agreement(scope: Scope, runs: Sequence[Run], finer: Sequence[Run]) -> Section:
    rows = []
    for run, fine in zip(runs, finer, strict=True):
        for name, signal in run.agreement.signals.items():
            half = fine.agreement.signals[name]
            rows.append(
                (
                    run.controller.name,
                    name.replace("_", " "),
                    f"{signal.sampled:.1e}",
                    _order(signal.sampled, half.sampled),
                    f"{signal.continuous:.1e}",
                    _order(signal.continuous, half.continuous),
                )
            )
    headings = ("controller", "signal", "to sampled", "its order", "to continuous", "order of that")
    h = 1e3 * scope.timestep
    text = (
        f"Largest difference over time as a share of the signal's peak, at a timestep of {h:g} ms, for as long as the comparison "
        f"applies; and the power of the step with which it shrinks, from {h:g} to {h / 2:g} ms. MuJoCo is the exact sampled "
        "response to within its integrator's error, order 4; that response tends to the continuous one with order 1, because the "
        "force is held over a step. Below 1e-9 there is only rounding, which has no order.",
    )
    return Section("Physics against analysis", text, (Table("agreement", headings, tuple(rows), words=2),))


def _margins(scope: Scope) -> Section:
    rows, figures, robust = [], [], []
    vehicle = replace(scope.vehicle, implementation=Implementation())
    for one in scope.active:
        scope.progress(f"margins of {one.name}")
        loop = find_margins(vehicle, one, scope.timestep, each=False)[""]
        box = robustness(vehicle, one, scope.timestep)
        predicted = loop.predicted
        pairs = [
            ("gain, factor", predicted.gain, loop.found_gain),
            ("phase [rad]", predicted.phase, loop.found_phase),
            ("delay [ms]", 1e3 * predicted.delay, 1e3 * loop.delay.unstable),
            ("sample period [ms]", 1e3 * predicted.sample_period, 1e3 * loop.found_sample_period),
        ]
        for name, first, second in pairs:
            rows.append((one.name, name, _margin(first), _margin(second)))
        verdict = "agrees" if loop.agrees else "DOES NOT AGREE"
        robust.append(
            (
                one.name,
                f"{one.certificate.norm.value:.5g}",
                _number(box.norm, ".5g"),
                ", ".join(f"{key.replace('_', ' ')} {value:.4g}" for key, value in box.at.items()),
                "same" if box.holds else "NOT THE SAME",
                verdict,
            )
        )
        figures.append(replace(margins_figure(vehicle, one, loop, box, scope.timestep), name=f"margins-{one.name}"))
    tables = (
        Table("margins", ("controller", "margin", "predicted", "MuJoCo"), tuple(rows), words=2),
        Table(
            "robustness",
            ("controller", "norm", "worst norm", "at", "corners: MuJoCo and analysis say the", "margins"),
            tuple(robust),
        ),
    )
    text = (
        "How much more gain, phase lag, delay or sample period the loop bears, all its actuators at once: predicted from the "
        f"loop transfer function, found in MuJoCo by bisection on growth and decay at {1e3 * scope.timestep:g} ms. The worst "
        "norm is over sprung masses from -30 to +40 % and tyre stiffnesses of +-25 %.",
    )
    return Section("Margins", text, tables, tuple(figures))


def _validity(scope: Scope) -> tuple[Section, str]:
    axes, timestep = read_axes(MAP), 2 * scope.timestep
    fixed = {"height": 0.1, "length": 5.0, "speed": 12.5}
    time = sample_times(scope.vehicle, BUMP_DURATION, timestep)
    figures, rows, sentences = [], [], []
    for one in scope.active:
        scope.progress(f"map of {one.name}")
        cells, _ = validity(scope.vehicle, one, grid(axes, fixed), time)
        figure = envelope_figure(scope.vehicle, one, cells, axes, {"length": 5.0}, THRESHOLD)
        figures.append(replace(figure, name=f"map-{one.name}"))
        shares = [np.mean(cells.first == end) for end in range(len(ENDS))]
        rows.append(
            (
                one.name,
                f"{100 * np.mean(cells.error <= THRESHOLD):.1f} %",
                *(f"{100 * share:.1f} %" for share in shares),
                f"{100 * cells.agreement:.2f} %",
            )
        )
        sentences.append(f"{one.name} {_highest(cells)}")
    headings = ("controller", "linear analysis holds", *(f"{end} first" for end in ENDS), "as predicted")
    text = (
        "Bumps of 5 m length, 20 heights by 20 speeds, each run in MuJoCo: what breaks first, and where the linear prediction is "
        f"off by more than {100 * THRESHOLD:g} % of a peak.",
    )
    answer = f"Stop trusting the line, over bumps of 5 m at 12.5 m/s, above: {'; '.join(sentences)}."
    return Section("The map of validity", text, (Table("validity", headings, tuple(rows)),), tuple(figures)), answer


def _highest(cells: Cells) -> str:
    """Up to which height nothing breaks at the paper's speed, from the linear peaks."""
    i = min(range(len(cells.bumps)), key=lambda k: (abs(cells.bumps[k].speed - 12.5), cells.bumps[k].height))
    used = cells.used[i]
    return f"{cells.bumps[i].height / used.max():.3g} m ({ENDS[int(used.argmax())]})" if used.max() > 0 else "any height"


def _paper(scope: Scope) -> Section:
    found = ours(scope.designer)
    rows = []
    for row in PRINTED:
        entry = f"[{row.entry[0] + 1}, {row.entry[1] + 1}]" if row.entry is not None else ""
        digits = max(0, -math.floor(math.log10(row.digit)))
        mine = entry_of(found[row.quantity], row.entry)
        same = round(mine / row.digit) == round(row.value / row.digit)
        rows.append(
            (
                row.equation,
                f"{row.quantity}{entry}",
                "same" if same else row.reason,
                f"{row.value:.{digits}f}",
                f"{mine:.{digits + 2}f}",
            )
        )
    text = ("Every number that the paper prints of its designs, and ours from scratch, to two digits more.",)
    headings = ("equation", "quantity", "to the digits printed", "paper", "ours")
    return Section("The paper's numbers", text, (Table("paper", headings, tuple(rows), words=3),))


def _provenance(scope: Scope, provenance: dict[str, str]) -> Section:
    rows = tuple(provenance.items())
    vehicle = scope.vehicle
    settings: list[tuple[str, str]] = [(f"{name}", f"{value:g}") for name, value in vehicle.parameters.items()]
    settings += [(f"weight of {name}", f"{value:g}") for name, value in vehicle.performance.items()]
    tables = (
        Table("provenance", ("what", "value"), rows, words=2),
        Table("vehicle", ("parameter [SI]", "value"), tuple(settings)),
    )
    return Section("Where this comes from", (), tables)


def report_object(page: Page) -> dict[str, Any]:
    """Answer and tables as JSON has them."""
    tables = {
        table.name: [dict(zip(table.headings, row, strict=True)) for row in table.rows]
        for section in page.sections
        for table in section.tables
    }
    return json.loads(json.dumps({"title": page.title, "answer": page.answer, "tables": tables}))


def _order(coarse: float, fine: float) -> str:
    """Power of the step with which an error shrinks; - where it is rounding."""
    return f"{math.log2(coarse / fine):.2f}" if fine > 1e-9 and coarse > 1e-9 else "-"


def _margin(value: float) -> str:
    return "any" if math.isinf(value) else f"{value:.5g}"


def _number(value: float | None, form: str) -> str:
    return format(value, form) if value is not None and math.isfinite(value) else "-"
