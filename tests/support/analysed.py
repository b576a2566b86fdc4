"""The linear analysis and MuJoCo of a vehicle, its controller, a road and sample times, as tests have these in hand.

Each function here takes these one by one, makes the objects of the product from them, and calls its function of the same name.
"""

from collections.abc import Callable, Sequence

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.roads.road import Road, RoadInput
from models.vehicle.vehicle import Vehicle
from sim.linear import sampled_response as linear
from sim.physics import energy as balance
from sim.physics import simulate as physics_of
from sim.physics.driver import RunDriver
from sim.physics.simulate import PhysicsRuns
from sim.response.response import Response
from sim.runs import prediction
from sim.runs.prediction import Prediction
from synth.controller.controller import Controller
from synth.controller.loop_of import loop_of, radius
from synth.plant.state_space import StateSpace

Exponential = Callable[[Array], Array]


def sampled_radius(vehicle: Vehicle, controller: Controller, timestep: float) -> float:
    return radius(loop_of(vehicle, controller, timestep))


def cut_loop(vehicle: Vehicle, controller: Controller, timestep: float | None = None) -> StateSpace:
    """The loop cut at all forces, in continuous time or sampled."""
    loop = loop_of(vehicle, controller, timestep)
    return loop.cut(loop.forces)


def sampled_response(
    vehicle: Vehicle, controller: Controller, road: Road, time: Array, exponential: Exponential = linalg.expm
) -> Response:
    return linear.sampled_response(controller, RoadInput(vehicle, road, time), exponential)


def sampled_responses(vehicle: Vehicle, controller: Controller, roads: Sequence[Road], time: Array) -> Response:
    return linear.sampled_responses(controller, [RoadInput(vehicle, road, time) for road in roads])


def continuous_response(vehicle: Vehicle, controller: Controller, road: Road, time: Array) -> Response:
    return linear.continuous_response(controller, RoadInput(vehicle, road, time))


def simulate(
    vehicles: Sequence[Vehicle], controllers: Sequence[RunDriver], roads: Sequence[Road], time: Array, threads: int = 1
) -> PhysicsRuns:
    met = [RoadInput(vehicle, road, time) for vehicle, road in zip(vehicles, roads, strict=True)]
    return physics_of.simulate(controllers, met, threads)


def energy(vehicle: Vehicle, runs: PhysicsRuns, index: int, road: Road, until: float = np.inf) -> balance.Energy:
    return balance.energy(runs, index, RoadInput(vehicle, road, runs.response.time), until)


def predict(vehicle: Vehicle, controller: Controller, road: Road, time: Array, most_states: float = np.inf) -> Prediction:
    return prediction.predict(controller, RoadInput(vehicle, road, time), most_states)
