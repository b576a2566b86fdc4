"""The study of validity: a map of the bumps for which linear analysis is valid; the axes of the map are height, length or
speed.
"""

from pathlib import Path

from models import USUAL_TIMESTEP
from models.common.command import Parser
from models.vehicle.names import BUMP_HEIGHT, BUMP_LENGTH, BUMP_SPEED, LOAD_SYNTAX
from sim.studies.study import Study


class EnvelopeCommand(Study):
    """Printed texts and command options of `sim.studies.validity.study.EnvelopeStudy`."""

    description = "Map the bumps over which linear analysis is valid, and the limits that end it."
    epilog = """
exit code: 0 MuJoCo first reaches the limit that linear analysis predicts; 1 it first reaches another limit, or the controller
cannot be designed; 2 invalid input; 130 interrupted

examples:
  roadproof envelope --controller I --vary height:0.02:0.3:20 --vary speed:3:30:20 --picture envelope.png
  roadproof envelope --controller I --vary height:0.02:0.6:30 --speed 12.5
  roadproof envelope --controller II --vary length:1:10:30 --vary speed:4:30:30 --height 0.08 --csv envelope.csv
"""
    page = "docs/how-to/envelope.md"
    stages = ("map",)
    seconds = 8.0

    def add_options(self, parser: Parser) -> None:
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
        parser.add_loads("load on the body over every bump", LOAD_SYNTAX)
        parser.add_number("--threshold", 0.05, "-", "linear analysis is valid up to this error, relative to the peak")
        parser.add_number("--duration", 3.0, "s", "duration of each run")
        parser.add_number("--timestep", USUAL_TIMESTEP, "s", "integration step and sample period of the controller")
        parser.add_argument("--every-cell", action="store_true", help="simulate every cell of the map; takes ten times as long")
        parser.add_logs("the runs closest to each limit")
        parser.add_argument("--csv", type=Path, metavar="FILE", help="write the numbers of every cell (.csv)")
        parser.add_argument("--picture", type=Path, metavar="FILE", help="draw the map (.png, .svg or .pdf); needs matplotlib")
        parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
