"""What a report says: its answer, then section by section."""

import json
from dataclasses import replace
from typing import Any

from models.figures.page import Page, Section, Table
from models.roads.road import Bump
from sim.frequency.describing_function import DescribingFunction, describing_function
from sim.frequency.identification import ideal_measurements, identify
from sim.frequency.sweep import OWN, sweep
from sim.linear.at_rest import at_rest
from sim.report import answer as report_answer
from sim.report.agreement import agreement_section, bump_section
from sim.report.designs import design_section, frequency_section
from sim.report.front import front_section
from sim.report.limits import margins_section, regime_section, validity_section
from sim.report.loads import loads_section, workshop_section
from sim.report.paper import paper_section
from sim.report.regime_end import regime_end
from sim.report.ride import SEEDS, Ride, ride_section, rides_of
from sim.report.scope import AMPLITUDE, BUMP_DURATION, Scope
from sim.report.summary import summary
from sim.runs.run import run_all, sample_times
from synth.paper.printed import is_the_papers
from synth.paper.remarks import SEED


def page(scope: Scope, provenance: dict[str, str]) -> Page:
    """The whole report.

    Args:
        scope: what it is about.
        provenance: where it comes from, in words.
    """
    vehicle, road, h = scope.vehicle, Bump(), scope.timestep
    scope.progress("a bump")
    time, halves = (sample_times(vehicle, BUMP_DURATION, step) for step in (h, h / 2))
    runs = run_all(vehicle, scope.driven, road, time)
    finer = run_all(vehicle, scope.driven, road, halves)
    scope.progress("frequency responses")
    if scope.quick:
        sweeps, lines = [], identify(at_rest(vehicle), scope.stable, AMPLITUDE, h, road.speed) if scope.stable else []
    else:
        sweeps = sweep(vehicle, scope.stable, AMPLITUDE, h, road.speed, scope.progress) if scope.stable else []
        lines = [one.lines for one in sweeps]
    own: list[DescribingFunction] = []
    if not scope.quick and scope.laws:
        scope.progress(OWN)
        own = [describing_function(vehicle, one, AMPLITUDE, h, road.speed) for one in scope.laws]
    scope.progress("where the linear regime ends")
    ends = [(one, regime_end(ideal_measurements(vehicle), one, road, time)) for one in scope.stable]

    answer = [
        *report_answer.loops(scope),
        *report_answer.norms(scope),
        *report_answer.over_the_bump(scope, runs),
        *report_answer.left_short(scope, runs),
        *report_answer.responses(scope, lines, sweeps),
        *report_answer.regime(scope, road, ends, runs),
    ]
    sections = [design_section(scope)]
    if lines or own:
        sections.append(frequency_section(scope, lines, sweeps, road.speed, own))
    sections += [bump_section(scope, runs, road), agreement_section(scope, runs, finer)]
    if ends:
        sections.append(regime_section(scope, road, ends, runs))
    if not scope.quick and scope.active:
        given = replace(scope, vehicle=at_rest(vehicle))
        for section, findings in (margins_section(given), validity_section(scope, road)):
            sections.append(section)
            answer += findings
    rides: list[Ride] = []
    if not scope.quick and (scope.stable or scope.laws):
        scope.progress("random roads")
        rides = rides_of(vehicle, [*scope.stable, *scope.laws], h)
        sections.append(ride_section(vehicle, rides, scope.styles))
    if sweeps:
        sections.append(workshop_section(scope, sweeps))
    if scope.loads and (scope.stable or scope.laws):
        section, findings = loads_section(scope, scope.loads)
        sections.append(section)
        answer += findings
    if scope.front is not None:
        sections.append(front_section(scope, scope.front))
    if is_the_papers(vehicle):
        sections.append(paper_section(scope))
    sections.append(_provenance(scope, provenance))
    title = f"{vehicle.kind.name.replace('_', ' ').capitalize()}: suspension control from linear analysis to physics"
    texts = tuple(one.text for one in answer)
    return Page(title, texts, summary(scope, runs, ends, rides), tuple(sections), report_answer.worst(answer))


def _provenance(scope: Scope, provenance: dict[str, str]) -> Section:
    """What the page was made from: every number of the vehicle file that it depends on, and every setting."""
    vehicle, how = scope.vehicle, scope.vehicle.implementation
    rows = dict(provenance)
    h = 1e3 * scope.timestep
    rows["timestep"] = f"{h:g} ms, and {h / 2:g} ms for the orders of convergence"
    seeds = [f"{how.seed}, of the noise on measurements"] if any(how.noise.values()) else []
    if not scope.quick:
        rows["timestep"] += f"; {1e3 * scope.margins_timestep:g} ms for margins, {1e3 * scope.map_timestep:g} ms for the map"
        seeds.append("1, of the random road that the norm is tried on")
        seeds += [f"{SEED}, of the genetic algorithm"] if is_the_papers(vehicle) else []
        seeds.append(f"{SEEDS[0]} to {SEEDS[-1]}, of the random roads of the ride")
    rows["seeds"] = "; ".join(seeds) or "none: nothing is random"
    settings = [(name, f"{value:g}") for name, value in vehicle.parameters.items()]
    settings += [(f"weight of {name}", f"{value:g}") for name, value in vehicle.performance.items()]
    settings += [(f"filter of {name}", one.words) for name, one in vehicle.filters.items()]
    settings += [("filter of the road", vehicle.road_filter.words)] if vehicle.road_filter is not None else []
    settings += [(f"[limits] {name}", text) for name, text in vehicle.limits.written.items()] or [("[limits]", "none")]
    built = {"sample_period": how.sample_period, "delay": how.delay or None}
    built |= {f"noise of {name}": rms for name, rms in how.noise.items()}
    built |= {f"quantisation of {name}": step for name, step in how.quantisation.items()}
    there = [(f"[implementation] {name}", f"{value:g}") for name, value in built.items() if value is not None]
    settings += there or [("[implementation]", "none")]
    settings += [
        (f"[curves] {one.parameter}", one.curve.words) for one in {one.parameter: one for one in vehicle.fitted}.values()
    ]
    for one in vehicle.adjustable:
        lag = {} if one.damper.bandwidth is None else {"bandwidth": one.damper.bandwidth}
        ranges = {"c_min": one.damper.c_min, "c_max": one.damper.c_max, **lag}
        settings += [(f"[actuators] {name}{one.ending}", f"{value:g}") for name, value in ranges.items()]
    caption = (
        "Every number of the vehicle file that this page depends on, as it stands there, in SI units: a bandwidth in rad/s. All "
        "other frequencies on this page are in Hz."
    )
    tables = (
        Table("provenance", "What this page was made from, and how.", ("what", "value"), tuple(rows.items()), words=2),
        Table("vehicle", caption, ("parameter [SI]", "value"), tuple(settings)),
    )
    return Section("Where does this page come from?", "provenance and settings", (), tables)


def report_object(page: Page) -> dict[str, Any]:
    """Answer and tables as JSON has them."""
    tables = {
        table.name: [dict(zip(table.headings, row, strict=True)) for row in table.rows]
        for part in page.parts
        for table in part.tables
    }
    return json.loads(json.dumps({"title": page.title, "answer": page.answer, "verdict": page.state, "tables": tables}))
