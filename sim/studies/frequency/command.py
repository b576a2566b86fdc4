"""The study of frequency responses (Fig. 3 of the paper), largest gains and the H-infinity norm, all measured in MuJoCo."""

from pathlib import Path

from models import USUAL_TIMESTEP
from models.common.command import Parser
from sim.studies.study import Study


class SweepCommand(Study):
    """Printed texts and command options of `sim.studies.frequency.study.SweepStudy`."""

    description = "Measure frequency responses in MuJoCo and compare them with linear analysis."
    epilog = """
Linear analysis does not apply to a control law in Python. The law is simulated over one sinusoid at a time, and the output
contains the fundamental and the energy at other frequencies.

exit code: 0 every claim holds, or the output shows how MuJoCo left the linear regime; 1 a claim fails, a controller cannot be
designed, or every run of a law diverged, so that nothing is measured; 2 invalid input

examples:
  roadproof sweep --picture sweep.png
  roadproof sweep --controller I --amplitude 0.05
  roadproof sweep --vehicle half_car --controller all --json
"""
    page = "docs/how-to/sweep.md"
    takes = "several"
    usual = ("passive", "state", "I", "II")
    seconds = 5.0
    # Names of the stages, equal to the constants LINES, EXTREMES and OWN of `sim.studies.frequency.sweep`
    stages = ("frequency responses", "norms", "laws in Python")

    def add_options(self, parser: Parser) -> None:
        parser.add_controller_and_vehicle("default: passive, state, I and II")
        parser.add_number("--amplitude", 1e-4, "m", "largest height of each road; a larger height can reach the vehicle's limits")
        parser.add_number("--speed", 12.5, "m/s", "speed of the vehicle; affects only vehicles with rear wheels")
        parser.add_number("--timestep", USUAL_TIMESTEP, "s", "integration step and sample period of the controller")
        parser.add_exported()
        parser.add_logs("runs of each controller over its worst sinusoid")
        parser.add_argument(
            "--picture", type=Path, metavar="FILE", help="draw the responses (.png, .svg or .pdf); needs matplotlib"
        )
        parser.add_printed("invariants, sampled norms and EUSAMA's minimum loads")
