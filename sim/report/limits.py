"""The sections of a report on where the analysis ends: margins, other vehicles, the map of validity."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from models.common.numbers import percent
from models.figures.page import Section, Table
from models.reality import Implementation
from models.roads.road import Bump
from sim.frequency.identification import ideal_measurements
from sim.report.answer import Finding, unclaimed_words
from sim.report.regime_end import RegimeEnd
from sim.report.scope import BUMP_DURATION, Scope, number
from sim.response.regime import END_NAMES
from sim.runs.run import Run, sample_times
from sim.stability.figure import margins_figure
from sim.stability.fragile import find_fragility
from sim.stability.margins import find_all, searches
from sim.stability.robustness import robustness, varied_text
from sim.validity.cells import validity
from sim.validity.figure import envelope_figure
from sim.validity.grid import grid, read_axes
from synth.controller import Controller

MAP = ("height:0.02:0.3:20", "speed:3:30:20")
THRESHOLD = 0.05  # of a peak, where linear analysis is said to hold


def margins_section(scope: Scope) -> tuple[Section, list[Finding]]:
    """What the loops bear, predicted and found; and the controllers of which physics says something else."""
    rows, figures, robust, found = [], [], [], []
    vehicle = replace(scope.vehicle, implementation=Implementation())
    scope.progress("margins")
    actuators = range(len(vehicle.linear_model.inputs))
    timestep = scope.margins_timestep
    loops = [searches(vehicle, one, actuators, timestep) for one in scope.active]
    find_all(loops, timestep)
    scope.progress("other vehicles")
    for one, loop, box in zip(scope.active, loops, robustness(vehicle, scope.active, timestep), strict=True):
        scope.progress("fragility")
        predicted, fragile = loop.predicted, find_fragility(vehicle, one, timestep)
        errors = fragile.predicted.stable.found, fragile.edge.found
        pairs = [
            ("gain, factor", predicted.gain, loop.gain.found),
            ("phase [rad]", predicted.phase, loop.found_phase),
            ("delay [ms]", 1e3 * predicted.delay, 1e3 * loop.delay.unstable),
            ("sample period [ms]", 1e3 * predicted.sample_period, 1e3 * loop.found_sample_period),
            ("error of each reading and force [%]", *(100 * value for value in errors)),
        ]
        for name, first, second in pairs:
            rows.append((one.name, name, _margin(first), _margin(second)))
        agrees = loop.agrees and fragile.agrees
        verdict = "agrees" if agrees else "DOES NOT AGREE"
        if not agrees:
            found.append(Finding(f"MuJoCo DOES NOT AGREE with {one.name}'s predicted margins: see the table.", "fails"))
        others = ("-", "-", "-")
        if box is not None:
            at = ", ".join(f"{key.replace('_', ' ')} {value:.4g}" for key, value in box.at.items())
            others = (number(box.norm, ".5g"), at, "same" if box.holds else "NOT THE SAME")
            if not box.holds:
                text = f"MuJoCo and analysis DO NOT AGREE on other vehicles with {one.name}: see the table of margins."
                found.append(Finding(text, "fails"))
        robust.append((one.name, f"{one.certificate.norm.value:.5g}", *others, verdict))
        figures.append(replace(margins_figure(vehicle, one, loop, fragile, box, timestep), name=f"margins-{one.name}"))
    tables = (
        Table(
            "margins",
            "What every loop bears before it becomes unstable: predicted, and found in MuJoCo.",
            ("controller", "margin", "predicted", "MuJoCo"),
            tuple(rows),
            words=2,
        ),
        Table(
            "robustness",
            "The worst norm on other vehicles, where that is, and whether MuJoCo settles there as the analysis says.",
            ("controller", "norm", "worst norm", "at", "corners: MuJoCo and analysis say the", "margins"),
            tuple(robust),
        ),
    )
    text = (
        "How much more gain, phase lag, delay or sample period the loop bears, all its actuators at once: predicted from the "
        f"loop transfer function, found in MuJoCo by bisection on growth and decay at {1e3 * timestep:g} ms. Other vehicles, "
        f"with the ideal loop: {varied_text(vehicle.kind)}.",
    )
    if not scope.plain:
        about = f"without [implementation]{scope.lag}: what is asked is how much of a delay or sample period it would bear"
        about += f", and its {scope.vehicle.implementation.blur} is not tried" if scope.blurred else ""
        text = (*text, f"Margins are those of the loop {about}. The nominal norm is the ideal loop's, too.")
    title = "How much goes wrong before it becomes unstable?"
    return Section(title, "stability margins, other vehicles", text, tables, tuple(figures)), found


def regime_section(scope: Scope, bump: Bump, ends: Sequence[tuple[Controller, RegimeEnd | None]], runs: Sequence[Run]) -> Section:
    """Up to which height of one bump the linear regime holds: predicted, and the two runs of MuJoCo that enclose it."""
    rows = []
    for one, end in ends:
        if end is None:
            rows.append((one.name, "at no height", *("-",) * 5))
            continue
        rows.append(
            (
                one.name,
                end.predicted_end,
                f"{end.predicted:.5g}",
                f"{end.stays:.5g}",
                f"{end.error:.1e}",
                number(end.leaves, ".5g"),
                end.end or "nothing",
            )
        )
    headings = (
        "controller",
        "predicted end",
        "at [m]",
        "MuJoCo stays linear at [m]",
        "off by, of a peak",
        "and not at [m]",
        "ended by",
    )
    text = (
        f"Bumps of {bump.length:g} m at {bump.speed:g} m/s, over {BUMP_DURATION:g} s at {1e3 * scope.timestep:g} ms"
        f"{scope.without}: up to which height nothing breaks, from one linear run of the loop as it "
        "runs, and the two nearest heights in MuJoCo, of which the first breaks nothing and the second does.",
    )
    if none := unclaimed_words(ends, runs):
        text = (*text, f"{none} What stands here of it is only when something breaks.")
    caption = "Up to which height of a bump nothing breaks: predicted, and the two runs of MuJoCo that enclose it."
    table = Table("regime", caption, headings, tuple(rows), words=2)
    return Section("How high may a bump be?", "where the linear regime ends", text, (table,))


def validity_section(scope: Scope, bump: Bump) -> tuple[Section, list[Finding]]:
    """The map of every controller; and the controllers whose runs break otherwise than predicted."""
    axes, timestep, vehicle = read_axes(MAP), scope.map_timestep, ideal_measurements(scope.vehicle)
    fixed = {"height": bump.height, "length": bump.length, "speed": bump.speed}
    time = sample_times(vehicle, BUMP_DURATION, timestep)
    figures, rows, found = [], [], []
    scope.progress("map")
    for one in scope.active:
        scope.progress(f"of {one.name}")
        cells = validity(vehicle, one, grid(axes, fixed), time)
        figure = envelope_figure(vehicle, one, cells, axes, {"length": bump.length}, THRESHOLD)
        figures.append(replace(figure, name=f"map-{one.name}", title=f"{figure.title}{scope.without}"))
        shares = [np.mean(cells.first == end) for end in (-1, *range(len(END_NAMES)))]
        rows.append(
            (
                one.name,
                f"{100 * np.mean(cells.error <= THRESHOLD):.1f} %",
                *(f"{100 * share:.1f} %" for share in shares),
                f"{100 * cells.agreement:.2f} %",
                f"{cells.unexplained}",
            )
        )
        if not cells.as_predicted:
            text = f"MuJoCo DOES NOT break as predicted in {percent(1 - cells.agreement)} of {one.name}'s map."
            found.append(Finding(text, "fails"))
    headings = (
        "controller",
        "linear analysis holds",
        "nothing breaks",
        *(f"{end} first" for end in END_NAMES),
        "as predicted",
        "of the others not at a boundary",
    )
    text = (
        f"Bumps of {bump.length:g} m length, {len(axes[0].values)} heights by {len(axes[1].values)} speeds, each run in MuJoCo "
        f"at {1e3 * timestep:g} ms{scope.without}: what breaks first, and where the linear prediction is off by more than "
        f"{100 * THRESHOLD:g} % of a peak.",
    )
    table = Table("validity", "Shares of every controller's map, and how much of it is as predicted.", headings, tuple(rows))
    title = "How far can the analysis be trusted?"
    return Section(title, "the map of validity, over heights and speeds", text, (table,), tuple(figures)), found


def _margin(value: float) -> str:
    return "any" if math.isinf(value) else f"{value:.5g}"
