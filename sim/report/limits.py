"""The sections of a report on where the analysis ends: margins, other vehicles, the map of validity."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from models.common.printed import as_name, cell
from models.document.document import Document, Statement, Table, notes
from models.document.field import Field, cells, titles
from models.document.figure import Figure
from models.document.reading import Pivot
from models.roads.road import Bump
from models.vehicle.limits_and_implementation import Implementation
from sim.report.headline import regime, unclaimed_words
from sim.report.scope import BUMP_DURATION, Scope
from sim.response.regime import END_NAMES
from sim.runs.run import Run, sample_times
from sim.studies.frequency.identification import ideal_measurements
from sim.studies.validity.grid import grid, read_axes
from sim.studies.validity.regime_end import RegimeEnd
from sim.studies.validity.regime_map import validity
from sim.studies.validity.report import envelope_figure
from synth.controller.controller import Controller

MAP = ("height:0.02:0.3:20", "speed:3:30:20")
THRESHOLD = 0.05  # of a peak, where linear analysis is said to hold


def margins_section(scope: Scope) -> Document:
    """Returns the section on margins, predicted and found."""
    # A quick report has no margins, and waits for none of their searches to be imported.
    from sim.studies.stability.figure import margins_figure
    from sim.studies.stability.fragility import find_fragility
    from sim.studies.stability.margin_search import find_all, implemented_searches, searches
    from sim.studies.stability.robustness import robustness, varied_text

    rows, figures, robust, statements = [], [], [], []
    vehicle = replace(scope.vehicle, implementation=Implementation())
    actuators = range(len(vehicle.linear_model.inputs))
    timestep = scope.margins_timestep
    loops = [searches(vehicle, one, actuators, timestep) for one in scope.active]
    built = [] if scope.prompt else [implemented_searches(scope.vehicle, one, actuators, timestep) for one in scope.active]
    find_all([*loops, *built])
    scope.progress("other vehicles")
    boxes = robustness(vehicle, scope.active, timestep)
    for one, loop, as_built, box in zip(scope.active, loops, built or [None] * len(loops), boxes, strict=True):
        scope.progress("fragility")
        predicted, fragile = loop.predicted, find_fragility(vehicle, one, timestep)
        errors = fragile.predicted.stable.smallest_violation, fragile.edge.found
        pairs = []
        for each, of in ((as_built, ""), (loop, "" if as_built is None else ", ideal loop")):
            if each is not None:
                pairs += [
                    (f"gain{of}, factor", each.predicted.gain, each.gain.found, each.gain.extrapolated),
                    (f"phase lag{of} [rad]", each.predicted.phase, each.found_phase, False),
                    (f"phase lead{of} [rad]", each.predicted.lead, math.nan, False),
                    (f"disk margin{of}", each.predicted.disk.size, math.nan, False),
                ]
        pairs += [
            ("delay [ms]", 1e3 * predicted.delay, 1e3 * loop.found_delay, False),
            ("sample period [ms]", 1e3 * predicted.sample_period, 1e3 * loop.found_sample_period, False),
            ("error of each reading and force [%]", *(100 * value for value in errors), fragile.edge.extrapolated),
        ]
        for name, first, second, limit in pairs:
            rows.append((one.name, name, _margin(first), f"{_margin(second)}{' (extrapolated)' * limit}"))
        agrees = loop.agrees and fragile.agrees and (as_built is None or as_built.agrees)
        verdict = "agrees" if agrees else "DOES NOT AGREE"
        if not agrees:
            statements.append(
                Statement(f"MuJoCo DOES NOT AGREE with the predicted margins of {as_name(one.name)}: see the table.", "fails")
            )
        others = ("-", "-", "-", "-")
        if box is not None:
            at = ", ".join(f"{key.replace('_', ' ')} {value:.4g}" for key, value in box.at.items())
            others = (cell(box.norm, ".5g"), f"{box.computed}", at, "same" if box.holds else "NOT THE SAME")
            if not box.holds:
                text = f"MuJoCo and analysis DO NOT AGREE on other vehicles with {as_name(one.name)}: see the table of margins."
                statements.append(Statement(text, "fails"))
        robust.append((one.name, f"{one.certificate.norm.value:.5g}", *others, verdict))
        figures.append(replace(margins_figure(vehicle, one, loop, as_built, fragile, box), name=f"margins-{one.name}"))
    tables = (
        Table(
            "margins",
            "What every loop bears before it becomes unstable: predicted, and found in MuJoCo.",
            ("controller", "margin", "predicted", "MuJoCo"),
            tuple(rows),
            words=2,
            pivot=Pivot(("margin",), "controller", ("predicted", "MuJoCo")),
        ),
        Table(
            "robustness",
            "The largest norm of so many other vehicles, where that is, and whether MuJoCo settles as the analysis says. Nothing "
            "is proved of vehicles between those that were computed.",
            ("controller", "norm", "worst norm", "of vehicles", "at", "corners: MuJoCo and analysis say the", "margins"),
            tuple(robust),
        ),
    )
    text = (
        "How much more gain, phase lag, delay or sample period the loop bears, all its actuators at once: predicted from the "
        f"loop transfer function, and found in MuJoCo by the derivative of its step at {1e3 * timestep:g} ms; two runs confirm "
        "each margin, one that decays and one that grows. Phase lead and disk margin are predicted alone: "
        "no run has a lead at every frequency, or a complex factor. Of gain and phase at once the disk margin alone speaks: "
        "each force bears any complex factor f with |f - 1| / |f + 1| below half of it. Other vehicles, with the ideal loop: "
        f"{varied_text(vehicle.kind)}.",
    )
    text = (*text, *(f"{as_name(one.name)}: {promise.text}." for one in scope.active for promise in one.robustness))
    if not scope.is_ideal:
        about = "" if scope.prompt else "Gain, phase and disk margins are those of the implemented loop, beside the ideal ones. "
        about += f"Delay, sample period and errors are those of the loop without [implementation]{scope.lag}."
        about += f" Its {scope.vehicle.implementation.noise_text} is not included." if scope.blurred else ""
        text = (*text, f"{about} The nominal norm is the ideal loop's, too.")
    return Document("Stability margins", (*statements, *notes(*text), *figures, *tables))


REGIME: tuple[Field[RegimeEnd], ...] = (
    Field("predicted end", lambda end: end.predicted_end),
    Field("at [m]", lambda end: end.predicted, "{:.5g}".format),
    Field("MuJoCo stays linear at [m]", lambda end: end.stays, "{:.5g}".format),
    Field("off by, of a peak", lambda end: end.error, "{:.1e}".format),
    Field("and not at [m]", lambda end: end.leaves, ".5g"),
    Field("ended by", lambda end: end.end or "nothing"),
)


def regime_section(
    scope: Scope, bump: Bump, ends: Sequence[tuple[Controller, RegimeEnd | None]], runs: Sequence[Run]
) -> Document:
    """Up to which height of one bump the linear regime holds: predicted, and the two runs of MuJoCo that enclose it."""
    rows = []
    for one, end in ends:
        if end is None:
            rows.append((one.name, "at no height", *("-",) * 5))
            continue
        rows.append((one.name, *cells(REGIME, [end])[0]))
    text = (
        f"Bumps of {bump.length:g} m at {bump.speed:g} m/s, over {BUMP_DURATION:g} s at {1e3 * scope.timestep:g} ms"
        f"{scope.noise_qualifier}: up to which height nothing breaks, from one linear run of the loop as it "
        "runs, and the two nearest heights in MuJoCo, of which the first breaks nothing and the second does.",
    )
    if none := unclaimed_words(scope, ends, runs):
        text = (*text, f"{none} What stands here of it is only when something breaks.")
    caption = "Up to which height of a bump nothing breaks: predicted, and the two runs of MuJoCo that enclose it."
    table = Table("regime", caption, ("controller", *titles(REGIME)), tuple(rows), words=2)
    return Document("Range of linear analysis over bumps", (*regime(scope, bump, ends, runs), *notes(*text), table))


Map = tuple[Figure, tuple[str, ...], tuple[Statement, ...]]  # figure, row of the table, and what is wrong with it


def map_of(scope: Scope, number: int) -> Map:
    """Runs bumps of the paper's length, of every height and speed of `MAP`, with one of the active controllers."""
    one, bump, timestep, vehicle = scope.active[number], Bump(), scope.map_timestep, ideal_measurements(scope.vehicle)
    axes, fixed = read_axes(MAP), {"height": bump.height, "length": bump.length, "speed": bump.speed}
    cells = validity(vehicle, one, grid(axes, fixed), sample_times(vehicle, BUMP_DURATION, timestep))
    figure = envelope_figure(vehicle, one, cells, axes, {"length": bump.length}, THRESHOLD)
    shares = [np.mean(cells.predicted == end) for end in (-1, *range(len(END_NAMES)))]
    row = (
        one.name,
        f"{100 * cells.share(lambda one: one.error <= THRESHOLD):.1f} %",
        *(f"{100 * share:.1f} %" for share in shares),
        f"{100 * cells.agreement:.2f} %",
        f"{cells.unexplained}",
    )
    text = f"MuJoCo DOES NOT break as predicted everywhere in the map of {as_name(one.name)}."
    findings = () if cells.as_predicted else (Statement(text, "fails"),)
    named = replace(figure, name=f"map-{one.name}", title=f"{figure.title}{scope.noise_qualifier}")
    return named, row, findings


def validity_section(scope: Scope, maps: Sequence[Map]) -> Document:
    """Returns the section on the map of every controller."""
    axes, bump = read_axes(MAP), Bump()
    headings = (
        "controller",
        "linear analysis holds",
        "nothing breaks",
        *(f"{end} first" for end in END_NAMES),
        "as predicted",
        "of the others not at a boundary",
    )
    text = (
        f"Bumps of {bump.length:g} m length, {len(axes[0].values)} heights by {len(axes[1].values)} speeds: what breaks first, "
        "predicted from one linear response per speed. MuJoCo runs cells that are spread over the map, and two bumps at every "
        f"edge, at {1e3 * scope.map_timestep:g} ms{scope.noise_qualifier}. Linear analysis holds in a run up to a difference of "
        f"{100 * THRESHOLD:g} % of a peak.",
    )
    table = Table(
        "validity",
        "Shares of every controller's map as predicted; and of its MuJoCo runs, where linear analysis holds, and which end as "
        "predicted.",
        headings,
        tuple(row for _, row, _ in maps),
    )
    figures = tuple(figure for figure, *_ in maps)
    wrong = [finding for *_, findings in maps for finding in findings]
    return Document("Range of linear analysis over height and speed", (*wrong, *notes(*text), *figures, table))


def _margin(value: float) -> str:
    return "any" if math.isinf(value) else "-" if math.isnan(value) else f"{value:.5g}"
