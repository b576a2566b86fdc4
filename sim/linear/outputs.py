"""Computes signals of a vehicle from the states and inputs of its model over time, and preview forces from the road ahead."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from models.common.extensions import FEATURES
from models.kinds.linear_model import LinearModel
from models.roads.road import RoadInput
from sim.drive.response import Response
from synth.controller.loop_of import HELD, with_ending

if TYPE_CHECKING:
    from models.laws.preview import RoadPreview


def response_of(
    model: LinearModel,
    road: RoadInput,
    states: Array,
    inputs: Array,
    beyond: Array | float,
    beside: Mapping[str, Array] | None = None,
) -> Response:
    """Computes the response with all signals of a vehicle from the states and inputs of its model over time.

    Args:
        model: model of the vehicle, or a larger model whose first states and inputs are those of the vehicle.
        states, inputs: states and inputs of the model at the samples, shapes (T, n) and (T, m).
        beyond: contribution of characteristics and loads to the outputs, shape (T, p); 0 without characteristics and loads.
        beside: additional signals by name, each of shape (T,). If `beside` is None, the function computes and adds the damper
            signals that belong to `inputs`.
    """
    outputs = states @ model.C.T + inputs @ model.D.T + road.heights @ model.Cr.T + beyond
    return response_by_name(road, (*model.outputs, *with_ending(model.inputs, HELD)), np.hstack([outputs, inputs]), beside)


def response_by_name(
    road: RoadInput, names: Sequence[str], outputs: Array, beside: Mapping[str, Array] | None = None
) -> Response:
    """Computes the response with all signals of a vehicle from the outputs of its loop, shape (T, p).

    Args:
        names: names of the loop's outputs, as in `loop_of`: the output signals of the vehicle, and the forces that its
            actuators receive.
        beside: additional signals, see `response_of`.
    """
    vehicle, steady, place = road.vehicle, road.steady_signals(road.time), {name: i for i, name in enumerate(names)}
    if beside is None and vehicle.dampers:
        states, forces = vehicle.linear_model.states, with_ending(vehicle.linear_model.inputs, HELD)
        beside = FEATURES.load("dampers in linear analysis").linear_signals(
            vehicle, *(outputs[:, [place[name] for name in some]] for some in (states, forces))
        )
    wheels, more, signals = vehicle.kind.wheels, beside or {}, vehicle.kind.signals
    values = np.hstack([road.heights, road.velocities, outputs[:, : len(names)], *(one[:, None] for one in more.values())])
    known = (*(one.road_displacement for one in wheels), *(one.road_velocity for one in wheels), *names, *more)
    column = {name: i for i, name in enumerate(known)}
    values = values[:, [column[signal.name] for signal in signals]]
    return Response(road.time, signals, values if steady is None else values + steady)


def with_linear_sides(response: Response, road: RoadInput, held: bool, of_heights: Array | None = None) -> Response:
    """Adds, to a linear response, the signal values on the other side of each vertical edge of the road.

    Args:
        response: linear response of a single run over the road.
        held: value for the argument `held` of `RoadInput.vertical_edges`.
        of_heights: jump of each of p outputs if the road height under one of r wheels jumps by 1 m, shape (p, r); None if no
            force jumps.
    """
    if not road.road.jumps:
        return response
    wheels, model = road.vehicle.kind.wheels, road.vehicle.linear_model
    if of_heights is None:
        of_heights = model.C @ (model.jump if held else model.Bw) + model.Cr
    rows = dict(zip(model.outputs, of_heights, strict=True))
    rows |= dict(zip((wheel.road_displacement for wheel in wheels), np.eye(len(wheels)), strict=True))
    jump = np.stack([rows.get(name, np.zeros(len(wheels))) for name in response.names])
    sides = {k: response.values[k] + jump @ edge.change for k, edge in road.vertical_edges(held).items()}
    return response.with_sides(sides)


def forces_ahead(preview: "RoadPreview", road: RoadInput, steps: int) -> Array:
    """Returns the preview forces that a computer requests [N], shape (T, m), each constant for `steps` time steps."""
    h = road.timestep
    heights = np.concatenate([road.heights, road.ahead((preview.samples(steps * h) - 1) * steps)])
    return preview.forces(heights, steps, h, len(road.time))
