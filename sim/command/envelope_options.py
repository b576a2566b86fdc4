"""Options of `sim.envelope`."""

from pathlib import Path

from models import USUAL_TIMESTEP
from models.common.command import Parser
from models.vehicle.names import BUMP_HEIGHT, BUMP_LENGTH, BUMP_SPEED
from sim.command.road_options import add_loads

EPILOG = """
exit code: 0 physics breaks first what linear analysis predicts, 1 it does not, 2 bad input,
130 interrupted

examples:
  python -m sim.envelope --controller I --vary height:0.02:0.3:20 --vary speed:3:30:20 --picture envelope.png
  python -m sim.envelope --controller I --vary height:0.02:0.6:30 --speed 12.5
  python -m sim.envelope --controller II --vary length:1:10:30 --vary speed:4:30:30 --height 0.08 --csv envelope.csv
"""


def parser() -> Parser:
    """The options."""
    parser = Parser(
        "sim.envelope", "Maps where linear analysis holds over bumps, and what breaks first where it does not.", EPILOG
    )
    parser.add_one("passive, state, or one of the vehicle file's")
    parser.add_argument(
        "--vary",
        action="append",
        metavar="NAME:LOW:HIGH:COUNT",
        help="an axis: height, length or speed; give one or two",
    )
    parser.add_number("--height", BUMP_HEIGHT, "m", "bump height, where it is not varied")
    parser.add_number("--length", BUMP_LENGTH, "m", "bump length, where it is not varied")
    parser.add_number("--speed", BUMP_SPEED, "m/s", "forward speed, where it is not varied")
    add_loads(parser, "pushes the body over every bump")
    parser.add_number("--threshold", 0.05, "-", "largest error at which linear analysis is said to hold, as a share of a peak")
    parser.add_number("--duration", 3.0, "s", "how long every run is")
    parser.add_number("--timestep", USUAL_TIMESTEP, "s", "integration step and sample period of the controller")
    parser.add_logs("the cells nearest to where something breaks")
    parser.add_argument("--csv", type=Path, metavar="FILE", help="write every cell's numbers")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="draw the map, as .png or .svg; needs matplotlib")
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    return parser


def nearest_run(controller: str, end: int) -> str:
    """Returns the name of a run by its first event, an index into `REGIME_ENDS`, or -1 for no event."""
    from sim.response.regime import END_NAMES

    what = "nothing_breaks" if end < 0 else END_NAMES[end].replace(" ", "_").replace("-", "_")
    return f"{controller}_{what}"
