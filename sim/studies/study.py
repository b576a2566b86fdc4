"""Interface of a study. A study defines a computation and the ways in which the result is printed, plotted and written.

A study becomes a command or a part of the report by a row in `models.common.extensions`. Help pages must appear without delay,
so the module of a study imports other modules only inside its methods. If the study is in a module `study`, a base class in a
neighbouring module `command` contains its texts and options, such as `MarginsCommand` for `MarginsStudy`.
"""

from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, Literal, TypeVar

from models.common.command import Parser
from models.common.printed import DETAIL_LINES, fit_lines, title_lines

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
    """Inputs of a study.

    Attributes:
        options: values of the command-line options, by name of the option.
        vehicle: vehicle with the actuators that the controllers use; None for a study without a vehicle.
        names: names of the requested controllers.
        controllers: designed controllers; empty as long as they are not designed.
    """

    options: Namespace
    vehicle: "Vehicle" = None  # pyright: ignore[reportAssignmentType] - only a study without a vehicle has None
    names: Sequence[str] = ()
    controllers: "Sequence[Any]" = ()


class Study(Generic[R]):
    """A study, whose method `run` returns a result of type R.

    A study that has a command defines the following class attributes. A study that only adds a section to the report does not
    need the attributes of a command.

    Attributes:
        name: name of the study in the registry `STUDIES`.
        description, epilog: texts that `--help` prints before and after the options. The epilog contains exit codes and
            examples of the command.
        page: path of the documentation page that explains the printed output.
        takes: "one" if the command needs one linear controller, "several" if it accepts any controllers, "" if it uses no
            vehicle.
        usual: default value of `--controller` for a command that takes several controllers.
        details: text that names the details that are omitted with `-v` if they do not fit on a screen; empty if they always
            fit.
        stages: names of the stages that `run` passes to `progress`.
        seconds: approximate duration of the longest computation that a report requests [s]. Long computations start first.
    """

    description = epilog = ""
    page = "docs/which-command.md"
    takes: Literal["", "one", "several"] = "one"
    usual: tuple[str, ...] = ()
    details = ""
    stages: tuple[str, ...] = ()
    seconds = 1.0

    def __init__(self, name: str) -> None:
        """Prepares the study that has this name in `STUDIES`."""
        self.name = name

    def add_options(self, parser: Parser) -> None:
        """Adds the command-line options of the study. The options `--logs`, `--picture`, `--csv`, `--as` and `--json` are
        handled by the command itself.
        """
        if self.takes == "one":
            parser.add_one("passive, state, or a controller of the vehicle file")
        elif self.takes:
            parser.add_controller_and_vehicle(f"default: {', '.join(self.usual) or 'required'}")
        parser.add_printed("details")

    def vehicle(self, given: "Vehicle", names: Sequence[str]) -> "Vehicle":
        """Returns the vehicle for which the study is run.

        Args:
            given: vehicle that is defined by the vehicle file.
            names: names of the requested controllers.
        """
        return given.with_common_actuators(names)

    def check(self, request: StudyRequest) -> None:
        """Checks the options before the controllers are designed; raises InputError if an option is invalid."""

    def check_controllers(self, request: StudyRequest) -> None:
        """Checks the designed controllers before the run; raises InputError if the study does not support a controller."""

    def run(self, request: Any, progress: Progress) -> R:
        """Runs the study and returns the result."""
        raise NotImplementedError

    def describe(self, request: StudyRequest, result: R) -> "Document":
        """Returns the result of the study as a document."""
        raise NotImplementedError

    def record(self, request: StudyRequest, result: R) -> dict[str, Any]:
        """Returns the result of the study as a JSON object."""
        raise NotImplementedError

    def title(self, request: StudyRequest, result: R) -> str:
        """Returns the first line of the printed result."""
        return f"{request.vehicle.kind.name} with {', '.join(one.name for one in request.controllers)}"

    def lines(self, request: StudyRequest, result: R, files: Sequence[str]) -> list[str]:
        """Returns the printed lines of the result. `files` contains the lines that name the files which were written."""
        from models.document.text import text_lines

        title = title_lines(self.title(request, result), request.vehicle.source)
        detail = "full" if getattr(request.options, "verbose", False) else "normal"
        document = self.describe(request, result)
        lines = [*title, *files, "", *text_lines(document, detail)]
        if detail == "full" and self.details and len(fit_lines(lines)) > DETAIL_LINES:
            lines = [*title, *files, "", *text_lines(document), f"shown only with --json: {self.details}"]
        return lines

    def holds(self, result: R) -> bool:
        """Returns True if the result of the study is successful, so that the exit code is 0."""
        return True

    def figure(self, request: StudyRequest, result: R) -> "Figure":
        """Returns the figure for the option `--picture`."""
        raise NotImplementedError

    def write_csv(self, path: "Path", result: R) -> None:
        """Writes the file that the option `--csv` names."""
        raise NotImplementedError

    def recorded_vehicle(self, given: "Vehicle") -> "Vehicle":
        """Returns the vehicle whose vehicle file is stored in the logs."""
        return given

    def runs(self, request: StudyRequest, result: R) -> "Mapping[str, Run]":
        """Returns the runs that `--logs` records, by name of the run in the log."""
        raise NotImplementedError

    def check_page(self, scope: "Subject") -> None:
        """Checks, before controllers are designed, that the report can contain the section of this study; raises InputError if
        it cannot.
        """

    def requests(self, scope: "Subject") -> Mapping[str, Any]:
        """Returns the computations that the report requests from this study, by subject; empty if the report requests none.

        The requested computations are independent of each other. Each requested computation can run in a separate process.
        """
        return {}

    def for_page(self, result: R) -> Any:
        """Returns the part of a result that the report needs.

        This part of the result must be picklable, because it may come from another process.
        """
        return result

    def sections(self, scope: "Subject", results: "Mapping[str, Mapping[str, Any]]") -> "Sequence[Document]":
        """Returns the sections of this study in the report; by default, the sections are the results, which must then be
        documents.

        Args:
            scope: subject of the report, which holds the vehicle, the controllers and the runs.
            results: results of all studies, by name of the study and then by subject of the request.
        """
        return [*results.get(self.name, {}).values()]
