"""`python -m sim.sweep`: the paper's Fig. 3, measured: frequency responses and the H-infinity norm, in MuJoCo and in analysis."""

if __name__ == "__main__":
    from models.common.cli import run

    run("sim.sweep")

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from models import USUAL_TIMESTEP
from models.common.command import Parser, chosen, print_json, remarked
from models.common.errors import InputError
from models.common.printed import Stages, say, titled
from sim.command.road_options import USUAL, add_exported, left_out_lines, omitted_controllers

if TYPE_CHECKING:
    from models.vehicle.vehicle import Vehicle
    from sim.runs.run import Run
    from sim.studies.frequency.describing_function import DescribingFunction
    from sim.studies.frequency.sweep import Sweep


EPILOG = """
Linear analysis does not apply to a control law in Python. The law is simulated over one sinusoid at a time, and the output
contains the fundamental and the energy at other frequencies.

exit code: 0 every claim holds, or the output shows how MuJoCo left the linear regime; 1 a claim fails, a controller cannot be
designed, or every run of a law diverged, so that nothing is measured; 2 invalid input

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
    parser.add_number("--speed", 12.5, "m/s", "speed of the vehicle; affects only vehicles with rear wheels")
    parser.add_number("--timestep", USUAL_TIMESTEP, "s", "integration step and sample period of the controller")
    add_exported(parser)
    parser.add_logs("runs of each controller over its worst sinusoid")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="draw the responses (.png, .svg or .pdf); needs matplotlib")
    parser.add_printed("errors of each signal, invariants, sampled norms and EUSAMA's minimum loads")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code.

    Raises:
        InputError: bad options or vehicle file.
    """
    options = parser().parse_args(arguments)
    from models.document.outputs import check_outputs, written, written_lines
    from models.vehicle.vehicle import read_vehicle
    from sim.command.comparison import controllers_of, left_out_object, log_lines, recorded, runnable, warn_invalid_certificates
    from sim.studies.frequency.describing_function import describing_function
    from sim.studies.frequency.sweep import EXTREMES, LINES, OWN, holds, sweep, sweep_object
    from synth.vehicle.designer import Designer

    given = remarked(read_vehicle(options.vehicle))
    usual = [name for name in USUAL if name in given.controller_names]
    names = chosen(given.controller_names, options.controller, usual)
    vehicle = given.with_common_actuators(names)
    if not 1e-3 <= options.speed <= 1e3:
        raise InputError(f"speed = {options.speed:g} m/s is not allowed; give a number from 0.001 to 1000 m/s")
    if "speed" in options.given and not any(wheel.behind(vehicle.parameters) for wheel in vehicle.kind.wheels):
        raise InputError(f"--speed affects only rear wheels, but a {vehicle.kind.name} has no rear wheels; omit --speed")
    outputs = {"picture": options.picture}
    check_outputs(outputs | {"logs": options.logs}, vehicle.files)
    stage = Stages("designs", LINES, EXTREMES, OWN, "picture and logs")
    stage("designs")
    designer = Designer(vehicle, search=False)
    controllers = controllers_of(vehicle, names, runnable(vehicle, designer.design, options.timestep), options.exported)
    driven = [one.name for one in controllers]
    how = options.amplitude, options.timestep, options.speed
    warn_invalid_certificates(controllers)
    linear = [one for one in controllers if one.linear is True]
    swept = sweep(vehicle, linear, *how, stage) if linear else []
    stage(OWN)
    own = [describing_function(vehicle, one, *how) for one in controllers if not one.linear]
    stage("picture and logs")
    if options.picture is not None:
        from models.document.figure import styles
        from models.document.picture import write_picture
        from sim.studies.frequency.figure import sweep_figure

        figure = sweep_figure(vehicle, [one.lines for one in swept], *how[1:], styles(tuple(names)), own)
        write_picture(figure, options.picture)

    sweeps: list[Sweep | DescribingFunction] = sorted([*swept, *own], key=lambda one: names.index(one.controller.name))
    result = {
        "sweeps": [sweep_object(one) for one in sweeps],
        **{key: getattr(options, key) for key in ("amplitude", "timestep", "speed")},
        **left_out_object(names, driven),
    }
    logs = recorded(options, given, driven, lambda: _worst_runs(vehicle, sweeps, options), lambda: result)
    stage.end()
    if options.json:
        print_json({**result, **written(outputs), "logs": logs})
    else:
        from models.document.text import text_lines
        from sim.studies.frequency.report import describe, workshop

        found = describe(vehicle, [one.lines for one in swept], swept, own, *how[:2])
        _, *lines = text_lines(found, "full" if options.verbose else "normal")
        if options.verbose and swept:
            lines += ["", *text_lines(workshop(vehicle, swept))]
        elif swept:
            lines.append("  -v adds errors of each signal, invariants, norms and EUSAMA's minimum loads")
        omitted = left_out_lines(omitted_controllers(vehicle, options.controller, names))
        title = titled(f"{found.title} of {vehicle.kind.name}", vehicle.source)
        say([*title, *lines, *written_lines(outputs), *log_lines([logs]), *omitted])
    return 0 if all(map(holds, sweeps)) and len(driven) == len(names) else 1


def _worst_runs(vehicle: "Vehicle", sweeps: "Sequence[Sweep | DescribingFunction]", options: Any) -> "dict[str, Run]":
    """Every controller on its worst sinusoid, from rest, to be recorded."""
    from models.roads.sinusoids import sinusoid
    from sim.runs.run import run_controllers, sample_times
    from sim.studies.frequency.identification import ideal_measurements
    from sim.studies.frequency.worst_case_gain import DURATION

    vehicle, runs = ideal_measurements(vehicle), {}
    time = sample_times(vehicle, DURATION, options.timestep)
    for one in sweeps:
        road = sinusoid(one.worst_omega, options.speed).scaled(options.amplitude / 2)
        (runs[one.controller.name],) = run_controllers(vehicle, [one.controller], road, time)
    return runs
