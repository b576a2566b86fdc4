"""The command `roadproof identify`, which identifies a vehicle from measured logs and writes the vehicle file."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from models.common.command import Parser
from models.common.errors import InputError
from models.common.printed import Whole, title_lines
from sim.studies.study import Progress, Study, StudyRequest

if TYPE_CHECKING:
    from collections.abc import Sequence

    from models.document.document import Document
    from models.document.figure import Figure
    from sim.studies.identification.identification import Identification
    from sim.studies.identification.plan import ChirpPlan

    Result = Identification | list[ChirpPlan] | str


class IdentifyStudy(Study["Result"]):
    """Identifies a vehicle from logs. With --columns, the study returns a first map file for the logs; with --plan, the study
    plans a rig test.
    """

    description = (
        "Identify the parameters of a vehicle from measured logs, with intervals, and show what the logs do not determine."
    )
    epilog = """
exit code: 0 the residuals are white, or --columns; 1 they are not white, so the vehicle lacks something; 2 invalid input

examples:
  roadproof identify rig.csv --vehicle start.toml --signals map.toml --out found.toml
  roadproof identify drive.mcap --vehicle quarter_car --fix sprung_mass
  roadproof identify rig.csv --vehicle start.toml --columns > map.toml
"""
    page = "docs/how-to/identify.md"
    takes = ""
    stages = ("logs and estimate",)

    def add_options(self, parser: Parser) -> None:
        parser.add_argument(
            "files",
            nargs="*",
            type=Path,
            metavar="LOG",
            help="measured log, or a log that the command bump or drive wrote (.mcap)",
        )
        parser.add_argument("--vehicle", default="quarter_car", metavar="FILE", help="vehicle file with initial values")
        parser.add_argument("--signals", type=Path, metavar="MAP", help="map of columns to signals (TOML)")
        parser.add_argument(
            "--columns", action="store_true", help="print a first map, guessed from the headings of the logs, and stop"
        )
        parser.add_argument(
            "--fix", action="append", default=[], metavar="NAME", help="parameter that keeps its value and is not estimated"
        )
        parser.add_argument("--free", action="append", default=[], metavar="NAME", help="additional parameter to estimate")
        parser.add_argument(
            "--hold-out",
            action="append",
            type=Path,
            default=[],
            metavar="LOG",
            help="log that is predicted, but not used for the estimate",
        )
        parser.add_argument(
            "--controllers", action="store_true", help="also certify all controllers for the vehicles that agree with the logs"
        )
        parser.add_argument(
            "--plan", action="store_true", help="print the chirps that would determine the parameters best, and stop"
        )
        parser.add_argument("--out", type=Path, metavar="FILE", help="write the identified vehicle (.toml)")
        parser.add_argument("--picture", type=Path, metavar="FILE", help="draw measured and predicted signals; needs matplotlib")
        parser.add_count("--seed", "seed of further starting points of the search", "0", 0, 2**31, 0)
        parser.add_printed("shares of correlations of the residuals that are outside their bounds")

    def check(self, request: StudyRequest) -> None:
        from models.document.outputs import check_outputs

        options = request.options
        check_outputs({"vehicle": options.out}, [*options.files, *options.hold_out], options.json)
        if not options.files and not options.plan:
            raise InputError("no log is given; give the file of a log, or --plan to plan a test")
        if options.columns and options.plan:
            raise InputError("--columns and --plan print different results; give only one of the two")
        if (options.columns or options.plan) and options.picture is not None:
            raise InputError(f"{'--columns' if options.columns else '--plan'} draws no picture; omit --picture")
        if options.plan and options.out is not None:
            raise InputError("--plan writes no vehicle file, so --out has no effect; omit --out")

    def run(self, request: StudyRequest, progress: Progress) -> "Result":
        from models.common.files import whole_file
        from models.vehicle.vehicle import read_vehicle
        from sim.studies.identification.columns import map_text
        from sim.studies.identification.identification import identify
        from sim.studies.identification.log_map import read_map
        from sim.studies.identification.plan import plans
        from sim.studies.identification.report import vehicle_text

        options = request.options
        vehicle = read_vehicle(options.vehicle)
        progress("logs and estimate")
        if options.plan:
            return plans(vehicle, read_map(options.signals, vehicle), options.fix, options.free)
        if options.columns:
            result = text = map_text(options.files, vehicle)
        else:
            result = identify(options.files, vehicle, options.signals, options.fix, options.free, options.hold_out, options.seed)
            if options.controllers:
                from sim.studies.identification.allowed import allowed_results

                result = replace(result, allowed=tuple(allowed_results(result)))
            text = vehicle_text(result, options.files) if options.out is not None else ""
        if options.out is not None:
            with whole_file(options.out, "vehicle") as beside:
                beside.write_text(text, encoding="utf-8", newline="\n")
        return result

    def title(self, request: StudyRequest, result: "Result") -> str:
        assert not isinstance(result, str)
        if isinstance(result, list):
            return f"plan for {request.options.vehicle}"
        logs = ", ".join(path.name for path in request.options.files)
        return f"{result.vehicle.kind.name} identified from {logs}"

    def lines(self, request: StudyRequest, result: "Result", files: "Sequence[str]") -> list[str]:
        from models.document.text import text_lines

        options = request.options
        if isinstance(result, str):
            return [f"map: {options.out}"] if options.out is not None else [Whole(line) for line in result.splitlines()]
        out = [f"  vehicle file: {options.out}"] if options.out is not None else []
        source = "" if isinstance(result, list) else result.vehicle.source
        title = title_lines(self.title(request, result), source)
        return [*title, *files, *out, "", *text_lines(self.describe(request, result), "full" if options.verbose else "normal")]

    def describe(self, request: StudyRequest, result: "Result") -> "Document":
        from sim.studies.identification.report import describe, describe_plans

        assert not isinstance(result, str)
        return describe_plans(result) if isinstance(result, list) else describe(result)

    def record(self, request: StudyRequest, result: "Result") -> dict[str, Any]:
        from sim.studies.identification.plan import PLAN
        from sim.studies.identification.report import record

        if isinstance(result, list):
            return {"plans": [PLAN(one) for one in result]}
        return {"map": result} if isinstance(result, str) else record(result)

    def figure(self, request: StudyRequest, result: "Result") -> "Figure":
        from sim.studies.identification.report import figure

        assert not isinstance(result, str | list)
        return figure(result)

    def holds(self, result: "Result") -> bool:
        return isinstance(result, str | list) or result.estimate.white
