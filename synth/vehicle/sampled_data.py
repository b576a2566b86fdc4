"""A controller of a vehicle file that is designed for the loop that its computer closes (`synth.design.sampled_data`)."""

import contextlib
from collections.abc import Callable

from models.common.errors import InputError
from models.laws.linear import static_law
from models.vehicle.controllers import ControllerEntry
from models.vehicle.vehicle import Vehicle
from synth.analysis.bounding import certify_tightly
from synth.analysis.lower_bound import LowerBound
from synth.controller.controller import Controller
from synth.controller.implementation_norm import pieces_of, plant_as_built
from synth.controller.problem import Problem, measurements
from synth.design.sampled_data import SampledDataProblem, held_design
from synth.plant.numerics import DesignError


def held_problem(vehicle: Vehicle, entry: ControllerEntry) -> SampledDataProblem:
    """Returns the sampled-data problem of a controller: the vehicle with its filters, its actuators' lag, and the measurements.

    Raises:
        InputError: the vehicle has no sample period.
    """
    how = vehicle.implementation
    if how.sample_period is None:
        raise InputError(
            f"controller {entry.name!r} is designed for the loop that a computer closes, and [implementation] gives no sample "
            "period; give it, as in sample_period = 0.01, seconds"
        )
    Cy, through = measurements(vehicle, entry.measured, vehicle.limits.actuator_bandwidth)
    return SampledDataProblem(plant_as_built(vehicle), Cy, through, pieces_of(how, how.sample_period))


def sampled_design(
    vehicle: Vehicle, entry: ControllerEntry, posed: Problem, lower_bound: LowerBound, ideal: Callable[[], Controller]
) -> Controller:
    """Designs a gain for the sampled loop. Returns it with the certificate of its ideal loop and a remark on the sampled one.

    Args:
        vehicle: with sample period and delay.
        posed: the problem that its ideal loop is judged with.
        ideal: returns the design for the ideal loop, which is a start of this one, or raises a DesignError.

    Raises:
        InputError: the vehicle has no sample period.
        DesignError: no gain was found.
    """
    known = []
    with contextlib.suppress(DesignError):
        known = [ideal().law.D]
    designed = held_design(held_problem(vehicle, entry), lower_bound.gamma or 1.0, known)
    law = static_law(designed.gain)
    level = f", whose norm the LMI promises to be at most {designed.level:.7g}" if designed.level is not None else ""
    reads = ", of which forces on their way are not measured" if vehicle.implementation.delay else ""
    remark = f"designed for the sampled loop{reads}{level}"
    return Controller(
        entry.name,
        entry.measured,
        law,
        designed=True,
        certificate=certify_tightly(*posed.closed_loop(law), lower_bound, by_itself=posed.plant),
        redundant=tuple(signal for i, signal in enumerate(entry.measured) if i not in designed.kept),
        fallback_method=f"not by the two steps but by descent on the sampled norm, for {designed.instead}"
        if designed.instead
        else "",
        remarks=(remark,),
        hardware=entry.hardware,
        sampled=True,
    )
