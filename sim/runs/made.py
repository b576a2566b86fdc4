"""Exact responses in which what physics has decided is played: of laws in Python, and of adjustable dampers."""

from dataclasses import replace

from models.common.arrays import Array
from models.damping.laws import SemiActive
from models.own.python_law import Programmed
from models.roads.road import Road
from models.vehicle import Vehicle
from sim.linear.curved import is_curved
from sim.linear.dampers import scaled_commands
from sim.physics.geometry import has_geometry
from sim.response.response import Response
from sim.runs.prediction import Prediction, Smaller, predict_forced, predict_switched, smaller
from synth.controller import Controller

NEAR = 1e-5  # of a peak, at 1 ms; MuJoCo is nearer to its exact response, and further off no decision is a slip of rounding
ORDER = 4  # of RK4: as which power of the step it is off
NEAR_KNOTS, KNOTS_ORDER = 1e-4, 2  # the same with curves: RK4 steps over their knots
NEAR_GEOMETRY = 1e-2  # where bodies turn, over the whole road: geometry's share of a peak; over less of it in proportion


def predict_made(
    vehicle: Vehicle, controller: Controller | Programmed | SemiActive, road: Road, time: Array, physics: Response, asked: Array
) -> Prediction:
    """What the exact response is in a run from rest whose decisions are known from physics alone.

    Args:
        vehicle: the vehicle.
        controller: its controller: a law in Python, or any one of a vehicle with adjustable dampers.
        road: the road.
        time: equidistant sample times from 0 [s], shape (T,).
        physics: what MuJoCo made of it.
        asked: what was asked for in it, see `PhysicsRuns`.
    """
    if vehicle.dampers:
        at_1_ms, order = (NEAR_KNOTS, KNOTS_ORDER) if is_curved(vehicle) else (NEAR, ORDER)
        near = NEAR_GEOMETRY if has_geometry(vehicle) else min(at_1_ms * max(1.0, float(time[1]) / 1e-3) ** order, NEAR_GEOMETRY)
        programmed = asked if isinstance(controller, Programmed) else None
        return predict_switched(vehicle, controller, road, time, physics, near, programmed)
    assert isinstance(controller, Programmed), "a linear one is predicted by itself"
    return predict_forced(vehicle, controller, road, time, asked)


def reference_at(share: float, prediction: Prediction, physics: Response) -> Smaller:
    """What is predicted of a run at a share of its road's height: as much of it, as far as it is linear.

    Args:
        share: of the height.
        prediction: over the whole road.
        physics: what MuJoCo made of it at that share of the road, whose own decisions adjustable dampers follow.
    """
    vehicle = prediction.vehicle
    if not vehicle.dampers:
        return smaller(prediction, share)
    small, road = with_noise(share, vehicle), prediction.road.scaled(share)
    asked = scaled_commands(vehicle, prediction.asked, share) if len(prediction.asked) else None
    near = share * NEAR_GEOMETRY
    again = predict_switched(small, prediction.controller, road, prediction.time, physics, near, asked)
    return Smaller(again.sampled, again.integrated)


def with_noise(share: float, vehicle: Vehicle) -> Vehicle:
    """The vehicle with so much of its noise, as over that share of a road."""
    return replace(vehicle, implementation=vehicle.implementation.scaled(share))
