"""The L2 gain of a vehicle's sampled loop, from the road's continuous velocity to the continuous z.

It is the continuous norm (18) of the loop with `[implementation]` and the lag of `[limits]`: the force is held and delayed, while
road and vehicle move continuously. Nonlinear parts (limits of force and stroke, quantisation) and noise do not count. Behind a
lag, z weights the acting force.
"""

import numpy as np

from models import USUAL_TIMESTEP
from models.vehicle.controllers import NOMINAL
from models.vehicle.limits_and_implementation import Implementation
from models.vehicle.vehicle import Vehicle
from synth.analysis.norm import hinf_norm
from synth.analysis.sampled_loop import HoldInterval, SampledLoop
from synth.analysis.sampled_norm import sampled_norm
from synth.analysis.specification import SampledNorm
from synth.controller.controller import Controller
from synth.controller.open_loop import sampled
from synth.controller.problem import generalized_plant, measurements
from synth.plant.augmented import on_larger_plant
from synth.plant.generalized import GeneralizedPlant


def norm_as_implemented(vehicle: Vehicle, controller: Controller, timestep: float = USUAL_TIMESTEP) -> SampledNorm:
    """Returns the L2 gain of the loop from all disturbances to z, infinite if the loop is not stable.

    Args:
        vehicle: with the controller's implementation.
        timestep: of the runs [s]; the sample period if the vehicle gives none.
    """
    ideal = controller.certificate.norm.value
    near = ideal if 0 < ideal < np.inf else 1.0
    return sampled_norm(sampled_loop(vehicle, controller, timestep), near)


def sampled_loop(vehicle: Vehicle, controller: Controller, timestep: float = USUAL_TIMESTEP) -> SampledLoop:
    """Returns the loop as implemented, with the plant's weights and lag; arguments as for `norm_as_implemented`."""
    how = vehicle.implementation
    period = how.sample_period or timestep
    cut = sampled(vehicle, controller, period)
    plant = plant_as_built(vehicle)
    n, kept = len(plant.A), len(cut.kept)
    own = len(cut.model.A) - kept
    G = np.insert(cut.G, [own] * (n - own), 0.0, axis=1)  # of states of filters nobody measures any
    memory = np.hstack([np.zeros((kept, n)), np.eye(kept)]) + period * G[cut.forces :]
    return SampledLoop(plant, pieces_of(how, period), G[: cut.forces], memory, period * cut.hold)


def pieces_of(how: Implementation, period: float) -> tuple[HoldInterval, ...]:
    """Returns the consecutive parts of a sample period [s]: two if the delay has a fraction of a period."""
    return tuple(HoldInterval(share * period, late) for share, late in how.hold_intervals)


def norm_in_continuous_time(vehicle: Vehicle, controller: Controller) -> float:
    """Returns the limit of the norm for fast sampling: that of the loop with its actuators' lag, and the road alone."""
    if controller.hardware == NOMINAL and vehicle.limits.actuator_bandwidth is None:
        return controller.certificate.norm.value
    Cy, through = measurements(vehicle, controller.measured, vehicle.limits.actuator_bandwidth)
    plant, G = on_larger_plant(plant_as_built(vehicle), Cy, controller.law.continuous().fed_back(through))
    return hinf_norm(plant.closed_loop(G)).value


def plant_as_built(vehicle: Vehicle) -> GeneralizedPlant:
    """Returns the plant (15) behind its actuators' lag, if they have one; z weights the acting forces."""
    return generalized_plant(vehicle, vehicle.limits.actuator_bandwidth, acting=True)
