"""Exact linear response of a vehicle to known control forces, for controllers to which linear analysis does not apply.

With nonlinear characteristics, the response is computed by RK4. The equations of motion are those in
`sim.linear.sampled_response`. The forces u[k] are known and constant from one sample to the next, so the equations contain no
feedback:

    xi[k+1] = Phi xi[k] + Gamma [u[k]; z_r(t_k + h/2)],    x[k] = xi[k] + Bw z_r(t_k).
"""

from collections.abc import Callable

import numpy as np
from scipy import linalg

from models.common.arrays import Array, recursion
from models.laws.linear import static_law
from models.roads.road import RoadInput
from sim.drive.response import Response
from sim.linear.outputs import response_by_name, with_linear_sides
from sim.linear.sampled_response import acting_on, disturbances, road_forcing
from synth.controller.loop_of import plant_of
from synth.plant.loop import HoldInterval, Loop, respond


def forced_response(forces: Array, road: RoadInput, exponential: Callable[[Array], Array] = linalg.expm) -> Response:
    """Returns the response, from equilibrium, to known forces and to the road; both are constant during each step, as in
    MuJoCo.

    Args:
        forces: requested forces at every sample [N], shape (T, m).
        road: road input, which also contains the vehicle that drives over the road.
        exponential: function that computes the matrix exponential. With `taylor4`, the result is that of RK4 up to rounding
            errors. If dampers or springs have characteristics, the response is always computed by RK4.
    """
    vehicle, h, model = road.vehicle, road.timestep, road.vehicle.linear_model
    if vehicle.parts.nonlinear:
        from sim.linear.stepped import forced_run

        return forced_run(forces, road).single
    known = {name: values[0] for name, values in disturbances([road]).items()} | dict(zip(model.inputs, forces.T, strict=True))
    law, hold = static_law(np.zeros((len(model.inputs), 0))), (HoldInterval(h, 0),)
    loop = Loop(plant_of(vehicle, sampled=True), law, (), model.inputs, hold, h, exponential)
    outputs = respond(loop, loop.plant.outputs, known, vehicle.start_state)
    response = response_by_name(road, loop.plant.outputs, outputs)
    return with_linear_sides(response, road, True)


def forced_continuous_response(forces: Array, road: RoadInput) -> Response:
    """Returns the response, from equilibrium, to forces that are constant during each step and to a road that changes
    continuously. The arguments are those of `forced_response`.
    """
    plant, model = plant_of(road.vehicle), road.vehicle.linear_model
    Phi, Gamma = plant.part((), model.inputs).hold_matrices(road.timestep)
    start = None if (moved := road.vehicle.start_state) is None else np.pad(moved, (0, len(Phi) - len(moved)))
    outputs = recursion(Phi, road_forcing(plant, road) + forces @ Gamma.T, start) @ plant.C.T + acting_on(plant, road, forces)
    response = response_by_name(road, plant.outputs, outputs)
    return with_linear_sides(response, road, False)
