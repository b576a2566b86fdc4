"""`python -m sim.sweep`: the paper's Fig. 3, measured: frequency responses and the H-infinity norm, in MuJoCo and in analysis."""

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.command import Parser, chosen, run_command
from models.common.errors import InputError
from models.vehicle import Vehicle, read_vehicle
from sim.command.asked import Asked
from sim.command.logs import log_lines, recorded
from sim.command.outputs import check_outputs, written, written_lines
from sim.figures.picture import write_picture
from sim.frequency.extremes import DURATION
from sim.frequency.identification import ideal_measurements
from sim.frequency.sweep import Sweep, failures, sweep, sweep_lines, sweep_object
from sim.recording.run_log import RunLog
from sim.roads.description import described_road
from sim.roads.sinusoids import Multisine, sinusoid
from sim.runs.run import run_all, sample_times
from synth.designer import Designer

FIGURE_3 = ("passive", "state", "I", "II")

EPILOG = """
exit code: 0 every claim holds, or physics has left the linear regime and the text says how; 1 a claim fails, 2 bad input

examples:
  python -m sim.sweep --picture sweep.png
  python -m sim.sweep --controller I --amplitude 0.05
  python -m sim.sweep --vehicle half_car --controller all --json
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code.

    Raises:
        InputError: bad options or vehicle file.
    """
    options = parser().parse_args(arguments)
    vehicle = read_vehicle(options.vehicle)
    names = _names(vehicle, options)
    if not 1e-3 <= options.speed <= 1e3:
        raise InputError(f"speed = {options.speed:g} m/s is not allowed; give a number from 0.001 to 1000")
    if "speed" in options.given and not any(wheel.behind(vehicle.parameters) for wheel in vehicle.kind.wheels):
        raise InputError(f"--speed matters to rear wheels only, and a {vehicle.kind.name} has none; leave it out")
    outputs = {"picture": options.picture}
    check_outputs(outputs | {"logs": options.logs}, [vehicle.source])
    designer = Designer(vehicle)
    controllers = [designer.design(name) for name in names]
    sweeps = sweep(vehicle, controllers, options.amplitude, options.timestep, options.speed)
    if options.picture is not None:
        from sim.frequency.figure import sweep_figure

        lines = [one.lines for one in sweeps]
        write_picture(sweep_figure(vehicle, lines, options.amplitude, options.timestep, options.speed), options.picture)

    result = {
        "sweeps": [sweep_object(one) for one in sweeps],
        "amplitude": options.amplitude,
        "timestep": options.timestep,
        "speed": options.speed,
    }
    logs = recorded(options, vehicle, names, lambda: _worst_runs(vehicle, sweeps, options), result)
    if options.json:
        print(json.dumps({**result, **written(outputs), "logs": logs}, allow_nan=False))
    else:
        hertz = sweeps[0].lines.omega / (2 * np.pi)
        count = len(hertz)
        print(
            f"{vehicle.kind.name} ({vehicle.source}), {count} lines from {hertz[0]:.4g} to {hertz[-1]:.4g} Hz on roads of "
            f"{options.amplitude:g} m, at {options.timestep:g} s"
        )
        for one in sweeps:
            print("\n".join(["", *sweep_lines(one)]))
        print("".join(f"{line}\n" for line in [*written_lines(outputs), *log_lines(logs)]), end="")
    return 0 if all(one.ended or not failures(one) for one in sweeps) else 1


def asked(vehicle: Vehicle, options: argparse.Namespace) -> Asked:
    """What a log of these options holds: worst sinusoids, whose frequencies the command finds itself."""

    def is_it(road: Mapping[str, Any]) -> bool:
        found = described_road(road)
        return isinstance(found, Multisine) and road == _worst_road(found.omega[0], options).describe()

    result = {name: getattr(options, name) for name in ("amplitude", "timestep", "speed")}
    names, ideal = _names(vehicle, options), ideal_measurements(vehicle).implementation
    samples = len(_worst_times(vehicle, options))
    return Asked(names, samples, options.timestep, is_it, lambda name, how: name in names and how == ideal, result)


def _names(vehicle: Vehicle, options: argparse.Namespace) -> list[str]:
    usual = [name for name in FIGURE_3 if name in vehicle.controller_names]
    return chosen(vehicle.controller_names, options.controller, usual)


def _worst_runs(vehicle: Vehicle, sweeps: Sequence[Sweep], options: Any) -> "list[RunLog]":
    """Every controller on its worst sinusoid, from rest, to be recorded."""
    from sim.recording.provenance import run_log

    vehicle, found = ideal_measurements(vehicle), []
    time = _worst_times(vehicle, options)
    for one in sweeps:
        road = _worst_road(one.extremes.tried, options)
        found.append(run_log(run_all(vehicle, [one.lines.controller], road, time)[0]))
    return found


def _worst_times(vehicle: Vehicle, options: argparse.Namespace) -> Array:
    return sample_times(ideal_measurements(vehicle), DURATION, options.timestep)


def _worst_road(omega: float, options: argparse.Namespace) -> Multisine:
    return sinusoid(omega, options.speed).scaled(options.amplitude / 2)


def parser() -> Parser:
    """The options."""
    parser = Parser("sim.sweep", "Identifies frequency responses in MuJoCo and compares them with the linear analysis.", EPILOG)
    parser.add_controller_and_vehicle("default: passive, state, I and II")
    parser.add_number("--amplitude", 1e-4, "m", "largest height of every road; larger ones meet the vehicle's limits")
    parser.add_number("--speed", 12.5, "m/s", "forward speed; only the later wheels of longer vehicles notice")
    parser.add_number("--timestep", 1e-3, "s", "integration step and sample period of the controller")
    parser.add_logs("every controller on its worst sinusoid")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="draw the responses, as .png or .svg; needs matplotlib")
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    return parser


if __name__ == "__main__":
    run_command(main)
