"""Robust stability and robust performance of a controller whose errors are weighted by frequency, proved.

Both are peaks over frequency of the structured singular value mu of its loop. The loop stays stable with all errors of size below
1 / mu. With the performance, mu <= gamma says that for all errors of size 1 / gamma its norm is at most gamma.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.printed import digits
from models.kinds.linear_model import LinearModel
from models.laws.combinations import FULL
from models.laws.filter import Filter
from models.laws.linear import LinearLaw
from models.vehicle.controllers import ControllerEntry
from models.vehicle.vehicle import Vehicle
from models.vehicle.weighted_errors import WeightedErrors
from synth.analysis.bounding import certify_tightly
from synth.analysis.lower_bound import LowerBound
from synth.analysis.specification import FREQUENCY, ROBUST_PERFORMANCE, ROBUST_STABILITY, Specification
from synth.controller.controller import Controller
from synth.controller.problem import generalized_plant, plant_states
from synth.design.methods import design as design_for
from synth.design.problem import DesignProblem
from synth.design.uncertainty.robust_design import Design, RobustDesign, robust_design
from synth.design.uncertainty.structured_bound import structured_bound
from synth.design.uncertainty.structured_loop import StructuredLoop, StructuredPlant, plant_with_errors
from synth.design.uncertainty.structured_perturbation import worst_errors
from synth.plant.generalized import Plant
from synth.plant.state_space import StateSpace

SAMPLED = "robust stability and performance (mu) are those of the continuous loop, not of the sampled one"


def with_robustness(vehicle: Vehicle, controller: Controller, errors: WeightedErrors) -> Controller:
    """Returns a controller with its specifications for weighted errors; unchanged if its loop is unstable without errors."""
    if not controller.certificate.stable:
        return controller
    loop = structured_plant(vehicle, controller, errors).closed_by(controller.law.continuous())
    promises = (_robust(ROBUST_PERFORMANCE, loop, None), _robust(ROBUST_STABILITY, loop.of_errors, 1.0))
    said = () if vehicle.implementation.undelayed else (SAMPLED,)
    return replace(controller, specifications=(*controller.specifications, *promises), remarks=(*controller.remarks, *said))


def _robust(what: str, loop: StructuredLoop, at_most: float | None) -> Specification:
    """Returns a lower bound on the peak of mu, shown by errors, and a proved upper bound."""
    above = structured_bound(loop)
    below = worst_errors(loop, above.peak_frequency) if np.isfinite(above.gamma) else None
    value = below.mu if below is not None else np.inf
    where = f"at {FREQUENCY.text(above.peak_frequency)}"
    if at_most is not None and 0 < above.gamma < np.inf:
        where += f"; stable with up to {digits(1 / above.gamma)} times the errors"
    return Specification(what, value, above.gamma, at_most, where=where, proof="scales, computed twice")


def is_robust_design(entry: ControllerEntry) -> bool:
    """Returns True if a controller is designed for its weighted errors: one with `order`, for the continuous loop."""
    request, structure = entry.request, entry.request.structure
    free = request.design == FULL if structure is None else not (structure.kind or structure.rows)
    return entry.errors is not None and free and not request.sampled


def robust_controller(
    vehicle: Vehicle,
    entry: ControllerEntry,
    nominal: Controller,
    problem: DesignProblem,
    on_progress: Callable[[float, bool], None] = lambda goal, within: None,
) -> Controller:
    """Returns a controller of an entry with a better robust performance than one that is designed for the norm alone.

    A law of fewer states begins with the scales of a law of full order.

    Args:
        nominal: the controller designed for the norm; returned if no other is better.
        problem: design problem of the nominal controller.
        on_progress: callback that receives the robust performance so far, and True.
    """
    assert entry.errors is not None, "it has weights"
    posed, structure = nominal.problem(vehicle), entry.request.structure
    structured = structured_plant(vehicle, nominal, entry.errors)
    kept, unbounded = posed.state_measurements, replace(problem, lower_bound=LowerBound(0.0), states=())

    def designs(**kind: Any) -> Design:
        def design(plant: Plant) -> LinearLaw:
            scaled = replace(unbounded, plant=plant.rows(kept).without_feedthrough, **kind)
            return problem.as_run(design_for(scaled).law)

        return design

    first = RobustDesign(nominal.law, structured_bound(structured.closed_by(nominal.law)).gamma)
    best = [first]

    def on_turn(found: RobustDesign) -> None:
        if structure is None or found.law.states <= structure.order:
            best[:] = [found]
        on_progress(found.gamma, True)

    full = robust_design(structured, designs(order=FULL, structure=None), first, on_turn)
    if structure is not None:
        robust_design(structured, designs(), first, on_turn, full.law)
    if not best[0].turns:
        return nominal
    law = replace(best[0].law, anti_windup=entry.request.anti_windup)
    certificate = certify_tightly(*posed.closed_loop(law), nominal.certificate.below, by_itself=posed.plant)
    remark = (
        "designed for the smallest robust performance (mu), by design and scaling of errors in turn; the law with the smallest "
        f"norm, {digits(nominal.certificate.norm.value)}, has mu = {digits(first.gamma)}"
    )
    return replace(nominal, law=law, certificate=certificate, remarks=(remark,))


def structured_plant(vehicle: Vehicle, controller: Controller, errors: WeightedErrors) -> StructuredPlant:
    """Returns the plant of a controller from [w; p; u] to [z; q; y], see `StructuredPlant`."""
    posed, inputs = controller.problem(vehicle), vehicle.linear_model.inputs
    weights = errors.of_forces(inputs, controller.measured), errors.of_readings(controller.measured)
    of_errors = _of_added_force(vehicle, controller.hardware.bandwidth, posed.plant.B.shape, posed.plant.D.shape)
    systems = _systems(weights[0]), _systems(weights[1])
    return plant_with_errors(posed.plant, of_errors, systems)


def _systems(weights: list[Filter | None]) -> list[StateSpace | None]:
    return [None if one is None else StateSpace.of_law(one.realisation) for one in weights]


def _of_added_force(
    vehicle: Vehicle, bandwidth: float | None, of_states: tuple[int, ...], of_z: tuple[int, ...]
) -> tuple[Array, Array]:
    """Returns B and D of a force that is added to the requested one, which z weighs without it."""
    forces = vehicle.linear_model.inputs
    other = [signal for signal, weight in vehicle.performance.items() if weight > 0 and signal not in forces]
    without = [replace(one, terms={name: by for name, by in one.terms.items() if name not in forces}) for one in vehicle.sums]
    sums = tuple(one for one in without if one.terms)
    B, D = np.zeros(of_states), np.zeros(of_z)
    model: LinearModel = vehicle.linear_model.behind_lag(bandwidth)
    B[: len(model.A)] = model.B
    if not other and not sums:
        return B, D
    weights, filters = ({name: by[name] for name in other if name in by} for by in (vehicle.performance, vehicle.filters))
    rest = replace(vehicle, performance=weights, filters=filters, sums=sums)
    plant, names = generalized_plant(rest, bandwidth), plant_states(vehicle, bandwidth)
    B[[names.index(name) for name in plant_states(rest, bandwidth)]] = plant.B
    rows = [one.name for one in vehicle.weighted]
    D[[rows.index(one.name) for one in rest.weighted]] = plant.D
    return B, D
