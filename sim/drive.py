"""`python -m sim.drive`: controllers over one road of any kind, in MuJoCo and in linear analysis, compared and measured."""

import argparse
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.command import Parser, chosen, run_command
from models.errors import InputError
from models.vehicle import Vehicle, read_vehicle
from sim.comparison import add_how, check_view, compared_lines, run_chosen, view
from sim.expected import APPROXIMATE, EXACT, Expected, Settled, expect, settled, settling_time
from sim.iso8608 import CLASSES, Iso8608
from sim.metrics import measure, metrics_of
from sim.outputs import check_outputs
from sim.road import Road
from sim.roads import SYNTAX, choose_road
from sim.run import Run, check_road, sample_times
from sim.verdict import log_lines, run_object

EPILOG = """
exit code: 0 physics and analysis agree for every controller and energy balances, 1 not, 2 bad input. A run that ends early,
diverged or on a flat tyre, is judged until then, and has no metrics.

examples:
  python -m sim.drive --controller I --class C --speed 20
  python -m sim.drive --controller passive --controller I --road pothole:depth=0.06:length=1.5 --speed 10
  python -m sim.drive --controller I --road measured.csv --speed 15 --json
  python -m sim.drive --controller I --road survey.txt:separator=semicolon:columns=1,3:height_unit=mm --speed 15
  python -m sim.drive --vehicle full_car --controller I --class B --seed 7
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code.

    Raises:
        InputError: bad options, vehicle file, road or logs folder.
    """
    options = _parser().parse_args(arguments)
    vehicle = read_vehicle(options.vehicle)
    names = chosen(vehicle.controller_names, options.controller)
    time = sample_times(vehicle, options.duration, options.timestep)
    road = _road(vehicle, options)
    check_road(vehicle, road, time)
    check_view(options)
    check_outputs({"logs": options.logs}, [vehicle.source])

    runs, passive = run_chosen(vehicle, names, road, time)
    first = _first(vehicle, runs, road, options.duration, options.timestep)
    measured = [measure_run(vehicle, run, road, first) for run in runs]
    result = {
        "runs": [run_object(vehicle, run) | _object(run, one) for run, one in zip(runs, measured, strict=True)],
        "road": road.describe(),
        "timestep": options.timestep,
        "measured_from": float(time[first]),
    }
    logs = {"mcap": None, "layout": None, "rerun": None}
    if options.logs is not None:
        from sim.provenance import record_runs, run_log

        logs = record_runs(options.logs, "drive", vehicle, names, [run_log(vehicle, road, run) for run in runs], result)
    if options.json:
        print(json.dumps({**result, "logs": logs}, allow_nan=False))
    else:
        about = ", ".join(
            f"{key} {value:g}" if isinstance(value, float) else f"{key} {value}" for key, value in road.describe().items()
        )
        lines = [f"{vehicle.kind.name} ({vehicle.source}) over a road: {about}; {options.duration:g} s at {options.timestep:g} s"]
        for run, one in zip(runs, measured, strict=True):
            lines += ["", *compared_lines(vehicle, run, passive), ""]
            lines += metric_lines(run, one, float(time[first]), options.duration)
        print("\n".join(lines + (["", *log_lines(logs)] if logs["rerun"] else [])))
    view(options, logs)
    return 0 if all(run.holds for run in runs) else 1


@dataclass(frozen=True)
class Measured:
    """One metric of one run, thrice.

    Attributes:
        unit: SI.
        mujoco: of the physics; None where the run broke off.
        linear: of the exact sampled response over the same road; None where the run broke off.
        expected: over all roads of this kind, from their spectrum; None where the road has none, or the loop is unstable.
        spread: its standard deviation from road to road; None where it is not known.
    """

    unit: str
    mujoco: float | None
    linear: float | None
    expected: float | None
    spread: float | None


@dataclass(frozen=True)
class RunMetrics:
    """All metrics of one run, and what they rest on.

    Attributes:
        metrics: by name.
        settled: how much of the variance is there when measuring begins; None for roads without a spectrum and unstable loops.
        error: what the expectations' integrals are off, relative, at most; None where there are none.
    """

    metrics: Mapping[str, Measured]
    settled: Settled | None
    error: float | None


def measure_run(vehicle: Vehicle, run: Run, road: Road, first: int) -> RunMetrics:
    """The metrics of a run from sample `first` on, beside their linear predictions."""
    time, timestep = run.physics.time, float(run.physics.time[1])
    expected: Expected | None = None
    begun: Settled | None = None
    if isinstance(road, Iso8608):
        expected = expect(vehicle, run.controller, road, timestep, (len(time) - first) * timestep)
        begun = settled(vehicle, run.controller, road.speed, timestep, float(time[first]))
    mujoco: Mapping[str, float] = {}
    linear: Mapping[str, float] = {}
    if run.broke_off is None:
        with np.errstate(over="ignore", invalid="ignore"):  # an unstable loop overflows
            mujoco, linear = (measure(vehicle, response, first) for response in (run.physics, run.sampled))
    metrics = {
        metric.name: Measured(
            metric.unit,
            mujoco.get(metric.name),
            linear.get(metric.name),
            expected.mean[metric.name] if expected else None,
            expected.spread.get(metric.name) if expected else None,
        )
        for metric in metrics_of(vehicle)
    }
    return RunMetrics(metrics, begun, expected.error if expected else None)


def metric_lines(run: Run, found: RunMetrics, start: float, end: float) -> list[str]:
    """The metrics of a run as a table, and what they rest on in sentences."""
    measured, notes = found.metrics, []
    if run.broke_off is not None:
        notes.append(f"no metrics of this run: {run.broke_off[0]} at {run.broke_off[1]:.4g} s, and what follows is no vehicle's")
    if found.settled is not None:
        notes.append(
            f"{100 * found.settled.share:.3g} % of the variance, of white road velocity, is there when measuring begins "
            f"({found.settled.signal}; of all other signals more)"
        )
    if found.error is not None:
        notes.append(f"expected {', '.join(APPROXIMATE)} are approximate: some 5 %, 11 % for the travel of a passive quarter-car")
    if found.error is not None and found.error > EXACT:
        notes.append(
            f"expected values may be off by {min(found.error, 1.0):.1g}: a resonance is too narrow for the lines of this road, "
            "or for the integral over them"
        )
    if run.broke_off is not None and not any(one.expected is not None for one in measured.values()):
        return [f"  {note}" for note in notes]
    width = max(len(name) for name in measured)
    random = any(one.expected is not None for one in measured.values())
    head = f"  {f'measured from {start:.4g} to {end:.4g} s':{width}}  {'unit':8}{'MuJoCo':>11}{'linear':>11}"
    lines = [head + (f"{'expected':>11}{'from road to road':>20}" if random else "")]
    for name, one in measured.items():
        line = f"  {name:{width}}  {one.unit:8}{_cell(one.mujoco):>11}{_cell(one.linear):>11}"
        spread = f"+- {_cell(one.spread)}" if one.spread is not None else ""
        lines.append((line + (f"{_cell(one.expected):>11}{spread:>20}" if random else "")).rstrip())
    return [*lines, *(f"  {note}" for note in notes)]


def _object(run: Run, found: RunMetrics) -> dict[str, Any]:
    broke = run.broke_off
    return {
        "broke_off": {"by": broke[0], "at": broke[1]} if broke else None,
        "settled": {"share": found.settled.share, "signal": found.settled.signal} if found.settled else None,
        "expected_error": _finite(found.error),
        "metrics": _metrics(found.metrics),
    }


def _metrics(measured: Mapping[str, Measured]) -> dict[str, Any]:
    return {
        name: {
            "unit": one.unit,
            "mujoco": _finite(one.mujoco),
            "linear": _finite(one.linear),
            "expected": _finite(one.expected),
            "spread": _finite(one.spread),
        }
        for name, one in measured.items()
    }


def _road(vehicle: Vehicle, options: argparse.Namespace) -> Road:
    """The road that was asked for."""
    text = options.road
    if options.road_class is not None:
        if text is not None:
            raise InputError("give --class or --road, not both: --class C is --road iso8608:class=C")
        text = f"iso8608:class={options.road_class.upper()}"
    choice = choose_road(text or "iso8608:class=C")
    if "seed" in options.given and not choice.random:
        raise InputError(f"--seed says which random road, and {choice.text!r} is none; leave it out")
    road = choice.build(vehicle, options.speed, options.seed, options.speed * options.duration)
    passed = getattr(road, "duration", math.inf)
    if passed < 2 * options.timestep:
        raise InputError(
            f"road {choice.text!r} is over in {passed:.3g} s, less than two timesteps of {options.timestep:g} s, so physics "
            "would not see it; give a longer one, less speed, or a smaller timestep"
        )
    if getattr(road, "track", "both") != "both" and not any(wheel.side for wheel in vehicle.kind.wheels):
        raise InputError(f"road {choice.text!r}: a {vehicle.kind.name} has only one track; leave track out")
    return road


def _first(vehicle: Vehicle, runs: Sequence[Run], road: Road, duration: float, timestep: float) -> int:
    """The sample from which is measured: when a random road's vehicle has forgotten its start, half of the run at the latest."""
    if not isinstance(road, Iso8608):
        return 0
    settled = max(settling_time(vehicle, run.controller) for run in runs)
    return round(min(settled, duration / 2) / timestep)


def _cell(value: float | None) -> str:
    return f"{value:.4g}" if value is not None and math.isfinite(value) else "-"


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def _seed(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None


def _parser() -> Parser:
    parser = Parser(
        "sim.drive",
        "Drives controllers over a road, in MuJoCo and in linear analysis; compares, measures and logs them.",
        EPILOG,
    )
    parser.add_what("required")
    parser.add_argument(
        "--class", dest="road_class", metavar="CLASS", help=f"random road of ISO 8608, {CLASSES[0]} to {CLASSES[-1]} (default: C)"
    )
    parser.add_argument("--seed", type=_seed, default=0, metavar="N", help="of the random road (default: 0)")
    parser.add_argument("--road", metavar="ROAD", help=f"another road: {SYNTAX}".replace("%", "%%"))
    parser.add_number("--speed", 20.0, "m/s", "forward speed of the vehicle")
    add_how(parser, 20.0)
    return parser


if __name__ == "__main__":
    run_command(main)
