"""`python -m sim.bump`: controllers over a bump, in MuJoCo and in linear analysis, compared and logged."""

import json
from argparse import Namespace
from collections.abc import Sequence
from typing import TYPE_CHECKING

from models.common.command import chosen, run_command
from sim.command.bump_options import parser, requested_road

if TYPE_CHECKING:
    from models.roads.road import Bump
    from models.vehicle.vehicle import Vehicle


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code.

    Raises:
        InputError: bad options, vehicle file or logs folder.
    """
    options = parser().parse_args(arguments)
    from models.common.printed import say
    from models.figures.outputs import check_outputs, written, written_lines
    from models.vehicle.vehicle import read_vehicle
    from sim.command import comparison
    from sim.runs.report import half_step_object, run_object, summary_lines
    from sim.runs.run import sample_times
    from sim.studies.ride.standing import standing_lines, standings_object
    from synth.vehicle.designer import Designer

    vehicle = read_vehicle(options.vehicle)
    names, road = chosen(vehicle.controller_names, options.controller), requested_road(options)
    time = sample_times(vehicle, options.duration, options.timestep)
    road.check(vehicle, time)
    comparison.check_view(options)
    check_outputs({"picture": options.picture, "csv": options.csv, "logs": options.logs}, vehicle.files, options.json)

    design = Designer(vehicle, search=False).design
    runs = comparison.run_named(vehicle, names, design, road, time, options.exported)
    driven = [run.controller.name for run in runs]
    result = {
        "runs": [run_object(run) | {"half_step": half_step_object(run)} for run in runs],
        "road": road.describe(),
        "timestep": options.timestep,
        **comparison.left_out_object(names, driven),
    }
    logs = comparison.recorded(options, vehicle, driven, lambda: dict(zip(driven, runs, strict=True)), result)
    outputs = comparison.write_histories(options, runs, _where(road))
    passive = comparison.passive_beside(runs, design)
    standings = comparison.standings_of(runs, passive)
    exported = comparison.exported_object(vehicle, runs, options.timestep)
    if options.json:
        print(
            json.dumps(
                {**result, **exported, "compared": standings_object(standings), **written(outputs), "logs": logs}, allow_nan=False
            )
        )
    else:
        lines = _titled(vehicle, road, options)
        if options.verbose:
            for of_run in comparison.compared_lines(runs, passive):
                lines += ["", *of_run]
        elif not options.brief:
            lines += comparison.short_lines(runs)
        lines += comparison.exported_lines(exported, options.verbose) if not options.brief else []
        lines += ["", *standing_lines(standings, comparison.table_note(runs, options, "MuJoCo, all of the run"))]
        lines += comparison.stop_lines(runs, options.verbose)
        say([*lines, *written_lines(outputs), *comparison.log_lines(logs, options.brief, runs), "", *summary_lines(runs)])
    comparison.view(options, logs)
    return 0 if all(run.passed for run in runs) and len(runs) == len(names) else 1


def _titled(vehicle: "Vehicle", road: "Bump", options: Namespace) -> list[str]:
    from models.common.printed import titled

    return titled(
        f"{vehicle.kind.name} over {_where(road)}; {options.duration:g} s at {options.timestep:g} s",
        vehicle.source,
    )


def _where(road: "Bump") -> str:
    wheels = "" if road.track == "both" else f", {road.track} wheels only"
    return f"a bump {road.height:g} m high and {road.length:g} m long at {road.speed:g} m/s{wheels}"


if __name__ == "__main__":
    run_command(main)
