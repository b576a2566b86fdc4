"""What a report says: its answer, then section by section."""

import json
import math
from collections.abc import Sequence
from typing import Any

from sim.identification import Lines, identify
from sim.page import Page, Section, Table
from sim.paper import PRINTED, entry_of, is_the_papers, ours
from sim.report_agreement import agreement_section, bump_section, design_section, frequency_section
from sim.report_limits import margins_section, validity_section
from sim.report_ride import ride_section
from sim.report_scope import AMPLITUDE, BUMP_DURATION, Scope
from sim.run import Run, run_all, sample_times
from sim.sweep import Sweep, failures, sweep


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

    sections = [
        design_section(scope),
        frequency_section(scope, lines, sweeps, road.speed),
        bump_section(scope, runs),
        agreement_section(scope, runs, finer),
    ]
    answer = _answer(scope, runs, lines, sweeps)
    if not scope.quick:
        sections.append(margins_section(scope))
        mapped, sentence = validity_section(scope)
        sections.append(mapped)
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
