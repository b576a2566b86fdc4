"""What commands share that drive controllers of one vehicle over one road: their text and their view."""

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from models.common.arrays import Array
from models.common.errors import InputError
from models.roads.road import Road
from models.vehicle import Vehicle
from sim.command.claims import say_false_claims
from sim.command.driven import driven
from sim.runs.energy import energy_lines
from sim.runs.run import Run, run_all
from sim.runs.words import controller_lines, run_lines, verdict_lines
from synth.controller import Controller


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


def run_beside_passive(
    vehicle: Vehicle, names: Sequence[str], design: Callable[[str], Controller], road: Road, time: Array
) -> tuple[list[Run], Run]:
    """A run of every controller asked for, in their order, and that of the passive vehicle, with which they are compared.

    Claims of theirs that are false are said first. Arguments and errors as for `driven` and `run_all`.
    """
    together = list(dict.fromkeys([*names, "passive"]))
    controllers = driven(vehicle, together, design)
    say_false_claims(controllers)
    runs = run_all(vehicle, controllers, road, time)
    return runs[: len(names)], runs[together.index("passive")]


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
