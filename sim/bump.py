"""`python -m sim.bump`: controllers over a bump, in MuJoCo and in linear analysis, compared and logged."""

import json
from collections.abc import Sequence
from pathlib import Path

from models.command import Parser, run_command
from models.errors import InputError
from models.vehicle import Vehicle, read_vehicle
from sim.road import Bump
from sim.run import Run, check_road, run_all, sample_times
from sim.verdict import controller_lines, log_lines, run_lines, run_object, verdict_lines
from synth.controller import Designer

EPILOG = """
exit code: 0 physics and analysis agree for every controller, 1 they do not, 2 bad input

examples:
  python -m sim.bump --controller I
  python -m sim.bump --controller I --controller II --height 0.05
  python -m sim.bump --controller mine --vehicle my_car.toml --json
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code.

    Raises:
        InputError: bad options, vehicle file or logs folder.
    """
    parser = _parser()
    options = parser.parse_args(arguments)
    vehicle = read_vehicle(options.vehicle)
    names = _chosen(vehicle, options.controller)
    road = Bump(options.height, options.length, options.speed, options.track)
    if road.track != "both" and not any(wheel.side for wheel in vehicle.kind.wheels):
        raise InputError(f"--track {road.track}: a {vehicle.kind.name} has only one track; leave the option out")
    time = sample_times(vehicle, options.duration, options.timestep)
    if road.duration < 2 * options.timestep:
        raise InputError(
            f"the bump is over in {road.duration:.3g} s, less than two timesteps of {options.timestep:g} s, so physics would not "
            "see it; give a longer one, less speed, or a smaller timestep"
        )
    check_road(vehicle, road, time)

    designer = Designer(vehicle)
    with_passive = [*names, *(["passive"] if "passive" not in names else [])]  # the reference of the last column
    controllers = [designer.design(name) for name in with_passive]
    if options.logs is not None:  # after the last bad input, so that nothing is written; before the long work
        from sim.recording import check_folder

        check_folder(options.logs)

    everything = run_all(vehicle, controllers, road, time)
    runs, passive = everything[: len(names)], everything[with_passive.index("passive")]

    result = {
        "runs": [run_object(vehicle, run) for run in runs],
        "road": road.describe(),
        "timestep": options.timestep,
    }
    logs = {"mcap": None, "rerun": None}
    if options.logs is not None:
        from sim.provenance import record_runs, run_log

        logs = record_runs(options.logs, "bump", vehicle, names, [run_log(vehicle, road, run) for run in runs], result)
    if options.json:
        print(json.dumps({**result, "logs": logs}, allow_nan=False))
    else:
        print("\n".join(_text(vehicle, road, runs, passive, options, logs)))
    return 0 if all(run.agreement.agrees for run in runs) else 1


def _parser() -> Parser:
    parser = Parser(
        "sim.bump", "Drives controllers over a bump, in MuJoCo and in linear analysis, compares and logs them.", EPILOG
    )
    parser.add_argument(
        "--controller",
        action="append",
        metavar="NAME",
        help="passive, state, one of the vehicle file's, or all; may be repeated. Required",
    )
    parser.add_argument(
        "--vehicle", default="quarter_car", metavar="FILE", help="vehicle file, or one that ships (default: quarter_car)"
    )
    parser.add_number("--height", Bump.height, "m", "bump height")
    parser.add_number("--length", Bump.length, "m", "bump length")
    parser.add_number("--speed", Bump.speed, "m/s", "forward speed of the vehicle")
    parser.add_argument(
        "--track", choices=("left", "right", "both"), default="both", help="the wheels that the bump lies under (default: both)"
    )
    parser.add_number("--duration", 3.0, "s", "how long to run")
    parser.add_number("--timestep", 1e-3, "s", "integration step and sample period of the controller")
    parser.add_argument("--logs", type=Path, default=Path("logs"), metavar="DIR", help="folder for the log files (default: logs)")
    parser.add_argument("--no-logs", dest="logs", action="store_const", const=None, help="write no log files")
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    return parser


def _chosen(vehicle: Vehicle, asked: Sequence[str] | None) -> list[str]:
    """The controllers to run, each once, in the order asked for."""
    if not asked:
        raise InputError(
            f"no controller was asked for; give --controller with one of: all, {', '.join(vehicle.controller_names)}"
        )
    names = [name for choice in asked for name in (vehicle.controller_names if choice == "all" else [choice])]
    return list(dict.fromkeys(names))


def _text(vehicle: Vehicle, road: Bump, runs: Sequence[Run], passive: Run, options, logs: dict) -> list[str]:
    lines = [
        f"{vehicle.kind.name} ({vehicle.source}) over a bump of {road.height:g} m height and {road.length:g} m length at "
        f"{road.speed:g} m/s{'' if road.track == 'both' else f', {road.track} wheels only'}; "
        f"{options.duration:g} s at {options.timestep:g} s"
    ]
    for run in runs:
        lines += [
            "",
            *controller_lines(run.controller),
            "",
            *run_lines(vehicle, run, passive if run is not passive else None),
            "",
        ]
        lines += [f"  {line}" for line in verdict_lines(run)]
    if logs["rerun"]:
        lines += ["", *log_lines(logs)]
    return lines


if __name__ == "__main__":
    run_command(main)
