"""The study of margins for gain, phase, delay and sample period, both predicted by linear analysis and found in MuJoCo."""

from pathlib import Path

from models.common.command import Parser
from sim.studies.stability import TIMESTEP
from sim.studies.study import Study


class MarginsCommand(Study):
    """Printed texts and command options of `sim.studies.stability.study.MarginsStudy`."""

    description = "Find the margins of a control loop for gain, phase, delay and sample period."
    epilog = """
exit code: 0 prediction and MuJoCo agree; 1 they disagree, or the controller cannot be designed; 2 invalid input

examples:
  roadproof margins --controller II
  roadproof margins --controller I --picture margins.png --logs logs
  roadproof margins --controller I --vehicle half_car --json
"""
    page = "docs/how-to/margins.md"
    details = "phase, disk margin and sample period of each loop"
    stages = ("margins",)
    seconds = 10.0

    def add_options(self, parser: Parser) -> None:
        parser.add_one("state, or a controller of the vehicle file")
        parser.add_number("--timestep", TIMESTEP, "s", "integration step; delays and sample periods are multiples of it")
        parser.add_gone("--vary", "give the controller these vehicles as a family, whose norms synth proves, or run a campaign")
        parser.add_logs("MuJoCo runs on both sides of the delay margin")
        parser.add_argument(
            "--picture", type=Path, metavar="FILE", help="draw the margins (.png, .svg or .pdf); needs matplotlib"
        )
        parser.add_printed("each loop")
