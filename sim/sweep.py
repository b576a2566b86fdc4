"""`python -m sim.sweep`: the paper's Fig. 3, measured: frequency responses and the H-infinity norm, in MuJoCo and in analysis."""

import argparse
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from models.common.arrays import Array
from models.common.command import Parser, chosen, run_command
from models.common.errors import InputError
from models.vehicle import Vehicle, read_vehicle
from sim.command.asked import Asked
from sim.command.outputs import check_outputs, written, written_lines
from sim.figures.picture import draw
from sim.frequency.extremes import DURATION, Extremes, extremes
from sim.frequency.identification import HIGHEST, LOWEST, Lines, ideal_measurements, identify
from sim.recording.run_log import RunLog
from sim.roads.description import described_road
from sim.roads.sinusoids import Multisine, sinusoid
from sim.runs.run import run_all, sample_times
from sim.runs.words import log_lines
from synth.controller import Controller, Designer

FIGURE_3 = ("passive", "state", "I", "II")
TOLERANCE = 1e-4  # of the response at a line; RK4's own error at 1 ms is 3e-6, so more is no frequency response of this loop
ABOVE = 1e-5  # above the norm, relative: RK4's own error again
REACHED = 1e-3  # below the norm
WIDTH = 38  # of the column of names

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
        draw(sweep_figure(vehicle, lines, options.amplitude, options.timestep, options.speed), options.picture)

    result = {
        "sweeps": [sweep_object(one) for one in sweeps],
        "amplitude": options.amplitude,
        "timestep": options.timestep,
        "speed": options.speed,
    }
    logs = {"mcap": None, "layout": None, "rerun": None}
    if options.logs is not None:
        from sim.recording.provenance import record_runs

        logs = record_runs(options.logs, options.command_line, vehicle, names, _worst_runs(vehicle, sweeps, options), result)
    if options.json:
        print(json.dumps({**result, **written(outputs), "logs": logs}, allow_nan=False))
    else:
        count = len(sweeps[0].lines.omega)
        print(
            f"{vehicle.kind.name} ({vehicle.source}), {count} lines from {LOWEST:g} to {HIGHEST:g} Hz on roads of "
            f"{options.amplitude:g} m, at {options.timestep:g} s"
        )
        for one in sweeps:
            print("\n".join(["", *sweep_lines(one)]))
        print("\n".join(written_lines(outputs)), end="\n" if options.picture else "")
        if options.logs is not None:
            print("\n".join(["", *log_lines(logs)]))
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


@dataclass(frozen=True, eq=False)
class Sweep:
    """What was found of one controller: its frequency response, and the most that it lets through."""

    lines: Lines
    extremes: Extremes

    @property
    def ended(self) -> tuple[str, ...]:
        """What ended the linear regime, in whichever run."""
        return tuple(dict.fromkeys((*self.lines.ended, *self.extremes.ended)))

    @property
    def gains(self) -> dict[str, float]:
        """L2 gain by road."""
        return {**self.extremes.gains, "chirp": self.lines.gain}


def sweep(vehicle: Vehicle, controllers: Sequence[Controller], amplitude: float, timestep: float, speed: float) -> list[Sweep]:
    """Everything, of every controller. Arguments and errors as for `sim.frequency.identification.identify`."""
    lines = identify(vehicle, controllers, amplitude, timestep, speed)
    most = extremes(vehicle, controllers, amplitude, timestep, speed)
    return [Sweep(*pair) for pair in zip(lines, most, strict=True)]


def failures(one: Sweep) -> list[str]:
    """The claims that do not hold of a sweep, in words."""
    failed = []
    error, norm = float(one.lines.error(one.lines.sampled).max()), one.extremes.worst.gain
    if not error <= TOLERANCE:
        failed.append(f"a line is {error:.1e} off the sampled response; {TOLERANCE:g} is allowed")
    for invariant in one.extremes.invariants:
        if not invariant.error <= invariant.allowed:
            failed.append(f"{invariant.name} is {invariant.error:.1e} off its invariant; {invariant.allowed:.1e} is allowed")
    if not one.extremes.lti:
        return failed
    for name, gain in one.gains.items():
        if not gain <= norm * (1 + ABOVE):
            failed.append(f"the {name} has an L2 gain of {gain:.7g}, above the norm {norm:.7g}")
    if not one.gains["worst sinusoid"] >= norm * (1 - REACHED):
        failed.append(f"the worst sinusoid reaches {one.gains['worst sinusoid']:.7g} of the norm {norm:.7g} only")
    return failed


def sweep_lines(one: Sweep) -> list[str]:
    """A sweep in words and numbers."""
    norm, failed, found = one.extremes.worst, failures(one), one.lines
    sampled, continuous = found.error(found.sampled), found.error(found.continuous)
    lines = [
        f"controller {found.controller.name}",
        f"  {'largest relative error over the lines:':{WIDTH}}{'to sampled':>12}{'to continuous':>16}",
    ]
    lines += [
        f"  {name:{WIDTH}}{a:12.1e}{b:16.1e}"
        for name, a, b in zip(found.outputs, sampled.tolist(), continuous.tolist(), strict=True)
    ]
    if math.isfinite(found.order):
        lines.append(f"  sampled tends to continuous with the timestep to the power {found.order:.2f}")
    for invariant in one.extremes.invariants:
        lines.append(
            f"  |{invariant.name}| = {invariant.measured:.6f} at {invariant.omega:.2f} rad/s, {invariant.expected:.6f} for any "
            f"suspension ({invariant.error:.1e} off)"
        )
    lines.append(
        f"  norm of the sampled loop, one road under all wheels: {norm.gain:.7g} at {norm.omega:.5g} rad/s; of the "
        f"continuous one, any road under any wheel: {_norm(one):.7g}"
    )
    gains = ", ".join(f"{name} {gain:.5g}" for name, gain in one.gains.items() if name != "worst sinusoid")
    shares = one.gains["worst sinusoid"] / norm.gain
    lines.append(f"  L2 gains in MuJoCo: worst sinusoid {one.gains['worst sinusoid']:.7g} ({100 * shares:.4f} %), {gains}")
    if not one.extremes.lti:
        lines.append("  the controller is slower than the timestep, so its loop has harmonics: the norm is without them")
    if one.ended:
        lines.append(
            f"  outside the linear regime: {', '.join(one.ended)}; what physics does there is shown, and is no disagreement"
        )
    elif failed:
        lines += [f"  DOES NOT AGREE: {text}" for text in failed]
    else:
        norm_too = "and the norm as the largest gain" if one.extremes.lti else "without the norm"
        lines.append(f"  agrees: every line, the invariants, {norm_too}")
    return lines


def sweep_object(one: Sweep) -> dict[str, Any]:
    """A sweep as JSON has it: SI units, complex numbers as [real, imaginary], None for what does not exist."""

    def pairs(values) -> list[list[float | None]]:
        return [[_finite(value.real), _finite(value.imag)] for value in values]

    found, norm = one.lines, one.extremes.worst
    error = {"sampled": found.error(found.sampled), "continuous": found.error(found.continuous)}
    return {
        "controller": found.controller.name,
        "omega": found.omega.tolist(),
        "signals": {
            name: {
                "measured": pairs(found.measured[:, i]),
                "sampled": pairs(found.sampled[:, i]),
                "continuous": pairs(found.continuous[:, i]),
                "error": {key: _finite(value[i]) for key, value in error.items()},
            }
            for i, name in enumerate(found.outputs)
        },
        "order": _finite(found.order),
        "invariants": [
            {"name": i.name, "omega": i.omega, "expected": i.expected, "measured": _finite(i.measured)}
            for i in one.extremes.invariants
        ],
        "norm": {"sampled": norm.gain, "peak_frequency": norm.omega, "continuous": _finite(_norm(one))},
        "gains": {name: _finite(gain) for name, gain in one.gains.items()},
        "ended": list(one.ended),
        "failures": failures(one),
    }


def _worst_runs(vehicle: Vehicle, sweeps: Sequence[Sweep], options: Any) -> "list[RunLog]":
    """Every controller on its worst sinusoid, from rest, to be recorded."""
    from sim.recording.provenance import run_log

    vehicle, found = ideal_measurements(vehicle), []
    time = _worst_times(vehicle, options)
    for one in sweeps:
        road = _worst_road(one.extremes.tried, options)
        found.append(run_log(vehicle, road, run_all(vehicle, [one.lines.controller], road, time)[0]))
    return found


def _worst_times(vehicle: Vehicle, options: argparse.Namespace) -> Array:
    return sample_times(ideal_measurements(vehicle), DURATION, options.timestep)


def _worst_road(omega: float, options: argparse.Namespace) -> Multisine:
    return sinusoid(omega, options.speed).scaled(options.amplitude / 2)


def _norm(one: Sweep) -> float:
    return one.lines.controller.certificate.norm.value


def _finite(value: Any) -> float | None:
    return float(value) if math.isfinite(value) else None


def parser() -> Parser:
    """The options."""
    parser = Parser("sim.sweep", "Identifies frequency responses in MuJoCo and compares them with the linear analysis.", EPILOG)
    parser.add_what("default: passive, state, I and II")
    parser.add_number("--amplitude", 1e-4, "m", "largest height of every road; larger ones meet the vehicle's limits")
    parser.add_number("--speed", 12.5, "m/s", "forward speed; only the later wheels of longer vehicles notice")
    parser.add_number("--timestep", 1e-3, "s", "integration step and sample period of the controller")
    parser.add_logs("every controller on its worst sinusoid")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="draw the responses, as .png or .svg; needs matplotlib")
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    return parser


if __name__ == "__main__":
    run_command(main)
