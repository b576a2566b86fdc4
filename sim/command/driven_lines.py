"""Printed text of the commands that simulate a drive: `sim.bump` and `sim.drive`. With `--json`, the module for printed text is
not loaded.
"""

from argparse import Namespace
from collections.abc import Sequence
from dataclasses import replace
from itertools import zip_longest
from typing import TYPE_CHECKING

from models.common.extensions import FEATURES
from models.common.printed import DETAIL_LINES, FEW, GAP, fit_lines, title_lines, wrap_text
from models.document.document import Document, Statement, notes, statements
from models.document.text import table_lines, text_lines
from sim.command.driven import VehicleRuns
from sim.command.road_options import end_lines, starts_later
from sim.runs.report import checks_table, describe_run, sentences, share_statements, verdicts
from sim.runs.run import Run
from sim.studies.ride.score_table import score_lines
from synth.controller.law_margins import direct_feedback, law_margins, warnings
from synth.controller.report import study_notes

if TYPE_CHECKING:
    from sim.studies.ride.scores import Score


def driven_lines(
    options: Namespace,
    driven: Sequence[VehicleRuns],
    where: str,
    scores: "Sequence[Score]",
    about: str,
    response: Document,
    below: Sequence[str],
) -> list[str]:
    """Returns the printed lines of a command: title, findings, table of controllers, further lines, and verdicts.

    With `-v`, the table of controllers comes first. For a single run, all details follow the table; for several runs, one table
    of norms and checks follows.

    Args:
        options: options from the command's parser.
        driven: runs of each vehicle.
        where: text that describes the road.
        scores: scores of the controllers, one for each row of the table of controllers.
        about: text that states in which part of the run the ride is measured.
        response: description of the step response, as in the result of the command; empty if the road is not a step.
        below: lines to print between the table of controllers and the verdicts, such as paths of files.
    """
    shown, metrics = [run for each in driven for run in each.named_runs], [one for each in driven for one in each.metrics]
    road, verbose = shown[0].road, options.verbose
    kinds = " and ".join(dict.fromkeys(each.vehicle.kind.name for each in driven))
    sources = ", ".join(options.vehicles) if driven[0].title else driven[0].vehicle.source
    on = f"a road: {where}" if metrics else where
    lines = title_lines(f"{kinds} over {on}; {options.duration:g} s, step {1e3 * options.timestep:g} ms", sources)
    if metrics:
        lines += end_lines(road, options.duration)
    details, ride, found, below_table = _start_lines(options, driven), None, list[str](), list[dict[str, str]]()
    if metrics and not options.brief:
        ride = FEATURES.load("ride of a run")
        found = text_lines(ride.summary(shown, metrics))
    alone = verbose and len(shown) == 1
    if alone:
        for each in driven:
            for run, plain, own in zip_longest(each.named_runs, each.runs, each.metrics):
                one = describe_run(run, None if run.physics is each.passive else each.passive)
                blocks = one.blocks[1:]  # the first block is the verdict, which the command prints at its end
                if ride is not None:
                    blocks = (*blocks, *notes(*ride.basis(run, own)))
                    below_table += [{"vehicle": each.title} | cells for cells in ride.expected_cells(plain, own)]
                details += ["", *text_lines(replace(one, blocks=blocks), "full")]
    elif not options.brief:
        details += _finding_lines(shown, verbose)
        if ride is not None:
            left = [(run.controller.name, Statement(line)) for run in shown for line in ride.broken_off_sentence(run)]
            details += text_lines(Document("", share_statements(left)))
    lines += [] if verbose else [*details, *([""] if found else []), *found]
    if response.blocks and not options.brief:
        lines += ["", *text_lines(response, "full" if alone else "normal")]
    more = "; -v prints more" if len(shown) > FEW and not (verbose or options.brief) else ""
    lines += ["", *score_lines(scores, f"MuJoCo, {about}{more}", below_table)]
    end = [*below, "", *text_lines(Document("", verdicts(shown)))]
    if verbose:
        if ride is not None:
            rough = dict.fromkeys(ride.roughness_sentence(each.runs[0]) for each in driven)
            angles = ride.summary(shown, metrics).tables
            lines += [*text_lines(Document("", notes(*filter(None, rough)))), *text_lines(Document("", angles))]
        lines += details
        lines += [] if alone else _check_lines(shown, [*lines, *end])
    return [*lines, *end]


def _check_lines(runs: Sequence[Run], others: Sequence[str]) -> list[str]:
    """Returns the printed table of norms and checks, with as many runs as fit into `DETAIL_LINES` lines, and a line that lists
    omitted details.

    Args:
        runs: all runs that the table may show.
        others: lines that are printed together with the table.
    """
    lines = list[str]()
    for count in range(len(runs), 0, -1):
        rest = f", {len(runs) - count} controllers" if count < len(runs) else ""
        one = checks_table(runs[:count])
        more = f"shown only with --controller NAME -v, or --json: gains, every signal{rest}"
        lines = ["", *table_lines(one), *wrap_text(one.caption, GAP, len(GAP)), *fit_lines([more])]
        if len(fit_lines(others)) + len(lines) <= DETAIL_LINES:
            break
    return lines


def _start_lines(options: Namespace, driven: Sequence[VehicleRuns]) -> list[str]:
    """Returns the printed lines that describe how the runs start; empty if the ride is not measured."""
    lines = list[str]()
    for each in driven:
        if each.metrics:
            start_lines = FEATURES.load("start of a run").start_lines
            lines += start_lines(each.named_runs[: len(each.implemented_runs)], starts_later(options))
    return lines


def _finding_lines(runs: Sequence[Run], verbose: bool) -> list[str]:
    """Returns the lines about the runs that are printed above the table of controllers.

    For at most `FEW` runs, the lines contain all findings and warnings. For more than `FEW` runs, the lines contain only
    warnings and the reasons why a run fails or diverges.
    """
    few = len(runs) <= FEW
    said = [(run.controller.name, one) for run in runs for one in sentences(run, full=False) if one.detail == "normal"]
    lines = text_lines(Document("", share_statements(each for each in said if few or each[1].state == "fails")))
    if not few:
        margins = {run.controller.name: law_margins(run.vehicle, run.controller) for run in runs}
        studied = [(run.controller.name, text) for run in runs for text in study_notes(run.vehicle, run.controller)[:1]]
        lines = [*text_lines(Document("", (*notes(*direct_feedback(margins), *warnings(margins)), *statements(studied)))), *lines]
    more = ["-v adds gains, every signal and the checks behind the verdict"] if few and not verbose else []
    return ["", *lines, *more] if lines else []
