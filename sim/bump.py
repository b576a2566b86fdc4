"""`python -m sim.bump`: controllers over a bump, in MuJoCo and in linear analysis, compared and logged."""

import json
from collections.abc import Sequence

from models.common.command import chosen, run_command
from models.common.printed import say, titled
from models.figures.outputs import check_outputs
from models.roads.road import Bump
from models.vehicle import Vehicle, read_vehicle
from sim.asked.bump import asked_road, parser
from sim.command.comparison import check_view, compared_lines, run_beside_passive, view
from sim.command.logs import log_lines, recorded
from sim.runs.run import Run, sample_times
from sim.runs.words import half_step_object, run_object, summary_lines
from synth.designer import Designer


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code.

    Raises:
        InputError: bad options, vehicle file or logs folder.
    """
    options = parser().parse_args(arguments)
    vehicle = read_vehicle(options.vehicle)
    names, road = chosen(vehicle.controller_names, options.controller), asked_road(options)
    time = sample_times(vehicle, options.duration, options.timestep)
    road.check(vehicle, time)
    check_view(options)
    check_outputs({"logs": options.logs}, vehicle.files)

    runs, passive = run_beside_passive(vehicle, names, Designer(vehicle, search=False).design, road, time)
    result = {
        "runs": [run_object(run) | {"half_step": half_step_object(run)} for run in runs],
        "road": road.describe(),
        "timestep": options.timestep,
    }
    logs = recorded(options, vehicle, names, lambda: dict(zip(names, runs, strict=True)), result)
    if options.json:
        print(json.dumps({**result, "logs": logs}, allow_nan=False))
    else:
        say(_text(vehicle, road, runs, passive, options, logs))
    view(options, logs)
    return 0 if all(run.holds for run in runs) else 1


def _text(vehicle: Vehicle, road: Bump, runs: Sequence[Run], passive: Run, options, logs: dict) -> list[str]:
    lines = titled(
        f"{vehicle.kind.name} over a bump of {road.height:g} m height and {road.length:g} m length at {road.speed:g} m/s"
        f"{'' if road.track == 'both' else f', {road.track} wheels only'}; {options.duration:g} s at {options.timestep:g} s",
        vehicle.source,
    )
    for run in runs:
        lines += ["", *compared_lines(run, passive)]
    return [*lines, *log_lines(logs), "", *summary_lines(runs)]


if __name__ == "__main__":
    run_command(main)
