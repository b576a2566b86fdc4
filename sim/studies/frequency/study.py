"""Studies of frequency responses: the command `sweep`, and two sections of the report."""

from argparse import Namespace
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from models.common.errors import InputError
from models.common.printed import title_lines
from models.document.document import Document, Table
from models.document.figure import Figure, styles
from models.document.text import text_lines
from models.roads.sinusoids import sinusoid
from sim.linear.nonlinear_elements import at_rest
from sim.runs.run import Run, run_controllers, sample_times
from sim.studies.frequency.command import SweepCommand
from sim.studies.frequency.describing_function import DescribingFunction, describing_function
from sim.studies.frequency.figure import sweep_figure
from sim.studies.frequency.identification import Lines, ideal_measurements, measure_responses
from sim.studies.frequency.report import describe, summarize, workshop
from sim.studies.frequency.sweep import OWN, Sweep, holds, record, sweep
from sim.studies.frequency.worst_case_gain import DURATION
from sim.studies.study import Progress, Study, StudyRequest

if TYPE_CHECKING:
    from sim.studies.subject import Subject


@dataclass(frozen=True, eq=False)
class Responses:
    """Results of the study of frequency responses and gains.

    Attributes:
        lines: frequency responses of the linear controllers.
        sweeps: sweeps of the linear controllers; empty if only frequency responses were measured.
        own: describing functions of the nonlinear laws.
    """

    lines: Sequence[Lines]
    sweeps: Sequence[Sweep]
    own: Sequence[DescribingFunction]

    def each(self, names: Sequence[str]) -> list[Sweep | DescribingFunction]:
        """Returns the sweeps and the describing functions of all controllers, in the order of the controllers' names."""
        return sorted([*self.sweeps, *self.own], key=lambda one: names.index(one.controller.name))


class SweepStudy(SweepCommand):
    """Study of the frequency responses and largest gains of controllers."""

    def check(self, request: StudyRequest) -> None:
        options, vehicle = request.options, request.vehicle
        if not 1e-3 <= options.speed <= 1e3:
            raise InputError(f"speed = {options.speed:g} m/s is not allowed; give a number from 0.001 to 1000 m/s")
        if "speed" in options.given and not any(wheel.behind(vehicle.parameters) for wheel in vehicle.kind.wheels):
            raise InputError(f"--speed affects only rear wheels, but a {vehicle.kind.name} has no rear wheels; omit --speed")

    def run(self, request: StudyRequest, progress: Progress) -> Responses:
        vehicle, options = request.vehicle, request.options
        how = options.amplitude, options.timestep, options.speed
        linear = [one for one in request.controllers if one.linear is True]
        if getattr(options, "lines_alone", False):
            return Responses(measure_responses(at_rest(vehicle), linear, *how) if linear else [], [], [])
        sweeps = sweep(vehicle, linear, *how, progress) if linear else []
        progress(OWN)
        own = [describing_function(vehicle, one, *how) for one in request.controllers if not one.linear]
        return Responses([one.lines for one in sweeps], sweeps, own)

    def describe(self, request: StudyRequest, result: Responses) -> Document:
        options = request.options
        return describe(request.vehicle, result.lines, result.sweeps, result.own, options.amplitude, options.timestep)

    def record(self, request: StudyRequest, result: Responses) -> dict[str, Any]:
        options = {key: getattr(request.options, key) for key in ("amplitude", "timestep", "speed")}
        return {"sweeps": [record(one) for one in result.each(request.names)], **options}

    def lines(self, request: StudyRequest, result: Responses, files: Sequence[str]) -> list[str]:
        vehicle, verbose = request.vehicle, request.options.verbose
        several = verbose and len(result.sweeps) + len(result.own) > 1
        document = self.describe(request, replace(result, own=()) if several else result)
        shown = [one for one in document.blocks if not (isinstance(one, Table) and (several or one.name == "signals"))]
        _, *lines = text_lines(replace(document, blocks=tuple(shown)), "full" if verbose and not several else "normal")
        if several:
            lines += text_lines(summarize(result.sweeps, result.own))[1:]
            lines.append("  shown only with --controller NAME -v, or --json: gains, signals, tyre loads")
        elif verbose and result.sweeps:
            lines += ["", *text_lines(workshop(vehicle, result.sweeps))]
        elif result.sweeps:
            lines.append("  -v adds invariants, norms and EUSAMA's minimum loads")
        return [*title_lines(f"{document.title} of {vehicle.kind.name}", vehicle.source), *lines, *files]

    def holds(self, result: Responses) -> bool:
        return all(map(holds, (*result.sweeps, *result.own)))

    def figure(self, request: StudyRequest, result: Responses) -> Figure:
        options = request.options
        known = getattr(options, "styles", None) or styles(tuple(request.names))
        return sweep_figure(request.vehicle, result.lines, options.timestep, options.speed, known, result.own)

    def runs(self, request: StudyRequest, result: Responses) -> dict[str, Run]:
        """Returns the run of each controller over the worst sinusoidal road, starting from equilibrium."""
        vehicle, options, runs = ideal_measurements(request.vehicle), request.options, {}
        time = sample_times(vehicle, DURATION, options.timestep)
        for one in result.each(request.names):
            road = sinusoid(one.worst_omega, options.speed).scaled(options.amplitude / 2)
            (runs[one.controller.name],) = run_controllers(vehicle, [one.controller], road, time)
        return runs

    def requests(self, scope: "Subject") -> Mapping[str, StudyRequest]:
        controllers = scope.stable if scope.quick else [*scope.stable, *scope.laws]
        return {"": self._request(scope, controllers)} if controllers else {}

    def _request(self, scope: "Subject", controllers: Sequence[Any]) -> StudyRequest:
        from sim.studies.subject import AMPLITUDE

        how = {"amplitude": AMPLITUDE, "timestep": scope.timestep, "speed": scope.speed, "styles": scope.styles}
        return StudyRequest(Namespace(**how, lines_alone=scope.quick), scope.vehicle, (), controllers)

    def sections(self, scope: "Subject", results: Mapping[str, Mapping[str, Any]]) -> list[Document]:
        request = self._request(scope, ())
        return [
            replace(section, blocks=(self.figure(request, found), *section.blocks))
            for found in results[self.name].values()
            for section in [self.describe(request, found)]
        ]


class WorkshopStudy(Study[None]):
    """Study that adds the section about the EUSAMA test to a report. The results of this study are computed by `SweepStudy`."""

    def sections(self, scope: "Subject", results: Mapping[str, Mapping[str, Any]]) -> list[Document]:
        return [workshop(scope.vehicle, one.sweeps) for one in results.get("sweep", {}).values() if one.sweeps]
