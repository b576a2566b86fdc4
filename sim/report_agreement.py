"""The sections of a report that hold MuJoCo against the analysis: designs, frequency responses, the paper's bump, agreement."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim.figure import Curve, Figure, Panel, styles
from sim.identification import Lines
from sim.page import Section, Table
from sim.report_scope import AMPLITUDE, BUMP_DURATION, Scope, number
from sim.run import Run
from sim.sweep import Sweep
from sim.sweep_picture import sweep_figure
from sim.verdict import gain_text, verdict_lines
from synth.table import percent

POINTS = 60  # of MuJoCo in a time history


def design_section(scope: Scope) -> Section:
    """Every controller: gain, certificate, and how good that is."""
    rows = []
    for one in scope.controllers:
        certificate, norm = one.certificate, one.certificate.norm
        rows.append(
            (
                one.name,
                ", ".join(one.measured).replace("_", " ") or "nothing",
                gain_text(one.gain) if one.measured else "0",
                number(certificate.bound, ".7g"),
                number(norm.value, ".7g"),
                number(norm.peak_frequency, ".5g"),
                number(certificate.lower.gamma, ".7g") if certificate.lower is not None and certificate.lower.gamma > 0 else "-",
                percent(certificate.gap) if certificate.gap is not None else "-",
                number(float(np.real(certificate.poles).max()), ".4g"),
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


def frequency_section(scope: Scope, lines: Sequence[Lines], sweeps: Sequence[Sweep], speed: float) -> Section:
    """The paper's Fig. 3, points of MuJoCo on its lines; and the norm as a fact, where there are sweeps."""
    figure = replace(sweep_figure(scope.vehicle, lines, AMPLITUDE, scope.timestep, speed), name="frequency-responses")
    rows = [
        (
            one.controller.name,
            f"{one.error(one.sampled).max():.1e}",
            f"{one.error(one.continuous).max():.1e}",
            number(one.order, ".2f"),
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


def bump_section(scope: Scope, runs: Sequence[Run]) -> Section:
    """The paper's Fig. 4, and the peaks in it."""
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


def agreement_section(scope: Scope, runs: Sequence[Run], finer: Sequence[Run]) -> Section:
    """How far MuJoCo is from the analysis, and with which power of the step that shrinks."""
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


def _order(coarse: float, fine: float) -> str:
    """Power of the step with which an error shrinks; - where it is rounding."""
    return f"{math.log2(coarse / fine):.2f}" if fine > 1e-9 and coarse > 1e-9 else "-"
