"""`python -m sim.envelope`: the map of validity, over any two of a bump's height, length and the speed."""

import argparse
import functools
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from models.common import interrupt
from models.common.arrays import Array
from models.common.command import Parser, complain, one_chosen, run_command
from models.common.errors import InputError
from models.vehicle import Vehicle, read_vehicle
from sim.command.asked import Asked
from sim.command.logs import log_lines, recorded
from sim.command.outputs import check_outputs, written, written_lines
from sim.command.progress import bar
from sim.figures.picture import write_picture
from sim.recording.run_log import RunLog
from sim.response.regime import END_NAMES
from sim.roads.road import LOWEST, Bump
from sim.runs.run import run_all, sample_times
from sim.validity.cells import Cells, Interrupted, validity
from sim.validity.grid import UNITS, grid, read_axes
from sim.validity.words import envelope_lines, envelope_object, write_csv
from synth.controller import Controller
from synth.designer import design

EPILOG = """
exit code: 0 physics breaks first what linear analysis predicts, 1 it does not, 2 bad input,
130 interrupted, 143 by SIGTERM: what is done is kept

examples:
  python -m sim.envelope --controller I --vary height:0.02:0.3:20 --vary speed:3:30:20 --picture envelope.png
  python -m sim.envelope --controller II --vary length:1:10:30 --vary speed:4:30:30 --height 0.08 --csv envelope.csv
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code.

    Raises:
        InputError: bad options, vehicle file or output file.
    """
    options = parser().parse_args(arguments)
    vehicle = read_vehicle(options.vehicle)
    name = one_chosen(vehicle.controller_names, options.controller)
    axes = read_axes(options.vary or [])
    for axis in axes:
        if axis.name in options.given:
            raise InputError(f"--{axis.name} is of what is not varied, and --vary {axis.name} varies it; leave one of them out")
    bumps = grid(axes, {name: getattr(options, name) for name in UNITS})
    time = sample_times(vehicle, options.duration, options.timestep)
    _check(vehicle, bumps, time, options.threshold)
    outputs = {"csv": options.csv, "picture": options.picture}
    check_outputs(outputs | {"logs": options.logs}, [vehicle.source], options.json)
    controller = design(vehicle, name)

    try:
        cells = validity(vehicle, controller, bumps, time, bar(len(bumps), "cells"))
    except Interrupted as interruption:
        cells = interruption.cells
        if not cells.done.any():
            raise
    if options.csv is not None:
        write_csv(options.csv, cells, options.threshold)
    if options.picture is not None:
        from sim.validity.figure import envelope_figure

        fixed = {name: getattr(options, name) for name in UNITS if name not in {axis.name for axis in axes}}
        write_picture(envelope_figure(vehicle, controller, cells, axes, fixed, options.threshold), options.picture)
    result = envelope_object(cells, axes, name, options.threshold) | written(outputs)
    nearest = functools.partial(_nearest_runs, vehicle, controller, cells, time)
    logs = recorded(options, vehicle, [controller.name], nearest, result)
    if options.json:
        print(json.dumps({**result, "logs": logs}, allow_nan=False))
    else:
        lines = [
            f"{vehicle.kind.name} ({vehicle.source}), controller {controller.name}",
            *envelope_lines(cells, options.threshold),
        ]
        print("\n".join([*lines, *written_lines(outputs), *log_lines(logs)]))
    if not cells.done.all():
        complain(f"{interrupt.word()} after {int(cells.done.sum())} of {len(bumps)} cells; they are kept")
        return interrupt.code()
    return 0 if cells.as_predicted else 1


def asked(vehicle: Vehicle, options: argparse.Namespace) -> Asked:
    """What a log of these options holds: some of the cells."""
    axes = {axis.name: axis.values for axis in read_axes(options.vary or [])}
    allowed = {name: axes.get(name, (getattr(options, name),)) for name in UNITS}

    def is_it(road: Mapping[str, Any]) -> bool:
        cell = {name: road.get(name) for name in UNITS}
        return road == {**Bump().describe(), **cell} and all(cell[name] in allowed[name] for name in UNITS)

    name = one_chosen(vehicle.controller_names, options.controller)
    samples = len(sample_times(vehicle, options.duration, options.timestep))
    result = {
        "controller": name,
        "axes": {name: list(values) for name, values in axes.items()},
        "threshold": options.threshold,
        **written({"csv": options.csv, "picture": options.picture}),
    }
    names = {_called(name, end) for end in (-1, *range(len(END_NAMES)))}
    return Asked(
        [name], samples, options.timestep, is_it, lambda run, how: run in names and how == vehicle.implementation, result
    )


def _called(controller: str, end: int) -> str:
    """What a run is called by what broke first, of `REGIME_ENDS`; -1 for nothing."""
    what = "nothing_breaks" if end < 0 else END_NAMES[end].replace(" ", "_").replace("-", "_")
    return f"{controller}_{what}"


def _nearest_runs(vehicle: Vehicle, controller: Controller, cells: Cells, time: Array) -> list[RunLog]:
    """Of the cells where nothing breaks the one nearest to breaking, and of those where an end comes first the mildest."""
    from sim.recording.provenance import run_log

    found, used = [], cells.used.max(axis=-1)
    for end in (-1, *range(len(END_NAMES))):
        mine = np.flatnonzero(cells.done & (cells.first == end))
        if len(mine):
            i = mine[used[mine].argmax() if end < 0 else used[mine].argmin()]
            run = run_all(vehicle, [controller], cells.bumps[i], time)[0]
            found.append(run_log(run, _called(controller.name, end)))
    return found


def _check(vehicle: Vehicle, bumps: Sequence[Bump], time: Array, threshold: float) -> None:
    if not 0 < threshold < 1:
        raise InputError(f"threshold = {threshold:g} is not allowed; give a share of a peak above 0 and below 1, such as 0.05")
    if abs(bumps[0].height) < LOWEST:
        raise InputError(f"height = {bumps[0].height:g} m is lost in rounding; give at least {LOWEST:g} m, either way")
    shortest, longest = (pick(bumps, key=lambda bump: bump.duration) for pick in (min, max))
    shortest.check(vehicle, time)
    if longest.duration > time[-1]:
        raise InputError(
            f"the longest bump takes {longest.duration:.3g} s, more than the run of {time[-1]:g} s; give a longer --duration"
        )


def parser() -> Parser:
    """The options."""
    parser = Parser(
        "sim.envelope", "Maps where linear analysis holds over bumps, and what breaks first where it does not.", EPILOG
    )
    parser.add_one("passive, state, or one of the vehicle file's")
    parser.add_argument(
        "--vary", action="append", metavar="NAME:LOW:HIGH:COUNT", help="an axis of the map: height, length or speed; give two"
    )
    parser.add_number("--height", Bump.height, "m", "bump height, where it is not varied")
    parser.add_number("--length", Bump.length, "m", "bump length, where it is not varied")
    parser.add_number("--speed", Bump.speed, "m/s", "forward speed, where it is not varied")
    parser.add_number("--threshold", 0.05, "-", "largest error at which linear analysis is said to hold, as a share of a peak")
    parser.add_number("--duration", 3.0, "s", "how long every run is")
    parser.add_number("--timestep", 1e-3, "s", "integration step and sample period of the controller")
    parser.add_logs("the cells nearest to where something breaks")
    parser.add_argument("--csv", type=Path, metavar="FILE", help="write every cell's numbers")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="draw the map, as .png or .svg; needs matplotlib")
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    return parser


if __name__ == "__main__":
    run_command(main)
