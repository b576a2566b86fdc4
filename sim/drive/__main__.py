"""The command `python -m sim.drive`: simulates controllers over a road, compares the runs with linear analysis, and measures
the ride.
"""

if __name__ == "__main__":
    from models.common.cli import run

    run("sim.drive.__main__")

from collections.abc import Sequence

from models.common.command import Parser
from models.vehicle.names import LOAD_SYNTAX
from sim.command.road_options import add_road, add_run_options, add_start, add_vehicles, requested_road

EPILOG = """
exit code: 0 MuJoCo and linear analysis agree for every controller, every closed loop is stable, and the energy balances; 1 they
disagree, a loop is unstable (not with --allow-unstable), or a controller cannot be designed; 2 invalid input. A run that diverges
or fully compresses a tyre ends early, and has no metrics.

examples:
  roadproof drive --controller I --class C --speed 20
  roadproof drive --controller passive --controller I --road pothole:depth=0.06:length=1.5 --speed 10
  roadproof drive --controller I --road step:height=0.04 --band 5
  roadproof drive --controller I --road measured.csv --speed 15 --json
  roadproof drive --controller I --road survey.txt:separator=semicolon:columns=1,3:height_unit=mm --speed 15
  roadproof drive --vehicle full_car --controller I --class B --seed 7
  roadproof drive --vehicle my_car.toml --vehicle van.toml --controller all --class C --speed 25
  roadproof drive --vehicle my_car.toml --controller mine --road bump --without noise --without delay
  roadproof drive --vehicle full_car --controller I --road rig:file=drive.csv --duration 30
  roadproof drive --vehicle my_car.toml --controller mine --road bump --beside rig.lvm --beside-start 2.35
  roadproof drive --vehicle full_car --controller I --load brake:g=0.5 --load corner:g=0.3
"""


def parser() -> Parser:
    """Returns the parser of the command's options."""
    parser = Parser(
        "sim.drive",
        "Drive over a road in MuJoCo and in linear analysis, compare the responses, measure the ride, and record it.",
        EPILOG,
    )
    add_vehicles(parser)
    add_start(parser)
    add_road(parser, "C")
    parser.add_loads("load on the body; the road is flat if no road is given", LOAD_SYNTAX)
    parser.add_number(
        "--band", 2.0, "percent", "half-width of the settling band for --road step, relative to the step or to a signal's peak"
    )
    parser.add_number(
        "--settle",
        None,
        "s",
        "time at the start of a random road without metrics",
        "until all controllers have settled",
    )
    add_run_options(parser, 20.0)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command and returns its exit code.

    Raises:
        InputError: an option, the vehicle file, the road or the folder for logs is invalid.
    """
    options = parser().parse_args(arguments)
    from sim.command.driving import drive

    return drive(options, requested_road, lambda road: road.words, rides=True)
