"""What `sim.bump` can be asked for."""

import argparse

from models.common.command import Parser, chosen
from models.roads.road import Bump
from models.vehicle import Vehicle
from sim.asked.asked import Asked
from sim.asked.options import add_run_options
from sim.runs.run import sample_times

EPILOG = """
exit code: 0 physics and analysis agree for every controller and energy balances, 1 not, 2 bad input

examples:
  python -m sim.bump --controller I
  python -m sim.bump --controller I --controller II --height 0.05
  python -m sim.bump --controller all --serve
  python -m sim.bump --controller mine --vehicle my_car.toml --json
"""


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


def asked(vehicle: Vehicle, options: argparse.Namespace) -> Asked:
    """What a log of these options holds."""
    names = chosen(vehicle.controller_names, options.controller)
    samples = len(sample_times(vehicle, options.duration, options.timestep))
    return Asked(
        names,
        samples,
        options.timestep,
        lambda road: road == asked_road(options).describe(),
        lambda name, how: name in names and how == vehicle.implementation,
    )


def asked_road(options: argparse.Namespace) -> Bump:
    """The bump that was asked for."""
    return Bump(options.height, options.length, options.speed, options.track)
