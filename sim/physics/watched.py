"""Many runs in MuJoCo, some samples at a time, and what has become of each so far: none of them need be held whole."""

from collections.abc import Iterator, Sequence

import numpy as np

from models.common.arrays import Array
from models.roads.road import Road, under_wheels
from models.vehicle import Vehicle
from sim.physics.blocks import Block, Course, in_blocks
from sim.physics.python_laws import Driven, Failure, steps_ahead
from sim.physics.simulate import loads_on
from sim.response.regime import BLOCK, EndDetector


class Watched:
    """N runs from rest, of vehicles of one kind that read out alike, over a road each.

    Attributes:
        now: heights of the roads under the wheels at the samples [m], shape (T, N, r).
        midway: the same half a step later, where MuJoCo holds them.
        ends: what ends their linear regime, and when, in the blocks so far.
        loads: on their bodies [N, N m], midway through the steps, shape (T, N, l); None where there are none.
        beyond: heights of the roads at the samples after the last, as far as laws in Python are told of them.
        failures: by run, the laws in Python that have failed; such a run goes on without forces.
        diverged: when each diverged in them [s], infinite where it did not, shape (N,).
    """

    def __init__(self, vehicles: Sequence[Vehicle], controllers: Sequence[Driven], roads: Sequence[Road], time: Array) -> None:
        """Arguments as for `sim.physics.simulate.simulate`."""
        self.vehicles, self.controllers, self.time = vehicles, controllers, time
        ahead = steps_ahead(vehicles, controllers, self.timestep)
        halves = np.arange(2 * (len(time) + ahead)) * (self.timestep / 2)
        heights = np.empty((len(halves), len(vehicles), len(vehicles[0].kind.wheels)))
        for i, (vehicle, road) in enumerate(zip(vehicles, roads, strict=True)):
            heights[:, i] = under_wheels(road.displacement, road, vehicle, halves)
        self.now, self.midway = heights[: 2 * len(time) : 2], heights[1 : 2 * len(time) : 2]
        self.loads = loads_on(vehicles, roads, time + self.timestep / 2)
        self.beyond, self.failures = heights[2 * len(time) :: 2], dict[int, Failure]()
        self.ends, self.diverged = EndDetector(vehicles, time), np.full(len(vehicles), np.inf)

    @property
    def timestep(self) -> float:
        """Of the runs [s]."""
        return float(self.time[1] - self.time[0])

    @property
    def until(self) -> Array:
        """The time before which each is linear [s], infinite for always, shape (N,)."""
        return np.minimum(self.ends.first, self.diverged)

    def blocks(self) -> Iterator[Block]:
        """Every block in its turn; once a run has diverged, what is left of it is clipped."""
        edges = [*range(0, len(self.time), BLOCK), len(self.time)]
        course = Course(
            self.vehicles,
            self.controllers,
            self.now,
            self.midway,
            self.timestep,
            edges,
            beyond=self.beyond,
            failures=self.failures,
            loads=self.loads,
        )
        for block in in_blocks(course):
            self.diverged = np.minimum(self.diverged, block.diverged(self.time))
            if np.isfinite(self.diverged).any():
                block.clip()
            self.ends.update(block.start, block.values)
            yield block
