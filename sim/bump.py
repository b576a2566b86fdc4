"""`python -m sim.bump`: simulates controllers over a bump in MuJoCo, compares the runs with linear analysis, and writes logs."""

if __name__ == "__main__":
    from models.common.cli import run

    run("sim.bump")

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING

from models.common.command import Parser
from models.vehicle.names import BUMP_HEIGHT, BUMP_LENGTH, BUMP_SPEED
from sim.command.road_options import add_run_options, add_start, add_vehicles

if TYPE_CHECKING:
    from models.common.arrays import Array
    from models.roads.road import Bump
    from models.vehicle.vehicle import Vehicle

EPILOG = """
exit code: 0 MuJoCo and linear analysis agree for every controller, every closed loop is stable, and the energy balances; 1 they
disagree, a loop is unstable (not with --allow-unstable), or a controller cannot be designed; 2 invalid input

examples:
  roadproof bump --controller I
  roadproof bump --controller I --controller II --height 0.05
  roadproof bump --controller all --serve
  roadproof bump --controller mine --vehicle my_car.toml --json
  roadproof bump --controller mine --vehicle my_car.toml --vehicle van.toml --without noise
"""


def parser() -> Parser:
    """Returns the command-line parser of the command."""
    parser = Parser(
        "sim.bump", "Drive over one bump in MuJoCo and in linear analysis, compare the responses, and record them.", EPILOG
    )
    add_vehicles(parser)
    add_start(parser)
    parser.add_number("--height", BUMP_HEIGHT, "m", "bump height")
    parser.add_number("--length", BUMP_LENGTH, "m", "bump length")
    parser.add_number("--speed", BUMP_SPEED, "m/s", "speed of the vehicle; other units, such as 90km/h, are allowed")
    parser.add_argument(
        "--track",
        choices=("left", "right", "both"),
        default="both",
        help="side of the vehicle that drives over the bump (default: both)",
    )
    add_run_options(parser, 3.0)
    return parser


def requested_road(vehicle: "Vehicle", options: argparse.Namespace, time: "Array") -> "Bump":
    """Returns the bump that the command-line options describe. The array `time` contains the sample times of the run [s], shape
    (T,).

    Raises:
        InputError: the vehicle cannot be driven over the bump.
    """
    from models.roads.road import Bump

    road = Bump(options.height, options.length, options.speed, options.track)
    road.check(vehicle, time)
    return road


def words(road: "Bump") -> str:
    """Returns a text that describes a bump."""
    wheels = "" if road.track == "both" else f", {road.track} wheels only"
    return f"a bump {road.height:g} m high and {road.length:g} m long at {road.speed:g} m/s{wheels}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code.

    Raises:
        InputError: an option, a vehicle file or the logs folder is invalid.
    """
    options = parser().parse_args(arguments)
    from sim.command.driving import drive

    return drive(options, requested_road, words)
