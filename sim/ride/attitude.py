"""How far a body pitches and rolls, and where loads would hold it at rest.

A body's angles follow from its heights over the wheels, and those from deflections and the road (`VehicleKind.angles`): that is
linear, and of MuJoCo's readings right to the square of the angle.
"""

import math
from collections.abc import Mapping

import numpy as np

from models.common.arrays import Array
from models.roads.road import Road
from models.vehicle import Vehicle
from sim.linear.loop import readings_of_loads
from synth.controller import Controller
from synth.implemented.controlled import continuous

DEGREES = 180 / math.pi
PITCH, ROLL = "pitch_angle", "roll_angle"
KINDS = {PITCH: ("dive", "squat", "at_end"), ROLL: ("peak", "at_end")}  # nose down, nose up; either way; with its sign


def angles_of(vehicle: Vehicle) -> Mapping[str, Mapping[str, float]]:
    """The angles that a vehicle's body can have, each as a sum of its signals [rad]."""
    return vehicle.kind.angles(vehicle.parameters)


def angle_metrics(angle: Array) -> dict[str, Array]:
    """What is told of an angle [rad] over time, shape (N, B), in degrees, shape (N,): of `KINDS` all that do for either."""
    largest, smallest = angle.max(axis=1), angle.min(axis=1)
    zero = np.zeros(len(angle))
    found = {
        "dive": np.maximum(largest, zero),
        "squat": np.maximum(-smallest, zero),
        "peak": np.maximum(largest, -smallest),
        "at_end": angle[:, -1],
    }
    return {name: DEGREES * value for name, value in found.items()}


def static_angles(vehicle: Vehicle, controller: Controller, road: Road, time: float) -> dict[str, float]:
    """Where the linear loop rests under what the loads are at a time [s], in degrees by angle; none where it does not rest.

    Args:
        vehicle: the vehicle.
        controller: its controller.
        road: with the loads.
        time: whose loads count.
    """
    cut = continuous(vehicle, controller)
    model, felt = cut.model, readings_of_loads(cut, controller)
    A, load = model.A + model.B @ cut.G, road.loads(vehicle, np.array([time]))[0]
    if np.linalg.eigvals(A).real.max() >= 0:
        return {}
    x = np.linalg.solve(A, -(model.Bl + model.B @ felt) @ load)
    outputs = dict(zip(model.outputs, model.C @ x + model.D @ (cut.G @ x + felt @ load) + model.Dl @ load, strict=True))
    sums = angles_of(vehicle).items()
    return {angle: DEGREES * sum(share * float(outputs.get(name, 0.0)) for name, share in parts.items()) for angle, parts in sums}
