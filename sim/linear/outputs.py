"""Signals of a vehicle by the states and inputs of its model over time, and forces by a preview of the road."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from models.kinds.linear_model import LinearModel
from models.roads.road import RoadInput
from sim.response.response import Response
from synth.controller.loop_of import HELD, named

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
    """Returns all signals of the vehicle from the states and inputs of its model over time, shapes (T, n) and (T, m).

    Args:
        model: the vehicle's model, or a larger one that begins with its states and inputs.
        states, inputs: states and inputs over time.
        beyond: contribution of curves and loads to the outputs, shape (T, p), or 0.
        beside: additional signals, each of shape (T,), or None for the damper signals of these inputs.
    """
    outputs = states @ model.C.T + inputs @ model.D.T + road.heights @ model.Cr.T + beyond
    forces = dict(zip(named(model.inputs, HELD), inputs.T, strict=True))
    return response_by_name(road, dict(zip(model.outputs, outputs.T, strict=True)) | forces, beside)


def response_by_name(road: RoadInput, outputs: Mapping[str, Array], beside: Mapping[str, Array] | None = None) -> Response:
    """Returns all signals of the vehicle from the outputs of its loop, by the names of `loop_of`, each of shape (T,).

    Args:
        outputs: the vehicle's output signals, and the forces that its actuators are given.
        beside: additional signals, see `response_of`.
    """
    vehicle, z_r, w, steady = road.vehicle, road.heights, road.velocities, road.steady_signals(road.time)
    if beside is None and vehicle.dampers:
        from sim.linear.dampers import linear_signals

        states, forces = vehicle.linear_model.states, named(vehicle.linear_model.inputs, HELD)
        beside = linear_signals(vehicle, *(np.stack([outputs[name] for name in names], axis=-1) for names in (states, forces)))
    values = {}
    for i, wheel in enumerate(vehicle.kind.wheels):
        values |= {wheel.road_displacement: z_r[:, i], wheel.road_velocity: w[:, i]}
    values |= dict(outputs) | dict(beside or {})
    signals = vehicle.kind.signals
    stacked = np.stack([values[signal.name] for signal in signals], axis=-1)
    return Response(road.time, signals, stacked if steady is None else stacked + steady)


def with_linear_sides(response: Response, road: RoadInput, of_heights: Array, held: bool) -> Response:
    """Returns a linear response with its values on the other side of vertical edges.

    Args:
        response: a single run over the road.
        of_heights: jump of every output per height of the road under every wheel, shape (p, r).
        held: see `RoadInput.vertical_edges`.
    """
    if not road.road.jumps:
        return response
    wheels, outputs = road.vehicle.kind.wheels, road.vehicle.linear_model.outputs
    rows = dict(zip(outputs, of_heights, strict=False)) | {
        wheel.road_displacement: unit for wheel, unit in zip(wheels, np.eye(len(wheels)), strict=True)
    }
    jump = np.stack([rows.get(name, np.zeros(len(wheels))) for name in response.names])
    sides = {k: response.values[k] + jump @ edge.change for k, edge in road.vertical_edges(held).items()}
    return response.with_sides(sides)


def forces_ahead(preview: "RoadPreview", road: RoadInput, steps: int) -> Array:
    """Returns the forces by which a computer answers the road ahead [N], shape (T, m), held for `steps` timesteps each."""
    h = road.timestep
    heights = np.concatenate([road.heights, road.ahead((preview.samples(steps * h) - 1) * steps)])
    return preview.forces(heights, steps, h, len(road.time))
