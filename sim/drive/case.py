"""Runs to drive, and a batch of runs that are stepped side by side."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from models.common.arrays import Array
from models.roads.road import Departure, Road, RoadInput, under_wheels
from models.vehicle.vehicle import Vehicle
from sim.drive.driver import Failure, RunDriver, steps_ahead
from synth.controller.controller import Controller


@dataclass(frozen=True, eq=False)
class State:
    """State of a run at its start, for forces without adjustable dampers.

    Attributes:
        motion: positions and velocities of MuJoCo, own states of parts, and activations, shape (nq + nv + k + na,).
        acting_forces: the forces that acted before [N], shape (m,).
        law, undelayed_forces: states of the controller, and of the second one, as they are run.
        pending_forces: forces that do not act yet, or act at the start of the first sample, the next first [N], shape (d, m).
    """

    motion: Array
    acting_forces: Array
    law: Array
    undelayed_forces: Array
    pending_forces: Array


@dataclass(frozen=True, eq=False)
class Case:
    """One run.

    Attributes:
        vehicle: the vehicle, with its limits and the implementation of its controller.
        driver: controller, or known commands.
        road: the road, with loads on the body if there are any.
        start: state at the start; None for rest, or for the steady motion in which a measured road starts.
        undelayed_controller: second controller without `[implementation]`, whose forces are added to those of the first, or None.
        earlier: see `RoadInput`.
        input: the road at the sample times, if it is computed already; None otherwise.
    """

    vehicle: Vehicle
    driver: RunDriver
    road: Road
    start: State | None = None
    undelayed_controller: Controller | None = None
    earlier: bool = False
    input: RoadInput | None = None


def inputs_of(cases: Sequence[Case], time: Array) -> list[RoadInput]:
    """Returns the roads of some cases at sample times [s], one for all cases with the same vehicle and road."""
    made = dict[tuple[int, int, bool], RoadInput]()
    for one in cases:
        key = id(one.vehicle), id(one.road), one.earlier
        made[key] = one.input or made.get(key) or RoadInput(one.vehicle, one.road, time, one.earlier)
    return [one.input or made[id(one.vehicle), id(one.road), one.earlier] for one in cases]


@dataclass(frozen=True, eq=False)
class Batch:
    """N cases that are stepped side by side, at the same sample times.

    Attributes:
        cases: N cases, with vehicles of one kind that read out alike, see `reads_out`.
        inputs: their roads at the samples.
        now: road heights at the samples [m], shape (T, N, r).
        midway: heights at which MuJoCo holds them over the steps.
        beyond: road heights at the samples after the last [m], shape (E, N, r), as far as controllers preview them.
        velocities: rates of the heights at the samples [m/s], shape (T, N, r); None if no observer needs them.
        held_inputs: effects beside the road's heights that MuJoCo holds over steps, see `RoadInput.held_inputs`, shape (T, N, l)
            or (T, N, l + r); None if there are none.
        effects: loads in the signals of the samples and in the measurements, see `RoadInput.in_signals`; None without loads.
        sides: road heights on the other side of vertical edges [m], shape (N, r), by sample.
        failures: failures of laws in Python by run: such a run continues without forces. None to raise the first failure.
        numbers: numbers of the runs among all cases, which `failures` has.
        diverged: time at which each run diverged in the blocks so far [s], shape (N,), or infinity.
        law_diverged: True for each of these that diverged by the states of its law alone, see `Block.law_diverged`, shape (N,).
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
        """The sample times [s], shape (T,)."""
        return self.inputs[0].time

    @property
    def timestep(self) -> float:
        """The timestep [s]."""
        return self.inputs[0].timestep

    @cached_property
    def vehicles(self) -> list[Vehicle]:
        """The vehicles."""
        return [one.vehicle for one in self.cases]

    @cached_property
    def drivers(self) -> list[RunDriver]:
        """The controllers, or known commands."""
        return [one.driver for one in self.cases]

    def part(self, runs: slice) -> "Batch":
        """Returns the batch of some of the runs."""
        arrays = {name: getattr(self, name)[:, runs] for name in ("now", "midway", "beyond")}
        more = {name: None if (one := getattr(self, name)) is None else one[:, runs] for name in ("velocities", "held_inputs")}
        return replace(
            self,
            cases=self.cases[runs],
            inputs=self.inputs[runs],
            effects=None if self.effects is None else (self.effects[0][:, runs], self.effects[1][:, runs]),
            sides={k: heights[runs] for k, heights in self.sides.items()},
            numbers=self.numbers[runs],
            diverged=self.diverged[runs],
            law_diverged=self.law_diverged[runs],
            **arrays,
            **more,
        )

    def steady(self, samples: slice) -> Iterator[tuple[int, Array]]:
        """Yields every run that does not start from rest at 0, by index, with its signals in steady motion, shape (B, S)."""
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
    """Returns the batch of some cases at sample times from 0 [s].

    Args:
        numbers: their numbers among all cases.
        streamed: True if the inputs need not keep their roads, which would take the memory of all samples twice.
        failures: receives the failures of laws in Python; None to raise the first one.
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
        if any(vehicle.linear_model.tyres_damp for vehicle in vehicles):  # their forces decide when they leave the road
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


ROAD_ARRAYS = ("heights", "midway", "velocities")  # of `RoadInput`


def _same_roads(inputs: Sequence[RoadInput]) -> list[RoadInput]:
    """Replaces each road input by the first one with equal heights under its wheels, so that these are computed once."""
    keys = [(*road.vehicle.parameters.values(), id(road.road)) for road in inputs]
    first = dict(zip(reversed(keys), reversed(inputs), strict=True))
    return [first[key] for key in keys]
