"""Options of `sim.margins`."""

from pathlib import Path

from models.common.command import Parser
from sim.studies.stability import TIMESTEP

EPILOG = """
errors [%]: every reading is off by a factor of its own, between 1 - error and
1 + error, and of several forces every force, too. Of one force that is an error
of each entry of its gain. What is proved is true of all such errors; found are
the worst, along which MuJoCo looks for the edge. An actuator's lag counts.

exit code: 0 prediction and physics agree, 1 they do not, 2 bad input

examples:
  python -m sim.margins --controller II
  python -m sim.margins --controller I --picture margins.png --logs logs
  python -m sim.margins --controller I --vary sprung_mass:0.8:1.2 --vary suspension_damping:0.5:1
  python -m sim.margins --controller I --vehicle half_car --json
"""


def parser() -> Parser:
    """The options."""
    parser = Parser(
        "sim.margins",
        "Finds how much gain, phase, delay and sample period a loop bears, and how large errors of what it reads.",
        EPILOG,
    )
    parser.add_one("state, or one of the vehicle file's")
    parser.add_number("--timestep", TIMESTEP, "s", "integration step; delays and sample periods are its multiples")
    parser.add_argument(
        "--vary",
        action="append",
        default=[],
        metavar="NAME:LOW:HIGH",
        help="other vehicles: a parameter from LOW to HIGH times the vehicle's own, up to four; by default what the kind says",
    )
    parser.add_logs("MuJoCo on either side of the delay margin")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="draw the margins, as .png or .svg; needs matplotlib")
    parser.add_printed("each loop, norms with errors, rounded numbers and each other vehicle")
    return parser


def late_run(name: str, samples: float) -> str:
    """Returns the name of a run with a delay."""
    return f"{name}_{samples}_samples_late"
