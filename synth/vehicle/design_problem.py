"""Converts a controller's section of a vehicle file to a design problem, and the result of a design to a controller."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from models.common.extensions import FEATURES
from models.common.printed import digits
from models.laws.design_methods import FULL, PREVIEW
from models.laws.linear import LinearLaw, static_law
from models.vehicle.controllers import ControllerEntry
from models.vehicle.vehicle import Vehicle
from synth.analysis.certificate import Certificate
from synth.controller.controller import Controller, on_readings
from synth.controller.problem import Problem, plant_states
from synth.design.problem import H2_NORM, MU, DesignProblem, DesignResult

if TYPE_CHECKING:
    from synth.analysis.lower_bounds.lower_bound import LowerBound

STATE_ALONE = (
    "states of filters are not measured: this static gain uses the states of the vehicle only and is designed as an output "
    "feedback"
)


def design_problem(vehicle: Vehicle, entry: ControllerEntry, plant_problem: Problem, lower_bound: "LowerBound") -> DesignProblem:
    """Returns the design problem that a controller's section without goals defines.

    Args:
        vehicle: vehicle whose file contains the section.
        entry: controller's section, which defines the design.
        plant_problem: plant and measurements for which the controller is certified.
        lower_bound: lower bound on the norm for any controller with the same measurements.

    Raises:
        InputError: the controller of a preview design does not measure every state, or a design for the sampled-data loop has
            no sample period.
        DesignError: an LQG design has noise, but no sample period.
    """
    request = entry.request
    by_force = request.structure is not None and request.structure.rows is not None
    noise = FEATURES.load("mean square designs").white_noise(vehicle, entry, plant_problem) if request.design == "lqg" else None
    problem = DesignProblem(
        plant=plant_problem.plant
        if by_force
        else plant_problem.plant.without_feedthrough
        if request.two_steps
        else plant_problem.of_states,
        order="full" if request.design == FULL else "static",
        structure=request.structure,
        design=request.design if request.design != FULL else "",
        stable=request.stable,
        fastest_pole=request.fastest_pole,
        noise=noise,
        preview=request.preview,
        alternatives=False,
        thorough=False,
        lower_bound=lower_bound,
        states=plant_states(vehicle, entry.hardware.bandwidth),
    )
    # a design for the sampled-data loop uses the measurements unchanged
    if not (request.two_steps or by_force or request.sampled):
        problem = replace(problem, as_run=partial(on_readings, problem=plant_problem))
    if request.sampled:
        states = plant_states(vehicle, vehicle.limits.actuator_bandwidth)
        near, certify = lower_bound.gamma or 1.0, certify_ideal_loop(plant_problem, lower_bound)
        return replace(
            problem,
            sampled=FEATURES.load("norm as implemented").held_problem(vehicle, entry),
            near=near,
            states=states,
            certify=certify,
        )
    if entry.errors is not None:
        weighted_errors = FEATURES.load("weighted errors")
        if weighted_errors.is_robust_design(entry):
            ideal = certify_ideal_loop(plant_problem, lower_bound)
            errors, as_run = weighted_errors.structured_plant(vehicle, entry, entry.errors), problem.as_run
            return replace(problem, errors=errors, certify=lambda law: ideal(as_run(law)))
    if request.design == PREVIEW:
        FEATURES.load("mean square designs").check_preview(entry, problem)
    return problem


def certify_ideal_loop(problem: Problem, lower_bound: "LowerBound") -> Callable[[LinearLaw], Certificate]:
    """Returns a function that certifies, for the ideal loop, a control law that acts on the measurements."""
    certify_tightly = FEATURES.load("bounds by Riccati equations").certify_tightly
    return lambda law: certify_tightly(*problem.closed_loop(law), lower_bound, plant_without_law=problem.plant)


def controller_of(
    vehicle: Vehicle, entry: ControllerEntry, plant_problem: Problem, problem: DesignProblem, result: DesignResult
) -> Controller:
    """Builds a controller from the result of a design. The control law of this controller acts on the sensor signals."""
    law, remarks = problem.as_run(result.law), result.remarks
    redundant = tuple(entry.measured[i] for i in result.redundant if i < len(entry.measured))
    if entry.request.sampled:
        of_gain = "" if result.law.states else ", without measuring the delayed forces" * bool(vehicle.implementation.delay)
        level = f", whose norm is at most {digits(result.level)} by the LMI" if result.level is not None else ""
        remarks = "; ".join([f"designed for the sampled loop{of_gain}{level}", *remarks])
        instead = f"designed by descent on the sampled norm; reason: {result.instead}" if result.instead else ""
        more = {"remarks": (remarks,), "sampled": True, "redundant": redundant, "fallback_method": instead}
        return Controller.of(entry, replace(law, anti_windup=entry.request.anti_windup), result.certificate, **more)
    if entry.request.two_steps:
        beside = STATE_ALONE if entry.name == "state" and len(plant_problem.plant.Cy) < len(plant_problem.plant.A) else ""
        return Controller.of(
            entry,
            plant_problem.on_readings(static_law(plant_problem.plant.on_readings(result.gain))),
            result.certificate,
            steps=result,
            redundant=redundant,
            degeneracy="; ".join(filter(None, (result.case, beside))),
            fallback_method=result.instead,
        )
    if problem.structure is not None and result.criterion != MU:
        remarks = *([result.remark] if remarks else []), f"designed by descent on the norm from {result.origin}"
    if result.criterion == H2_NORM:
        remarks = FEATURES.load("mean square designs").mean_square_text(problem, result), *remarks
    preview = None if result.preview is None else FEATURES.load("mean square designs").preview_of_roads(vehicle, result.preview)
    law = replace(law, anti_windup=entry.request.anti_windup)
    return Controller.of(entry, law, result.certificate, remarks=remarks, preview=preview)
