"""`python -m sim.drive`: controllers over one road of any kind, in MuJoCo and in linear analysis, compared and measured."""

import json
from collections.abc import Sequence

from models.common.command import chosen, run_command
from sim.command.drive_options import parser, requested_road


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code.

    Raises:
        InputError: bad options, vehicle file, road or logs folder.
    """
    options = parser().parse_args(arguments)
    from models.common.printed import say, titled
    from models.figures.outputs import check_outputs
    from models.vehicle.vehicle import read_vehicle
    from sim.command.comparison import (
        check_view,
        compared_lines,
        log_lines,
        passive_beside,
        recorded,
        run_named,
        standings_of,
        view,
    )
    from sim.runs.report import half_step_object, run_object, summary_lines
    from sim.runs.run import sample_times
    from sim.studies.ride.metrics import DEFINITIONS
    from sim.studies.ride.run_metrics import (
        driven_roughness,
        first_sample,
        measure_run,
        metric_lines,
        metrics_object,
        roughness_object,
    )
    from sim.studies.ride.standing import standing_lines, standings_object
    from synth.vehicle.designer import Designer

    vehicle = read_vehicle(options.vehicle)
    names = chosen(vehicle.controller_names, options.controller)
    time = sample_times(vehicle, options.duration, options.timestep)
    road = requested_road(vehicle, options, time)
    check_view(options)
    check_outputs({"logs": options.logs}, vehicle.files)

    design = Designer(vehicle, search=False).design
    runs = run_named(vehicle, names, design, road, time)
    first = first_sample(vehicle, [run.controller for run in runs], road, options.duration, options.timestep)
    measured = [measure_run(run, first) for run in runs]
    roughness = driven_roughness(vehicle, road, time)
    result = {
        "runs": [
            run_object(run) | {"half_step": half_step_object(run)} | metrics_object(run, one)
            for run, one in zip(runs, measured, strict=True)
        ],
        "road": road.describe(),
        "timestep": options.timestep,
        "measured_from": float(time[first]),
        "definitions": DEFINITIONS,
        "iri": roughness_object(roughness),
    }
    logs = recorded(options, vehicle, names, lambda: dict(zip(names, runs, strict=True)), result)
    passive = passive_beside(runs, design)
    standings = standings_of(runs, passive, first, measured)
    if options.json:
        print(json.dumps({**result, "compared": standings_object(standings), "logs": logs}, allow_nan=False))
    else:
        lines = titled(
            f"{vehicle.kind.name} over a road: {road.words}; {options.duration:g} s at {options.timestep:g} s", vehicle.source
        )
        if not options.brief:
            for run, one, compared in zip(runs, measured, compared_lines(runs, passive), strict=True):
                lines += ["", *compared, ""]
                lines += metric_lines(run, one, float(time[first]), options.duration, roughness)
        window = f"MuJoCo, from {time[first]:.4g} s on"
        say([*lines, "", *standing_lines(standings, window), *log_lines(logs, options.brief), "", *summary_lines(runs)])
    view(options, logs)
    return 0 if all(run.passed for run in runs) else 1


if __name__ == "__main__":
    run_command(main)
