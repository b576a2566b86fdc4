"""Study of stability margins: the command `margins`, and a section of the report."""

import math
from argparse import Namespace
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from models.common.errors import InputError
from models.document.document import Document
from models.document.figure import Figure
from models.vehicle.limits_and_implementation import Implementation
from models.vehicle.vehicle import Vehicle
from sim.linear.nonlinear_elements import at_rest
from sim.linear.sampled_response import taylor4
from sim.runs.run import Run, run_controllers, sample_times
from sim.studies.stability.command import MarginsCommand
from sim.studies.stability.figure import margins_figure
from sim.studies.stability.margin_search import BUMP, LONGEST
from sim.studies.stability.margins import StabilityMargins, stability_margins
from sim.studies.stability.report import compare, describe, record
from sim.studies.study import Progress, StudyRequest
from sim.studies.subject import Subject
from synth.controller.controller import Controller
from synth.controller.design_notes import sign_note
from synth.controller.loop_of import loop_of, radius

RECORDED_TIME = 4.0  # s, duration of a recorded run


class MarginsStudy(MarginsCommand):
    """Study of stability margins: for one controller in the command, and for all active controllers in the report."""

    def check(self, request: StudyRequest) -> None:
        sample_times(at_rest(request.vehicle), LONGEST, request.options.timestep)

    def check_controllers(self, request: StudyRequest) -> None:
        vehicle = at_rest(request.vehicle)
        for one in request.controllers:
            check_loop(_without_computer(vehicle), vehicle, one, request.options.timestep)

    def run(self, request: StudyRequest, progress: Progress) -> list[StabilityMargins]:
        options = request.options
        each_loop = getattr(options, "each_loop", True)
        return stability_margins(request.vehicle, request.controllers, options.timestep, progress, each_loop)

    def describe(self, request: StudyRequest, result: list[StabilityMargins]) -> Document:
        return describe(result[0])

    def title(self, request: StudyRequest, result: list[StabilityMargins]) -> str:
        name = request.names[0]
        return f"{request.vehicle.kind.name} with controller {name}; MuJoCo at {request.options.timestep:g} s"

    def record(self, request: StudyRequest, result: list[StabilityMargins]) -> dict[str, Any]:
        return record(result[0])

    def holds(self, result: list[StabilityMargins]) -> bool:
        return all(one.agrees for one in result)

    def figure(self, request: StudyRequest, result: list[StabilityMargins]) -> Figure:
        return margins_figure(result[0])

    def recorded_vehicle(self, given: Vehicle) -> Vehicle:
        return _without_computer(given)

    def runs(self, request: StudyRequest, result: list[StabilityMargins]) -> dict[str, Run]:
        """Returns two runs: one with the longest stable delay, and one with the shortest unstable delay.

        If no delay is unstable, the only run has the longest delay that the search tried.
        """
        vehicle, timestep, delay = _without_computer(request.vehicle), request.options.timestep, result[0].loops[""].delay
        delays = [delay.stable, delay.unstable] if math.isfinite(delay.unstable) else [delay.stable]
        time, runs = sample_times(vehicle, RECORDED_TIME, timestep), {}
        for samples in (round(delay / timestep) for delay in delays):
            delayed = replace(vehicle, implementation=Implementation(delay=samples))
            (runs[f"{request.names[0]}_{samples}_samples_late"],) = run_controllers(delayed, request.controllers, BUMP, time)
        return runs

    def requests(self, scope: Subject) -> Mapping[str, StudyRequest]:
        options = Namespace(timestep=scope.margins_timestep, each_loop=False)
        return {"": StudyRequest(options, scope.vehicle, (), scope.active)} if scope.active and not scope.quick else {}

    def for_page(self, result: list[StabilityMargins]) -> Document:
        return compare(result)


def _without_computer(vehicle: Vehicle) -> Vehicle:
    """Returns the vehicle without sample period, delay and noise."""
    return replace(vehicle, implementation=Implementation())


def check_loop(vehicle: Vehicle, built: Vehicle, controller: Controller, timestep: float) -> None:
    """Checks that the ideal and the implemented loop have margins: both must be stable, and the controller must command a
    force.

    Args:
        vehicle: vehicle without sample period, delay and noise.
        built: vehicle with the sample period, delay and noise of the vehicle file.
        controller: controller that closes the loop.
        timestep: timestep of the simulation [s].

    Raises:
        InputError: a loop is unstable, or the controller commands no force.
    """
    name, certificate = f"controller {controller.name!r}", controller.certificate
    if not controller.law.acts:
        raise InputError(
            f"{name} requests no force, so it closes no loop and has no stability margin; choose a different controller"
        )
    if not certificate.stable:
        why = f"its ideal loop is not stable ({certificate.stability.words})"
        raise InputError(f"{name} has no stability margin, because {why}; choose a stable controller{sign_note(controller)}")
    times = loop_of(vehicle, controller).direct_radius
    if times >= 1:
        raise InputError(
            f"{name} tolerates neither delay nor sampling, because its own force returns in its measurements "
            f"{times:.4g} times as large and grows at each sample; lower the gain on accelerations, or filter accelerations"
        )
    growth = radius(loop_of(vehicle, controller, timestep, taylor4))
    if growth >= 1:
        raise InputError(
            f"{name} is not stable because of the timestep of {timestep:g} s or the lag of the actuators (motion grows by a "
            f"factor of {growth:.6g} every step); give a smaller timestep or a larger actuator_bandwidth"
        )
    if radius(loop_of(built, controller, timestep, taylor4)) >= 1:
        why = f"its implemented loop is not stable ({', '.join(built.implementation.without_noise.phrases)})"
        raise InputError(f"{name} has no stability margin, because {why}; give a shorter sample_period or delay")
