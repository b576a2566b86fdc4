"""The L2 gain of a vehicle's loop as its computer closes it, from the road's continuous velocity to the continuous z.

That is the continuous counterpart of the norm (18) for what `[implementation]` and the lag of `[limits]` make of the loop: its
force is held from sample to sample and comes late, while road and vehicle go on. What is not linear does not count: limits of
force and stroke, quantisation; nor does noise, which no road makes. Behind a lag the force that z weighs is the one that acts.
"""

import numpy as np

from models import USUAL_TIMESTEP
from models.vehicle.controllers import IDEAL
from models.vehicle.limits_and_implementation import Implementation
from models.vehicle.vehicle import Vehicle
from synth.analysis.norm import hinf_norm
from synth.analysis.sampled_loop import Piece, SampledLoop
from synth.analysis.sampled_norm import sampled_norm
from synth.analysis.specification import SampledNorm
from synth.controller.controller import Controller
from synth.controller.open_loop import sampled
from synth.controller.problem import generalized_plant, measurements
from synth.plant.augmented import on_larger_plant
from synth.plant.generalized import GeneralizedPlant


def norm_as_implemented(vehicle: Vehicle, controller: Controller, timestep: float = USUAL_TIMESTEP) -> SampledNorm:
    """The L2 gain of the loop from all that disturbs it to z, infinite where it is not stable.

    Args:
        vehicle: it says how the controller is implemented.
        controller: its controller.
        timestep: of the runs [s]; the sample period, where the vehicle gives none.
    """
    ideal = controller.certificate.norm.value
    near = ideal if 0 < ideal < np.inf else 1.0
    return sampled_norm(sampled_loop(vehicle, controller, timestep), near)


def sampled_loop(vehicle: Vehicle, controller: Controller, timestep: float = USUAL_TIMESTEP) -> SampledLoop:
    """The loop as it is implemented, around the plant with its weights and its lag; arguments as for `norm_as_implemented`."""
    how = vehicle.implementation
    period = how.sample_period or timestep
    cut = sampled(vehicle, controller, period)
    plant = plant_as_built(vehicle)
    n, kept = len(plant.A), len(cut.kept)
    own = len(cut.model.A) - kept
    G = np.insert(cut.G, [own] * (n - own), 0.0, axis=1)  # of states of filters nobody measures any
    memory = np.hstack([np.zeros((kept, n)), np.eye(kept)]) + period * G[cut.forces :]
    return SampledLoop(plant, pieces_of(how, period), G[: cut.forces], memory, period * cut.hold)


def pieces_of(how: Implementation, period: float) -> tuple[Piece, ...]:
    """The parts of a sample period [s], one after the other: two where forces come a fraction of one late."""
    return tuple(Piece(share * period, late) for share, late in how.held)


def norm_in_continuous_time(vehicle: Vehicle, controller: Controller) -> float:
    """What the norms of faster and faster computers tend to: of the loop with its actuators' lag, and the road alone."""
    if controller.hardware == IDEAL and vehicle.limits.actuator_bandwidth is None:
        return controller.certificate.norm.value
    Cy, through = measurements(vehicle, controller.measured, vehicle.limits.actuator_bandwidth)
    plant, G = on_larger_plant(plant_as_built(vehicle), Cy, controller.law.continuous().fed_back(through))
    return hinf_norm(plant.closed_loop(G)).value


def plant_as_built(vehicle: Vehicle) -> GeneralizedPlant:
    """The plant (15) behind its actuators' lag, if they have one; z weighs the forces that act."""
    return generalized_plant(vehicle, vehicle.limits.actuator_bandwidth, acting=True)
