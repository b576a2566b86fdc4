"""The L2 gain of a vehicle's loop as its computer closes it, from the road's continuous velocity to the continuous z.

That is the continuous counterpart of the norm (18) for what `[implementation]` and the lag of `[limits]` make of the loop: its
force is held from sample to sample and comes late, while road and vehicle go on. What is not linear does not count: limits of
force and stroke, quantisation; nor does noise, which no road makes. Behind a lag the force that z weighs is the one that acts.
"""

import numpy as np

from models.common.arrays import Array
from models.controllers import IDEAL
from models.reality import USUAL_TIMESTEP, Implementation
from models.vehicle import Vehicle
from synth.certificate.norm import hinf_norm
from synth.controller import Controller
from synth.dynamic.loop import on_larger_plant
from synth.implemented.controlled import readings, sampled
from synth.plant import GeneralizedPlant
from synth.problem.problem import generalized_plant
from synth.sampled.loop import Piece, SampledLoop
from synth.sampled.norm import SampledNorm, sampled_norm


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
    plant = lagged_plant(vehicle)
    n, kept = len(plant.A), len(cut.kept)
    memory = np.hstack([np.zeros((kept, n)), np.eye(kept)]) + period * _spread(cut.kept, vehicle, n + kept)
    return SampledLoop(plant, pieces_of(how, period), _spread(cut.asked, vehicle, n + kept), memory, period * cut.hold)


def pieces_of(how: Implementation, period: float) -> tuple[Piece, ...]:
    """The parts of a sample period [s], one after the other: two where forces come a fraction of one late."""
    return tuple(Piece(share * period, late) for share, late in how.held)


def norm_in_continuous_time(vehicle: Vehicle, controller: Controller) -> float:
    """What the norms of faster and faster computers tend to: of the loop with its actuators' lag, and the road alone."""
    if controller.hardware == IDEAL and vehicle.limits.actuator_bandwidth is None:
        return controller.certificate.norm.value
    plant, (C, D) = lagged_plant(vehicle), readings(vehicle, controller)
    Cy = _spread(C, vehicle, len(plant.A))
    plant, G = on_larger_plant(plant, Cy, controller.law.continuous().fed_back(D))
    return hinf_norm(plant.closed_loop(G)).value


def _spread(rows: Array, vehicle: Vehicle, states: int) -> Array:
    """Of so many states of a plant with filters, of which nobody measures any: they lie behind the vehicle's own."""
    own = len(vehicle.linear_model.A)
    return np.hstack([rows[:, :own], np.zeros((len(rows), states - rows.shape[1])), rows[:, own:]])


def lagged_plant(vehicle: Vehicle) -> GeneralizedPlant:
    """The plant (15) with the actuators' lag, if they have one: the forces are its last states then."""
    plant, bandwidth = generalized_plant(vehicle), vehicle.limits.actuator_bandwidth
    if bandwidth is None:
        return plant
    (n, m), r = plant.B.shape, plant.Bw.shape[1]
    return GeneralizedPlant(
        A=np.block([[plant.A, plant.B], [np.zeros((m, n)), -bandwidth * np.eye(m)]]),
        B=np.vstack([np.zeros((n, m)), bandwidth * np.eye(m)]),
        Bw=np.vstack([plant.Bw, np.zeros((m, r))]),
        C=np.hstack([plant.C, plant.D]),
        D=np.zeros_like(plant.D),
        Dw=plant.Dw,
    )
