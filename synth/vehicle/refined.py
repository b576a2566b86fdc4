"""Result of the option `--refine` for a controller: the trade-off of norm and gain, and an estimate of the benefit of
refinement.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.laws.combinations import check_command, goes
from models.laws.linear import static_law
from models.vehicle.controllers import ControllerEntry
from models.vehicle.vehicle import Vehicle
from synth.analysis.bounding import certify_law
from synth.analysis.lower_bounds.lower_bound import LowerBound
from synth.controller.controller import Controller
from synth.controller.problem import Problem
from synth.design.descent.refine import SEEN, Refinement, from_some, refine, worth_refining
from synth.design.two_step import independent_rows
from synth.plant.numerics import DesignError

NOT_REFINED = "but --refine changes static gains, which have no integral; omit --refine"


@dataclass(frozen=True, eq=False)
class RefinedController:
    """Controller whose norm was reduced by refinement, and details of the refinement.

    Attributes:
        controller: refined controller, which includes a certificate.
        start: controller that was refined; None if the two-step method found no gain.
        origin: description of the gain at which the minimisation of the norm began; empty if the minimisation began at `start`.
        refinement: norms before and after the refinement, growth of the gain, and the decrease of the norm that was rejected as
            too small.
    """

    controller: Controller
    start: Controller | None
    origin: str
    refinement: Refinement

    @property
    def trade_off_text(self) -> str:
        """Text that describes the trade-off between the norm and the size of the gain."""
        return f"refined: {f'from {self.origin}; ' if self.origin else ''}{self.refinement.trade_off_text}"


def refined_controller(designer: Any, name: str, zero_l: bool) -> RefinedController:
    """Returns the refined controller of a vehicle from its `Designer`; see `Designer.refine`."""
    entry, vehicle = designer.entry(name), designer.vehicle
    measured = entry.measured
    if not measured:
        raise InputError(
            f"controller {name!r} measures nothing, so it has no gain to refine; give a controller with measurements"
        )
    check_command(f"controller {entry.name!r}", entry.parts, "refine", DesignError)
    if vehicle.integrals:
        raise DesignError(f"controller {entry.name!r}: [performance] weights an integral, {NOT_REFINED}")
    try:
        start = designer.design(name, zero_l)
    except DesignError:
        start = None
    problem, lower_bound = designer.problem(measured, entry.hardware), designer.lower_bound(measured, entry.hardware)
    if entry.request.sampled and start is None:
        designer.design(name)  # this call raises an error that states the reason
    return refine_controller(vehicle, entry, problem, start, lower_bound)


def refine_controller(
    vehicle: Vehicle, entry: ControllerEntry, problem: Problem, start: Controller | None, lower_bound: LowerBound
) -> RefinedController:
    """Returns a controller with a lower norm than `start` for a section of the vehicle file.

    Args:
        vehicle: vehicle to which the controller belongs.
        entry: section of the vehicle file that defines the controller.
        problem: control problem with which the controller is evaluated.
        start: controller to refine; None if the two-step method found no gain. If `start` is None, the best result from several
            other starting gains is used.
        lower_bound: lower bound on the norm for any controller with the same measurements.

    Raises:
        DesignError: the gain of `start` does not stabilise the vehicle, or no starting point leads to a gain.
    """
    if entry.request.sampled and start is not None:
        from synth.controller.implementation_norm import held_problem
        from synth.design.sampled_data import refined_further
        from synth.vehicle.design_problem import certify_ideal_loop

        refinement = refined_further(held_problem(vehicle, entry), start.law.D, lower_bound.gamma or 1.0)
        gain, remarks = static_law(refinement.gain), ("designed and refined for the sampled loop",)
        certificate = certify_ideal_loop(problem, lower_bound)(gain)
        controller = Controller.of(entry, gain, certificate, remarks=remarks, sampled=True, redundant=start.redundant)
        return RefinedController(controller, start, "", refinement)
    rows, origin = independent_rows(problem.plant), ""
    independent = problem.plant.rows(rows).without_feedthrough
    if start is None:
        from synth.design.static import static_output_feedback

        static = static_output_feedback(independent, lower_bound=lower_bound)
        K, origin = static.gain, static.origin
    else:
        K = _gain(vehicle, start, problem, rows)
    refinement = refine(independent, None, K)
    gain = np.zeros((len(K), len(entry.measured)))
    gain[:, rows] = refinement.gain
    certificate = certify_law(independent, static_law(refinement.gain), lower_bound)
    law = static_law(problem.plant.on_readings(gain))
    return RefinedController(Controller.of(entry, law, certificate), start, origin, refinement)


def worth(designer: Any, controller: Controller) -> float:
    """Returns a cautious (low) estimate of the relative norm decrease that refinement would achieve; 0 if the decrease is
    negligible.
    """
    vehicle = designer.vehicle
    if (
        not controller.designed
        or controller.sampled  # a design for the sampled-data loop has already been refined
        or not controller.measured
        or not goes("refine", designer.entry(controller.name).parts)
        or vehicle.integrals
        or not controller.certificate.stable
    ):
        return 0.0
    problem = designer.problem(controller.measured, controller.hardware)
    gap = controller.certificate.gap
    if gap is not None and gap <= SEEN:
        return 0.0
    rows = independent_rows(problem.plant)
    independent = problem.plant.rows(rows).without_feedthrough
    share = worth_refining(independent, _gain(vehicle, controller, problem, rows))
    return share if share > SEEN else 0.0


def _gain(vehicle: Vehicle, controller: Controller, problem: Problem, kept: list[int]) -> Array:
    """Returns the controller's gain from the independent measurements only, shape (m, len(kept))."""
    return from_some(controller.law_on_states(vehicle).D, problem.plant.Cy, kept)
