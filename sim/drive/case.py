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
    """State of vehicle and controller at the start of a run, for vehicles without semi-active dampers.

    Attributes:
        motion: positions and velocities of MuJoCo, states of the vehicle's parts, and activations, shape (nq + nv + k + na,).
        acting_forces: control forces that already act just before the first sample [N], shape (m,).
        law, undelayed_forces: states of the controller, and states of the second controller, which has no delay; both in
            discrete time.
        pending_forces: delayed control forces that act at the first sample or later, in the order in which they act [N], shape
            (d, m).
    """

    motion: Array
    acting_forces: Array
    law: Array
    undelayed_forces: Array
    pending_forces: Array


@dataclass(frozen=True, eq=False)
class Case:
    """Description of a single run: vehicle, controller and road.

    Attributes:
        vehicle: vehicle of the run, including force limits and the implementation of the controller.
        driver: controller of the run, or recorded commands that replace the controller.
        road: road of the run, including any external loads on the body.
        start: state at the start of the run. If `start` is None, the run starts in equilibrium or, on a measured road, in
            steady motion.
        undelayed_controller: second controller, which runs without `[implementation]`; None if there is no second controller.
            The forces of both controllers are added.
        earlier: True to repeat a run that was made with an earlier version of Roadproof, see `RoadInput.earlier`.
        input: road heights at the sample times, if these heights have been computed before; otherwise None.
    """

    vehicle: Vehicle
    driver: RunDriver
    road: Road
    start: State | None = None
    undelayed_controller: Controller | None = None
    earlier: bool = False
    input: RoadInput | None = None


def inputs_of(cases: Sequence[Case], time: Array) -> list[RoadInput]:
    """Returns the road inputs of cases at sample times [s]. Cases with the same vehicle and road share one `RoadInput` object."""
    made = dict[tuple[int, int, bool], RoadInput]()
    for one in cases:
        key = id(one.vehicle), id(one.road), one.earlier
        made[key] = one.input or made.get(key) or RoadInput(one.vehicle, one.road, time, one.earlier)
    return [one.input or made[id(one.vehicle), id(one.road), one.earlier] for one in cases]


@dataclass(frozen=True, eq=False)
class Batch:
    """Batch of N cases that are simulated together, at the same sample times.

    Attributes:
        cases: the N cases. All vehicles have the same type, and their signals depend in the same way on MuJoCo's state, see
            `reads_out`.
        inputs: road input of each case.
        now: road heights at the samples [m], shape (T, N, r).
        midway: constant road heights that MuJoCo uses during each step [m], shape (T, N, r).
        beyond: road heights at the E samples after the end of the run, which controllers need for preview [m], shape (E, N, r).
        velocities: rates of change of the road heights at the samples [m/s], shape (T, N, r); None if these rates are not
            needed.
        held_inputs: further inputs that are constant during each step, see `RoadInput.held_inputs`, shape (T, N, l) or (T, N, l
            + r); None if there are no such inputs.
        effects: effects of the external loads on the signals at the samples and on the measurements, see
            `RoadInput.in_signals`; None if there are no loads.
        sides: road heights [m] at each vertical edge, on the side whose height `now` does not contain, by index of the sample;
            shape (N, r) each.
        failures: failures of Python control laws, by number of the run. A run whose control law has failed continues without
            control forces. If `failures` is None, the first failure is raised as an error.
        numbers: index of each run in the list of all cases; these indices are the keys of `failures`.
        diverged: time at which each run diverged [s], shape (N,); infinity for a run that has not diverged so far.
        law_diverged: True for each run that diverged only because the states of its control law diverged, see
            `Block.law_diverged`, shape (N,).
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
        """Controller of each case, or the recorded commands that replace this controller."""
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
        numbers: index of each case in the list of all cases; these indices are the keys of `failures`.
        streamed: True for road inputs that do not store their road heights. If False, all road heights are stored twice, in the
            road inputs and in the batch.
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
    """Returns the road inputs, without duplicate objects. Equal inputs are replaced by one object, so that the heights under
    the wheels are computed only once.
    """
    keys = [(*road.vehicle.parameters.values(), id(road.road)) for road in inputs]
    first = dict(zip(reversed(keys), reversed(inputs), strict=True))
    return [first[key] for key in keys]
