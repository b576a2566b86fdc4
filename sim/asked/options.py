"""Options that commands share which drive over one road."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from models.common.command import Parser
from models.loads.choice import SYNTAX, choose_load, is_file
from models.loads.table import named
from models.reality import USUAL_TIMESTEP
from models.roads.loaded import PLUS
from sim.asked.asked import same_path


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


def add_loads(parser: Parser, what: str) -> None:
    """`--load`, again and again.

    Args:
        parser: of the command.
        what: what loads do there.
    """
    parser.add_argument(
        "--load",
        dest="loads",
        action="append",
        default=[],
        metavar="LOAD",
        help=f"{what}; several act together: {SYNTAX}",
    )


def without_loads(road: Mapping[str, Any], asked: Sequence[str]) -> dict[str, Any] | None:
    """What a log describes as a road, without its loads; None where these are not those that were asked for.

    Of a load's file only the name counts: it is not read.
    """
    pushed = str(road["loads"]).split(PLUS) if "loads" in road else []
    if len(pushed) != len(asked) or not all(_is_load(*pair) for pair in zip(pushed, asked, strict=True)):
        return None
    return {name: value for name, value in road.items() if name != "loads"}


def _is_load(described: str, asked: str) -> bool:
    """Whether a load that describes itself so was asked for."""
    if is_file(asked):
        return same_path(described.partition(";")[0], named(asked))
    return described == choose_load(asked).text
