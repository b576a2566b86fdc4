"""Studies of the validity of linear analysis, which compute the map and the bump height up to which linear analysis is valid."""

from argparse import Namespace
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.command import print_remarks
from models.common.errors import InputError
from models.document.document import Document
from models.document.figure import Figure
from models.roads.loads.choice import choose_load
from models.roads.loads.load import Load
from models.roads.road import LOWEST, Bump
from models.vehicle.names import BUMP_LENGTH, PLUS
from models.vehicle.vehicle import Vehicle
from sim.drive.regime import END_NAMES
from sim.runs.run import Run, run_controllers, sample_times
from sim.studies.frequency.identification import ideal_measurements
from sim.studies.study import Progress, Study, StudyRequest
from sim.studies.subject import BUMP_DURATION, Subject
from sim.studies.validity.command import EnvelopeCommand
from sim.studies.validity.grid import UNITS, grid, read_axes
from sim.studies.validity.map_runs import with_loads
from sim.studies.validity.regime_end import RegimeEnd, regime_ends
from sim.studies.validity.regime_map import Cells, validity
from sim.studies.validity.report import RECORD, compare_maps, describe, describe_ends, envelope_figure, write_csv

OF_A_PAGE = ("height:0.02:0.3:20", "speed:3:30:20")  # axes of the maps that a report shows


class EnvelopeStudy(EnvelopeCommand):
    """Study that maps the validity of linear analysis, for one controller in the command, and for each active controller in the
    report.
    """

    def vehicle(self, given: Vehicle, names: Sequence[str]) -> Vehicle:
        """Returns the vehicle in equilibrium, from which each run over a bump starts."""
        return given.with_common_actuators(names).starting()

    def check(self, request: StudyRequest) -> None:
        options, (bumps, time, loads) = request.options, _map_of(request)
        print_remarks(bumps[-1])  # remarks are printed for the largest bump only
        if not 0 < options.threshold < 1:
            raise InputError(f"threshold = {options.threshold:g} is not allowed; give a number above 0 and below 1, such as 0.05")
        if abs(bumps[0].height) < LOWEST:
            raise InputError(f"height = {bumps[0].height:g} m is too small; give a magnitude of at least {LOWEST:g} m")
        shortest, longest = (pick(bumps, key=lambda bump: bump.duration) for pick in (min, max))
        shortest.check(request.vehicle, time)
        if longest.duration > time[-1]:
            raise InputError(
                f"the longest bump takes {longest.duration:.3g} s, but each run lasts only {time[-1]:g} s; give a "
                "longer --duration"
            )
        with_loads(bumps[0], loads).check(request.vehicle, time)

    def run(self, request: StudyRequest, progress: Progress) -> Cells:
        options, (bumps, time, loads) = request.options, _map_of(request)
        progress(self.stages[0])

        def done(count: int) -> None:
            progress(f"{count} of {len(bumps)} cells")

        return validity(request.vehicle, request.controllers[0], bumps, time, done, loads, options.every_cell, options.threshold)

    def describe(self, request: StudyRequest, result: Cells) -> Document:
        return describe(result)

    def record(self, request: StudyRequest, result: Cells) -> dict[str, Any]:
        return RECORD(result) | ({"loads": request.options.loads} if request.options.loads else {})

    def title(self, request: StudyRequest, result: Cells) -> str:
        under = f", under {PLUS.join(load.label for load in result.loads)}" if result.loads else ""
        name = result.controller.name
        return f"{request.vehicle.kind.name} with controller {name}, over {len(result.bumps)} bumps{under}"

    def holds(self, result: Cells) -> bool:
        return result.as_predicted

    def figure(self, request: StudyRequest, result: Cells) -> Figure:
        return envelope_figure(result)

    def write_csv(self, path: Path, result: Cells) -> None:
        write_csv(path, result)

    def runs(self, request: StudyRequest, result: Cells) -> dict[str, Run]:
        """Simulates some cells of the map, and returns the runs by name.

        For each limit, the cell that exceeds the limit by the smallest amount is simulated. In addition, the cell that comes
        closest to a limit without reaching it is simulated.
        """
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

    def requests(self, scope: Subject) -> Mapping[str, StudyRequest]:
        if scope.quick or not scope.active:
            return {}
        vehicle, step = ideal_measurements(scope.vehicle), scope.map_timestep
        usual = {"length": BUMP_LENGTH, "loads": (), "every_cell": False, "threshold": 0.05, "given": set()}
        options = Namespace(vary=OF_A_PAGE, duration=BUMP_DURATION, timestep=step, height=None, speed=None, **usual)
        return {one.name: StudyRequest(options, vehicle, (), [one]) for one in scope.active}

    def sections(self, scope: Subject, results: Mapping[str, Mapping[str, Any]]) -> Sequence[Document]:
        maps = [results[self.name][one.name] for one in scope.active if one.name in results[self.name]]
        return [compare_maps(maps, scope.map_timestep, scope.noise_qualifier)] if maps else []


class EndsStudy(Study[list[RegimeEnd | None]]):
    """Study that adds to a report, for each stable controller, the bump height up to which linear analysis is valid."""

    def requests(self, scope: Subject) -> Mapping[str, Subject]:
        return {"": scope} if scope.stable else {}

    def run(self, request: Subject, progress: Progress) -> list[RegimeEnd | None]:
        time = sample_times(request.vehicle, BUMP_DURATION, request.timestep)
        return regime_ends(ideal_measurements(request.vehicle), request.stable, Bump(), time)

    def sections(self, scope: Subject, results: Mapping[str, Mapping[str, Any]]) -> list[Document]:
        runs = f"{BUMP_DURATION:g} s with a timestep of {1e3 * scope.timestep:g} ms"
        return [
            describe_ends(
                scope.vehicle, [*zip(scope.stable, ends, strict=True)], scope.disagreeing_names, Bump(), scope.where, runs
            )
            for ends in results[self.name].values()
        ]


def _map_of(request: StudyRequest) -> tuple[list[Bump], Array, tuple[Load, ...]]:
    """Returns the requested bumps, the sample times of all runs [s], shape (T,), and the requested loads on the body.

    Raises:
        InputError: an axis or a load is invalid, or another option sets a quantity that is already an axis.
    """
    options = request.options
    axes = read_axes(options.vary or [])
    for axis in axes:
        if axis.name in options.given:
            raise InputError(f"--{axis.name} and --vary {axis.name} set the same quantity; omit one of these options")
    bumps = grid(axes, {name: getattr(options, name) for name in UNITS})
    time = sample_times(request.vehicle, options.duration, options.timestep)
    return bumps, time, tuple(map(choose_load, options.loads))
