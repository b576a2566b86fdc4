"""Options of `sim.drive`."""

import argparse
import math
from dataclasses import replace
from typing import TYPE_CHECKING

from models.common.command import Parser
from models.common.errors import InputError, error_in
from models.common.printed import percent, wrapped
from models.vehicle.names import CLASSES, PLUS, ROAD_SYNTAX, named_file, split_off
from sim.command.road_options import add_loads, add_run_options, add_vehicles

if TYPE_CHECKING:
    from models.common.arrays import Array
    from models.roads.choice import RoadChoice
    from models.roads.road import Road
    from models.vehicle.vehicle import Vehicle

NEARLY = 0.01  # relative: so much longer or shorter than its road a run may be without a word

EPILOG = """
exit code: 0 MuJoCo and linear analysis agree for every controller, and the energy balances; 1 they disagree, or a controller
cannot be designed; 2 invalid input. A run that diverges or fully compresses a tyre ends there, without metrics.

examples:
  python -m sim.drive --controller I --class C --speed 20
  python -m sim.drive --controller passive --controller I --road pothole:depth=0.06:length=1.5 --speed 10
  python -m sim.drive --controller I --road step:height=0.04 --band 5
  python -m sim.drive --controller I --road measured.csv --speed 15 --json
  python -m sim.drive --controller I --road survey.txt:separator=semicolon:columns=1,3:height_unit=mm --speed 15
  python -m sim.drive --vehicle full_car --controller I --class B --seed 7
  python -m sim.drive --vehicle my_car.toml --vehicle van.toml --controller all --class C --speed 25
  python -m sim.drive --vehicle my_car.toml --controller mine --road bump --without noise --without delay
  python -m sim.drive --vehicle full_car --controller I --road rig:file=drive.csv --duration 30
  python -m sim.drive --vehicle full_car --controller I --load brake:g=0.5 --load corner:g=0.3
"""


def parser() -> Parser:
    """The options."""
    parser = Parser(
        "sim.drive",
        "Drive over a road in MuJoCo and in linear analysis, compare the responses, measure the ride, and record it.",
        EPILOG,
    )
    add_vehicles(parser)
    add_road(parser, "C")
    add_loads(parser, "load on the body; the road is flat if no road is given")
    parser.add_number(
        "--band", 2.0, "percent", "half-width of the settling band for --road step, relative to the step or to a signal's peak"
    )
    add_run_options(parser, 20.0)
    return parser


def add_road(parser: Parser, default: str) -> None:
    """Adds `--class` with its default in words, `--seed`, `--road`, `--from` and `--speed`."""
    parser.add_argument(
        "--class",
        dest="road_class",
        metavar="CLASS",
        help=f"random road of ISO 8608, {CLASSES[0]} to {CLASSES[-1]} (default: {default})",
    )
    parser.add_argument("--seed", type=_seed, default=0, metavar="N", help="seed of the random road (default: 0)")
    parser.add_argument("--road", metavar="ROAD", help=f"road instead of --class: {ROAD_SYNTAX}".replace("%", "%%"))
    parser.add_number(
        "--from",
        None,
        "m",
        "start of the vehicle on a road from a file, in metres even if the file has another unit",
        "first point",
    )
    parser.add_number("--speed", 20.0, "m/s", "speed of the vehicle; other units, such as 90km/h, are allowed")


def requested_road(vehicle: "Vehicle", options: argparse.Namespace, time: "Array") -> "Road":
    """Returns the requested road, if it can be driven."""
    from models.roads.choice import choose_road
    from models.roads.load_choice import choose_load

    choice = choose_road(road_text(options))
    choice = replace(choice, loads=(*choice.loads, *map(choose_load, options.loads)))
    if "seed" in options.given and not choice.random:
        raise InputError(f"--seed chooses a random road, and {choice.text!r} is not random; omit it")
    if "speed" in options.given and choice.kind == "rig":
        raise InputError("--speed does not apply to a rig, on which the vehicle stands still; omit it")
    road = _built(vehicle, options, choice)
    with error_in(f"road {choice.text!r}:"):
        road.check(vehicle, time)
    return road


def gaps(road: "Road", duration: float) -> list[str]:
    """Returns a remark on a wide gap between the points of a road from a file that are driven in a time [s]."""
    from models.roads.profile import Profile
    from models.roads.road import Departure

    felt = road.from_start
    profile = felt.road if isinstance(felt, Departure) else None
    return [f"remark: {remark}"] if isinstance(profile, Profile) and (remark := profile.gap(road.speed * duration)) else []


def starts_later(options: argparse.Namespace) -> bool:
    """True if the vehicle is to start later on a road from a file than at its first point."""
    from models.roads.choice import driven

    return "from" in driven(split_off(road_text(options))[0])


def end_lines(road: "Road", duration: float) -> list[str]:
    """Returns a line on a road from a file that ends before the run, of this duration [s], or after it."""
    ends = road.duration
    if road.points is None or math.isclose(ends, duration, rel_tol=NEARLY):
        return []
    if ends > duration:
        return wrapped(f"{percent(duration / ends)} of the road is driven: --duration {ends:.4g} drives all of it")
    lower = f"the road's points end at {ends:.4g} s of {duration:g} s; it is straight from there on, which lowers every rms"
    return wrapped(f"{lower}: --duration {ends:.4g} measures the road alone")


def road_text(options: argparse.Namespace) -> str:
    """Returns the text of the requested road."""
    if (start := vars(options)["from"]) is not None:
        road, loads = split_off(options.road or "")
        if (named_file(road) or ("", ""))[1] != "profile":
            raise InputError("--from is the start on a road from a file; give a file with --road, or omit --from")
        return PLUS.join([f"{road}:from={start!r}", *loads])
    if options.road_class is None:
        return options.road or ("flat" if options.loads and "seed" not in options.given else "iso8608:class=C")
    if options.road is not None:
        raise InputError("give --class or --road, not both: --class C is --road iso8608:class=C")
    return f"iso8608:class={options.road_class.upper()}"


def _built(vehicle: "Vehicle", options: argparse.Namespace, choice: "RoadChoice") -> "Road":
    return choice.build(vehicle, options.speed, options.seed, options.speed * options.duration)


def _seed(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not an integer") from None
