"""Options of commands that drive over one road."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from models import USUAL_TIMESTEP
from models.common.command import ALL, Parser
from models.vehicle.names import LOAD_SYNTAX, WITHOUT

if TYPE_CHECKING:
    from models.vehicle.vehicle import Vehicle


def add_vehicles(parser: Parser) -> None:
    """Adds `--controller`, `--vehicle`, of which several may be given, and `--without`."""
    parser.add_controller_and_vehicle("required", several="one table of all vehicles")
    parser.add_argument(
        "--without",
        action="append",
        choices=WITHOUT,
        default=[],
        help="also run every controller without this part of the vehicle file, to show its effect: sensor noise and "
        "quantisation, delay of the forces, limits (largest force and bump stops), or lag of the actuators; may be repeated",
    )


USUAL = ("passive", "state", "I", "II")


def omitted_controllers(vehicle: "Vehicle", given: Sequence[str] | None, names: Sequence[str]) -> list[str]:
    """Returns a vehicle's controllers that are not among the chosen ones; empty if the user chose some.

    Args:
        given: values of `--controller`.
        names: names of the chosen controllers.
    """
    return [] if given else [name for name in vehicle.controller_names if name not in names]


def left_out_lines(names: Sequence[str]) -> list[str]:
    """Returns a line that lists the omitted controllers and how to include them; empty if none is omitted."""
    return [f"left out: {', '.join(names)}; to have one, name it with --controller, which may be {ALL}"] if names else []


def add_run_options(parser: Parser, duration: float) -> None:
    """Adds `--duration` with its default [s], `--timestep`, `--as`, and the options of logs, viewers and output."""
    add_exported(parser)
    parser.add_number("--duration", duration, "s", "duration of the run")
    parser.add_number("--timestep", USUAL_TIMESTEP, "s", "integration step and sample period of the controller")
    parser.add_argument(
        "--picture",
        type=Path,
        metavar="FILE",
        help="draw MuJoCo and linear analysis over time, with a panel for each weighted signal (.png, .svg or .pdf)",
    )
    parser.add_argument(
        "--csv", type=Path, metavar="FILE", help="write all signals over time, of MuJoCo and linear analysis (.csv)"
    )
    logs = parser.add_mutually_exclusive_group()
    logs.add_argument("--logs", type=Path, default=Path("logs"), metavar="DIR", help="folder for log files (default: logs)")
    logs.add_argument("--no-logs", dest="logs", action="store_const", const=None, help="write no log files")
    view = parser.add_mutually_exclusive_group()
    view.add_argument(
        "--open", action="store_true", help="open the recording in a Rerun window, which remains open after the command"
    )
    view.add_argument("--serve", action="store_true", help="serve the recording to a browser on this machine until Ctrl-C")
    parser.add_printed(
        "gains, all signals and the details of the verdict",
        "print only the comparison of controllers and the verdicts",
    )


def add_exported(
    parser: Parser, what: str = "run the controller as compiled code from this folder, written by python -m synth --export"
) -> None:
    """Adds `--as`."""
    parser.add_argument(
        "--as",
        dest="exported",
        type=Path,
        metavar="DIR",
        help=what,
    )


def add_loads(parser: Parser, what: str) -> None:
    """Adds `--load`, which may be repeated."""
    meaning = f"{what}; may be repeated, and all loads act together: {LOAD_SYNTAX}"
    parser.add_argument("--load", dest="loads", action="append", default=[], metavar="LOAD", help=meaning)
