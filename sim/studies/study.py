"""A study: what runs, and how its result is shown. Its row in `EXTENSIONS` makes it a command and a part of the page.

A module of a study imports what its run needs inside the methods, so that help pages appear without delay.
"""

from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, Literal, TypeVar

from models.common.command import Parser
from models.common.printed import title_lines

if TYPE_CHECKING:
    from pathlib import Path

    from models.document.document import Document
    from models.document.figure import Figure
    from models.vehicle.vehicle import Vehicle
    from sim.runs.run import Run
    from sim.studies.subject import Subject

R = TypeVar("R")
Progress = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class StudyRequest:
    """Task of a study.

    Attributes:
        options: values of the study's options, by name.
        vehicle: the vehicle, with the actuators that the controllers drive; None for a study without one.
        names: names of the requested controllers.
        controllers: the designed controllers; empty before their design.
    """

    options: Namespace
    vehicle: "Vehicle" = None  # pyright: ignore[reportAssignmentType] - only a study without a vehicle has None
    names: Sequence[str] = ()
    controllers: "Sequence[Any]" = ()


class Study(Generic[R]):
    """A study whose run has a result of type R. A command needs the first attributes; a section of the page alone needs none.

    Attributes:
        name: name in `EXTENSIONS`.
        description, epilog: texts of `--help`; the epilog contains exit codes and examples.
        page: documentation of the printed output.
        takes: controllers that the command takes: "one" with a linear law, "several" of any kind, or "" without a vehicle.
        usual: controllers without `--controller`, if it takes several.
        stages: names of the parts of `run`, with which it calls `progress`.
        seconds: rough time of the longest request of a page; a page begins long ones first.
    """

    description = epilog = ""
    page = "docs/which-command.md"
    takes: Literal["", "one", "several"] = "one"
    usual: tuple[str, ...] = ()
    stages: tuple[str, ...] = ()
    seconds = 1.0

    def __init__(self, name: str) -> None:
        """Prepares the study of a name."""
        self.name = name

    def add_options(self, parser: Parser) -> None:
        """Adds the options of the command. `--logs`, `--picture`, `--csv`, `--as` and `--json` have the usual meaning."""
        if self.takes == "one":
            parser.add_one("passive, state, or a controller of the vehicle file")
        elif self.takes:
            parser.add_controller_and_vehicle(f"default: {', '.join(self.usual) or 'required'}")
        parser.add_printed("details")

    def vehicle(self, given: "Vehicle", names: Sequence[str]) -> "Vehicle":
        """Returns the vehicle of a file that is studied."""
        return given.with_common_actuators(names)

    def check(self, request: StudyRequest) -> None:
        """Checks the options before any work; raises an InputError."""

    def check_controllers(self, request: StudyRequest) -> None:
        """Checks the designed controllers before the run; raises an InputError."""

    def run(self, request: Any, progress: Progress) -> R:
        """Returns the result."""
        raise NotImplementedError

    def describe(self, request: StudyRequest, result: R) -> "Document":
        """Returns the result as a document."""
        raise NotImplementedError

    def record(self, request: StudyRequest, result: R) -> dict[str, Any]:
        """Returns the result as a JSON object."""
        raise NotImplementedError

    def title(self, request: StudyRequest, result: R) -> str:
        """Returns the first line of the printed result."""
        return f"{request.vehicle.kind.name} with {', '.join(one.name for one in request.controllers)}"

    def lines(self, request: StudyRequest, result: R, files: Sequence[str]) -> list[str]:
        """Returns the printed lines; `files` are the lines on written files."""
        from models.document.text import text_lines

        title = title_lines(self.title(request, result), request.vehicle.source)
        detail = "full" if getattr(request.options, "verbose", False) else "normal"
        return [*title, *files, "", *text_lines(self.describe(request, result), detail)]

    def holds(self, result: R) -> bool:
        """Returns True if the exit code is 0."""
        return True

    def figure(self, request: StudyRequest, result: R) -> "Figure":
        """Returns the figure of `--picture`."""
        raise NotImplementedError

    def write_csv(self, path: "Path", result: R) -> None:
        """Writes the file of `--csv`."""
        raise NotImplementedError

    def recorded_vehicle(self, given: "Vehicle") -> "Vehicle":
        """Returns the vehicle whose text is in the logs."""
        return given

    def runs(self, request: StudyRequest, result: R) -> "Mapping[str, Run]":
        """Returns the runs of `--logs`, by their names in the log."""
        raise NotImplementedError

    def check_page(self, scope: "Subject") -> None:
        """Checks before any work that the section of a page is possible; raises an InputError."""

    def requests(self, scope: "Subject") -> Mapping[str, Any]:
        """Returns the requests of a page by subject: independent ones, each run in a process. Empty if the page has none."""
        return {}

    def for_page(self, result: R) -> Any:
        """Returns what the sections of a page need of a result. It comes from another process, so it must be picklable."""
        return result

    def sections(self, scope: "Subject", results: "Mapping[str, Mapping[str, Any]]") -> "Sequence[Document]":
        """Returns the sections of a page: by default the results, as of a study whose results are documents.

        Args:
            scope: subject of the page.
            results: results of the requests of every study on the page, by its name and their subjects.
        """
        return [*results.get(self.name, {}).values()]
