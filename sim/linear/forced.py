"""The exact linear response to forces that are known: of a vehicle whose controller no linear analysis speaks of.

As in `sim.linear.loop`, but the forces u[k], held from one sample to the next, are given, and no loop is closed:

    xi[k+1] = Phi xi[k] + Gamma [u[k]; z_r(t_k + h/2)],    x[k] = xi[k] + Bw z_r(t_k).
"""

from collections.abc import Callable

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.roads.road import Road, under_wheels
from models.vehicle import Vehicle
from sim.linear.curved import is_curved
from sim.linear.curved_steps import CurvedSteps
from sim.linear.loop import held_loads, load_forcing, recursion, response_of, road_forcing, taylor4
from sim.response.response import Response
from synth.implemented.controlled import with_lag
from synth.sampled.hold import held_inputs


def forced_response(
    vehicle: Vehicle, forces: Array, road: Road, time: Array, exponential: Callable[[Array], Array] = linalg.expm
) -> Response:
    """The response to forces, and to the road as MuJoCo holds it, from rest.

    Args:
        vehicle: the vehicle.
        forces: asked for at every sample [N], shape (T, m).
        road: the road.
        time: equidistant sample times [s], shape (T,).
        exponential: the matrix exponential; `taylor4` to predict an RK4 integrator to rounding.
    """
    h, model = float(time[1] - time[0]), with_lag(vehicle)
    loads = held_loads(road, vehicle, time) if road.loaded else None
    outside = [] if loads is None else [model.Bl]
    Phi, Gamma, Gamma_r, *Gamma_l = held_inputs(model.A, h, exponential, model.B, model.A @ model.Bw + model.Br, *outside)
    now, midway = (under_wheels(road.displacement, road, vehicle, times) for times in (time, time + h / 2))
    jump, add = now @ model.Bw.T, 0.0 if loads is None else loads @ model.Dl.T
    if not is_curved(vehicle):
        push = midway @ Gamma_r.T + forces @ Gamma.T
        if loads is not None:
            push += loads @ Gamma_l[0].T
        return response_of(vehicle, model, road, time, recursion(Phi, push) + jump, forces, add)
    steps = CurvedSteps(vehicle, model, h, exact=exponential is not taylor4)
    xi = np.zeros((len(time), 1, len(model.A)))
    for k in range(len(time) - 1):
        pushed = None if loads is None else loads[k : k + 1] @ model.Bl.T
        xi[k + 1] = steps(xi[k], forces[k : k + 1], midway[k : k + 1], pushed=pushed)
    states = xi[:, 0] + jump
    return response_of(vehicle, model, road, time, states, forces, steps.beyond(states, now) + add)


def forced_continuous_response(vehicle: Vehicle, forces: Array, road: Road, time: Array) -> Response:
    """The response to forces that are held, and to the road as it is, from rest. Arguments as for `forced_response`."""
    h, model = float(time[1] - time[0]), with_lag(vehicle)
    Phi, Gamma = held_inputs(model.A, h, linalg.expm, model.B)
    forcing, loads = road_forcing(model.A, model, road, vehicle, time) + forces @ Gamma.T, None
    if road.loaded:
        forcing, loads = forcing + load_forcing(model.A, model.Bl, road, vehicle, time), road.loads(vehicle, time)
    add = 0.0 if loads is None else loads @ model.Dl.T
    return response_of(vehicle, model, road, time, recursion(Phi, forcing), np.asarray(forces), add)
