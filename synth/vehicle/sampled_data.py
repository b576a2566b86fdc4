"""A controller of a vehicle file that is designed for the loop that its computer closes: a static gain or a full-order law."""

import contextlib
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from models.common.printed import digits
from models.laws.linear import LinearLaw, static_law
from models.vehicle.controllers import ControllerEntry
from models.vehicle.vehicle import Vehicle
from synth.analysis.bounding import certify_tightly
from synth.analysis.lower_bound import LowerBound, SampledBound
from synth.controller.controller import Controller
from synth.controller.implementation_norm import held_problem
from synth.controller.problem import Problem, plant_states
from synth.design.fixed_order.sampled_data import sampled_fixed_order
from synth.design.full_order.sampled_data import sampled_full_order
from synth.design.sampled_data import held_design, refined_further
from synth.plant.numerics import DesignError
from synth.vehicle.refined import RefinedController


def sampled_design(
    vehicle: Vehicle, entry: ControllerEntry, posed: Problem, lower_bound: LowerBound, ideal: Callable[[], Controller]
) -> Controller:
    """Designs a gain for the sampled loop. Returns it with the certificate of its ideal loop and a remark on the sampled one.

    Args:
        vehicle: vehicle with sample period and delay.
        posed: the problem by which its ideal loop is evaluated.
        ideal: returns the design for the ideal loop, which is a start of this one, or raises a DesignError.

    Raises:
        InputError: the vehicle has no sample period.
        DesignError: no gain was found.
    """
    held, known = held_problem(vehicle, entry), []
    with contextlib.suppress(DesignError):
        known = [ideal().law.D]
    designed = held_design(held, lower_bound.gamma or 1.0, known)
    level = f", whose norm is at most {digits(designed.level)} by the LMI" if designed.level is not None else ""
    reads = ", without measuring the delayed forces" if vehicle.implementation.delay else ""
    controller = _controller(entry, posed, lower_bound, static_law(designed.gain), f"designed for the sampled loop{reads}{level}")
    return replace(
        controller,
        redundant=tuple(signal for i, signal in enumerate(entry.measured) if i not in designed.kept),
        fallback_method=f"designed by descent on the sampled norm; reason: {designed.instead}" if designed.instead else "",
    )


def full_order_sampled_design(
    vehicle: Vehicle, entry: ControllerEntry, posed: Problem, lower_bound: LowerBound, bound: SampledBound | None
) -> Controller:
    """Designs a discrete law of full order or of a structure for the sampled loop; arguments as for `sampled_design`.

    Args:
        bound: lower bound of the sampled loop; None if none is proved.
    """
    states = plant_states(vehicle, vehicle.limits.actuator_bandwidth)
    given = held_problem(vehicle, entry), bound, lower_bound.gamma or 1.0, states, entry.stable
    design = sampled_full_order(*given) if entry.structure is None else sampled_fixed_order(*given, entry.structure)
    law = replace(design.law, anti_windup=entry.anti_windup)
    remark = f"designed for the sampled loop{f'; {design.remark}' if design.remark else ''}"
    return _controller(entry, posed, lower_bound, law, remark)


def sampled_refinement(
    vehicle: Vehicle, entry: ControllerEntry, posed: Problem, start: Controller, lower_bound: LowerBound
) -> RefinedController:
    """Returns the controller of an entry with a lower sampled norm; arguments as for `refined`.

    Raises:
        DesignError: the sampled loop of the start is not stable.
    """
    refinement = refined_further(held_problem(vehicle, entry), start.law.D, lower_bound.gamma or 1.0)
    gain = static_law(refinement.gain)
    controller = _controller(entry, posed, lower_bound, gain, "designed and refined for the sampled loop")
    return RefinedController(replace(controller, redundant=start.redundant), start, "", refinement)


def _controller(entry: ControllerEntry, posed: Problem, lower_bound: LowerBound, law: LinearLaw, remark: str) -> Controller:
    """Returns the controller of a law, with the certificate of its ideal loop.

    Raises:
        DesignError: the ideal loop does not exist, or rounding leaves no certificate.
    """
    try:
        certificate = certify_tightly(*posed.closed_loop(law), lower_bound, by_itself=posed.plant)
    except (ValueError, np.linalg.LinAlgError) as error:
        raise DesignError(f"the law designed for the sampled loop cannot be converted to continuous time: {error}") from error
    return Controller.of(entry, law, certificate, remarks=(remark,), sampled=True)
