"""`python -m sim.report`: writes one HTML page about a vehicle file and its controllers."""

if __name__ == "__main__":
    from models.common.cli import run

    run("sim.report.__main__")

import argparse
import datetime
import re
import shlex
import sys
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, cast

from models.common.command import Parser, chosen_of, print_json, print_remarks
from models.common.errors import InputError
from models.common.printed import DETAIL_LINES, Stages, Whole, say, show, some_sentences
from models.vehicle.names import LOAD_SYNTAX, PLUS, without_copies
from sim.command.road_options import (
    add_road,
    left_out_lines,
    omitted_controllers,
    requested_road,
    road_text,
)

if TYPE_CHECKING:
    from models.document.document import Table
    from models.document.figure import Figure
    from models.document.page import Page
    from models.roads.loads.load import Load
    from models.vehicle.vehicle import Vehicle
    from sim.report.page import Report
    from sim.report.processes import Processes


EPILOG = """
exit code: 0 the report is written; 1 it omits a controller that cannot be designed, or a number of --gallery is not reproduced;
2 invalid input

examples:
  roadproof report --out report.html
  roadproof report --vehicle my_car.toml --controller passive --controller mine --out mine.html --figures figures
  roadproof report --quick --out quick.html
  roadproof report --vehicle my_car.toml --road my_road.csv --speed 15 --duration 30
  roadproof report --quick --vehicle my_car.toml --vehicle van.toml
  roadproof report --vehicle full_car --load brake:g=0.5 --load corner:g=0.3 --out full_car.html
  roadproof report --gallery --out gallery.html
  roadproof report --one-page --vehicle my_car.toml --class C --speed 90km/h --out mail.html
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code.

    Raises:
        InputError: an option, a vehicle file or an output file is invalid.
    """
    options = _parser().parse_args(arguments)
    from models.document.outputs import check_outputs, output_paths, written_lines
    from models.document.page import check_page
    from models.document.picture import check_drawing
    from models.roads.loads.choice import choose_load
    from models.vehicle.names import named_files
    from sim.report.page import record
    from sim.report.processes import Processes, processes
    from sim.studies.ride.score_table import score_lines

    check_page()
    if options.gallery:
        return _gallery(options)
    if options.one_page and (given := [name for name in ("quick", "front", "exported") if vars(options)[name]]):
        raise InputError(f"--one-page and --{given[0].replace('exported', 'as')} cannot be combined; omit one of them")
    subjects = _subjects(options)
    if len(subjects) > 1 and options.exported is not None:
        raise InputError("--as works with one vehicle, but several are given; give one --vehicle")
    outputs = _outputs(options, subjects)
    for title, (vehicle, _) in subjects.items():
        check_outputs(outputs[title], [*vehicle.files, *named_files((options.road, *options.loads))], options.json)
    if options.figures is not None:
        check_drawing()
    loads, results, undesigned = tuple(choose_load(text) for text in options.loads), {}, []
    for title, (vehicle, names) in subjects.items():
        # If Python code calls `main`, it starts no child processes
        with Processes(processes(options.quick) if arguments is None else 0) as pool:
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
        lines = [
            *written_lines(outputs)[1:],
            *left,
            *left_out_lines(others),
            "",
            *score_lines(result.scores, result.compared_on),
        ]
        if not options.brief:
            others = [*lines, "", "", page.verdict]
            said = (
                some_sentences(
                    list(dict.fromkeys([*page.warnings, *(one.text for one in page.answer)])),
                    others,
                    DETAIL_LINES,
                    "the page contains",
                )
                if options.verbose
                else some_sentences(page.warnings, others[1:])
            )
            lines += ["", *said, *([""] if said else []), page.verdict]
        say(lines)
    return 1 if undesigned else 0


def _subjects(options: argparse.Namespace) -> "dict[str, tuple[Vehicle, list[str]]]":
    """Returns the vehicle and the controllers of each page, by title.

    If a vehicle has both semi-active dampers and controllers that need force actuators, these controllers get a separate page.
    """
    from sim.command.driving import read_vehicles

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


def _outputs(
    options: argparse.Namespace, subjects: "Mapping[str, tuple[Vehicle, list[str]]]"
) -> "dict[str, dict[str, Path | None]]":
    """Returns the path of the page and the folder for the figures of each vehicle, by title."""
    from sim.studies.subject import file_stem

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
    outputs: "Mapping[str, Mapping[str, Path | None]]",
    results: "Mapping[str, Report]",
    undesigned: Sequence[str],
) -> int:
    """Prints the written files and one table with the controllers of several vehicles; returns the exit code."""
    from models.document.outputs import output_paths, written_lines
    from sim.report.page import record
    from sim.studies.ride.score_table import score_lines
    from sim.studies.ride.scores import scores_record

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
    vehicle: "Vehicle",
    names: Sequence[str],
    loads: "tuple[Load, ...]",
    pool: "Processes",
    outputs: "Mapping[str, Path | None]",
) -> "Report":
    """Writes the page of a vehicle, and its figures if they are requested; returns the report."""
    from models.common.extensions import STUDIES
    from models.vehicle.limits_and_implementation import steps_per_sample
    from sim.command.comparison import controllers_of, runnable, warn_invalid_certificates
    from sim.report.page import report, stages
    from sim.runs.run import sample_times
    from sim.studies.frequency.identification import check
    from sim.studies.subject import AMPLITUDE, BUMP_DURATION, Subject
    from synth.controller.controller import Controller
    from synth.vehicle.designer import Designer

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
    if options.one_page:
        from sim.report.one_page import one_page

        result = one_page(scope)
    else:
        result = report(scope, _about(vehicle.source), pool.begin, stage)
    stage("the page")
    _write(result.page, outputs)
    stage.end()
    return result


OF_A_VEHICLE = (
    *(
        "controller",
        "vehicle",
        "one_page",
        "quick",
        "front",
        "load",
        "as",
        "timestep",
        "road",
        "class",
        "seed",
        "speed",
        "duration",
    ),
)  # the page of the gallery does not have these options


def _gallery(options: argparse.Namespace) -> int:
    """Writes the page of the gallery; returns the exit code."""
    from models.common.extensions import STUDIES
    from models.document.outputs import check_outputs, output_paths, written_lines
    from models.document.picture import check_drawing
    from sim.report.gallery import gallery_page
    from sim.studies.gallery.entries import names
    from sim.studies.study import StudyRequest

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
    stage, gallery = Stages(*names(), "the page"), STUDIES.load("gallery")("gallery")
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
    """Returns how a page was made, as texts by name: time, command, vehicle file and versions of packages."""
    from models.common.command import versions

    return {
        "written": datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "command": shlex.join(["python", *sys.orig_argv[1:]]),
        "vehicle file": source,
        "versions": ", ".join(f"{name} {version}" for name, version in versions().items()),
    }


def _write(page: "Page", outputs: "Mapping[str, Path | None]") -> None:
    """Writes a page, and its figures if they are requested. If an error occurs, no file is written."""
    from models.common.files import made_folder, together
    from models.document.figure import Figure
    from models.document.page import write_page
    from models.document.picture import write_picture
    from models.document.reading import write_rows

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


def _parser() -> Parser:
    parser = Parser("sim.report", "Write one HTML page about a vehicle file and its controllers.", EPILOG)
    parser.add_controller_and_vehicle("default: all but published copies, such as I_printed", "a page for each and one table")
    parser.add_argument("--gallery", action="store_true", help="write the page of published results instead")
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="file of the page (default: report-VEHICLE.html, report-gallery.html)"
    )
    parser.add_argument(
        "--figures", type=Path, metavar="DIR", help="also write figures (SVG, PNG) and tables (CSV) to this folder"
    )
    parser.add_argument(
        "--one-page", action="store_true", help="write only the comparison over the road (default: class C) on one page of A4"
    )
    parser.add_argument("--quick", action="store_true", help="omit margins, map and ride; takes a few seconds instead of 20 s")
    parser.add_argument(
        "--front",
        metavar="AXES",
        help="add a trade-off between two or three objectives, such as ride:travel, as in `roadproof synth --front`, with "
        "MuJoCo runs of some designs; takes half a minute more",
    )
    parser.add_exported(
        "describe the exported code in this folder, which roadproof synth --export wrote, and its effect on the run"
    )
    add_road(parser, "none")
    parser.add_number("--duration", 20.0, "s", "duration of the run over the road")
    parser.add_loads("add a load on a flat road; with --road or --class it acts there, too", LOAD_SYNTAX)
    parser.add_number("--timestep", 1e-3, "s", "integration step and sample period of the controller")
    printed = parser.add_mutually_exclusive_group()
    printed.add_argument("-v", "--verbose", action="store_true", help="also print every statement of the page")
    printed.add_argument("--brief", action="store_true", help="print only the written files and the comparison of controllers")
    printed.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    return parser


def _files(page: "Page") -> "list[tuple[Figure | Table, tuple[str, ...]]]":
    """Returns the figures and tables of a page with the names of their files."""
    figures = [(one, (f"{one.name}.svg", f"{one.name}.png")) for one in page.whole.figures]
    return [*figures, *((one, (f"{one.name}.csv",)) for one in page.whole.tables)]


def _others(page: "Page", folder: Path) -> list[str]:
    """Returns the names of figures and tables in the folder that do not belong to this page. The command keeps these files."""
    own = {name for _, names in _files(page) for name in names}
    there = {path.name for path in folder.iterdir() if path.suffix.lower() in (".csv", ".svg", ".png")}
    return sorted(name for name in there - own if not name.startswith("."))
