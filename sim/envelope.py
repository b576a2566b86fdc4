"""`python -m sim.envelope`: the map of validity, over one or two of a bump's height, length and the speed."""

if __name__ == "__main__":
    from models.common.cli import run

    run("sim.envelope")

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from models import USUAL_TIMESTEP
from models.common.command import Parser, one_chosen, print_json, remarked
from models.common.errors import InputError
from models.common.printed import Stages, say, titled
from models.vehicle.names import BUMP_HEIGHT, BUMP_LENGTH, BUMP_SPEED, PLUS, named_files
from sim.command.road_options import add_loads

if TYPE_CHECKING:
    from models.common.arrays import Array
    from models.roads.load import Load
    from models.roads.road import Bump
    from models.vehicle.vehicle import Vehicle
    from sim.runs.run import Run
    from sim.studies.validity.regime_map import Cells
    from synth.controller.controller import Controller


EPILOG = """
exit code: 0 MuJoCo first reaches the limit that linear analysis predicts; 1 it first reaches another limit, or the controller
cannot be designed; 2 invalid input; 130 interrupted

examples:
  python -m sim.envelope --controller I --vary height:0.02:0.3:20 --vary speed:3:30:20 --picture envelope.png
  python -m sim.envelope --controller I --vary height:0.02:0.6:30 --speed 12.5
  python -m sim.envelope --controller II --vary length:1:10:30 --vary speed:4:30:30 --height 0.08 --csv envelope.csv
"""


def parser() -> Parser:
    """The options."""
    parser = Parser("sim.envelope", "Map the bumps over which linear analysis is valid, and the limits that end it.", EPILOG)
    parser.add_one("passive, state, or a controller of the vehicle file")
    parser.add_argument(
        "--vary",
        action="append",
        metavar="NAME:LOW:HIGH:COUNT",
        help="axis of the map: height [m], length [m] or speed [m/s], for example height:0.02:0.3:20; give one or two axes",
    )
    parser.add_number("--height", BUMP_HEIGHT, "m", "bump height, if not varied")
    parser.add_number("--length", BUMP_LENGTH, "m", "bump length, if not varied")
    parser.add_number("--speed", BUMP_SPEED, "m/s", "speed of the vehicle, if not varied")
    add_loads(parser, "load on the body over every bump")
    parser.add_number("--threshold", 0.05, "-", "linear analysis is valid up to this error, relative to the peak")
    parser.add_number("--duration", 3.0, "s", "duration of each run")
    parser.add_number("--timestep", USUAL_TIMESTEP, "s", "integration step and sample period of the controller")
    parser.add_argument("--every-cell", action="store_true", help="simulate every cell of the map; takes ten times as long")
    parser.add_logs("the runs closest to each limit")
    parser.add_argument("--csv", type=Path, metavar="FILE", help="write the numbers of every cell (.csv)")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="draw the map (.png, .svg or .pdf); needs matplotlib")
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code.

    Raises:
        InputError: bad options, vehicle file or output file.
    """
    options = parser().parse_args(arguments)
    from models.document.outputs import check_outputs, written, written_lines
    from models.document.text import text_lines
    from models.roads.load_choice import choose_load
    from models.vehicle.vehicle import read_vehicle
    from sim.command.comparison import log_lines, recorded, warn_invalid_certificates
    from sim.runs.run import sample_times
    from sim.studies.validity.grid import UNITS, grid, read_axes
    from sim.studies.validity.map_runs import loaded
    from sim.studies.validity.regime_map import validity
    from sim.studies.validity.report import describe, envelope_object, write_csv
    from synth.vehicle.designer import Designer

    given = remarked(read_vehicle(options.vehicle))
    name = one_chosen(given.controller_names, options.controller)
    vehicle = given.with_actuators_of(name).starting()  # the map is of bumps that meet a vehicle at rest
    axes = read_axes(options.vary or [])
    for axis in axes:
        if axis.name in options.given:
            raise InputError(f"--{axis.name} and --vary {axis.name} set the same quantity; omit one of these options")
    bumps = grid(axes, {name: getattr(options, name) for name in UNITS})
    remarked(bumps[-1])  # the largest of all
    time = sample_times(vehicle, options.duration, options.timestep)
    _check(vehicle, bumps, time, options.threshold)
    loads = tuple(map(choose_load, options.loads))
    loaded(bumps[0], loads).check(vehicle, time)
    outputs = {"csv": options.csv, "picture": options.picture}
    check_outputs(outputs | {"logs": options.logs}, [*vehicle.files, *named_files(options.loads)], options.json)
    stage = Stages("design", "map", "picture and logs")
    stage("design")
    controller = Designer(vehicle, search=False).design(name)
    warn_invalid_certificates([controller])
    progress = stage.counted("map", len(bumps), "cells")
    cells = validity(vehicle, controller, bumps, time, progress, loads, options.every_cell, options.threshold)
    stage("picture and logs")
    if options.csv is not None:
        write_csv(options.csv, cells)
    if options.picture is not None:
        from models.document.picture import write_picture
        from sim.studies.validity.report import envelope_figure

        write_picture(envelope_figure(cells), options.picture)
    result = envelope_object(cells) | ({"loads": list(options.loads)} if options.loads else {}) | written(outputs)
    nearest = functools.partial(_nearest_runs, vehicle, controller, cells, time, loads)
    logs = recorded(options, given, [controller.name], nearest, lambda: result)
    stage.end()
    if options.json:
        print_json({**result, "logs": logs})
    else:
        under = f", under {PLUS.join(load.label for load in loads)}" if loads else ""
        about = f"{vehicle.kind.name} with controller {controller.name}, over {len(bumps)} bumps{under}"
        lines = [*titled(about, vehicle.source), *written_lines(outputs), *log_lines([logs]), ""]
        say([*lines, *text_lines(describe(cells))])
    return 0 if cells.as_predicted else 1


def _nearest_runs(
    vehicle: "Vehicle", controller: "Controller", cells: "Cells", time: "Array", loads: "tuple[Load, ...]"
) -> "dict[str, Run]":
    """Runs the cell nearest to an event among those without a predicted one, and the mildest cell of each predicted event."""
    import numpy as np

    from sim.drive.regime import END_NAMES
    from sim.runs.run import run_controllers
    from sim.studies.validity.map_runs import loaded

    nearest, used = {}, cells.used.max(axis=-1)
    for end in (-1, *range(len(END_NAMES))):
        mine = np.flatnonzero(cells.predicted == end)
        if len(mine):
            i = mine[used[mine].argmax() if end < 0 else used[mine].argmin()]
            what = "nothing breaks" if end < 0 else END_NAMES[end]
            (run,) = run_controllers(vehicle, [controller], loaded(cells.bumps[i], loads), time)
            nearest[f"{controller.name}_{what}".replace(" ", "_").replace("-", "_")] = run
    return nearest


def _check(vehicle: "Vehicle", bumps: "Sequence[Bump]", time: "Array", threshold: float) -> None:
    from models.roads.road import LOWEST

    if not 0 < threshold < 1:
        raise InputError(f"threshold = {threshold:g} is not allowed; give a number above 0 and below 1, such as 0.05")
    if abs(bumps[0].height) < LOWEST:
        raise InputError(f"height = {bumps[0].height:g} m is too small; give at least {LOWEST:g} m, up or down")
    shortest, longest = (pick(bumps, key=lambda bump: bump.duration) for pick in (min, max))
    shortest.check(vehicle, time)
    if longest.duration > time[-1]:
        raise InputError(
            f"the longest bump takes {longest.duration:.3g} s, but a run lasts only {time[-1]:g} s; give a longer --duration"
        )
