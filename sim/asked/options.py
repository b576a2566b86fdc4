"""Options that commands share which drive over one road."""

from pathlib import Path

from models.common.command import Parser
from models.reality import USUAL_TIMESTEP


def add_run_options(parser: Parser, duration: float) -> None:
    """`--duration`, with a default [s], `--timestep`, `--logs`, `--no-logs`, `--open`, `--serve` and `--json`."""
    parser.add_number("--duration", duration, "s", "how long to run")
    parser.add_number("--timestep", USUAL_TIMESTEP, "s", "integration step and sample period of the controller")
    logs = parser.add_mutually_exclusive_group()
    logs.add_argument("--logs", type=Path, default=Path("logs"), metavar="DIR", help="folder for the log files (default: logs)")
    logs.add_argument("--no-logs", dest="logs", action="store_const", const=None, help="write no log files")
    view = parser.add_mutually_exclusive_group()
    view.add_argument(
        "--open", action="store_true", help="open the recording in Rerun's window, which stays when the command ends"
    )
    view.add_argument("--serve", action="store_true", help="serve the recording to a browser on this machine, until Ctrl-C")
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
