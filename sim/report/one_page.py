"""The short report for printing or e-mail: a comparison of controllers over one road, with a table, verdicts and a figure."""

from models.common.printed import brief
from models.document.document import Document, Statement
from models.document.page import Page
from sim.report.page import Report
from sim.report.summary import compared_on, first_screen
from sim.runs.report import verdicts
from sim.runs.run import passive_beside
from sim.studies.ride.run_metrics import measured_words
from sim.studies.ride.score_table import headline, some_names
from sim.studies.ride.scores import scores_of_runs
from sim.studies.subject import Subject, file_stem
from synth.controller.law_margins import law_margins, warnings

HOUR = 3.6  # km/h per m/s


def one_page(scope: Subject) -> Report:
    """Returns the report about one road, which fits on one A4 page.

    Args:
        scope: subject of the report, which must have a road (`own_road`).
    """
    runs = scope.runs
    compared = scores_of_runs(runs, passive_beside(runs, scope.designer.design), scope.samples, scope.run_metrics)
    where = compared_on(scope, compared, False, measured_words(scope.time, scope.samples))
    screen = first_screen(scope, runs, compared, {}, where)
    names, speed = some_names([one.name for one in scope.driven_controllers]), scope.road.speed
    title = f"{file_stem(scope.vehicle)}, {scope.road.words} ({brief(HOUR * speed)} km/h): {names}"
    small = warnings({one.name: law_margins(scope.vehicle, one) for one in scope.driven_controllers})
    summary = Document("", (*verdicts(runs), *(Statement(f"{text}.", detail="brief") for text in small), *screen.blocks))
    return Report(Page(title, summary, (), headline(compared)), compared, where)
