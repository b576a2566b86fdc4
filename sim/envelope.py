"""`python -m sim.envelope`: the map of validity, over one or two of a bump's height, length and the speed."""

if __name__ == "__main__":
    from models.common.cli import run

    run("sim.envelope")

import functools
import json
from collections.abc import Sequence
from typing import TYPE_CHECKING

from models.common.command import one_chosen
from models.common.errors import InputError
from models.common.printed import Stages, say, titled
from models.vehicle.names import PLUS, named_files
from sim.command.envelope_options import nearest_run, parser

if TYPE_CHECKING:
    from models.common.arrays import Array
    from models.roads.load import Load
    from models.roads.road import Bump
    from models.vehicle.vehicle import Vehicle
    from sim.runs.run import Run
    from sim.studies.validity.regime_map import Cells
    from synth.controller.controller import Controller


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code.

    Raises:
        InputError: bad options, vehicle file or output file.
    """
    options = parser().parse_args(arguments)
    from models.figures.outputs import check_outputs, written, written_lines
    from models.roads.load_choice import choose_load
    from models.vehicle.vehicle import read_vehicle
    from sim.command.comparison import log_lines, recorded, warn
    from sim.runs.run import sample_times
    from sim.studies.validity.edges import edge_lines, edges, edges_object, travel_line
    from sim.studies.validity.grid import UNITS, grid, read_axes
    from sim.studies.validity.regime_map import loaded, validity
    from sim.studies.validity.report import compared_lines, envelope_lines, envelope_object, loads_object, write_csv
    from synth.vehicle.designer import Designer

    given = read_vehicle(options.vehicle)
    name = one_chosen(given.controller_names, options.controller)
    vehicle = given.driven_by(name)
    axes = read_axes(options.vary or [])
    for axis in axes:
        if axis.name in options.given:
            raise InputError(f"--{axis.name} is of what is not varied, and --vary {axis.name} varies it; omit one of them")
    bumps = grid(axes, {name: getattr(options, name) for name in UNITS})
    time = sample_times(vehicle, options.duration, options.timestep)
    _check(vehicle, bumps, time, options.threshold)
    loads = tuple(map(choose_load, options.loads))
    loaded(bumps[0], loads).check(vehicle, time)
    outputs = {"csv": options.csv, "picture": options.picture}
    check_outputs(outputs | {"logs": options.logs}, [*vehicle.files, *named_files(options.loads)], options.json)
    stage = Stages("design", "map", "picture and logs")
    stage("design")
    controller = Designer(vehicle, search=False).design(name)
    warn(vehicle, [controller])
    cells = validity(vehicle, controller, bumps, time, stage.counted("map", len(bumps), "cells"), loads)
    stage("picture and logs")
    fixed = {name: getattr(options, name) for name in UNITS if name not in {axis.name for axis in axes}}
    along, found = edges(cells, axes, proportional=not (loads or vehicle.is_curved))
    if options.csv is not None:
        write_csv(options.csv, cells, options.threshold)
    if options.picture is not None:
        from models.figures.picture import write_picture
        from sim.studies.validity.report import envelope_figure

        write_picture(envelope_figure(vehicle, controller, cells, axes, fixed, options.threshold, loads), options.picture)
    result = envelope_object(cells, axes, name, options.threshold) | {"edges": edges_object(along, found)}
    result |= loads_object(options.loads) | written(outputs)
    nearest = functools.partial(_nearest_runs, vehicle, controller, cells, time, loads)
    logs = recorded(options, given, [controller.name], nearest, result)
    stage.end()
    if options.json:
        print(json.dumps({**result, "logs": logs}, allow_nan=False))
    else:
        under = f", under {PLUS.join(load.label for load in loads)}" if loads else ""
        about = f"{vehicle.kind.name} with controller {controller.name}, over {cells.counted('bumps')}{under}"
        lines = [*titled(about, vehicle.source), *compared_lines(vehicle, controller)]
        if not controller.certificate.stable:
            lines.append(f"UNSTABLE loop; every run grows: {controller.certificate.own.words.removeprefix('unstable: ')}")
        ends = [*edge_lines(along, found, fixed), *travel_line(vehicle, cells)]
        say([*lines, *written_lines(outputs), *log_lines(logs), "", *ends, "", *envelope_lines(cells, options.threshold)])
    return 0 if cells.as_predicted else 1


def _nearest_runs(
    vehicle: "Vehicle", controller: "Controller", cells: "Cells", time: "Array", loads: "tuple[Load, ...]"
) -> "dict[str, Run]":
    """Runs the cell nearest to an event among those without one, and the mildest cell of each first event."""
    import numpy as np

    from sim.response.regime import END_NAMES
    from sim.runs.run import run_controllers
    from sim.studies.validity.regime_map import loaded

    nearest, used = {}, cells.used.max(axis=-1)
    for end in (-1, *range(len(END_NAMES))):
        mine = np.flatnonzero(cells.first == end)
        if len(mine):
            i = mine[used[mine].argmax() if end < 0 else used[mine].argmin()]
            (nearest[nearest_run(controller.name, end)],) = run_controllers(
                vehicle, [controller], loaded(cells.bumps[i], loads), time
            )
    return nearest


def _check(vehicle: "Vehicle", bumps: "Sequence[Bump]", time: "Array", threshold: float) -> None:
    from models.roads.road import LOWEST

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
