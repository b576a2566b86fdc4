"""Options of commands that drive over one road, and the log that options lead to."""

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

from models import USUAL_TIMESTEP
from models.common.command import ALL, Parser, chosen_of
from models.vehicle.names import LOAD_SYNTAX, PLUS, WITHOUT, is_load_file, logged_variant, run_without

if TYPE_CHECKING:
    from models.vehicle.limits_and_implementation import Implementation
    from models.vehicle.vehicle import Vehicle


Road = Mapping[str, Any]  # as it describes itself


@dataclass(frozen=True)
class ExpectedLog:
    """Log that a command line writes.

    Attributes:
        controllers: controllers of the logged runs, in order; a single one may have several runs.
        samples: number of samples of every run, or None if the command itself determines it.
        timestep: [s].
        road: returns True if the described road is possible for a run.
        run: returns True if the name and implementation are possible for a run.
        result: parts of the result that follow from the options, by key.
    """

    controllers: Sequence[str]
    samples: int | None
    timestep: float
    road: Callable[[Road], bool]
    run: "Callable[[str, Implementation], bool]"
    result: Mapping[str, Any] = field(default_factory=dict)


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


def driven_names(vehicle: "Vehicle", options: argparse.Namespace) -> "tuple[list[str], Callable[[str, Implementation], bool]]":
    """Returns the controllers of a log's runs in their order, and the check of a run's name and implementation."""
    names = chosen_of({"": vehicle.controller_names}, options.controller, partly=len(options.vehicles) > 1)[""]
    runs = {name: vehicle.implementation for name in names}
    every = list(names)
    for part in options.without:
        if (own := vehicle.without(part)) is not vehicle:
            some = run_without(names, part)
            every += some
            runs |= {f"{name}{logged_variant(part)}": own.implementation for name in some}
    return every, lambda name, how: runs.get(name) == how


def same_path(first: str, second: str) -> bool:
    """Returns True if two texts name one path, on whatever system they were written."""
    return PurePosixPath(first.replace("\\", "/")) == PurePosixPath(second.replace("\\", "/"))


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


def without_loads(road: Mapping[str, Any], given: Sequence[str]) -> dict[str, Any] | None:
    """Returns the road description without loads, or None if the loads differ from the requested ones.

    A load's file is compared by name, and not read.
    """
    pushed = str(road["loads"]).split(PLUS) if "loads" in road else []
    if len(pushed) != len(given) or not all(_is_load(*pair) for pair in zip(pushed, given, strict=True)):
        return None
    return {name: value for name, value in road.items() if name != "loads"}


def _is_load(described: str, given: str) -> bool:
    """Returns True if a described load is the requested one."""
    if is_load_file(given):
        from models.roads.load_choice import named

        return same_path(described.partition(";")[0], named(given))
    from models.roads.load_choice import choose_load

    return described == choose_load(given).text
