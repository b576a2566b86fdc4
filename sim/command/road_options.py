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
    parser.add_controller_and_vehicle("required", several="compare several vehicles in one table")
    parser.add_argument(
        "--without",
        action="append",
        choices=WITHOUT,
        default=[],
        help="also run every controller without this part of the vehicle file, to see what it costs: noise (and quantisation), "
        "delay of the forces, limits (largest force and bump stops), lag of the actuators; may be repeated",
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
    parser.add_number("--duration", duration, "s", "how long to run")
    parser.add_number("--timestep", USUAL_TIMESTEP, "s", "integration step and sample period of the controller")
    parser.add_argument(
        "--picture",
        type=Path,
        metavar="FILE",
        help="draw MuJoCo over the analysis, a panel for each weighed signal (.png or .svg)",
    )
    parser.add_argument(
        "--csv", type=Path, metavar="FILE", help="write every signal over time, MuJoCo's and the analysis', as a table (.csv)"
    )
    logs = parser.add_mutually_exclusive_group()
    logs.add_argument("--logs", type=Path, default=Path("logs"), metavar="DIR", help="folder for the log files (default: logs)")
    logs.add_argument("--no-logs", dest="logs", action="store_const", const=None, help="write no log files")
    view = parser.add_mutually_exclusive_group()
    view.add_argument(
        "--open", action="store_true", help="open the recording in Rerun's window, which stays when the command ends"
    )
    view.add_argument("--serve", action="store_true", help="serve the recording to a browser on this machine, until Ctrl-C")
    parser.add_printed(
        "gains, every signal and all sentences behind the verdict",
        "print only which controller is best at what, and the verdicts",
    )


def add_exported(
    parser: Parser, what: str = "let the compiled code of this folder of python -m synth --export drive its controller"
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
    """`--load`, again and again."""
    parser.add_argument(
        "--load", dest="loads", action="append", default=[], metavar="LOAD", help=f"{what}; several act together: {LOAD_SYNTAX}"
    )
