"""The command that runs a study of any type.

The command reads the vehicle, designs the controllers, runs the study, writes files and logs, and prints text or JSON. The
studies themselves are subclasses of `sim.studies.study.Study`.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from models.common.command import Parser, chosen_controllers, one_chosen, print_json, print_remarks
from models.common.extensions import STUDIES
from models.common.lazy import resolve_name
from models.common.printed import Stages, say
from sim.studies.command_name import command_of
from sim.studies.study import StudyRequest

if TYPE_CHECKING:
    from collections.abc import Callable

    from synth.controller.controller import AnyController


def main(name: str, arguments: Sequence[str] | None = None) -> int:
    """Runs the command of a study; returns its exit code.

    Raises:
        InputError: an option, the vehicle file or an output file is invalid, or the study does not support a controller.
    """
    # Options in a separate module are a base class of the study: `study:MarginsStudy` inherits `command:MarginsCommand`
    own = STUDIES[name].replace(".study:", ".command:")
    command = (STUDIES.load(name) if own == STUDIES[name] else resolve_name(f"{own.removesuffix('Study')}Command"))(name)
    parser = Parser(command_of(name), command.description, command.epilog, command.page)
    command.add_options(parser)
    options, one = parser.parse_args(arguments), STUDIES.load(name)(name)
    from models.document.outputs import check_outputs, output_paths, written_lines
    from models.vehicle.names import named_files
    from sim.command.comparison import left_out_object, log_lines, record_command_runs, warn_invalid_certificates
    from sim.command.road_options import left_out_lines, omitted_controllers

    given, request, several = None, StudyRequest(options), one.takes == "several"
    if one.takes:
        from models.vehicle.vehicle import read_vehicle

        given = print_remarks(read_vehicle(options.vehicle))
        if not several:
            linear = [each for each in given.controllers if each in given.linear_names]
            names = [one_chosen(given.controller_names, options.controller, next(iter(linear), given.linear_names[1]))]
        else:
            usual = [each for each in one.usual if each in given.controller_names]
            names = chosen_controllers(given.controller_names, options.controller, usual)
        request = replace(request, vehicle=one.vehicle(given, names), names=names)
    one.check(request)
    outputs = {key: getattr(options, key) for key in ("csv", "picture") if hasattr(options, key)}
    logs, files = {"logs": options.logs} if hasattr(options, "logs") else {}, given.files if given is not None else ()
    check_outputs(outputs | logs, [*files, *named_files(getattr(options, "loads", ()))], options.json)
    stage = Stages(*["designs" if several else "design"] * bool(one.takes), *one.stages, "picture and logs")
    if one.takes:
        stage("designs" if several else "design")
        request = replace(request, controllers=_designed_controllers(request, several))
        one.check_controllers(request)
        warn_invalid_certificates(request.controllers)
    result, driven = one.run(request, stage), [each.name for each in request.controllers]
    stage("picture and logs")
    if outputs.get("csv") is not None:
        one.write_csv(options.csv, result)
    if outputs.get("picture") is not None:
        from models.document.picture import write_picture

        write_picture(one.figure(request, result), options.picture)
    whole = {}
    if options.json or logs.get("logs") is not None:
        whole = {**one.record(request, result), **left_out_object(request.names, driven), **output_paths(outputs)}
    if logs and given is not None:
        logs = record_command_runs(options, one.recorded_vehicle(given), driven, lambda: one.runs(request, result), lambda: whole)
        whole = {**whole, "logs": logs}
    stage.end()
    if options.json:
        print_json(whole)
    else:
        lines = one.lines(request, result, [*written_lines(outputs), *log_lines([logs])])
        if given is not None:
            lines += left_out_lines(omitted_controllers(given, options.controller, request.names), one=not several)
        say(lines)
    return 0 if one.holds(result) and len(driven) == len(request.names) else 1


def _designed_controllers(request: StudyRequest, several: bool) -> "Sequence[AnyController]":
    """Returns the controllers that the user requested.

    If `several` is False, the study needs a single linear controller. If `several` is True, the controllers can be of any type.
    """
    from sim.command.comparison import controllers_of, runnable
    from synth.vehicle.designer import Designer

    designer = Designer(request.vehicle, search=False)
    if not several:
        return [designer.design(name) for name in request.names]
    design: Callable[[str], AnyController] = runnable(request.vehicle, designer.design, request.options.timestep)
    return controllers_of(request.vehicle, request.names, design, getattr(request.options, "exported", None))
