"""Contents of a report: its answer, then section by section."""

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from models.document.document import Document, Table
from models.document.page import Page
from models.roads.road import Bump
from models.vehicle.names import PASSIVE
from models.vehicle.sketch import vehicle_sketch
from sim.command.comparison import standings_of
from sim.linear.nonlinear_elements import at_rest
from sim.report.agreement import agreement_section, response_section
from sim.report.designs import design_section, paper_section
from sim.report.exported import exported_section
from sim.report.loads import dives, loads_section
from sim.report.ride import AVERAGE, SEEDS, OverRoads, Ride, ride_section
from sim.report.scope import AMPLITUDE, BUMP_DURATION, Subject, file_stem
from sim.report.summary import compared_on, first_screen, trust_section
from sim.runs.run import Run, passive_beside, run_controllers, sample_times
from sim.studies.frequency.describing_function import DescribingFunction, describing_function
from sim.studies.frequency.figure import sweep_figure
from sim.studies.frequency.identification import ideal_measurements, identify
from sim.studies.frequency.report import describe, workshop
from sim.studies.frequency.sweep import OWN, Sweep, sweep
from sim.studies.ride.run_metrics import RunMetrics, measure_run, measured_samples, measured_words
from sim.studies.ride.standing import Standing, headline, record_of_standings, some_names, standing, without_unsound
from sim.studies.validity.grid import grid, read_axes
from sim.studies.validity.regime_end import regime_ends
from sim.studies.validity.regime_map import Cells, validity
from sim.studies.validity.report import compare_maps, describe_ends
from synth.vehicle.paper import SEED, is_the_papers

BUMP, REGIME, FREQUENCIES, MARGINS = "a bump", "where the linear regime ends", "frequency responses", "margins"
MAP, RIDE, LOADS, FRONT, PAPER = "map", "random roads", "loads", "trade-off", "the paper"
EXPORTED = "exported code"
OF_MAP = ("height:0.02:0.3:20", "speed:3:30:20")


Name = tuple[str, str]  # stage and subject
Piece = Callable[[Subject], Any]  # a function of a module, or a `partial` of one
MOST_ORDERS = 4  # controllers whose order of convergence is found, as that takes twice a run


@dataclass(frozen=True, eq=False)
class Report:
    """A report: its page, and the comparison of controllers.

    Attributes:
        page: whole page.
        compared: the controllers' standings, the passive one first.
        compared_on: roads of the comparison, in words.
    """

    page: Page
    compared: list[Standing]
    compared_on: str


def report(
    scope: Subject, provenance: dict[str, str], begin: Callable[[Subject, dict[Name, Piece]], Callable[[], dict[Name, Any]]]
) -> Report:
    """Returns the whole report.

    Args:
        provenance: origin of the report, in words.
        begin: function that begins independent pieces and returns the function for their results, as `WorkerPool.begin` does.
    """
    vehicle, bump, h = scope.vehicle, Bump(), scope.timestep
    results = begin(scope, pieces_of(scope))
    scope.progress(BUMP)
    time, halves = (sample_times(vehicle, scope.duration, step) for step in (h, h / 2))
    runs = run_controllers(vehicle, scope.driven, scope.road, time)
    finer = run_controllers(vehicle, scope.driven[:MOST_ORDERS], scope.road, halves, balanced=False)
    scope.progress(REGIME)
    short = sample_times(vehicle, BUMP_DURATION, h)
    ends = list(zip(scope.stable, regime_ends(ideal_measurements(vehicle), scope.stable, bump, short), strict=True))
    parts = results()

    frequencies: list[Document] = parts[FREQUENCIES, ""]
    rides: list[Ride]
    rides, over_roads = parts.get((RIDE, ""), ([], []))
    samples, measured = (0, None), []
    if scope.own_road is not None:
        samples = measured_samples([(vehicle, one) for one in scope.driven], scope.own_road, scope.duration, h)
        measured = [measure_run(run, *samples) for run in runs]
        over_roads = []
    compared, when = _compared(scope, runs, over_roads, samples, measured), measured_words(time, samples)
    disagree = {run.controller.name for run in runs if not run.agreement.agrees}
    wrong = [one.name for one, _ in ends if one.name in disagree]  # no height is claimed for them
    sections = [trust_section(scope, runs, ends, wrong), design_section(scope), *frequencies[:1]]
    sections += [response_section(scope, runs, measured, when), agreement_section(scope, runs, finer)]
    if ends:
        sections.append(describe_ends(vehicle, ends, wrong, bump, scope.where, f"{BUMP_DURATION:g} s at {1e3 * h:g} ms"))
    if (MARGINS, "") in parts:
        maps = [parts[MAP, one.name] for one in scope.active]
        sections += [parts[MARGINS, ""], compare_maps(maps, scope.map_timestep, scope.noise_qualifier)]
    if rides:
        sections.append(ride_section(vehicle, rides, scope.styles))
    sections += frequencies[1:]
    sections += [parts[name, ""] for name in (LOADS, EXPORTED, FRONT, PAPER) if (name, "") in parts]
    sections.append(_provenance(scope, provenance))
    where = compared_on(scope, compared, bool(rides), when)
    names, kind = some_names([one.name for one in scope.driven]), vehicle.kind.name.replace("_", " ")
    whole = Page(
        f"{file_stem(vehicle)}: {names} on a {kind}, from linear analysis to MuJoCo",
        first_screen(scope, runs, compared, dives(scope), where),
        tuple(sections),
        headline(compared),
        sketch=vehicle_sketch(vehicle),
    )
    return Report(whole, compared, where)


def stages(pieces: Iterable[Name]) -> tuple[str, ...]:
    """Returns the stages of a page, in their order where one process computes all its pieces."""
    return BUMP, REGIME, *dict.fromkeys(stage for stage, _ in reversed([*pieces]))


def pieces_of(scope: Subject) -> dict[Name, Piece]:
    """Returns the independent pieces of a page, by stage and subject, the longest first."""
    maps = {(MAP, one.name): partial(_map, number=i) for i, one in enumerate(scope.active)}
    some, full = bool(scope.stable or scope.laws), not scope.quick
    return {
        **({(FRONT, ""): _front} if scope.front is not None else {}),
        **({(MARGINS, ""): _margins, **maps} if full and maps else {}),
        **({(RIDE, ""): _rides} if full and some else {}),
        (FREQUENCIES, ""): _frequencies,
        **({(EXPORTED, ""): exported_section} if scope.exported is not None else {}),
        **({(LOADS, ""): loads_section} if scope.loads and some else {}),
        **({(PAPER, ""): paper_section} if is_the_papers(scope.vehicle) else {}),
    }


def _front(scope: Subject) -> Document:
    """Returns the section on a trade-off."""
    from sim.report.front import front_section  # only a report with --front waits for its import

    return front_section(scope)


def _frequencies(scope: Subject) -> list[Document]:
    """Returns the sections on frequency responses and, except in a quick report, on a workshop's plate; none without a loop."""
    vehicle, how = scope.vehicle, (AMPLITUDE, scope.timestep, scope.speed)
    sweeps: list[Sweep] = []
    if scope.quick:
        lines = identify(at_rest(vehicle), scope.stable, *how) if scope.stable else []
    else:
        sweeps = sweep(vehicle, scope.stable, *how, scope.progress) if scope.stable else []
        lines = [one.lines for one in sweeps]
    own: list[DescribingFunction] = []
    if not scope.quick and scope.laws:
        scope.progress(OWN)
        own = [describing_function(vehicle, one, *how) for one in scope.laws]
    if not lines and not own:
        return []
    found = describe(vehicle, lines, sweeps, own, *how[:2])
    section = replace(found, blocks=(sweep_figure(vehicle, lines, *how[1:], scope.styles, own), *found.blocks))
    return [section, *([workshop(vehicle, sweeps)] if sweeps else [])]


def _margins(scope: Subject) -> Document:
    """Returns the section on margins, predicted and found."""
    # A quick report has no margins, and waits for none of their searches to be imported.
    from sim.studies.stability.report import compare
    from sim.studies.stability.study import stability_margins

    step = scope.margins_timestep
    return compare(stability_margins(scope.vehicle, scope.active, step, scope.progress, each_loop=False))


def _map(scope: Subject, number: int) -> Cells:
    """Returns the map of an active controller: bumps of the paper's length, with all heights and speeds of `OF_MAP`."""
    bumps, vehicle = grid(read_axes(OF_MAP), {"length": Bump().length}), ideal_measurements(scope.vehicle)
    return validity(vehicle, scope.active[number], bumps, sample_times(vehicle, BUMP_DURATION, scope.map_timestep))


def _rides(scope: Subject) -> tuple[list[Ride], list[Standing]]:
    """Returns the ride of stable controllers and of laws over random roads, and their standings and that of passive."""
    reported = (*scope.stable, *scope.laws)
    driven = [OverRoads(scope.vehicle, one, scope.timestep) for one in reported]
    passive = [] if any(one.name == PASSIVE for one in reported) else [scope.designer.design(PASSIVE)]
    beside = [OverRoads(scope.vehicle, one, scope.timestep, AVERAGE) for one in passive]
    return [ride for one in driven for ride in one.rides()], [one.standing() for one in (*beside, *driven)]


def _compared(
    scope: Subject,
    runs: Sequence[Run],
    over_roads: Sequence[Standing],
    samples: tuple[int, int | None],
    measured: Sequence[RunMetrics],
) -> list[Standing]:
    """Returns the standing of every controller over random roads or, without these, in the runs; passive first.

    A controller that is not driven over random roads, such as one with an unstable loop, has no numbers there.
    """
    if not over_roads:
        return standings_of(runs, passive_beside(runs, scope.designer.design), samples, measured)
    there = {one.controller: one for one in over_roads}
    names = dict.fromkeys((PASSIVE, *(one.name for one in scope.driven)))
    unsound = [one.name for one in scope.driven if one.growth]
    return without_unsound([there.get(name) or standing(scope.vehicle, name, {}) for name in names], unsound)


def _provenance(scope: Subject, provenance: dict[str, str]) -> Document:
    """Returns the section on the sources of the page: every number of the vehicle file that it depends on, and every setting."""
    vehicle, how = scope.vehicle, scope.vehicle.implementation
    rows = dict(provenance)
    if absent := [name for name in vehicle.controller_names if name not in {one.name for one in scope.driven}]:
        rows["controllers not on this page"] = ", ".join(absent)
    h = 1e3 * scope.timestep
    rows |= {"road": scope.own_road.words, "duration": f"{scope.duration:g} s"} if scope.own_road is not None else {}
    rows["timestep"] = f"{h:g} ms, and {h / 2:g} ms for the orders of convergence"
    seeds = [f"{how.seed}, of the noise on measurements"] if any(how.noise.values()) else []
    if not scope.quick:
        rows["timestep"] += f"; {1e3 * scope.margins_timestep:g} ms for margins, {1e3 * scope.map_timestep:g} ms for the map"
        seeds.append("1, of the random road for the L2 gain")
        seeds += [f"{SEED}, of the genetic algorithm"] if is_the_papers(vehicle) else []
        seeds.append(f"{SEEDS[0]} to {SEEDS[-1]}, of the random roads of the ride")
    rows["seeds"] = "; ".join(seeds) or "none: nothing is random"
    built = {"sample_period": how.sample_period, "delay": how.delay or None}
    built |= {f"noise of {name}": rms for name, rms in how.noise.items()}
    built |= {f"quantisation of {name}": step for name, step in how.quantisation.items()}
    dampers = {
        f"[actuators] {name}{one.ending}": value
        for one in vehicle.parts.adjustable
        if one.damper.replaces
        for name, value in (("c_min", one.damper.c_min), ("c_max", one.damper.c_max), ("bandwidth", one.damper.bandwidth))
        if value is not None
    }
    settings = {
        **vehicle.parameters,
        **{f"weight of {name}": value for name, value in vehicle.performance.items()},
        **{f"weight of {one.name}": f"{one.weight:g} of {one.text}" for one in vehicle.sums},
        **{f"filter of {one.name}": one.filter.words for one in vehicle.weighted if one.filter is not None},
        **({"filter of the road": vehicle.road_filter.words} if vehicle.road_filter is not None else {}),
        **({f"[limits] {name}": text for name, text in vehicle.limits.written.items()} or {"[limits]": "none"}),
        **(
            {f"[implementation] {name}": value for name, value in built.items() if value is not None}
            or {"[implementation]": "none"}
        ),
        **{f"[curves] {one.name}": one.curve.words for one in vehicle.parts.with_curve},
        **dampers,
    }
    given = tuple((name, value if isinstance(value, str) else f"{value:g}") for name, value in settings.items())
    caption = (
        "Numbers of the vehicle file that this page depends on, in SI units. A bandwidth is in rad/s; all other frequencies on "
        "this page are in Hz."
    )
    tables = (
        Table("provenance", "Origin and settings of this page.", ("what", "value"), tuple(rows.items()), words=2),
        Table("vehicle", caption, ("parameter [SI]", "value"), given),
    )
    return Document("Provenance and settings", tables)


def report_object(report: Report) -> dict[str, Any]:
    """Returns answer, tables and standings for JSON."""
    page = report.page
    whole = {
        "title": page.title,
        "headline": page.headline,
        "lead": [f"{page.headline}."],
        "answer": [one.text for one in page.answer],
        "verdict": page.state,
        "tables": {one.name: one.records for one in page.whole.tables},
    }
    return json.loads(json.dumps({**whole, "compared": record_of_standings(report.compared)}))
