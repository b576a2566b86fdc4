"""Robust stability and robust performance of a controller for frequency-weighted uncertainties, with proofs.

Robust stability and robust performance both follow from the peak, over frequency, of the structured singular value mu of a
loop. The loop remains stable for all uncertainties smaller than the inverse of the peak of mu. For robust performance, mu <=
gamma means that the norm is at most gamma for all uncertainties up to the size 1 / gamma.
"""

from dataclasses import replace

import numpy as np

from models.common.arrays import Array
from models.common.printed import digits
from models.kinds.linear_model import LinearModel
from models.laws.design_methods import FULL
from models.laws.filter import Filter
from models.laws.weighted_errors import WeightedErrors
from models.vehicle.controllers import ControllerEntry
from models.vehicle.vehicle import Vehicle
from synth.analysis.specification import FREQUENCY, ROBUST_PERFORMANCE, ROBUST_STABILITY, Specification
from synth.controller.controller import Controller
from synth.controller.problem import generalized_plant, plant_states, problem
from synth.design.uncertainty.structured_bound import structured_bound
from synth.design.uncertainty.structured_loop import StructuredLoop, StructuredPlant, plant_with_errors
from synth.design.uncertainty.structured_perturbation import worst_errors
from synth.plant.state_space import StateSpace

CONTINUOUS_LOOP_REMARK = "robust stability and performance (mu) are those of the continuous loop, not of the sampled one"


def with_robustness(vehicle: Vehicle, controller: Controller, errors: WeightedErrors) -> Controller:
    """Adds the specifications for weighted uncertainties to a controller.

    A controller with an unstable loop is returned unchanged.
    """
    if not controller.certificate.stable:
        return controller
    loop = structured_plant(vehicle, controller, errors).closed_by(controller.law.continuous())
    promises = (_robust(ROBUST_PERFORMANCE, loop, None), _robust(ROBUST_STABILITY, loop.of_errors, 1.0))
    said = () if vehicle.implementation.undelayed else (CONTINUOUS_LOOP_REMARK,)
    return replace(controller, specifications=(*controller.specifications, *promises), remarks=(*controller.remarks, *said))


def _robust(what: str, loop: StructuredLoop, at_most: float | None) -> Specification:
    """Returns the specification of the peak of mu, with a lower bound from uncertainties that were found, and a proved upper
    bound.
    """
    above = structured_bound(loop)
    below = worst_errors(loop, above.peak_frequency) if np.isfinite(above.gamma) else None
    value = below.mu if below is not None else np.inf
    where = f"at {FREQUENCY.text(above.peak_frequency)}"
    if at_most is not None and 0 < above.gamma < np.inf:
        where += f"; stable with up to {digits(1 / above.gamma)} times the errors"
    return Specification(what, value, above.gamma, at_most, where=where, proof="scales, computed twice")


def is_robust_design(entry: ControllerEntry) -> bool:
    """Returns True if a controller is designed for its weighted uncertainties: the section contains `order`, and the design is
    not for the sampled-data loop.
    """
    request, structure = entry.request, entry.request.structure
    free = request.design == FULL if structure is None else not (structure.kind or structure.rows)
    return entry.errors is not None and free and not request.sampled


def structured_plant(vehicle: Vehicle, controller: Controller | ControllerEntry, errors: WeightedErrors) -> StructuredPlant:
    """Returns the plant of a controller from the inputs [w; p; u] to the outputs [z; q; y]; see `StructuredPlant`."""
    plant_problem, inputs = problem(vehicle, controller.measured, controller.hardware), vehicle.linear_model.inputs
    weights = errors.of_forces(inputs, controller.measured), errors.of_readings(controller.measured)
    of_errors = _of_added_force(vehicle, controller.hardware.bandwidth, plant_problem.plant.B.shape, plant_problem.plant.D.shape)
    systems = _systems(weights[0]), _systems(weights[1])
    return plant_with_errors(plant_problem.plant, of_errors, systems)


def _systems(weights: list[Filter | None]) -> list[StateSpace | None]:
    return [None if one is None else StateSpace.of_law(one.realisation) for one in weights]


def _of_added_force(
    vehicle: Vehicle, bandwidth: float | None, of_states: tuple[int, ...], of_z: tuple[int, ...]
) -> tuple[Array, Array]:
    """Returns the matrices B and D of a force that is added to the requested force. The output z contains only the requested
    force.
    """
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
