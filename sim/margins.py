"""`python -m sim.margins`: how much gain, phase, delay and sample period a loop bears, predicted and then found in MuJoCo."""

import argparse
import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from models.common.command import Parser, one_chosen, run_command
from models.common.errors import InputError
from models.reality import Implementation
from models.vehicle import Vehicle, read_vehicle
from sim.command.asked import Asked
from sim.command.outputs import check_outputs, written, written_lines
from sim.command.progress import show
from sim.figures.picture import draw
from sim.linear.loop import sampled_radius
from sim.recording.run_log import RunLog
from sim.runs.run import run_all, sample_times
from sim.runs.words import log_lines
from sim.stability.growth import BUMP, LONGEST, SHORTEST, TIMESTEP
from sim.stability.margins import GainMargin, LoopMargins, find_margins
from sim.stability.robustness import Robustness, robustness, varied_text
from synth.controller import Controller, design

EPILOG = """
exit code: 0 prediction and physics agree, 1 they do not, 2 bad input

examples:
  python -m sim.margins --controller II
  python -m sim.margins --controller I --picture margins.png --logs logs
  python -m sim.margins --controller I --vehicle half_car --json
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code.

    Raises:
        InputError: bad options or vehicle file, or a controller that has no loop to speak of.
    """
    options = parser().parse_args(arguments)
    # What is asked is how much the loop bears beyond an ideal implementation.
    as_built = read_vehicle(options.vehicle)
    vehicle = replace(as_built, implementation=Implementation())
    name = one_chosen(vehicle.controller_names, options.controller)
    outputs = {"picture": options.picture}
    check_outputs(outputs | {"logs": options.logs}, [vehicle.source])
    controller = _with_loop(vehicle, name, options.timestep)

    found = find_margins(vehicle, controller, options.timestep, show)
    box = robustness(vehicle, controller, options.timestep, show)
    if options.picture is not None:
        from sim.stability.figure import margins_figure

        draw(margins_figure(vehicle, controller, found[""], box, options.timestep), options.picture)
    result = {**_object(controller, found, box), "loop": None if as_built.ideal else _which_loop(as_built)}
    logs = {"mcap": None, "layout": None, "rerun": None}
    if options.logs is not None:
        from sim.recording.provenance import record_runs

        runs = _delayed_runs(vehicle, controller, found[""], options.timestep)
        logs = record_runs(options.logs, options.command_line, vehicle, [controller.name], runs, result)
    if options.json:
        print(json.dumps({**result, **written(outputs), "logs": logs}, allow_nan=False))
    else:
        lines = _text(vehicle, controller, found, box, options.timestep)
        if not as_built.ideal:
            lines.insert(1, _which_loop(as_built))
        lines += written_lines(outputs)
        print("\n".join([*lines, *(["", *log_lines(logs)] if options.logs is not None else [])]))
    return 0 if (box is None or box.holds) and all(one.agrees for one in found.values()) else 1


def asked(vehicle: Vehicle, options: argparse.Namespace) -> Asked:
    """What a log of these options holds."""
    name = one_chosen(vehicle.controller_names, options.controller)
    samples, result = len(sample_times(vehicle, SHORTEST, options.timestep)), {"controller": name}
    return Asked(
        [name],
        samples,
        options.timestep,
        lambda road: road == BUMP.describe(),
        lambda run, how: run == _late(name, how.delay) and how == Implementation(delay=how.delay),
        result,
    )


def _late(name: str, samples: int) -> str:
    """What a run is called."""
    return f"{name}_{samples}_samples_late"


def _with_loop(vehicle: Vehicle, name: str, timestep: float) -> Controller:
    """The controller of that name, if its loop is one that has margins.

    Raises:
        InputError: it has no gain, or is unstable as it is.
    """
    sample_times(vehicle, LONGEST, timestep)
    controller = design(vehicle, name)
    if not np.any(controller.gain):
        raise InputError(f"controller {name!r} has no gain, so there is no loop and no margin; give one that has")
    if not controller.certificate.stable:
        raise InputError(
            f"controller {name!r} has no margin, for its loop is not stable as it is ({controller.certificate.stability.words}); "
            "give one that makes it stable"
        )
    radius = sampled_radius(vehicle, controller, timestep)
    if radius >= 1:
        raise InputError(
            f"controller {name!r} is not stable at a timestep of {timestep:g} s (its sampled loop grows by {radius:.6g} every "
            "step) or with its actuators' lag; give a smaller timestep or a larger actuator_bandwidth"
        )
    return controller


def _delayed_runs(vehicle: Vehicle, controller: Controller, loop: LoopMargins, timestep: float) -> list[RunLog]:
    """The run that still decays and the one that grows, to be recorded; without a delay margin, the longest delay tried."""
    from sim.recording.provenance import run_log

    delays = [loop.delay.stable, loop.delay.unstable] if math.isfinite(loop.delay.unstable) else [loop.delay.stable]
    time, found = sample_times(vehicle, SHORTEST, timestep), []
    for samples in (round(delay / timestep) for delay in delays):
        delayed = replace(vehicle, implementation=Implementation(delay=samples))
        run = run_all(delayed, [controller], BUMP, time)[0]
        found.append(run_log(delayed, BUMP, run, _late(controller.name, samples)))
    return found


def _which_loop(vehicle: Vehicle) -> str:
    """Of which loop the margins are, and the norms of other vehicles, where the vehicle file says more than parameters."""
    lag = "with" if vehicle.limits.actuator_bandwidth is not None else "without"
    without = " and without the file's [implementation], whose delay and period are part of what it bears"
    computer = "" if vehicle.implementation.ideal else without
    return f"borne by the loop {lag} an actuator's lag{computer}; norms of other vehicles are of the ideal loop"


def _object(controller: Controller, found: dict[str, LoopMargins], box: Robustness | None) -> dict[str, Any]:
    """The result as JSON has it: SI units, None for what is infinite or does not exist."""
    loops = {name: _loop_object(one) for name, one in found.items() if name}
    result = {"controller": controller.name, **_loop_object(found[""]), "loops": loops}
    if box is None:
        return {**result, "robustness": None}
    varied = {one.name: [one.smallest, one.largest] for one in box.varied}
    corners = [
        {**corner.parameters, "norm": _finite(corner.norm), "stable": corner.decays, "agrees": corner.agrees}
        for corner in box.corners
    ]
    result["robustness"] = {"varied": varied, "worst_norm": _finite(box.norm), "at": box.at, "corners": corners}
    return result


def _loop_object(one: LoopMargins) -> dict[str, Any]:
    predicted = one.predicted
    gain = {
        "predicted": _finite(predicted.gain),
        "found": _finite(one.gain.found),
        "lower": {"predicted": predicted.gain_lower or None, "found": one.found_gain_lower or None},
        "sampled": [
            {"timestep": one.timestep / k, "predicted": _finite(at), "found": _finite(search.found)}
            for k, at, search in zip((1, 2), one.gain.sampled, (one.gain.search, one.gain.finer), strict=True)
            if search.tried
        ],
    }
    phase = {  # lag: what a delay makes
        "predicted": _finite(predicted.phase),
        "found": _finite(one.found_phase),
        "frequency": _finite(predicted.frequency),
        "smallest": _finite(predicted.smallest_phase),
    }
    return {
        "gain": gain,
        "phase": phase,
        "delay": {"predicted": _finite(predicted.delay), "found": _finite(one.delay.unstable)},
        "sample_period": {"predicted": _finite(predicted.sample_period), "found": _finite(one.found_sample_period)},
    }


def _text(
    vehicle: Vehicle, controller: Controller, found: dict[str, LoopMargins], box: Robustness | None, timestep: float
) -> list[str]:
    lines = [f"{vehicle.kind.name} ({vehicle.source}), controller {controller.name}; MuJoCo at {timestep:g} s"]
    for name, one in found.items():
        what = f"the loop of {name}, the others closed" if name else ("all loops at once" if len(found) > 1 else "the loop")
        lines += ["", f"{what:32}{'predicted':>12}{'MuJoCo':>12}", *_loop_lines(one)]
        lines.append("  agrees" if one.agrees else "  DOES NOT AGREE; where the timestep is too coarse, give a smaller one")

    if box is None:
        return [*lines, "", f"other vehicles: {varied_text(vehicle.kind)}"]
    at = ", ".join(f"{name} {value:.5g}" for name, value in box.at.items())
    lines += ["", f"{varied_text(vehicle.kind)}: worst norm {box.norm:.6g} at {at}"]
    for corner in box.corners:
        at = ", ".join(f"{name} {value:.5g}" for name, value in corner.parameters.items())
        physics = f"MuJoCo {'settles' if corner.decays else 'GROWS'}, {'agrees' if corner.agrees else 'DOES NOT AGREE'}"
        lines.append(f"  {at}: norm {corner.norm:.6g}; {physics}")
    return lines


def _loop_lines(one: LoopMargins) -> list[str]:
    predicted, h = one.predicted, one.timestep
    rows = [("gain, factor", predicted.gain, one.gain.found, ""), *_sampled_rows(one.gain, h, 1)]
    if predicted.gain_lower or one.found_gain_lower:
        rows.append(("gain, lower factor", predicted.gain_lower, one.found_gain_lower, ""))
        rows += _sampled_rows(one.gain_lower, h, -1)
    where = f"at {predicted.frequency:.5g} rad/s" if predicted.crossovers else ""
    if predicted.smallest_phase < predicted.phase * (1 - 1e-9):
        where += f"; another crossover needs less, {predicted.smallest_phase:.4g}, but more delay"
    rows.append(("phase lag, rad", predicted.phase, one.found_phase, where))
    samples = ""
    if math.isfinite(one.delay.unstable):
        samples = f"decays with {round(one.delay.stable / h)} samples, grows with {round(one.delay.unstable / h)}"
    rows.append(("delay, ms", 1e3 * predicted.delay, 1e3 * one.delay.unstable, samples))
    rows.append(("sample period, ms", 1e3 * predicted.sample_period, 1e3 * one.found_sample_period, ""))
    return [f"  {name:30}{_cell(first)}{_cell(second)}  {note}".rstrip() for name, first, second, note in rows]


def _sampled_rows(gain: GainMargin, h: float, power: int) -> list[tuple[str, float, float, str]]:
    """What the sampled loop bears at both timesteps, where that is not what the loop itself does; a lower factor has power -1."""
    searches = zip((h, h / 2), gain.sampled, (gain.search, gain.finer), strict=True)
    return [
        (f"  sampled every {1e3 * step:g} ms", at**power, search.found**power, "" if step == h else "above: what these tend to")
        for step, at, search in searches
        if gain.finer.tried
    ]


def _cell(value: float) -> str:
    return f"{'any' if math.isinf(value) else format(value, '.6g'):>12}"


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def parser() -> Parser:
    """The options."""
    parser = Parser("sim.margins", "Finds how much gain, phase, delay and sample period a loop bears.", EPILOG)
    parser.add_one("state, or one of the vehicle file's")
    parser.add_number("--timestep", TIMESTEP, "s", "integration step; delays and sample periods are its multiples")
    parser.add_logs("MuJoCo on either side of the delay margin")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="draw the margins, as .png or .svg; needs matplotlib")
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    return parser


if __name__ == "__main__":
    run_command(main)
