"""Options of `sim.margins`."""

from pathlib import Path

from models.common.command import Parser
from sim.studies.stability import TIMESTEP

EPILOG = """
errors [%]: each measurement has a factor of its own between 1 - error and 1 + error. With several forces, so has each force. With
one force, this equals an error of each entry of the gain. The proof holds for all such errors. The search finds the worst errors,
and MuJoCo finds the stability limit along them. The lag of the actuators is included.

exit code: 0 prediction and MuJoCo agree; 1 they disagree; 2 invalid input

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
        "Find the margins of a loop for gain, phase, delay, sample period and errors of the measurements.",
        EPILOG,
    )
    parser.add_one("state, or a controller of the vehicle file")
    parser.add_number("--timestep", TIMESTEP, "s", "integration step; delays and sample periods are multiples of it")
    parser.add_argument(
        "--vary",
        action="append",
        default=[],
        metavar="NAME:LOW:HIGH",
        help="vary up to four parameters from LOW to HIGH times their value (default: the parameters of the vehicle type)",
    )
    parser.add_logs("MuJoCo runs on both sides of the delay margin")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="draw the margins (.png or .svg); needs matplotlib")
    parser.add_printed("each loop, norms with errors, effects of rounding, and each varied vehicle")
    return parser


def late_run(name: str, samples: float) -> str:
    """Returns the name of a run with a delay."""
    return f"{name}_{samples}_samples_late"
