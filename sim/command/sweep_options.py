"""Options of `sim.sweep`."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from models import USUAL_TIMESTEP
from models.common.command import Parser, chosen
from sim.command.road_options import USUAL, add_exported

if TYPE_CHECKING:
    from models.common.arrays import Array
    from models.roads.sinusoids import Multisine
    from models.vehicle.vehicle import Vehicle

EPILOG = """
Linear analysis does not apply to a control law in Python. The law runs over one sinusoid at a time, and the output contains the
fundamental and the energy at other frequencies.
exit code: 0 every claim holds, or the output shows how MuJoCo left the linear regime; 1 a claim fails, or every run of a law
diverged, so that nothing is measured; 2 invalid input

examples:
  python -m sim.sweep --picture sweep.png
  python -m sim.sweep --controller I --amplitude 0.05
  python -m sim.sweep --vehicle half_car --controller all --json
"""


def parser() -> Parser:
    """The options."""
    parser = Parser("sim.sweep", "Measure frequency responses in MuJoCo and compare them with linear analysis.", EPILOG)
    parser.add_controller_and_vehicle("default: passive, state, I and II")
    parser.add_number("--amplitude", 1e-4, "m", "largest height of each road; a larger height can reach the vehicle's limits")
    parser.add_number("--speed", 12.5, "m/s", "speed of the vehicle; matters only if there are rear wheels")
    parser.add_number("--timestep", USUAL_TIMESTEP, "s", "integration step and sample period of the controller")
    add_exported(parser)
    parser.add_logs("each controller over its worst sinusoid")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="draw the responses (.png or .svg); needs matplotlib")
    parser.add_printed("every signal, invariant and road of each controller, as for a single controller")
    return parser


def requested_names(vehicle: "Vehicle", options: argparse.Namespace) -> list[str]:
    """Returns the names of the requested controllers."""
    usual = [name for name in USUAL if name in vehicle.controller_names]
    return chosen(vehicle.controller_names, options.controller, usual)


def worst_times(vehicle: "Vehicle", options: argparse.Namespace) -> "Array":
    """Sample times of a run on a worst sinusoid [s]."""
    from sim.runs.run import sample_times
    from sim.studies.frequency.identification import ideal_measurements
    from sim.studies.frequency.worst_case_gain import DURATION

    return sample_times(ideal_measurements(vehicle), DURATION, options.timestep)


def worst_road(omega: float, options: argparse.Namespace) -> "Multisine":
    """Returns the road of a frequency [rad/s] with the requested height."""
    from models.roads.sinusoids import sinusoid

    return sinusoid(omega, options.speed).scaled(options.amplitude / 2)
