"""Options of `sim.envelope`."""

from pathlib import Path

from models import USUAL_TIMESTEP
from models.common.command import Parser
from models.vehicle.names import BUMP_HEIGHT, BUMP_LENGTH, BUMP_SPEED
from sim.command.road_options import add_loads

EPILOG = """
exit code: 0 MuJoCo first reaches the limit that linear analysis predicts; 1 it first reaches another limit; 2 invalid input;
130 interrupted

examples:
  python -m sim.envelope --controller I --vary height:0.02:0.3:20 --vary speed:3:30:20 --picture envelope.png
  python -m sim.envelope --controller I --vary height:0.02:0.6:30 --speed 12.5
  python -m sim.envelope --controller II --vary length:1:10:30 --vary speed:4:30:30 --height 0.08 --csv envelope.csv
"""


def parser() -> Parser:
    """The options."""
    parser = Parser("sim.envelope", "Map the bumps over which linear analysis is valid, and the limits of the others.", EPILOG)
    parser.add_one("passive, state, or a controller of the vehicle file")
    parser.add_argument(
        "--vary",
        action="append",
        metavar="NAME:LOW:HIGH:COUNT",
        help="axis of the map: height [m], length [m] or speed [m/s], for example height:0.02:0.3:20; give one or two axes",
    )
    parser.add_number("--height", BUMP_HEIGHT, "m", "bump height, if not varied")
    parser.add_number("--length", BUMP_LENGTH, "m", "bump length, if not varied")
    parser.add_number("--speed", BUMP_SPEED, "m/s", "speed of the vehicle, if not varied")
    add_loads(parser, "load on the body over every bump")
    parser.add_number("--threshold", 0.05, "-", "largest error with which linear analysis counts as valid, relative to the peak")
    parser.add_number("--duration", 3.0, "s", "duration of each run")
    parser.add_number("--timestep", USUAL_TIMESTEP, "s", "integration step and sample period of the controller")
    parser.add_logs("the runs closest to each limit")
    parser.add_argument("--csv", type=Path, metavar="FILE", help="write the numbers of every cell (.csv)")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="draw the map (.png or .svg); needs matplotlib")
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    return parser


def nearest_run(controller: str, end: int) -> str:
    """Returns the name of a run by its first event, an index into `REGIME_ENDS`, or -1 for no event."""
    from sim.response.regime import END_NAMES

    what = "nothing_breaks" if end < 0 else END_NAMES[end].replace(" ", "_").replace("-", "_")
    return f"{controller}_{what}"
