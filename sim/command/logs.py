"""The life of `--logs`: what a command has run is recorded where it was asked for, and how to open that is said."""

import argparse
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from models.vehicle import Vehicle
from sim.runs.run import Run


def recorded(
    options: argparse.Namespace,
    vehicle: Vehicle,
    controllers: Sequence[str],
    runs: Callable[[], Mapping[str, Run]],
    result: Mapping[str, Any],
) -> dict[str, str | None]:
    """Records what a command has run, as `record_runs` does; None for every file where there is no folder.

    Args:
        options: as the command's parser read them, `--logs` among them.
        vehicle: as it was read.
        controllers: names of those that were run.
        runs: makes those that are recorded, by the names they have there, and is not called in vain.
        result: as `--json` prints it.
    """
    if options.logs is None:
        return {"mcap": None, "layout": None, "rerun": None}
    from sim.recording.provenance import record_runs  # it imports Rerun

    return {**record_runs(options.logs, options.command_line, vehicle, controllers, runs(), result)}


def log_lines(logs: Mapping[str, str | None]) -> list[str]:
    """Where a command has recorded, and how to open it; none where it has not."""
    paths = {name: Path(path) for name, path in logs.items() if path}
    if not paths:
        return []
    from sim.recording.files import opening_lines

    return ["", "logs", *opening_lines(paths)]
