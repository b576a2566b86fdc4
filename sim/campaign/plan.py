"""The runs of a campaign: which there are, in what order, which are driven side by side, and how far they are."""

import itertools
import math
import time
from bisect import bisect_right
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.document.field import Field
from models.roads.choice import RoadChoice
from models.roads.road import Road
from models.vehicle.vehicle import Vehicle
from sim.campaign.file import Campaign
from sim.campaign.samples import Values
from sim.drive.loop import runs_at_once
from sim.runs.sampled_vehicle import with_sample
from synth.controller.controller import AnyController

LOST_TIME = 5.0  # s of a worker's time in a batch, about: what an interruption may lose
RATE = Field[float]("speed", float, ".3g", unit="steps/s")
FEWEST = 16  # runs in a batch all the same; quarter-cars cost a fifth more by 16 than by 64, each
TOGETHER = 64  # runs in a row that one part of a campaign has, if there are enough
MOST_ROUNDS = 64  # of such rows of runs, dealt to all parts of a campaign
Runs = Sequence[tuple[int, int]]  # ascending (start, stop)


@dataclass(frozen=True)
class Candidate:
    """A controller of a vehicle, or a variant of one whose law is drawn.

    Attributes:
        controller: name of the controller.
        variant: number of the variant; None for the law of the vehicle file.
    """

    controller: str
    variant: int | None

    @property
    def name(self) -> str:
        """Name in tables."""
        return self.controller if self.variant is None else f"{self.controller}#{self.variant}"


@dataclass(frozen=True, eq=False)
class RunBlock:
    """The runs of a vehicle with a controller over a road at a speed, numbered in a row: variants slowest, seeds fastest.

    Attributes:
        start: number of the first run.
        vehicle, controller: names in the campaign.
        road, speed: the road, and the speed [m/s].
        variants: drawn values of the law; None if it is not drawn.
        samples: sampled values of the vehicle; a single empty one if none are sampled.
        seeds: seeds of the road; only the first for a road without random heights.
    """

    start: int
    vehicle: str
    controller: str
    road: RoadChoice
    speed: float
    variants: Sequence[Values] | None
    samples: Sequence[Values]
    seeds: Sequence[int]

    @property
    def shape(self) -> tuple[int, int, int]:
        """Numbers of variants, samples and seeds."""
        return len(self.variants or ({},)), len(self.samples), len(self.seeds)

    @property
    def stop(self) -> int:
        """Returns the number after that of the last run."""
        return self.start + math.prod(self.shape)

    @property
    def candidates(self) -> dict[Candidate, Array]:
        """The controller or its variants, each with the numbers of its runs."""
        numbers = [None] if self.variants is None else range(len(self.variants))
        runs = np.split(np.arange(self.start, self.stop), len(numbers))
        return {Candidate(self.controller, number): some for number, some in zip(numbers, runs, strict=True)}


@dataclass(frozen=True, eq=False)
class Plan:
    """Every run of a campaign, numbered: vehicles slowest, then controllers, roads and speeds. Roads without a seed run once.

    Attributes:
        campaign: the campaign.
        controllers: drivers by vehicle and name.
        variants: drawn laws of every vehicle, by controller.
        roughness: IRIs of roads so far; kept for a while, as many runs share a road.
    """

    campaign: Campaign
    controllers: Mapping[str, Mapping[str, AnyController]]
    variants: Mapping[str, Mapping[str, Sequence[AnyController]]] = field(default_factory=dict)
    roughness: dict[Hashable, dict[str, float]] = field(default_factory=dict)

    @cached_property
    def blocks(self) -> list[RunBlock]:
        """Every combination of vehicle, controller, road and speed, in the order of the runs."""
        c, blocks, start = self.campaign, list[RunBlock](), 0
        for vehicle, controller, road, speed in itertools.product(c.vehicles, c.controllers, c.roads, c.speeds):
            drawn, seeds = c.variants[vehicle].get(controller), c.seeds if road.random else c.seeds[:1]
            blocks.append(RunBlock(start, vehicle, controller, road, speed, drawn, c.samples[vehicle], seeds))
            start = blocks[-1].stop
        return blocks

    @property
    def count(self) -> int:
        """Returns the number of runs."""
        return self.blocks[-1].stop

    @cached_property
    def distances(self) -> Array:
        """Measured distance of every run at its speed [m], shape (count,)."""
        c, blocks = self.campaign, self.blocks
        counts = [len(c.time) - (c.first if one.road.stationary else 0) for one in blocks]
        of_blocks = [one.speed * count * c.timestep for one, count in zip(blocks, counts, strict=True)]
        return np.repeat(of_blocks, [one.stop - one.start for one in blocks])

    @cached_property
    def _starts(self) -> list[int]:
        return [block.start for block in self.blocks]

    def place(self, run: int) -> tuple[RunBlock, int, int, int]:
        """Returns the block of a run, and its variant, sample and seed in it, by index."""
        block = self.blocks[bisect_right(self._starts, run) - 1]
        variant, sample, seed = map(int, np.unravel_index(run - block.start, block.shape))
        return block, variant, sample, seed

    def driver(self, vehicle: str, candidate: Candidate) -> AnyController:
        """Returns the controller of a candidate."""
        drawn = self.variants.get(vehicle, {}).get(candidate.controller)
        return self.controllers[vehicle][candidate.controller] if drawn is None else drawn[candidate.variant or 0]

    def candidates(self, vehicle: str) -> dict[Candidate, Array]:
        """Returns every controller of a vehicle, and every variant of a drawn one, with its runs."""
        runs: dict[Candidate, list[Array]] = {}
        for block in (one for one in self.blocks if one.vehicle == vehicle):
            for candidate, some in block.candidates.items():
                runs.setdefault(candidate, []).append(some)
        return {candidate: np.concatenate(some) for candidate, some in runs.items()}

    def share(self, number: int, of: int) -> Runs:
        """Returns the runs of a part of the campaign, from 1 on. All parts take about the same time.

        The runs of each vehicle are dealt to the parts in rounds, each of which begins with another part. A part thus has runs of
        all controllers, roads and speeds, many of them in a row.
        """
        share, start = list[tuple[int, int]](), 0
        for stop in {block.vehicle: block.stop for block in self.blocks}.values():
            rounds = min(max(1, (stop - start) // (of * TOGETHER)), MOST_ROUNDS)
            for k in range(rounds):
                at = k * of + (number - 1 - k * of // rounds) % of
                first, last = (start + (stop - start) * i // (of * rounds) for i in (at, at + 1))
                if share and share[-1][1] == first:
                    first = share.pop()[0]
                share += [(first, last)] * (first < last)
            start = stop
        return share

    def batches(self, gaps: Iterable[tuple[int, int]], most: Callable[[], int]) -> Iterator[tuple[int, int]]:
        """Yields the runs of gaps (start, stop), cut into batches of one vehicle that fit into memory.

        Args:
            gaps: gaps, ascending.
            most: function that returns how many runs the next batch may have; called before each batch.
        """
        ends = {block.vehicle: block.stop for block in self.blocks}
        for start, stop in gaps:
            while start < stop:
                name = self.place(start)[0].vehicle
                size = runs_at_once(len(self.campaign.time), len(self.campaign.vehicles[name].kind.wheels))
                end = min(stop, ends[name], start + min(size, most()))
                yield start, end
                start = end

    def inputs(self, run: int) -> dict[str, Any]:
        """Returns the columns of a row that describe its run."""
        block, variant, sample, seed = self.place(run)
        law = block.variants[variant] if block.variants else None
        return {
            "vehicle": block.vehicle,
            "controller": block.controller,
            "road": block.road.text,
            "speed": block.speed,
            "seed": block.seeds[seed] if block.road.random else None,
            "sample": sample if block.samples[sample] else None,
            **{f"parameter_{parameter}": value for parameter, value in block.samples[sample].items()},
            **({"variant": variant, **{f"law_{key}": value for key, value in law.items()}} if law is not None else {}),
        }

    def runs(self, start: int, stop: int) -> "list[PlannedRun]":
        """Returns some runs of one vehicle. Runs of one sample share the vehicle."""
        c, runs, vehicles = self.campaign, [], dict[int, Vehicle]()
        for run in range(start, stop):
            block, variant, sample, seed = self.place(run)
            if sample not in vehicles:
                vehicles[sample] = with_sample(c.vehicles[block.vehicle], block.samples[sample])
            road = block.road.build(vehicles[sample], block.speed, block.seeds[seed], block.speed * c.duration)
            driver = self.driver(block.vehicle, Candidate(block.controller, variant))
            runs.append(PlannedRun(self.inputs(run), vehicles[sample], driver, block.road, road))
        return runs


@dataclass(frozen=True, eq=False)
class PlannedRun:
    """Run with everything that it needs.

    Attributes:
        inputs: columns of its row that describe the run.
        vehicle: vehicle with the sampled values.
        controller: driver of the run.
        choice, road: choice of the road, and the road.
    """

    inputs: Mapping[str, Any]
    vehicle: Vehicle
    controller: AnyController
    choice: RoadChoice
    road: Road

    @property
    def system(self) -> tuple[int, int]:
        """Returns a key that is equal for runs of one vehicle with one controller."""
        return id(self.vehicle), id(self.controller)


class Progress:
    """Progress of a campaign: runs done, speed, remaining time, and size of the next batch."""

    def __init__(self, plan: Plan, total: int, most: int, tell: Callable[[str], None]) -> None:
        self.steps, self.total, self.done, self.began = len(plan.campaign.time), total, 0, time.monotonic()
        self._most, self._next, self._tell = most, min(FEWEST, most), tell

    @property
    def rate(self) -> float:
        """Run-steps a second."""
        return self.done * self.steps / max(time.monotonic() - self.began, 1e-9)

    def next_batch(self) -> int:
        """Returns the size of the next batch: as many runs as a worker does in the time that an interruption may cost."""
        return self._next

    def add(self, runs: int, took: float) -> None:
        """Shows that some more are done, by one worker in so many seconds."""
        self._next = min(self._most, max(FEWEST, round(LOST_TIME * runs / max(took, 1e-9))))
        self.done += runs
        left = (self.total - self.done) * self.steps / self.rate
        clock = f"{int(left // 3600)}:{int(left // 60 % 60):02d}:{int(left % 60):02d}"
        self._tell(f"{self.done} of {self.total} runs, {RATE.text(self.rate)}, {clock} left")
