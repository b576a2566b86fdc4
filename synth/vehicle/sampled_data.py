"""A gain with a lower norm of the sampled loop."""

from models.laws.linear import static_law
from models.vehicle.controllers import ControllerEntry
from models.vehicle.vehicle import Vehicle
from synth.analysis.lower_bound import LowerBound
from synth.controller.controller import Controller
from synth.controller.implementation_norm import held_problem
from synth.controller.problem import Problem
from synth.design.sampled_data import refined_further
from synth.vehicle.design_problem import certify_ideal_loop
from synth.vehicle.refined import RefinedController


def sampled_refinement(
    vehicle: Vehicle, entry: ControllerEntry, posed: Problem, start: Controller, lower_bound: LowerBound
) -> RefinedController:
    """Returns the controller of an entry with a lower sampled norm; arguments as for `refined`.

    Raises:
        DesignError: the sampled loop of the start is not stable.
    """
    refinement = refined_further(held_problem(vehicle, entry), start.law.D, lower_bound.gamma or 1.0)
    gain = static_law(refinement.gain)
    certificate = certify_ideal_loop(posed, lower_bound)(gain)
    remarks = ("designed and refined for the sampled loop",)
    controller = Controller.of(entry, gain, certificate, remarks=remarks, sampled=True, redundant=start.redundant)
    return RefinedController(controller, start, "", refinement)
