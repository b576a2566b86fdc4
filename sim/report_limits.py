"""The sections of a report on where the analysis ends: margins, other vehicles, the map of validity."""

import math
from dataclasses import replace

import numpy as np

from models.reality import Implementation
from sim.broken import ENDS
from sim.envelope import grid, read_axes
from sim.envelope_picture import envelope_figure
from sim.loop_margins import find_all, searches
from sim.margins_picture import margins_figure
from sim.page import Section, Table
from sim.report_scope import BUMP_DURATION, Scope, number
from sim.robustness import robustness
from sim.run import sample_times
from sim.validity import Cells, validity

MAP = ("height:0.02:0.3:20", "speed:3:30:20")
THRESHOLD = 0.05  # of a peak, where linear analysis is said to hold


def margins_section(scope: Scope) -> Section:
    """What the loops bear, predicted and found."""
    rows, figures, robust = [], [], []
    vehicle = replace(scope.vehicle, implementation=Implementation())
    scope.progress("margins")
    actuators = range(len(vehicle.linear_model.inputs))
    loops = find_all([searches(vehicle, one, actuators, scope.timestep) for one in scope.active], scope.timestep)
    for one, loop in zip(scope.active, loops, strict=True):
        scope.progress(f"other vehicles with {one.name}")
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
                number(box.norm, ".5g"),
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


def validity_section(scope: Scope) -> tuple[Section, str]:
    """The map of every controller, and where to stop trusting the line, in a sentence."""
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


def _margin(value: float) -> str:
    return "any" if math.isinf(value) else f"{value:.5g}"
