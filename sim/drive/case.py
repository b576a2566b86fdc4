"""Cases to simulate (vehicle, controller and road), and a batch of cases that are simulated together."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from models.common.arrays import Array
from models.roads.road import Departure, Road, RoadInput, under_wheels
from models.vehicle.vehicle import Vehicle
from sim.drive.driver import Failure, RunDriver, steps_ahead
from synth.controller.controller import Controller


@dataclass(frozen=True, eq=False)
class State:
    """State at the start of a run, for vehicles without semi-active dampers.

    Attributes:
        motion: positions and velocities of MuJoCo, states of the vehicle's parts, and activations, shape (nq + nv + k + na,).
        acting_forces: forces that already act before the first sample [N], shape (m,).
        law, undelayed_forces: states of the controller, and of the second controller without delay, both in discrete form.
        pending_forces: delayed forces that act at the first sample or later, in the order in which they act [N], shape (d, m).
    """

    motion: Array
    acting_forces: Array
    law: Array
    undelayed_forces: Array
    pending_forces: Array


@dataclass(frozen=True, eq=False)
class Case:
    """A single run: vehicle, controller and road.

    Attributes:
        vehicle: vehicle of the run, with its force limits and the implementation of its controller.
        driver: controller of the run, or recorded commands that replace it.
        road: road of the run, with the loads on the body if there are any.
        start: state at the start of the run. If None, the run starts in equilibrium or, on a measured road, in steady motion.
        undelayed_controller: second controller without `[implementation]`, whose forces are added to those of the first
            controller; None if there is no second controller.
        earlier: True to repeat a run of an earlier version of Roadproof, see `RoadInput.earlier`.
        input: road heights at the sample times, if they have been computed before; otherwise None.
    """

    vehicle: Vehicle
    driver: RunDriver
    road: Road
    start: State | None = None
    undelayed_controller: Controller | None = None
    earlier: bool = False
    input: RoadInput | None = None


def inputs_of(cases: Sequence[Case], time: Array) -> list[RoadInput]:
    """Returns the road inputs of cases at sample times [s]. Cases with the same vehicle and road share one input."""
    made = dict[tuple[int, int, bool], RoadInput]()
    for one in cases:
        key = id(one.vehicle), id(one.road), one.earlier
        made[key] = one.input or made.get(key) or RoadInput(one.vehicle, one.road, time, one.earlier)
    return [one.input or made[id(one.vehicle), id(one.road), one.earlier] for one in cases]


@dataclass(frozen=True, eq=False)
class Batch:
    """Batch of N cases that are simulated together, at the same sample times.

    Attributes:
        cases: the N cases. All vehicles have the same type and the same map from MuJoCo's state to signals, see `reads_out`.
        inputs: road input of each case.
        now: road heights at the samples [m], shape (T, N, r).
        midway: road heights at which MuJoCo holds the road during each step [m], shape (T, N, r).
        beyond: road heights at the E samples after the end of the run, which controllers need for preview [m], shape (E, N, r).
        velocities: rates of change of the road heights at the samples [m/s], shape (T, N, r); None if not needed.
        held_inputs: further inputs that MuJoCo holds over each step, see `RoadInput.held_inputs`, shape (T, N, l) or (T, N, l +
            r); None if there are none.
        effects: effects of the loads on the signals at the samples and on the measurements, see `RoadInput.in_signals`; None if
            there are no loads.
        sides: road heights [m] at vertical edges of the road, on the side that `now` does not contain, shape (N, r) each, by
            index of the sample.
        failures: failures of Python control laws, by run. A run with a failed law continues without forces. If `failures` is
            None, the first failure is raised as an error.
        numbers: index of each run among all cases; the keys of `failures`.
        diverged: time at which each run diverged [s], shape (N,); infinity for a run that has not diverged so far.
        law_diverged: True for each run that diverged only because of the states of its law, see `Block.law_diverged`, shape
            (N,).
    """

    cases: Sequence[Case]
    inputs: Sequence[RoadInput]
    now: Array
    midway: Array
    beyond: Array
    velocities: Array | None
    held_inputs: Array | None
    effects: tuple[Array, Array] | None
    sides: Mapping[int, Array]
    failures: dict[int, Failure] | None
    numbers: Sequence[int]
    diverged: Array
    law_diverged: Array

    @property
    def time(self) -> Array:
        """Sample times [s], shape (T,)."""
        return self.inputs[0].time

    @property
    def timestep(self) -> float:
        """Time step [s]."""
        return self.inputs[0].timestep

    @cached_property
    def vehicles(self) -> list[Vehicle]:
        """Vehicle of each case."""
        return [one.vehicle for one in self.cases]

    @cached_property
    def drivers(self) -> list[RunDriver]:
        """Controller of each case, or the recorded commands that replace it."""
        return [one.driver for one in self.cases]

    def steady(self, samples: slice) -> Iterator[tuple[int, Array]]:
        """Yields the index of every run that starts in steady motion, with the signals of this motion, shape (B, S)."""
        for i, road in enumerate(self.inputs):
            if (steady := road.steady_signals(self.time[samples])) is not None:
                yield i, steady


def batch_of(
    cases: Sequence[Case],
    time: Array,
    numbers: Sequence[int],
    streamed: bool = False,
    failures: dict[int, Failure] | None = None,
) -> Batch:
    """Returns the batch of several cases at sample times from 0 [s].

    Args:
        numbers: index of each case in the list of all cases; the keys of `failures`.
        streamed: True for inputs that do not store their road heights. Such inputs avoid storing all samples twice.
        failures: dictionary that receives the failures of Python control laws; None to raise the first failure.
    """
    inputs, vehicles = inputs_of(cases, time), [one.vehicle for one in cases]
    ahead, count = steps_ahead(vehicles, [one.driver for one in cases], inputs[0].timestep), len(cases)
    velocities = None
    if streamed:
        halves = np.arange(2 * (len(time) + ahead)) * (inputs[0].timestep / 2)
        heights = np.empty((len(halves), count, len(vehicles[0].kind.wheels)))
        for i, road in enumerate(inputs):
            heights[:, i] = under_wheels(road.relative_road.displacement, road.relative_road, road.vehicle, halves)
            if isinstance(road.relative_road, Departure):
                heights[1::2, i] = road.held_heights(halves[1::2])
        now, midway, beyond = heights[: 2 * len(time) : 2], heights[1 : 2 * len(time) : 2], heights[2 * len(time) :: 2]
        # a tyre with damping leaves the road at a force that depends on these velocities
        if any(vehicle.linear_model.tyres_damp for vehicle in vehicles):
            velocities = np.stack([road.velocities for road in inputs], axis=1)
    else:
        same = _same_roads(inputs) if count > 1 else inputs
        now, midway, velocities = (np.stack([getattr(one, name) for one in same], axis=1) for name in ROAD_ARRAYS)
        beyond = np.stack([road.ahead(ahead) for road in same], axis=1)
    held = np.stack([road.held_inputs for road in inputs], axis=1) if any(road.has_held_inputs for road in inputs) else None
    effects = None
    if any(road.loaded for road in inputs):
        effects = np.stack([road.in_signals for road in inputs], axis=1), np.stack([road.in_readings for road in inputs], axis=1)
    edges = [] if streamed else [road.vertical_edges() for road in inputs]
    sides = {k: now[k].copy() for one in edges for k in one}
    for i, one in enumerate(edges):
        for k, edge in one.items():
            sides[k][i] += edge.change
    return Batch(
        cases,
        inputs,
        now,
        midway,
        beyond,
        velocities,
        held,
        effects,
        sides,
        failures,
        numbers,
        np.full(count, np.inf),
        np.zeros(count, dtype=bool),
    )


ROAD_ARRAYS = ("heights", "midway", "velocities")  # attributes of `RoadInput` that are arrays over time


def _same_roads(inputs: Sequence[RoadInput]) -> list[RoadInput]:
    """Returns the road inputs. Equal inputs are replaced by one object, so that the heights under the wheels are computed only
    once.
    """
    keys = [(*road.vehicle.parameters.values(), id(road.road)) for road in inputs]
    first = dict(zip(reversed(keys), reversed(inputs), strict=True))
    return [first[key] for key in keys]
