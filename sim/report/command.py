"""The pages that `python -m sim.report` writes: one for each vehicle and type of actuators, or the gallery."""

import argparse
import datetime
import re
import shlex
import sys
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import cast

from models.common.command import chosen_of, print_json, print_remarks, versions
from models.common.errors import InputError
from models.common.extensions import STUDIES
from models.common.files import made_folder, together
from models.common.printed import DETAIL_LINES, Stages, Whole, say, show, some_sentences
from models.document.document import Table
from models.document.figure import Figure
from models.document.outputs import check_outputs, output_paths, written_lines
from models.document.page import Page, check_page, write_page
from models.document.picture import check_drawing, write_picture
from models.document.reading import write_rows
from models.roads.loads.choice import choose_load
from models.roads.loads.load import Load
from models.vehicle.limits_and_implementation import steps_per_sample
from models.vehicle.names import PLUS, named_files, without_copies
from models.vehicle.vehicle import Vehicle
from sim.command.comparison import controllers_of, runnable, warn_invalid_certificates
from sim.command.driving import read_vehicles
from sim.command.road_options import left_out_lines, omitted_controllers, requested_road, road_text
from sim.report.gallery import gallery_page
from sim.report.one_page import one_page
from sim.report.page import Report, record, report, stages
from sim.report.processes import Processes, processes
from sim.runs.run import sample_times
from sim.studies.frequency.identification import check
from sim.studies.gallery.entries import names as gallery_names
from sim.studies.ride.score_table import score_lines
from sim.studies.ride.scores import scores_record
from sim.studies.study import StudyRequest
from sim.studies.subject import AMPLITUDE, BUMP_DURATION, Subject, file_stem
from synth.controller.controller import Controller
from synth.vehicle.designer import Designer

ROAD = ("road", "class", "seed", "speed", "duration")  # options that describe a road


def write_reports(options: argparse.Namespace, child_processes: bool) -> int:
    """Writes the pages of all vehicles; returns the exit code.

    Args:
        options: values of the command-line options.
        child_processes: True if child processes are allowed to compute parts of a page.

    Raises:
        InputError: an option, a vehicle file or an output file is invalid.
    """
    check_page()
    if options.one_page and (given := [name for name in ("quick", "front", "exported") if vars(options)[name]]):
        raise InputError(f"--one-page and --{given[0].replace('exported', 'as')} cannot be combined; omit one of them")
    subjects = _subjects(options)
    if len(subjects) > 1 and options.exported is not None:
        raise InputError("--as works with one vehicle, but several vehicles are given; give only one --vehicle")
    outputs = _outputs(options, subjects)
    for title, (vehicle, _) in subjects.items():
        check_outputs(outputs[title], [*vehicle.files, *named_files((options.road, *options.loads))], options.json)
    if options.figures is not None:
        check_drawing()
    loads, results, undesigned = tuple(choose_load(text) for text in options.loads), {}, []
    for title, (vehicle, names) in subjects.items():
        with Processes(processes(options.quick) if child_processes else 0) as pool:
            results[title] = _write_report(options, vehicle, names, loads, pool, outputs[title])
        undesigned += sorted({*names} - {one.controller for one in results[title].scores})
    if len(subjects) > 1:
        return _several(options, outputs, results, undesigned)
    ((vehicle, names),), (result,), (outputs,) = subjects.values(), results.values(), outputs.values()
    others, page = omitted_controllers(vehicle, options.controller, names), result.page
    older = _others(page, options.figures) if options.figures is not None else []
    if options.json:
        whole = {**record(result), **output_paths(outputs), "not_of_this_report": older, "left_out": [*others, *undesigned]}
        print_json(whole)
    else:
        left = ["other files in figures, left unchanged", *(Whole(f"  {name}") for name in older)] if older else []
        lines = [*written_lines(outputs)[1:], *left, *left_out_lines(others)]
        lines += ["", *score_lines(result.scores, result.compared_on)]
        if not options.brief:
            if options.verbose:
                every = list(dict.fromkeys([*page.warnings, *(one.text for one in page.answer)]))
                said = some_sentences(every, [*lines, "", "", page.verdict], DETAIL_LINES, "the page contains")
            else:
                said = some_sentences(page.warnings, [*lines, "", page.verdict])
            lines += ["", *said, *([""] if said else []), page.verdict]
        say(lines)
    return 1 if undesigned else 0


def _subjects(options: argparse.Namespace) -> dict[str, tuple[Vehicle, list[str]]]:
    """Returns the vehicle and the controllers of each page; the keys are the titles of the pages.

    If a vehicle has both semi-active dampers and controllers that need force actuators, these controllers get a separate page.
    """
    vehicles = read_vehicles(options)
    known = {title: vehicle.controller_names for title, vehicle in vehicles.items()}
    usual = without_copies(dict.fromkeys(name for names in known.values() for name in names))
    subjects = {}
    for title, names in chosen_of(known, options.controller, usual).items():
        vehicle = vehicles[title]
        pushing = [name for name in names if vehicle.with_actuators_of(name) is not vehicle]
        others = [name for name in names if name not in pushing]
        if pushing and any(name in vehicle.controllers for name in others):
            subjects[title or Path(vehicle.source).stem] = (vehicle, others)
            subjects[f"{title or Path(vehicle.source).stem}-force"] = (vehicle.with_force_actuators, pushing)
        else:
            subjects[title] = (vehicle.with_common_actuators(names), names)
    return subjects


def _outputs(options: argparse.Namespace, subjects: Mapping[str, tuple[Vehicle, list[str]]]) -> dict[str, dict[str, Path | None]]:
    """Returns the path of each vehicle's page and the folder for its figures; the keys are the titles of the vehicles."""
    if len(subjects) == 1:
        ((title, (vehicle, _)),) = subjects.items()
        return {title: {"report": options.out or Path(f"report-{file_stem(vehicle)}.html"), "figures": options.figures}}
    page, folder = options.out or Path("report.html"), options.figures
    return {
        title: {"report": page.with_name(f"{page.stem}-{name}{page.suffix}"), "figures": folder and folder / name}
        for title, name in ((title, re.sub(r"[^\w-]+", "_", title)) for title in subjects)
    }


def _several(
    options: argparse.Namespace,
    outputs: Mapping[str, Mapping[str, Path | None]],
    results: Mapping[str, Report],
    undesigned: Sequence[str],
) -> int:
    """Prints the names of the written files, and one table with the controllers of several vehicles; returns the exit code."""
    compared = [replace(one, vehicle=title) for title, result in results.items() for one in result.scores]
    if options.json:
        whole = {title: {**record(result), **output_paths(outputs[title])} for title, result in results.items()}
        left = {"left_out": list(undesigned)}
        print_json({"reports": whole, "compared": scores_record(compared), **left})
    else:
        lines = [line for each in outputs.values() for line in written_lines({"report": each["report"]})[2:]]
        say(["reports", *lines, "", *score_lines(compared, next(iter(results.values())).compared_on)])
    return 1 if undesigned else 0


def _write_report(
    options: argparse.Namespace,
    vehicle: Vehicle,
    names: Sequence[str],
    loads: tuple[Load, ...],
    pool: Processes,
    outputs: Mapping[str, Path | None],
) -> Report:
    """Writes the page of a vehicle, and its figures if the user requests them; returns the report."""
    check(vehicle, (), AMPLITUDE, options.timestep)
    steps_per_sample(vehicle.implementation, options.timestep)
    road, name, duration = None, "", BUMP_DURATION
    if options.road is not None or options.road_class is not None or options.one_page:
        duration = options.duration
        road = print_remarks(requested_road(vehicle, options, sample_times(vehicle, duration, options.timestep)))
        name = PLUS.join([road_text(options), *options.loads]) + (f" at {road.speed:g} m/s" if road.laid else "")
        name += f", seed {options.seed}" if "seed" in options.given else ""
    elif given := [name for name in ("speed", "seed", "duration", "from") if name in options.given]:
        raise InputError(f"--{given[0]} needs a road; give --road or --class, or omit --{given[0]}")
    designer, own = Designer(vehicle), {"own_road": road, "road_name": name, "duration": duration}
    scope = Subject(vehicle, designer, (), options.timestep, options.quick, (), options.front, loads, **own)
    for study, of_class in STUDIES.load_all().items():
        of_class(study).check_page(scope)

    show("designs")
    controllers, exported = controllers_of(vehicle, names, runnable(vehicle, designer.design, options.timestep)), None
    if options.exported is not None:
        known = {one.name: one for one in controllers}
        coded = controllers_of(vehicle, list(known), lambda name: cast("Controller", known[name]), options.exported)
        exported = next(one for one in coded if one.code is not None)
    warn_invalid_certificates(controllers)
    linear = tuple(one for one in controllers if one.linear is True)
    laws = tuple(one for one in controllers if one.linear is False)
    scope = replace(scope, controllers=linear, laws=laws, exported_controller=exported)
    stage = Stages(*([] if options.one_page else stages(scope)), "the page")
    result = one_page(scope) if options.one_page else report(scope, _about(vehicle.source), pool.begin, stage)
    stage("the page")
    _write(result.page, outputs)
    stage.end()
    return result


# Options that are not allowed with the page of the gallery
OF_A_VEHICLE = ("controller", "vehicle", "one_page", "quick", "front", "load", "as", "timestep", *ROAD)


def write_gallery(options: argparse.Namespace) -> int:
    """Writes the page of the gallery; returns the exit code."""
    check_page()
    repeated = {
        name
        for name, of in (("controller", "controller"), ("load", "loads"), ("as", "exported"), ("class", "road_class"))
        if getattr(options, of)
    } | {"vehicle" for _ in options.given & {"vehicles"}}
    if given := [name for name in OF_A_VEHICLE if name in options.given | repeated]:
        raise InputError(f"--{given[0].replace('_', '-')} and --gallery cannot be combined; omit one of them")
    outputs = {"report": options.out or Path("report-gallery.html"), "figures": options.figures}
    check_outputs(outputs, (), options.json)
    if options.figures is not None:
        check_drawing()
    stage, gallery = Stages(*gallery_names(), "the page"), STUDIES.load("gallery")("gallery")
    request = StudyRequest(argparse.Namespace(name=[]))
    results = gallery.run(request, stage)
    stage("the page")
    page = gallery_page(results, _about("models/gallery"))
    _write(page, outputs)
    stage.end()
    if options.json:
        print_json({**gallery.record(request, results), **output_paths(outputs)})
    else:
        say([*written_lines(outputs)[1:], "", page.headline, *(one.text for one in page.summary.statements)])
    return 1 if page.state == "fails" else 0


def _about(source: str) -> dict[str, str]:
    """Returns texts that state how a page was made, by title of the text: time, command, vehicle file and package versions."""
    return {
        "written": datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "command": shlex.join(["python", *sys.orig_argv[1:]]),
        "vehicle file": source,
        "versions": ", ".join(f"{name} {version}" for name, version in versions().items()),
    }


def _write(page: Page, outputs: Mapping[str, Path | None]) -> None:
    """Writes a page, and its figures if the user requests them. If an error occurs, no file is written."""
    out, figures = outputs["report"], outputs["figures"]
    assert out is not None, "every page has a file"
    with ExitStack() as stack:
        if figures is not None:
            stack.enter_context(made_folder(figures, "figures"))
        stack.enter_context(together())
        write_page(page, out)
        if figures is None:
            return
        for one, names in _files(page):
            if isinstance(one, Figure):
                write_picture(one, *(figures / name for name in names))
            else:
                write_rows(figures / names[0], [one.headings, *one.rows])


def _files(page: Page) -> list[tuple[Figure | Table, tuple[str, ...]]]:
    """Returns the figures and tables of a page, by the names of the files for them."""
    figures = [(one, (f"{one.name}.svg", f"{one.name}.png")) for one in page.whole.figures]
    return [*figures, *((one, (f"{one.name}.csv",)) for one in page.whole.tables)]


def _others(page: Page, folder: Path) -> list[str]:
    """Returns the names of figures and tables in the folder that do not belong to the page. The command does not delete the
    figures and tables of other pages.
    """
    own = {name for _, names in _files(page) for name in names}
    there = {path.name for path in folder.iterdir() if path.suffix.lower() in (".csv", ".svg", ".png")}
    return sorted(name for name in there - own if not name.startswith("."))
