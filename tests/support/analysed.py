"""The linear analysis and MuJoCo of a vehicle, its controller, a road and sample times, as tests have these in hand.

Each function here takes these one by one, makes the objects of the product from them, and calls its function of the same name.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.roads.road import Road, RoadInput
from models.vehicle.vehicle import Vehicle
from sim.drive.case import Case
from sim.drive.driver import RunDriver
from sim.drive.response import Response
from sim.linear import sampled_response as linear
from sim.linear.prediction import Prediction
from sim.observers import energy as balance
from sim.observers.recorder import Recording, record
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


@dataclass(frozen=True, eq=False)
class Runs:
    """N recordings of one kind of vehicle, and their signals and positions side by side."""

    recordings: Sequence[Recording]

    @cached_property
    def response(self) -> Response:
        """The vehicle's signals, values of shape (N, T, S)."""
        first = self.recordings[0].response
        count = len(self.recordings[0].vehicle.kind.signals)
        before = {name: np.stack([one.response.before[name] for one in self.recordings]) for name in first.before}
        values = np.stack([one.response.values[:, :count] for one in self.recordings])
        return Response(first.time, first.signals[:count], values, before)

    @property
    def diverged(self) -> Array:
        return np.array([one.diverged for one in self.recordings])

    @property
    def qpos(self) -> Array:
        return np.stack([one.qpos for one in self.recordings])

    @property
    def qvel(self) -> Array:
        return np.stack([one.qvel for one in self.recordings])

    @property
    def law_diverged(self) -> Array:
        return np.array([one.response.law_diverged for one in self.recordings])

    @property
    def requested_force(self) -> Array:
        return np.stack([one.commands for one in self.recordings])

    def with_response(self, response: Response) -> "Runs":
        """The runs with other signals, of shape (N, T, S)."""
        changed = [replace(one, response=response.run(i)) for i, one in enumerate(self.recordings)]
        return Runs(changed)

    def run(self, index: int) -> Response:
        return self.recordings[index].response


def simulate(
    vehicles: Sequence[Vehicle], controllers: Sequence[RunDriver], roads: Sequence[Road], time: Array, threads: int = 1
) -> Runs:
    return Runs(record([Case(*each) for each in zip(vehicles, controllers, roads, strict=True)], time, threads))


def simulate_inputs(controllers: Sequence[RunDriver], inputs: Sequence[RoadInput], threads: int = 1) -> Runs:
    pairs = zip(controllers, inputs, strict=True)
    return Runs(record([Case(on.vehicle, one, on.road, input=on) for one, on in pairs], inputs[0].time, threads))


def energy(vehicle: Vehicle, runs: Runs, index: int, road: Road, until: float = np.inf) -> balance.Energy:
    """The energy balance of a run by the numbers of a vehicle, which need not be those of the run."""
    run = runs.recordings[index]
    case = replace(run.case, vehicle=vehicle, road=road)
    return balance.energy(replace(run, case=case, input=RoadInput(vehicle, road, run.input.time)), until)


def predict(vehicle: Vehicle, controller: Controller, road: Road, time: Array, most_states: float = np.inf) -> Prediction:
    return Prediction(RoadInput(vehicle, road, time), controller, most_states=most_states)
