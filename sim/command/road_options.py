"""Command-line options for a run over one road, and the functions that build the requested road from them."""

import argparse
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from models import USUAL_TIMESTEP
from models.common.command import ALL, Parser
from models.common.errors import InputError, error_in
from models.common.extensions import FEATURES
from models.common.printed import percent, rough, wrap_text
from models.vehicle.names import CLASSES, FILE, PLUS, ROAD_SYNTAX, WITHOUT, named_file, split_off

if TYPE_CHECKING:
    from models.common.arrays import Array
    from models.roads.road import Road
    from models.vehicle.vehicle import Vehicle


def add_vehicles(parser: Parser) -> None:
    """Adds the options `--controller`, `--vehicle` (which may be repeated) and `--without`."""
    parser.add_controller_and_vehicle("default: all but published copies, such as I_printed", several="one table of all vehicles")
    parser.add_argument(
        "--without",
        action="append",
        choices=WITHOUT,
        default=[],
        help="also simulate every controller without one effect that the vehicle file describes, to show how much this effect "
        "matters: sensor noise and quantisation, delay of the forces, limits (largest force and bump stops), or lag of the "
        "actuators; may be repeated",
    )


def add_start(parser: Parser) -> None:
    """Adds the option `--start`, which may be repeated."""
    parser.add_argument(
        "--start",
        action="append",
        default=[],
        metavar="STATE=VALUE",
        help="start from this state instead of equilibrium: give a state of the vehicle's linear model, as in "
        "suspension_deflection=20mm, or give height=50mm to lift the whole vehicle for a drop test; may be repeated. With "
        "--road flat, the frequencies and damping ratios of the free decay are printed",
    )


def with_start(vehicle: "Vehicle", texts: Sequence[str]) -> "Vehicle":
    """Returns the vehicle with the initial state of `--start`; if `texts` is empty, the vehicle is returned unchanged."""
    if not texts:
        return vehicle
    start = dict[str, float | str]()
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals or name.strip() in start:
            wrong = "is given twice; give each state once" if equals else "has no value; give STATE=VALUE, as in height=50mm"
            raise InputError(f"--start {text} {wrong}")
        try:
            start[name.strip()] = float(value)
        except ValueError:
            start[name.strip()] = value.strip()
    try:
        return vehicle.starting(**start)
    except InputError as error:
        raise InputError(str(error).replace("[start]", "--start")) from error


def omitted_controllers(vehicle: "Vehicle", given: Sequence[str] | None, names: Sequence[str]) -> list[str]:
    """Returns the controllers of a vehicle that a command omits by default; empty if `--controller` names controllers.

    Args:
        vehicle: vehicle to which the controllers belong.
        given: names of the controllers that the user gave with `--controller`.
        names: names of the controllers that the command simulates.
    """
    return [] if given else [name for name in vehicle.controller_names if name not in names]


def left_out_lines(names: Sequence[str], one: bool = False) -> list[str]:
    """Returns a line that lists the omitted controllers and explains how to include them; empty if no controller is omitted.

    Args:
        one: True if the command accepts only one controller; the line then explains how to choose a different controller.
    """
    if one and names:
        return [f"other controllers: {', '.join(names)}; choose one with --controller NAME"]
    return [f"not simulated: {', '.join(names)}; add one with --controller NAME, or all with --controller {ALL}"] if names else []


def add_run_options(parser: Parser, duration: float) -> None:
    """Adds the options `--duration`, `--timestep` and `--as`, and the options for logs, viewers and output.

    Args:
        parser: parser of the command.
        duration: default value of `--duration` [s].
    """
    parser.add_exported()
    parser.add_number("--duration", duration, "s", "duration of the run")
    parser.add_number("--timestep", USUAL_TIMESTEP, "s", "integration step and sample period of the controller")
    parser.add_argument(
        "--picture",
        type=Path,
        metavar="FILE",
        help="draw the signals of MuJoCo and of linear analysis over time, with a panel for each weighted signal (.png, .svg or "
        ".pdf)",
    )
    parser.add_argument(
        "--csv", type=Path, metavar="FILE", help="write all signals of MuJoCo and linear analysis over time (.csv)"
    )
    add_measured(parser)
    logs = parser.add_mutually_exclusive_group()
    logs.add_argument("--logs", type=Path, default=Path("logs"), metavar="DIR", help="folder for log files (default: logs)")
    logs.add_argument("--no-logs", dest="logs", action="store_const", const=None, help="do not write log files")
    parser.add_argument("--allow-unstable", action="store_true", help="return exit code 0 even if a closed loop is unstable")
    view = parser.add_mutually_exclusive_group()
    view.add_argument(
        "--open", action="store_true", help="open the recording in a window of Rerun, which stays open after the command"
    )
    view.add_argument("--serve", action="store_true", help="show the recording in a browser on this machine until Ctrl-C")
    parser.add_printed(
        "gains, all signals and the details of the verdict",
        "print only the comparison of controllers and the verdicts",
    )


def add_measured(parser: Parser) -> None:
    """Adds `--beside`, which names the file of a measured log to compare with the runs, and the options that describe it."""
    parser.add_argument(
        "--beside",
        type=Path,
        metavar="FILE",
        help="compare the runs with a measured log, whose columns have names of signals and units, as in "
        "'sprung_acceleration [m/s2]' (.csv, .txt, .lvm, .mat, .xlsx)",
    )
    parser.add_argument(
        "--beside-column",
        action="append",
        default=[],
        metavar="SIGNAL=HEADING",
        help="heading of the column that contains a signal, if the heading is not the name of the signal; may be repeated",
    )
    parser.add_number("--beside-start", None, "s", "time of the log at which the runs start", "largest correlation")
    parser.add_number("--beside-rate", None, "Hz", "sample rate of a log without a column of time", "column of time")
    parser.add_argument(
        "--beside-remove-offset",
        action="store_true",
        help="remove the mean offset between each measured signal and the same signal in MuJoCo",
    )


def add_road(parser: Parser, default: str) -> None:
    """Adds the options `--class`, `--seed`, `--road`, `--from` and `--speed`. The argument `default` is the default of
    `--class` that the help prints.
    """
    parser.add_argument(
        "--class",
        dest="road_class",
        metavar="CLASS",
        help=f"class of a random road (ISO 8608), {CLASSES[0]} to {CLASSES[-1]} (default: {default})",
    )
    parser.add_argument("--seed", type=_seed, default=0, metavar="N", help="seed of the random road (default: 0)")
    parser.add_argument("--road", metavar="ROAD", help=f"road instead of --class: {ROAD_SYNTAX}".replace("%", "%%"))
    parser.add_number(
        "--from",
        None,
        "m",
        "position on a road from a file at which the vehicle starts, in metres even if the file uses another unit",
        "first point",
    )
    parser.add_number("--speed", 20.0, "m/s", "speed of the vehicle; other units, such as 90km/h, are allowed")


def requested_road(vehicle: "Vehicle", options: argparse.Namespace, time: "Array") -> "Road":
    """Returns the road that the command-line options describe.

    Args:
        vehicle: vehicle that drives over the road.
        options: options from the command's parser.
        time: sample times of the run [s], shape (T,).

    Raises:
        InputError: options contradict each other, or the vehicle cannot be driven over the road.
    """

    choice = FEATURES.load("roads by name").choose_road(road_text(options))
    choice = replace(choice, loads=(*choice.loads, *map(FEATURES.load("loads by name").choose_load, options.loads)))
    if "seed" in options.given and not choice.random:
        raise InputError(f"--seed selects a random road, but the road {choice.text!r} is not random; omit --seed")
    if "speed" in options.given and isinstance(choice.road, FEATURES.load("rigs").Rig):
        raise InputError("--speed does not apply to a test rig, on which the vehicle does not move; omit --speed")
    road = choice.build(vehicle, options.speed, options.seed, options.speed * options.duration)
    with error_in(f"road {choice.text!r}:"):
        road.check(vehicle, time)
    return road


def gaps(road: "Road", duration: float) -> list[str]:
    """Returns remarks about a road from a file: a wide gap between its points, or heights that are implausible for a road.

    Only the part of the road over which the vehicle drives within `duration` [s] is checked.
    """
    from models.roads.road import Departure

    felt = road.from_start
    profile: Any = felt.road if isinstance(felt, Departure) else None
    return (
        [f"remark: {remark}"]
        if isinstance(profile, FEATURES.load("measured roads").Profile) and (remark := profile.remark(road.speed * duration))
        else []
    )


def starts_later(options: argparse.Namespace) -> bool:
    """Returns True if the vehicle starts after the first point of a road that is read from a file."""
    file = FILE.fullmatch(split_off(road_text(options))[0])
    return file is not None and ":from=" in file["settings"]


def end_lines(road: "Road", duration: float) -> list[str]:
    """Returns the lines to print if a road from a file is shorter or longer than the run; empty if road and run have equal
    lengths.

    Args:
        road: road over which the vehicle drives.
        duration: duration of the run [s].
    """

    ends = road.duration
    if road.points is None or math.isclose(ends, duration, rel_tol=FEATURES.load("ride of a run").NEARLY):
        return []
    if ends > duration:
        return wrap_text(f"The run covers {percent(duration / ends)} of the road; --duration {rough(ends)} covers the whole road")
    lower = (
        f"the road has points for only {rough(ends)} s of the {duration:g}-s run. The straight road after its last point "
        "lowers every rms"
    )
    return wrap_text(f"{lower} value; --duration {rough(ends)} ends the run at the road's last point")


def road_text(options: argparse.Namespace) -> str:
    """Returns the road that `--class`, `--road` and `--from` request, as text in the syntax of `--road`."""
    if (start := vars(options)["from"]) is not None:
        road, loads = split_off(options.road or "")
        if (named_file(road) or ("", ""))[1] != "profile":
            raise InputError("--from applies only to a road that is read from a file; give a file with --road, or omit --from")
        return PLUS.join([f"{road}:from={start!r}", *loads])
    if options.road_class is None:
        return options.road or ("flat" if options.loads and "seed" not in options.given else "iso8608:class=C")
    if options.road is not None:
        raise InputError(
            "--class and --road cannot be combined, because --class C means --road iso8608:class=C; omit one of the two"
        )
    return f"iso8608:class={options.road_class.upper()}"


def _seed(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not an integer") from None
