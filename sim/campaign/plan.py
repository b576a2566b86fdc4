"""The runs of a campaign: how they are numbered, ordered, and divided into batches and parts; and the progress of the
simulation.
"""

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

LOST_TIME = 5.0  # s, approximate time that a worker spends on one batch; an interruption loses at most one batch per worker
RATE = Field[float]("speed", float, ".3g", unit="steps/s")
# smallest number of runs in a batch; a quarter-car run takes a fifth more time in a batch of 16 than in a batch of 64
FEWEST = 16
# smallest number of consecutive runs in a part of a campaign; parts are smaller only if the campaign has too few runs
TOGETHER = 64
MOST_ROUNDS = 64  # largest number of intervals of consecutive runs in one part of a campaign
# ascending intervals (start, stop) of run numbers; run `stop` itself is not part of its interval
Runs = Sequence[tuple[int, int]]


@dataclass(frozen=True)
class Candidate:
    """A controller of a vehicle, or one variant of a controller whose control law has sampled parameters.

    Attributes:
        controller: name of the controller.
        variant: number of the variant; None if no parameters of the law are sampled.
    """

    controller: str
    variant: int | None

    @property
    def name(self) -> str:
        """Name of the controller or variant in tables, such as `skyhook#12` for variant 12."""
        return self.controller if self.variant is None else f"{self.controller}#{self.variant}"


@dataclass(frozen=True, eq=False)
class RunBlock:
    """All runs of one vehicle with one controller over one road at one speed.

    The runs have consecutive numbers. From one run to the next, the seed changes first, then the sample, and last the variant.

    Attributes:
        start: number of the first run.
        vehicle, controller: names of the vehicle and the controller in the campaign file.
        road, speed: road, and the vehicle's speed on this road [m/s].
        variants: sampled parameters of the control law by key, one mapping for each variant; None if no parameters are sampled.
        samples: sampled parameters of the vehicle by name [SI], one mapping for each sample; a single empty mapping if no
            parameters are sampled.
        seeds: seeds of the random road; for a road that is not random, only the first seed.
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
        """Number of variants, number of samples and number of seeds."""
        return len(self.variants or ({},)), len(self.samples), len(self.seeds)

    @property
    def stop(self) -> int:
        """Number of the block's last run plus 1."""
        return self.start + math.prod(self.shape)

    @property
    def candidates(self) -> dict[Candidate, Array]:
        """The controller, or each variant of it, with the numbers of the runs that belong to it, shape (n,)."""
        numbers = [None] if self.variants is None else range(len(self.variants))
        runs = np.split(np.arange(self.start, self.stop), len(numbers))
        return {Candidate(self.controller, number): some for number, some in zip(numbers, runs, strict=True)}


@dataclass(frozen=True, eq=False)
class Plan:
    """All runs of a campaign, each with a number.

    In the order of the runs, the vehicle changes least often; the controller, the road and the speed change increasingly often.
    A road that is not random is simulated once, not for each seed.

    Attributes:
        campaign: campaign to which the runs belong.
        controllers: controllers of the campaign, by name of the vehicle and name of the controller.
        variants: controllers whose control laws have sampled parameters, one for each variant, by name of the vehicle and of
            the controller.
        roughness: international roughness indices [m/km] of the most recent roads, stored because many runs use the same road.
    """

    campaign: Campaign
    controllers: Mapping[str, Mapping[str, AnyController]]
    variants: Mapping[str, Mapping[str, Sequence[AnyController]]] = field(default_factory=dict)
    roughness: dict[Hashable, dict[str, float]] = field(default_factory=dict)

    @cached_property
    def blocks(self) -> list[RunBlock]:
        """All combinations of vehicle, controller, road and speed, in the order of the runs."""
        c, blocks, start = self.campaign, list[RunBlock](), 0
        for vehicle, controller, road, speed in itertools.product(c.vehicles, c.controllers, c.roads, c.speeds):
            drawn, seeds = c.variants[vehicle].get(controller), c.seeds if road.random else c.seeds[:1]
            blocks.append(RunBlock(start, vehicle, controller, road, speed, drawn, c.samples[vehicle], seeds))
            start = blocks[-1].stop
        return blocks

    @property
    def count(self) -> int:
        """Number of runs in the campaign."""
        return self.blocks[-1].stop

    @cached_property
    def distances(self) -> Array:
        """Distance that the vehicle drives during the measured part of each run [m], shape (count,)."""
        c, blocks = self.campaign, self.blocks
        counts = [len(c.time) - (c.first if one.road.stationary else 0) for one in blocks]
        of_blocks = [one.speed * count * c.timestep for one, count in zip(blocks, counts, strict=True)]
        return np.repeat(of_blocks, [one.stop - one.start for one in blocks])

    @cached_property
    def _starts(self) -> list[int]:
        return [block.start for block in self.blocks]

    def place(self, run: int) -> tuple[RunBlock, int, int, int]:
        """Returns the block that contains a run, and the indices of the run's variant, sample and seed within this block."""
        block = self.blocks[bisect_right(self._starts, run) - 1]
        variant, sample, seed = map(int, np.unravel_index(run - block.start, block.shape))
        return block, variant, sample, seed

    def driver(self, vehicle: str, candidate: Candidate) -> AnyController:
        """Returns the controller with which the runs of a candidate are simulated."""
        drawn = self.variants.get(vehicle, {}).get(candidate.controller)
        return self.controllers[vehicle][candidate.controller] if drawn is None else drawn[candidate.variant or 0]

    def candidates(self, vehicle: str) -> dict[Candidate, Array]:
        """Returns the candidates of a vehicle, each with the numbers of the candidate's runs, shape (n,).

        If the campaign samples the parameters of a control law, the resulting variants are candidates, and the controller
        itself is not.
        """
        runs: dict[Candidate, list[Array]] = {}
        for block in (one for one in self.blocks if one.vehicle == vehicle):
            for candidate, some in block.candidates.items():
                runs.setdefault(candidate, []).append(some)
        return {candidate: np.concatenate(some) for candidate, some in runs.items()}

    def share(self, number: int, of: int) -> Runs:
        """Returns the runs of one part of the campaign, as intervals of run numbers in ascending order. The parts take about
        equally long to simulate.

        The runs of each vehicle are distributed in rounds. Each round gives every part one interval of consecutive runs, and
        starts with a different part. Each part therefore contains runs with all controllers, roads and speeds.

        Args:
            number: number of the part, from 1 to `of`.
            of: total number of parts.
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
        """Yields batches (start, stop) of runs that have no results yet. All runs of a batch are of one vehicle, and the
        results of a batch fit into memory.

        Args:
            gaps: intervals (start, stop) of the numbers of runs that have no results yet, in ascending order.
            most: function that returns the largest allowed size of the next batch; called before each batch.
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
        """Returns those columns of a run's row in the results that describe the inputs of the run."""
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
        """Returns the `PlannedRun` objects of consecutive runs of one vehicle. Runs with the same sample share one vehicle
        object.
        """
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
    """All inputs of one run: vehicle, controller and road.

    Attributes:
        inputs: columns of the results that describe the inputs of the run.
        vehicle: vehicle with the sampled parameters of this run.
        controller: controller of the run.
        choice, road: the road as described in the campaign file, and the resulting road for this vehicle, speed and seed.
    """

    inputs: Mapping[str, Any]
    vehicle: Vehicle
    controller: AnyController
    choice: RoadChoice
    road: Road

    @property
    def system(self) -> tuple[int, int]:
        """Key that identifies the vehicle and the controller of a run: runs with the same vehicle and controller have equal
        keys.
        """
        return id(self.vehicle), id(self.controller)


class Progress:
    """Progress of a campaign: number of finished runs, speed of the simulation, remaining time, and size of the next batch."""

    def __init__(self, plan: Plan, total: int, most: int, tell: Callable[[str], None]) -> None:
        self.steps, self.total, self.done, self.began = len(plan.campaign.time), total, 0, time.monotonic()
        self._most, self._next, self._tell = most, min(FEWEST, most), tell

    @property
    def rate(self) -> float:
        """Number of time steps that are simulated per second, over all runs together."""
        return self.done * self.steps / max(time.monotonic() - self.began, 1e-9)

    def next_batch(self) -> int:
        """Returns the size of the next batch: the number of runs that a worker finishes in about `LOST_TIME`."""
        return self._next

    def add(self, runs: int, took: float) -> None:
        """Adds finished runs to the progress of the campaign, and prints the progress.

        Args:
            runs: number of finished runs.
            took: time that one worker needed to simulate the finished runs [s].
        """
        self._next = min(self._most, max(FEWEST, round(LOST_TIME * runs / max(took, 1e-9))))
        self.done += runs
        left = (self.total - self.done) * self.steps / self.rate
        clock = f"{int(left // 3600)}:{int(left // 60 % 60):02d}:{int(left % 60):02d}"
        self._tell(f"{self.done} of {self.total} runs, {RATE.text(self.rate)}, {clock} left")
