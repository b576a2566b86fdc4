"""The exact linear response to known forces: for controllers without a linear analysis. With curves it is that of RK4.

As in `sim.linear.sampled_response`, but the forces u[k], held from one sample to the next, are given, and no loop is closed:

    xi[k+1] = Phi xi[k] + Gamma [u[k]; z_r(t_k + h/2)],    x[k] = xi[k] + Bw z_r(t_k).
"""

from collections.abc import Callable

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.roads.road import RoadInput
from sim.linear.outputs import response_of, with_linear_sides
from sim.linear.sampled_response import (
    load_forcing,
    outside_at_samples,
    road_forcing,
)
from sim.response.recursion import recursion
from sim.response.response import Response
from synth.controller.open_loop import with_lag
from synth.plant.discrete import held_inputs


def forced_response(forces: Array, road: RoadInput, exponential: Callable[[Array], Array] = linalg.expm) -> Response:
    """Returns the response to forces, and to the road as MuJoCo holds it, from rest.

    Args:
        forces: requested at every sample [N], shape (T, m).
        exponential: the matrix exponential; `taylor4` to predict an RK4 integrator to rounding. With curves the response is that
            of RK4.
    """
    vehicle, h, model = road.vehicle, road.timestep, with_lag(road.vehicle)
    if vehicle.parts.nonlinear:
        from sim.linear.stepped import forced

        return forced(forces, road).single
    of_heights, loads = model.C @ model.jump + model.Cr, road.held if road.pushed else None
    outside = [] if loads is None else [model.Bh]
    Phi, Gamma, Gamma_r, *Gamma_l = held_inputs(model.A, h, exponential, model.B, model.A @ model.jump + model.Br, *outside)
    jump, add = road.heights @ model.jump.T, 0.0 if loads is None else road.in_signals @ model.Dh.T
    push = road.midway @ Gamma_r.T + forces @ Gamma.T
    if loads is not None:
        push += loads @ Gamma_l[0].T
    return with_linear_sides(response_of(model, road, recursion(Phi, push) + jump, forces, add), road, of_heights, True)


def forced_continuous_response(forces: Array, road: RoadInput) -> Response:
    """Returns the response to held forces, and to the continuous road, from rest. Arguments as for `forced_response`."""
    model = with_lag(road.vehicle)
    Phi, Gamma = held_inputs(model.A, road.timestep, linalg.expm, model.B)
    forcing, loads = road_forcing(model.A, model, road) + forces @ Gamma.T, None
    if road.loaded:
        forcing = forcing + load_forcing(model.A, model.Bl, road)
    if road.pushed:
        loads = outside_at_samples(road)
    add = 0.0 if loads is None else loads @ model.Dh.T
    response = response_of(model, road, recursion(Phi, forcing), np.asarray(forces), add)
    return with_linear_sides(response, road, model.C @ model.Bw + model.Cr, False)
