"""The controllers that are compared where none is asked for: the paper's four. Those of a vehicle file that are not are named."""

from collections.abc import Sequence

from models.common.command import ALL
from models.vehicle import Vehicle

USUAL = ("passive", "state", "I", "II")


def left_out(vehicle: Vehicle, asked: Sequence[str] | None, names: Sequence[str]) -> list[str]:
    """Controllers of a vehicle that nobody asked for, and that are not among those taken instead; none where some were asked for.

    Args:
        vehicle: the vehicle.
        asked: as `--controller` was given.
        names: of those that are taken.
    """
    return [] if asked else [name for name in vehicle.controller_names if name not in names]


def left_out_lines(names: Sequence[str]) -> list[str]:
    """Those in a line, with how to have them; none where there are none."""
    return [f"left out: {', '.join(names)}; to have one, name it with --controller, which may be {ALL}"] if names else []
