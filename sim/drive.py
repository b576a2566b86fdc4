"""`python -m sim.drive`: controllers over one road of any kind, in MuJoCo and in linear analysis, compared and measured."""

import argparse
import json
from collections.abc import Mapping, Sequence
from typing import Any

from models.common.arrays import Array
from models.common.command import Parser, chosen, run_command
from models.common.errors import InputError
from models.vehicle import Vehicle, read_vehicle
from sim.command.asked import Asked, same_path
from sim.command.comparison import add_run_options, check_view, compared_lines, run_chosen, view
from sim.command.logs import log_lines, recorded, run_logs
from sim.command.outputs import check_outputs
from sim.ride.measured import first_sample, measure_run, metric_lines, metrics_object
from sim.ride.metrics import DEFINITIONS
from sim.roads.choice import FILE, SYNTAX, RoadChoice, choose_road
from sim.roads.iso8608 import CLASSES
from sim.roads.road import Road
from sim.runs.run import sample_times
from sim.runs.words import half_step_object, run_object

EPILOG = """
exit code: 0 physics and analysis agree for every controller and energy balances, 1 not, 2 bad input. A run that ends early,
diverged or on a flat tyre, is judged until then, and has no metrics.

examples:
  python -m sim.drive --controller I --class C --speed 20
  python -m sim.drive --controller passive --controller I --road pothole:depth=0.06:length=1.5 --speed 10
  python -m sim.drive --controller I --road measured.csv --speed 15 --json
  python -m sim.drive --controller I --road survey.txt:separator=semicolon:columns=1,3:height_unit=mm --speed 15
  python -m sim.drive --vehicle full_car --controller I --class B --seed 7
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code.

    Raises:
        InputError: bad options, vehicle file, road or logs folder.
    """
    options = parser().parse_args(arguments)
    vehicle = read_vehicle(options.vehicle)
    names = chosen(vehicle.controller_names, options.controller)
    time = sample_times(vehicle, options.duration, options.timestep)
    road = _road(vehicle, options, time)
    check_view(options)
    check_outputs({"logs": options.logs}, [vehicle.source])

    runs, passive = run_chosen(vehicle, names, road, time)
    first = first_sample(vehicle, [run.controller for run in runs], road, options.duration, options.timestep)
    measured = [measure_run(run, first) for run in runs]
    result = {
        "runs": [
            run_object(run) | {"half_step": half_step_object(run)} | metrics_object(run, one)
            for run, one in zip(runs, measured, strict=True)
        ],
        "road": road.describe(),
        "timestep": options.timestep,
        "measured_from": float(time[first]),
        "definitions": DEFINITIONS,
    }
    logs = recorded(options, vehicle, names, lambda: run_logs(runs), result)
    if options.json:
        print(json.dumps({**result, "logs": logs}, allow_nan=False))
    else:
        about = ", ".join(
            f"{key} {value:g}" if isinstance(value, float) else f"{key} {value}" for key, value in road.describe().items()
        )
        lines = [f"{vehicle.kind.name} ({vehicle.source}) over a road: {about}; {options.duration:g} s at {options.timestep:g} s"]
        for run, one in zip(runs, measured, strict=True):
            lines += ["", *compared_lines(run, passive), ""]
            lines += metric_lines(run, one, float(time[first]), options.duration)
        print("\n".join([*lines, *log_lines(logs)]))
    view(options, logs)
    return 0 if all(run.holds for run in runs) else 1


def asked(vehicle: Vehicle, options: argparse.Namespace) -> Asked:
    """What a log of these options holds. Of a road file only the name: it is not read."""
    text = _road_text(options)
    file = FILE.fullmatch(text)

    def is_it(road: Mapping[str, Any]) -> bool:
        if file:
            named = same_path(str(road.get("source")), file["path"])
            return named and (road.get("type"), road.get("speed")) == ("profile", options.speed)
        return road == _built(vehicle, options, choose_road(text)).describe()

    names = chosen(vehicle.controller_names, options.controller)
    samples = len(sample_times(vehicle, options.duration, options.timestep))
    return Asked(names, samples, options.timestep, is_it, lambda name, how: name in names and how == vehicle.implementation)


def _road_text(options: argparse.Namespace) -> str:
    """Which road was asked for."""
    if options.road_class is None:
        return options.road or "iso8608:class=C"
    if options.road is not None:
        raise InputError("give --class or --road, not both: --class C is --road iso8608:class=C")
    return f"iso8608:class={options.road_class.upper()}"


def _built(vehicle: Vehicle, options: argparse.Namespace, choice: RoadChoice) -> Road:
    return choice.build(vehicle, options.speed, options.seed, options.speed * options.duration)


def _road(vehicle: Vehicle, options: argparse.Namespace, time: Array) -> Road:
    """The road that was asked for, if it can be driven."""
    choice = choose_road(_road_text(options))
    if "seed" in options.given and not choice.random:
        raise InputError(f"--seed says which random road, and {choice.text!r} is none; leave it out")
    road = _built(vehicle, options, choice)
    try:
        road.check(vehicle, time)
    except InputError as error:
        raise InputError(f"road {choice.text!r}: {error}") from error
    return road


def _seed(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None


def parser() -> Parser:
    """The options."""
    parser = Parser(
        "sim.drive",
        "Drives controllers over a road, in MuJoCo and in linear analysis; compares, measures and logs them.",
        EPILOG,
    )
    parser.add_controller_and_vehicle("required")
    parser.add_argument(
        "--class", dest="road_class", metavar="CLASS", help=f"random road of ISO 8608, {CLASSES[0]} to {CLASSES[-1]} (default: C)"
    )
    parser.add_argument("--seed", type=_seed, default=0, metavar="N", help="of the random road (default: 0)")
    parser.add_argument("--road", metavar="ROAD", help=f"another road: {SYNTAX}".replace("%", "%%"))
    parser.add_number("--speed", 20.0, "m/s", "forward speed of the vehicle")
    add_run_options(parser, 20.0)
    return parser


if __name__ == "__main__":
    run_command(main)
