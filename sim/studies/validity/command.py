"""The study of validity: a map of the bumps over which linear analysis is valid; its axes are height, length or speed."""

from argparse import Namespace
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from models import USUAL_TIMESTEP
from models.common.command import Parser, print_remarks
from models.common.errors import InputError
from models.vehicle.names import BUMP_HEIGHT, BUMP_LENGTH, BUMP_SPEED, LOAD_SYNTAX, PLUS
from sim.studies.study import Progress, Study, StudyRequest

if TYPE_CHECKING:
    from models.common.arrays import Array
    from models.document.document import Document
    from models.document.figure import Figure
    from models.roads.loads.load import Load
    from models.roads.road import Bump
    from models.vehicle.vehicle import Vehicle
    from sim.runs.run import Run
    from sim.studies.subject import Subject
    from sim.studies.validity.regime_end import RegimeEnd
    from sim.studies.validity.regime_map import Cells

OF_A_PAGE = ("height:0.02:0.3:20", "speed:3:30:20")  # axes of the maps that a report shows


class EnvelopeStudy(Study["Cells"]):
    """Study that maps the validity of linear analysis: for one controller in the command, for each active one in the report."""

    description = "Map the bumps over which linear analysis is valid, and the limits that end it."
    epilog = """
exit code: 0 MuJoCo first reaches the limit that linear analysis predicts; 1 it first reaches another limit, or the controller
cannot be designed; 2 invalid input; 130 interrupted

examples:
  roadproof envelope --controller I --vary height:0.02:0.3:20 --vary speed:3:30:20 --picture envelope.png
  roadproof envelope --controller I --vary height:0.02:0.6:30 --speed 12.5
  roadproof envelope --controller II --vary length:1:10:30 --vary speed:4:30:30 --height 0.08 --csv envelope.csv
"""
    page = "docs/how-to/envelope.md"
    stages = ("map",)
    seconds = 8.0

    def add_options(self, parser: Parser) -> None:
        parser.add_one("passive, state, or a controller of the vehicle file")
        parser.add_argument(
            "--vary",
            action="append",
            metavar="NAME:LOW:HIGH:COUNT",
            help="axis of the map: height [m], length [m] or speed [m/s], for example height:0.02:0.3:20; give one or two axes",
        )
        parser.add_number("--height", BUMP_HEIGHT, "m", "bump height, if not varied")
        parser.add_number("--length", BUMP_LENGTH, "m", "bump length, if not varied")
        parser.add_number("--speed", BUMP_SPEED, "m/s", "speed of the vehicle, if not varied")
        parser.add_loads("load on the body over every bump", LOAD_SYNTAX)
        parser.add_number("--threshold", 0.05, "-", "linear analysis is valid up to this error, relative to the peak")
        parser.add_number("--duration", 3.0, "s", "duration of each run")
        parser.add_number("--timestep", USUAL_TIMESTEP, "s", "integration step and sample period of the controller")
        parser.add_argument("--every-cell", action="store_true", help="simulate every cell of the map; takes ten times as long")
        parser.add_logs("the runs closest to each limit")
        parser.add_argument("--csv", type=Path, metavar="FILE", help="write the numbers of every cell (.csv)")
        parser.add_argument("--picture", type=Path, metavar="FILE", help="draw the map (.png, .svg or .pdf); needs matplotlib")
        parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")

    def vehicle(self, given: "Vehicle", names: Sequence[str]) -> "Vehicle":
        """Returns the vehicle in equilibrium, from which each run over a bump starts."""
        return given.with_common_actuators(names).starting()

    def check(self, request: StudyRequest) -> None:
        from models.roads.road import LOWEST
        from sim.studies.validity.map_runs import with_loads

        options, (bumps, time, loads) = request.options, _map_of(request)
        print_remarks(bumps[-1])  # remarks are printed for the largest bump only
        if not 0 < options.threshold < 1:
            raise InputError(f"threshold = {options.threshold:g} is not allowed; give a number above 0 and below 1, such as 0.05")
        if abs(bumps[0].height) < LOWEST:
            raise InputError(f"height = {bumps[0].height:g} m is too small; give at least {LOWEST:g} m, up or down")
        shortest, longest = (pick(bumps, key=lambda bump: bump.duration) for pick in (min, max))
        shortest.check(request.vehicle, time)
        if longest.duration > time[-1]:
            raise InputError(
                f"the longest bump takes {longest.duration:.3g} s, but a run lasts only {time[-1]:g} s; give a longer --duration"
            )
        with_loads(bumps[0], loads).check(request.vehicle, time)

    def run(self, request: StudyRequest, progress: Progress) -> "Cells":
        from sim.studies.validity.regime_map import validity

        options, (bumps, time, loads) = request.options, _map_of(request)
        progress(self.stages[0])

        def done(count: int) -> None:
            progress(f"{count} of {len(bumps)} cells")

        return validity(request.vehicle, request.controllers[0], bumps, time, done, loads, options.every_cell, options.threshold)

    def describe(self, request: StudyRequest, result: "Cells") -> "Document":
        from sim.studies.validity.report import describe

        return describe(result)

    def record(self, request: StudyRequest, result: "Cells") -> dict[str, Any]:
        from sim.studies.validity.report import RECORD

        return RECORD(result) | ({"loads": request.options.loads} if request.options.loads else {})

    def title(self, request: StudyRequest, result: "Cells") -> str:
        under = f", under {PLUS.join(load.label for load in result.loads)}" if result.loads else ""
        name = result.controller.name
        return f"{request.vehicle.kind.name} with controller {name}, over {len(result.bumps)} bumps{under}"

    def holds(self, result: "Cells") -> bool:
        return result.as_predicted

    def figure(self, request: StudyRequest, result: "Cells") -> "Figure":
        from sim.studies.validity.report import envelope_figure

        return envelope_figure(result)

    def write_csv(self, path: Path, result: "Cells") -> None:
        from sim.studies.validity.report import write_csv

        write_csv(path, result)

    def runs(self, request: StudyRequest, result: "Cells") -> "dict[str, Run]":
        """Simulates some cells of the map, and returns the runs by name.

        For each limit, the simulated cell is the one that exceeds the limit least. One more cell is the closest to a limit from
        below.
        """
        import numpy as np

        from sim.drive.regime import END_NAMES
        from sim.runs.run import run_controllers, sample_times
        from sim.studies.validity.map_runs import with_loads

        time = sample_times(request.vehicle, request.options.duration, request.options.timestep)
        nearest, used = {}, result.used.max(axis=-1)
        for end in (-1, *range(len(END_NAMES))):
            mine = np.flatnonzero(result.predicted == end)
            if len(mine):
                i = mine[used[mine].argmax() if end < 0 else used[mine].argmin()]
                what = "nothing breaks" if end < 0 else END_NAMES[end]
                (run,) = run_controllers(request.vehicle, request.controllers, with_loads(result.bumps[i], result.loads), time)
                nearest[f"{result.controller.name}_{what}".replace(" ", "_").replace("-", "_")] = run
        return nearest

    def requests(self, scope: "Subject") -> Mapping[str, StudyRequest]:
        from sim.studies.frequency.identification import ideal_measurements
        from sim.studies.subject import BUMP_DURATION

        if scope.quick or not scope.active:
            return {}
        vehicle, step = ideal_measurements(scope.vehicle), scope.map_timestep
        usual = {"length": BUMP_LENGTH, "loads": (), "every_cell": False, "threshold": 0.05, "given": set()}
        options = Namespace(vary=OF_A_PAGE, duration=BUMP_DURATION, timestep=step, height=None, speed=None, **usual)
        return {one.name: StudyRequest(options, vehicle, (), [one]) for one in scope.active}

    def sections(self, scope: "Subject", results: "Mapping[str, Mapping[str, Any]]") -> "Sequence[Document]":
        from sim.studies.validity.report import compare_maps

        maps = [results[self.name][one.name] for one in scope.active if one.name in results[self.name]]
        return [compare_maps(maps, scope.map_timestep, scope.noise_qualifier)] if maps else []


class EndsStudy(Study["list[RegimeEnd | None]"]):
    """Study that adds to a report the bump height up to which linear analysis is valid, for each stable controller."""

    def requests(self, scope: "Subject") -> "Mapping[str, Subject]":
        return {"": scope} if scope.stable else {}

    def run(self, request: "Subject", progress: Progress) -> "list[RegimeEnd | None]":
        from models.roads.road import Bump
        from sim.runs.run import sample_times
        from sim.studies.frequency.identification import ideal_measurements
        from sim.studies.subject import BUMP_DURATION
        from sim.studies.validity.regime_end import regime_ends

        time = sample_times(request.vehicle, BUMP_DURATION, request.timestep)
        return regime_ends(ideal_measurements(request.vehicle), request.stable, Bump(), time)

    def sections(self, scope: "Subject", results: "Mapping[str, Mapping[str, Any]]") -> "list[Document]":
        from models.roads.road import Bump
        from sim.studies.subject import BUMP_DURATION
        from sim.studies.validity.report import describe_ends

        runs = f"{BUMP_DURATION:g} s at {1e3 * scope.timestep:g} ms"
        return [
            describe_ends(
                scope.vehicle, [*zip(scope.stable, ends, strict=True)], scope.disagreeing_names, Bump(), scope.where, runs
            )
            for ends in results[self.name].values()
        ]


def _map_of(request: StudyRequest) -> "tuple[list[Bump], Array, tuple[Load, ...]]":
    """Returns the requested bumps, the sample times of all runs [s], shape (T,), and the requested loads.

    Raises:
        InputError: an axis or a load is invalid, or an option also sets the quantity of an axis.
    """
    from models.roads.loads.choice import choose_load
    from sim.runs.run import sample_times
    from sim.studies.validity.grid import UNITS, grid, read_axes

    options = request.options
    axes = read_axes(options.vary or [])
    for axis in axes:
        if axis.name in options.given:
            raise InputError(f"--{axis.name} and --vary {axis.name} set the same quantity; omit one of these options")
    bumps = grid(axes, {name: getattr(options, name) for name in UNITS})
    time = sample_times(request.vehicle, options.duration, options.timestep)
    return bumps, time, tuple(map(choose_load, options.loads))
