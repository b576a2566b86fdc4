"""The page of a report: the comparison of controllers, followed by the sections of all studies."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from models.common.extensions import STUDIES
from models.document.document import Document, Table
from models.document.page import Page
from models.vehicle.names import PASSIVE
from models.vehicle.sketch import vehicle_sketch
from sim.report.processes import Name
from sim.report.summary import compared_on, first_screen, trust_section
from sim.runs.run import passive_beside
from sim.studies.ride.run_metrics import measured_words
from sim.studies.ride.score_table import headline, some_names
from sim.studies.ride.scores import Score, score_of, scores_of_runs, scores_record, with_faults
from sim.studies.study import Progress
from sim.studies.subject import SEEDS, Subject, file_stem
from synth.vehicle.paper import SEED, is_the_papers

RUNS = "runs"  # name of the stage that simulates all controllers over the page's road
Begin = Callable[[dict[Name, Any], Progress], Callable[[], dict[Name, Any]]]


@dataclass(frozen=True, eq=False)
class Report:
    """A report: its HTML page, and the comparison of controllers.

    Attributes:
        page: whole HTML page of the report.
        scores: scores of the controllers in the comparison; the passive vehicle comes first.
        compared_on: text that describes the roads over which the controllers are compared.
    """

    page: Page
    scores: list[Score]
    compared_on: str


def report(scope: Subject, provenance: dict[str, str], begin: Begin, progress: Progress) -> Report:
    """Returns the whole report.

    Args:
        scope: subject of the report, with its vehicle, controllers and runs.
        provenance: texts that state how the report was made, such as time and command; the keys are the titles of the texts.
        begin: function that starts the computations of the studies and returns a function that waits for their results; see
            `Processes.begin`.
        progress: callback that receives the name of each study when the study begins.
    """
    # The copy of `scope` omits the cached runs, because transferring them would take long
    answers = begin(requests_of(replace(scope)), progress)
    progress(RUNS)
    runs, results = scope.runs, dict[str, dict[str, Any]]({name: {} for name in STUDIES})
    for (name, subject), result in answers().items():
        results[name][subject] = result
    over_roads = [one for _, scores in results.get("ride", {}).values() for one in scores] if scope.own_road is None else []
    compared, when = _compare_controllers(scope, over_roads), measured_words(scope.time, scope.samples)
    ends = [*zip(scope.stable, *results.get("ends", {}).values(), strict=False)] if results.get("ends") else []
    sections = [trust_section(scope, runs, ends, scope.disagreeing_names)]
    sections += [section for name, one in STUDIES.load_all().items() for section in one(name).sections(scope, results)]
    where = compared_on(scope, compared, any(results.get("ride", {}).values()), when)
    names, kind = some_names([one.name for one in scope.driven_controllers]), scope.vehicle.kind.name.replace("_", " ")
    dive = results.get("loads", {}).get("braking", {})
    whole = Page(
        f"{file_stem(scope.vehicle)}: {names} on a {kind}, from linear analysis to MuJoCo",
        first_screen(scope, runs, compared, dive, where),
        (*sections, _provenance(scope, provenance)),
        headline(compared),
        sketch=vehicle_sketch(scope.vehicle),
    )
    return Report(whole, compared, where)


def requests_of(scope: Subject) -> dict[Name, Any]:
    """Returns the requests (computations) that a page needs, by study and subject; the longest computation comes first. Each
    request is a computation of a study that does not depend on other requests.
    """
    studies = sorted((one(name) for name, one in STUDIES.load_all().items()), key=lambda one: -one.seconds)
    return {(one.name, subject): request for one in studies for subject, request in one.requests(scope).items()}


def stages(scope: Subject) -> tuple[str, ...]:
    """Returns the names of the stages in which a page is computed, in the order of the computation."""
    return RUNS, *dict.fromkeys(name for name, _ in reversed(requests_of(scope)))


def _compare_controllers(scope: Subject, over_roads: Sequence[Score]) -> list[Score]:
    """Returns the scores of all controllers over random roads or, if there are no random roads, over the road of the page.

    The score of the passive vehicle comes first. A controller without runs over random roads, for example a controller with an
    unstable loop, has a score without numbers.
    """
    if not over_roads:
        return scores_of_runs(scope.runs, passive_beside(scope.runs, scope.designer.design), scope.samples, scope.run_metrics)
    there = {one.controller: one for one in over_roads}
    names = dict.fromkeys((PASSIVE, *(one.name for one in scope.driven_controllers)))
    scores = [there.get(name) or score_of(scope.vehicle, name, {}) for name in names]
    return with_faults(scores, scope.vehicle, scope.driven_controllers)


def _provenance(scope: Subject, provenance: dict[str, str]) -> Document:
    """Returns the section that states how the page was made: all settings, and all numbers of the vehicle file that affect the
    page.
    """
    vehicle, how = scope.vehicle, scope.vehicle.implementation
    rows = dict(provenance)
    if absent := [name for name in vehicle.controller_names if name not in {one.name for one in scope.driven_controllers}]:
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


def record(report: Report) -> dict[str, Any]:
    """Returns the statements, tables and scores of a report as a JSON object."""
    page = report.page
    return {
        "title": page.title,
        "headline": page.headline,
        "lead": [f"{page.headline}."],
        "answer": [one.text for one in page.answer],
        "verdict": page.state,
        "tables": {one.name: one.records for one in page.whole.tables},
        "compared": scores_record(report.scores),
    }
