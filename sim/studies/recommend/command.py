"""The study that recommends a controller for a vehicle on a road."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from models.common.command import Parser, print_remarks
from models.common.errors import InputError
from models.common.extensions import FEATURES
from models.common.printed import title_lines
from models.vehicle.names import CLASSES, ROAD_SYNTAX
from sim.studies.recommend import GOALS
from sim.studies.study import Progress, Study, StudyRequest

if TYPE_CHECKING:
    from models.document.document import Document
    from sim.studies.recommend.result import Recommendation

QUICK = 0.1  # share of the usual number of candidates that --quick evaluates
LONGEST_RUN = 16.0  # s, duration for which a random road is built; it does not repeat itself within this time


class RecommendStudy(Study["Recommendation"]):
    """Study that ranks controllers for a vehicle on a road."""

    description = "Recommend a controller for a vehicle: search candidates of every kind, drive them in MuJoCo, and rank them."
    epilog = """
Candidates are designed for the implemented loop (sample period, delay, lag, noise, sensors of the vehicle file): another damper
and spring, skyhook laws, LQG, H-infinity, preview, semi-active laws and the controllers of the file. Their weights are searched
on the expected ride over the road. MuJoCo then drives the best ones over several roads. Ctrl-C prints the candidates so far.

exit code: 0 a controller is recommended; 1 none is better than the passive vehicle within the limits; 2 invalid input; 130
interrupted

examples:
  roadproof recommend --vehicle my_car.toml --class C --speed 90km/h
  roadproof recommend --vehicle my_car.toml --for holding --within stroke=90%,disk=0.4 --save best.toml
"""
    page = "docs/how-to/recommend.md"
    takes = ""
    stages = ("search and runs",)

    def add_options(self, parser: Parser) -> None:
        meaning = "vehicle file, or name of a built-in vehicle (default: quarter_car)"
        parser.add_argument("--vehicle", default="quarter_car", metavar="FILE", help=meaning)
        meaning = f"random road of ISO 8608, {CLASSES[0]} to {CLASSES[-1]} (default: C)"
        parser.add_argument("--class", dest="road_class", metavar="CLASS", help=meaning)
        parser.add_argument("--road", metavar="ROAD", help=f"road instead of --class: {ROAD_SYNTAX}".replace("%", "%%"))
        parser.add_number("--speed", 20.0, "m/s", "speed of the vehicle; other units, such as 90km/h, are allowed")
        meaning = "what is minimised: weighted acceleration, dynamic tyre load or travel (default: ride)"
        parser.add_argument("--for", dest="goal", choices=[*GOALS], default="ride", help=meaning)
        meaning = (
            "limits LIMIT=VALUE, separated by commas; other limits keep their defaults, and LIMIT=none removes a limit "
            "(default: stroke=95%%,force=100%%,gain_margin=6dB,disk=0.3,off_ground=0.1%%)"
        )
        parser.add_argument("--within", metavar="LIMITS", help=meaning)
        meaning = "write the vehicle file with the best controller as [controllers.best]"
        parser.add_argument("--save", type=Path, metavar="FILE", help=meaning)
        parser.add_argument("--quick", action="store_true", help="search only a tenth of the candidates")
        parser.add_number("--timestep", 1e-3, "s", "integration step of MuJoCo")
        parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")

    def check(self, request: StudyRequest) -> None:
        from sim.studies.recommend.within import read_within

        read_within(request.options.within or "")
        if request.options.road is not None and request.options.road_class is not None:
            raise InputError(
                "--class and --road cannot be combined, because --class C means --road iso8608:class=C; omit one of the two"
            )

    def run(self, request: StudyRequest, progress: Progress) -> "Recommendation":
        from models.document.outputs import check_outputs
        from models.vehicle.names import named_files
        from models.vehicle.vehicle import read_vehicle
        from sim.runs.run import sample_times
        from sim.studies.recommend.recommend import recommendation
        from sim.studies.recommend.result import save
        from sim.studies.recommend.task import Task
        from sim.studies.recommend.within import read_within

        options = request.options
        vehicle = print_remarks(read_vehicle(options.vehicle))
        check_outputs({"save": options.save}, [*vehicle.files, *named_files((options.road,))], options.json)
        text = options.road or f"iso8608:class={(options.road_class or 'C').upper()}"
        road = FEATURES.load("roads by name").choose_road(text).build(vehicle, options.speed, 0, options.speed * LONGEST_RUN)
        road.check(vehicle, sample_times(vehicle, LONGEST_RUN, options.timestep))
        progress(self.stages[0])
        effort = QUICK if options.quick else 1.0
        task = Task(vehicle, road, options.goal, read_within(options.within or ""), options.timestep, effort)
        result = recommendation(task, progress)
        if options.save is not None and not result.interrupted and result.saved is not None:
            save(options.save, result)
        return result

    def describe(self, request: StudyRequest, result: "Recommendation") -> "Document":
        return result.summary

    def record(self, request: StudyRequest, result: "Recommendation") -> dict[str, Any]:
        from sim.studies.recommend.result import RECORD

        return {**RECORD(result), "save": None if request.options.save is None else str(request.options.save)}

    def title(self, request: StudyRequest, result: "Recommendation") -> str:
        return f"{result.task.vehicle.kind.name} over a road: {result.task.road_words}"

    def lines(self, request: StudyRequest, result: "Recommendation", files: Sequence[str]) -> list[str]:
        from models.document.outputs import written_lines

        saved = None if result.interrupted or request.options.save is None else result.saved
        written = written_lines({"save": saved and request.options.save})
        if saved is not None and saved is not result.best:
            name = saved.candidate.name
            written.append(f"The file contains {name}, because the best controller needs the road ahead, or Python.")
        return [*title_lines(self.title(request, result), result.task.vehicle.source), *repr(result).splitlines(), *written]

    def holds(self, result: "Recommendation") -> bool:
        if result.interrupted:
            raise KeyboardInterrupt
        return result.best is not None
