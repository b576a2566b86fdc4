"""`python -m sim.bump`: controllers over a bump, in MuJoCo and in linear analysis, compared and logged."""

import argparse
import json
from collections.abc import Sequence

from models.common.command import Parser, chosen, run_command
from models.vehicle import Vehicle, read_vehicle
from sim.command.asked import Asked
from sim.command.comparison import add_run_options, check_view, compared_lines, run_chosen, view
from sim.command.logs import log_lines, recorded, run_logs
from sim.command.outputs import check_outputs
from sim.roads.road import Bump
from sim.runs.run import Run, sample_times
from sim.runs.words import half_step_object, run_object

EPILOG = """
exit code: 0 physics and analysis agree for every controller and energy balances, 1 not, 2 bad input

examples:
  python -m sim.bump --controller I
  python -m sim.bump --controller I --controller II --height 0.05
  python -m sim.bump --controller all --serve
  python -m sim.bump --controller mine --vehicle my_car.toml --json
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code.

    Raises:
        InputError: bad options, vehicle file or logs folder.
    """
    options = parser().parse_args(arguments)
    vehicle = read_vehicle(options.vehicle)
    names, road = chosen(vehicle.controller_names, options.controller), _road(options)
    time = sample_times(vehicle, options.duration, options.timestep)
    road.check(vehicle, time)
    check_view(options)
    check_outputs({"logs": options.logs}, [vehicle.source])

    runs, passive = run_chosen(vehicle, names, road, time)
    result = {
        "runs": [run_object(run) | {"half_step": half_step_object(run)} for run in runs],
        "road": road.describe(),
        "timestep": options.timestep,
    }
    logs = recorded(options, vehicle, names, lambda: run_logs(runs), result)
    if options.json:
        print(json.dumps({**result, "logs": logs}, allow_nan=False))
    else:
        print("\n".join(_text(vehicle, road, runs, passive, options, logs)))
    view(options, logs)
    return 0 if all(run.holds for run in runs) else 1


def asked(vehicle: Vehicle, options: argparse.Namespace) -> Asked:
    """What a log of these options holds."""
    names = chosen(vehicle.controller_names, options.controller)
    samples = len(sample_times(vehicle, options.duration, options.timestep))
    return Asked(
        names,
        samples,
        options.timestep,
        lambda road: road == _road(options).describe(),
        lambda name, how: name in names and how == vehicle.implementation,
    )


def _road(options: argparse.Namespace) -> Bump:
    return Bump(options.height, options.length, options.speed, options.track)


def parser() -> Parser:
    """The options."""
    parser = Parser(
        "sim.bump", "Drives controllers over a bump, in MuJoCo and in linear analysis, compares and logs them.", EPILOG
    )
    parser.add_controller_and_vehicle("required")
    parser.add_number("--height", Bump.height, "m", "bump height")
    parser.add_number("--length", Bump.length, "m", "bump length")
    parser.add_number("--speed", Bump.speed, "m/s", "forward speed of the vehicle")
    parser.add_argument(
        "--track", choices=("left", "right", "both"), default="both", help="the wheels that the bump lies under (default: both)"
    )
    add_run_options(parser, 3.0)
    return parser


def _text(vehicle: Vehicle, road: Bump, runs: Sequence[Run], passive: Run, options, logs: dict) -> list[str]:
    lines = [
        f"{vehicle.kind.name} ({vehicle.source}) over a bump of {road.height:g} m height and {road.length:g} m length at "
        f"{road.speed:g} m/s{'' if road.track == 'both' else f', {road.track} wheels only'}; "
        f"{options.duration:g} s at {options.timestep:g} s"
    ]
    for run in runs:
        lines += ["", *compared_lines(run, passive)]
    return [*lines, *log_lines(logs)]


if __name__ == "__main__":
    run_command(main)
