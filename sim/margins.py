"""`python -m sim.margins`: how much gain, phase, delay and sample period a loop bears, predicted and found in MuJoCo."""

if __name__ == "__main__":
    from models.common.cli import run

    run("sim.margins")

import functools
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from models.common.command import Parser, one_chosen, print_json, remarked
from models.common.errors import InputError
from models.common.printed import Stages, say, titled
from sim.studies.stability import TIMESTEP

if TYPE_CHECKING:
    from models.vehicle.vehicle import Vehicle
    from sim.runs.run import Run
    from sim.studies.stability.margin_search import LoopMargins
    from synth.controller.controller import Controller


RECORDED = 4.0  # s, of a recorded run

EPILOG = """
exit code: 0 prediction and MuJoCo agree; 1 they disagree, or the controller cannot be designed; 2 invalid input

examples:
  python -m sim.margins --controller II
  python -m sim.margins --controller I --picture margins.png --logs logs
  python -m sim.margins --controller I --vehicle half_car --json
"""


def parser() -> Parser:
    """The options."""
    parser = Parser(
        "sim.margins",
        "Find the margins of a control loop for gain, phase, delay and sample period.",
        EPILOG,
    )
    parser.add_one("state, or a controller of the vehicle file")
    parser.add_number("--timestep", TIMESTEP, "s", "integration step; delays and sample periods are multiples of it")
    parser.add_gone("--vary", "give the controller these vehicles as a family, whose norms synth proves, or run a campaign")
    parser.add_logs("MuJoCo runs on both sides of the delay margin")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="draw the margins (.png, .svg or .pdf); needs matplotlib")
    parser.add_printed("each loop")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code.

    Raises:
        InputError: bad options or vehicle file, or a controller that has no loop to speak of.
    """
    options = parser().parse_args(arguments)
    from models.document.outputs import check_outputs, written, written_lines
    from models.document.text import text_lines
    from models.vehicle.limits_and_implementation import Implementation
    from models.vehicle.vehicle import read_vehicle
    from sim.command.comparison import log_lines, recorded, warn_invalid_certificates
    from sim.linear.nonlinear_elements import at_rest
    from sim.runs.run import sample_times
    from sim.studies.stability.margin_search import LONGEST
    from sim.studies.stability.report import describe, margins_object
    from sim.studies.stability.study import stability_margins
    from synth.vehicle.designer import Designer

    given = remarked(read_vehicle(options.vehicle))
    name = one_chosen(given.controller_names, options.controller)
    as_built = given.with_actuators_of(name)
    vehicle = replace(at_rest(as_built), implementation=Implementation())
    outputs = {"picture": options.picture}
    check_outputs(outputs | {"logs": options.logs}, vehicle.files)
    stage = Stages("design", "margins", "picture and logs")
    stage("design")
    sample_times(vehicle, LONGEST, options.timestep)
    controller = Designer(as_built, search=False).design(name)
    with_computer = replace(vehicle, implementation=as_built.implementation)
    _check_loop(vehicle, with_computer, controller, options.timestep)
    warn_invalid_certificates([controller])
    (found,) = stability_margins(as_built, [controller], options.timestep, stage)
    stage("picture and logs")
    if options.picture is not None:
        from models.document.picture import write_picture
        from sim.studies.stability.figure import margins_figure

        write_picture(margins_figure(found), options.picture)
    result = margins_object(found) if options.json or options.logs is not None else {}
    undelayed = replace(as_built, implementation=Implementation())
    delayed = functools.partial(_delayed_runs, undelayed, controller, found.loops[""], options.timestep)
    of_file = replace(given, implementation=Implementation())
    logs = recorded(options, of_file, [controller.name], delayed, lambda: result)
    stage.end()
    if options.json:
        print_json({**result, **written(outputs), "logs": logs})
    else:
        lines = titled(f"{vehicle.kind.name} with controller {controller.name}; MuJoCo at {options.timestep:g} s", vehicle.source)
        lines += [*written_lines(outputs), *log_lines([logs]), ""]
        say([*lines, *text_lines(describe(found), "full" if options.verbose else "normal")])
    return 0 if found.agrees else 1


def _check_loop(vehicle: "Vehicle", built: "Vehicle", controller: "Controller", timestep: float) -> None:
    """Checks that a loop has margins: the ideal one, and the one as implemented.

    Raises:
        InputError: a loop is unstable, or the controller has no gain.
    """
    from sim.linear.sampled_response import taylor4
    from synth.controller.loop_of import loop_of, radius
    from synth.controller.report import sign_note

    name, certificate = f"controller {controller.name!r}", controller.certificate
    if not controller.law.acts:
        raise InputError(f"{name} requests no force, so there is no loop and no margin; choose another controller")
    if not certificate.stable:
        why = f"its ideal loop is not stable ({certificate.stability.words})"
        raise InputError(f"{name} has no margin, because {why}; choose a stable controller{sign_note(controller)}")
    times = loop_of(vehicle, controller).direct_radius
    if times >= 1:
        raise InputError(
            f"{name} tolerates neither delay nor sampling: its measurements immediately contain {times:.4g} times its own force, "
            "which grows from sample to sample; lower the gain on accelerations, or filter the accelerations"
        )
    growth = radius(loop_of(vehicle, controller, timestep, taylor4))
    if growth >= 1:
        raise InputError(
            f"{name} is not stable at a timestep of {timestep:g} s or with the lag of the actuators (motion grows by a factor of "
            f"{growth:.6g} every step); give a smaller timestep or a larger actuator_bandwidth"
        )
    if radius(loop_of(built, controller, timestep, taylor4)) >= 1:
        why = f"its implemented loop is not stable ({', '.join(built.implementation.without_noise.phrases)})"
        raise InputError(f"{name} has no margin, because {why}; give a shorter sample_period or delay")


def _delayed_runs(vehicle: "Vehicle", controller: "Controller", loop: "LoopMargins", timestep: float) -> "dict[str, Run]":
    """The run that still decays and the one that grows, to be recorded; without a delay margin, the longest delay tried."""
    from models.vehicle.limits_and_implementation import Implementation
    from sim.runs.run import run_controllers, sample_times
    from sim.studies.stability.margin_search import BUMP

    delays = [loop.delay.stable, loop.delay.unstable] if math.isfinite(loop.delay.unstable) else [loop.delay.stable]
    time, runs = sample_times(vehicle, RECORDED, timestep), {}
    for samples in (round(delay / timestep) for delay in delays):
        delayed = replace(vehicle, implementation=Implementation(delay=samples))
        (runs[f"{controller.name}_{samples}_samples_late"],) = run_controllers(delayed, [controller], BUMP, time)
    return runs
