"""What commands share that drive controllers of one vehicle over one road: options, runs and text."""

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from models.common.arrays import Array
from models.common.command import Parser
from models.common.errors import InputError
from models.vehicle import Vehicle
from sim.roads.road import Road
from sim.runs.run import Run, run_all
from sim.runs.words import controller_lines, energy_lines, run_lines, verdict_lines
from synth.designer import Designer


def add_run_options(parser: Parser, duration: float) -> None:
    """`--duration`, with a default [s], `--timestep`, `--logs`, `--no-logs`, `--open`, `--serve` and `--json`."""
    parser.add_number("--duration", duration, "s", "how long to run")
    parser.add_number("--timestep", 1e-3, "s", "integration step and sample period of the controller")
    logs = parser.add_mutually_exclusive_group()
    logs.add_argument("--logs", type=Path, default=Path("logs"), metavar="DIR", help="folder for the log files (default: logs)")
    logs.add_argument("--no-logs", dest="logs", action="store_const", const=None, help="write no log files")
    view = parser.add_mutually_exclusive_group()
    view.add_argument(
        "--open", action="store_true", help="open the recording in Rerun's window, which stays when the command ends"
    )
    view.add_argument("--serve", action="store_true", help="serve the recording to a browser on this machine, until Ctrl-C")
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")


def check_view(options: argparse.Namespace) -> None:
    """Ask before the long work whether its recording can be shown afterwards, as `--open` and `--serve` want.

    Raises:
        InputError: there will be none, or no screen to show it on.
    """
    if not (options.open or options.serve):
        return
    if options.logs is None:
        raise InputError(
            f"{'--open' if options.open else '--serve'} shows the recording, and --no-logs makes none; leave one out"
        )
    if options.open:
        from sim.command.viewer import check_display

        check_display()


def view(options: argparse.Namespace, logs: Mapping[str, str | None]) -> None:
    """Shows a recording as `--open` and `--serve` want; what the command has printed is out before.

    Raises:
        InputError: the web viewer does not come up.
    """
    recording = logs["rerun"]
    if recording is None or not (options.open or options.serve):
        return
    from sim.command.viewer import open_viewer, serve_viewer

    sys.stdout.flush()
    (open_viewer if options.open else serve_viewer)(Path(recording))


def run_chosen(vehicle: Vehicle, names: Sequence[str], road: Road, time: Array) -> tuple[list[Run], Run]:
    """Runs controllers over a road.

    Args:
        vehicle: the vehicle.
        names: of its controllers.
        road: the road.
        time: equidistant sample times from 0 [s].

    Returns:
        A run for every name, and that of `passive`, with which they are compared.

    Raises:
        InputError: a controller that cannot be designed.
    """
    designer = Designer(vehicle)
    with_passive = [*names, *(["passive"] if "passive" not in names else [])]
    controllers = [designer.design(name) for name in with_passive]
    everything = run_all(vehicle, controllers, road, time)
    return everything[: len(names)], everything[with_passive.index("passive")]


def compared_lines(run: Run, passive: Run) -> list[str]:
    """One run: its controller, its table, its verdict."""
    table = run_lines(run, passive if run is not passive else None)
    return [
        *controller_lines(run.vehicle, run.controller),
        "",
        *table,
        "",
        *(f"  {line}" for line in [*verdict_lines(run), *energy_lines(run)]),
    ]
