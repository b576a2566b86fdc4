"""What commands share that drive controllers of one vehicle over one road: runs, their text and their view."""

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from models.common.arrays import Array
from models.common.errors import InputError
from models.vehicle import Vehicle
from sim.roads.road import Road
from sim.runs.run import Run, run_all
from sim.runs.words import controller_lines, energy_lines, run_lines, verdict_lines
from synth.designer import Designer


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
