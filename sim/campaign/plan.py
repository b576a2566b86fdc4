"""The runs of a campaign: which there are, in what order, which are driven side by side, and how far they are."""

import itertools
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.laws.python_law import Programmed
from models.roads.road import Road
from models.vehicle.vehicle import Vehicle
from sim.campaign.file import Campaign
from sim.physics.run_blocks import runs_at_once
from synth.controller.controller import Driver

LOST = 5.0  # s of a worker's time in a batch, about: what an interruption may lose
FEWEST = 16  # runs in a batch all the same; quarter-cars cost a fifth more by 16 than by 64, each


@dataclass(frozen=True)
class RunKey:
    """Indices of a run into the lists of its campaign; the variant is 0 of a controller whose law is not drawn."""

    vehicle: int
    controller: int
    road: int
    speed: int
    variant: int
    sample: int
    seed: int


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
class Plan:
    """Every run of a campaign, numbered: vehicles slowest, seeds fastest. Roads without a seed run once.

    Attributes:
        campaign: the campaign.
        controllers: controllers by vehicle and name.
        variants: drawn laws by vehicle and controller, for controllers that have some.
    """

    campaign: Campaign
    controllers: Mapping[str, Mapping[str, Driver]]
    variants: Mapping[str, Mapping[str, Sequence[Driver]]] = field(default_factory=dict)

    @cached_property
    def _blocks(self) -> list[tuple[int, int, int, int, int]]:
        """(first run, vehicle, controller, road, speed) of every combination, ascending; variant, sample and seed within."""
        c, blocks, start = self.campaign, [], 0
        for v, name in enumerate(c.vehicles):
            for k, controller in enumerate(c.controllers):
                drawn = len(c.variants[name].get(controller, ({},))) * len(c.samples[name])
                for r, road in enumerate(c.roads):
                    for s in range(len(c.speeds)):
                        blocks.append((start, v, k, r, s))
                        start += drawn * (len(c.seeds) if road.random else 1)
        return [*blocks, (start, -1, -1, -1, -1)]

    @property
    def count(self) -> int:
        """Returns the number of runs."""
        return self._blocks[-1][0]

    @cached_property
    def _starts(self) -> Array:
        return np.array([block[0] for block in self._blocks])

    def key(self, run: int) -> RunKey:
        """Returns the key of a run."""
        start, v, k, r, s = self._blocks[int(np.searchsorted(self._starts, run, side="right")) - 1]
        c = self.campaign
        drawn, seed = divmod(run - start, len(c.seeds) if c.roads[r].random else 1)
        variant, sample = divmod(drawn, len(c.samples[list(c.vehicles)[v]]))
        return RunKey(v, k, r, s, variant, sample, seed)

    def driver(self, key: RunKey) -> Driver:
        """Returns the controller of a run."""
        vehicle, controller = list(self.campaign.vehicles)[key.vehicle], self.campaign.controllers[key.controller]
        drawn = self.variants.get(vehicle, {}).get(controller)
        return self.controllers[vehicle][controller] if drawn is None else drawn[key.variant]

    def candidates(self, vehicle: str) -> "dict[Candidate, Array]":
        """Returns every controller of a vehicle, and every variant of a drawn one, with its runs."""
        c = self.campaign
        runs: dict[Candidate, list[Array]] = {}
        for (start, v, k, *_), (stop, *_) in itertools.pairwise(self._blocks):
            if list(c.vehicles)[v] != vehicle:
                continue
            controller = c.controllers[k]
            drawn = c.variants[vehicle].get(controller)
            for i, some in enumerate(np.split(np.arange(start, stop), len(drawn or ((),)))):
                candidate = Candidate(controller, None) if drawn is None else Candidate(controller, i)
                runs.setdefault(candidate, []).append(some)
        return {candidate: np.concatenate(some) for candidate, some in runs.items()}

    def programmed(self, run: int) -> bool:
        """Returns True if a law in Python drives the run."""
        key = self.key(run)
        name, controller = list(self.campaign.vehicles)[key.vehicle], self.campaign.controllers[key.controller]
        return isinstance(self.controllers[name][controller], Programmed)

    def batches(self, gaps: Iterable[tuple[int, int]], most: Callable[[], int]) -> Iterator[tuple[int, int]]:
        """Yields the runs of gaps (start, stop), cut into batches of one vehicle that fit into memory.

        Args:
            gaps: gaps, ascending.
            most: function that returns how many runs the next batch may have; called before each batch.
        """
        vehicles = list(self.campaign.vehicles.values())
        for start, stop in gaps:
            while start < stop:
                v = self.key(start).vehicle
                same = next((first for first, u, *_ in self._blocks[:-1] if first > start and u != v), self.count)
                size = runs_at_once(len(self.campaign.time), len(vehicles[v].kind.wheels))
                end = min(stop, same, start + min(size, most()))
                yield start, end
                start = end

    def inputs(self, key: RunKey) -> dict[str, Any]:
        """Returns the inputs of a run as in its row."""
        c = self.campaign
        name, road = list(c.vehicles)[key.vehicle], c.roads[key.road]
        sample, controller = c.samples[name][key.sample], c.controllers[key.controller]
        drawn = c.variants[name].get(controller)
        of_law = {"variant": key.variant, **{f"law_{one}": value for one, value in drawn[key.variant].items()}} if drawn else {}
        return {
            "vehicle": name,
            "controller": controller,
            "road": road.text,
            "speed": c.speeds[key.speed],
            "seed": c.seeds[key.seed] if road.random else None,
            "sample": key.sample if sample else None,
            **{f"parameter_{parameter}": value for parameter, value in sample.items()},
            **of_law,
        }


class PlannedRun:
    """Run with everything that it needs."""

    def __init__(self, plan: Plan, key: RunKey, vehicle: Vehicle) -> None:
        c = plan.campaign
        self.name, self.vehicle, self.key = list(c.vehicles)[key.vehicle], vehicle, key
        self.controller = plan.driver(key)
        self.choice, self.speed, self.seed = c.roads[key.road], c.speeds[key.speed], c.seeds[key.seed]
        self.road: Road = self.choice.build(vehicle, self.speed, self.seed, self.speed * c.duration)
        self.system = (id(vehicle), key.controller, key.variant)
        self.inputs = plan.inputs(key)


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
        self._next = min(self._most, max(FEWEST, round(LOST * runs / max(took, 1e-9))))
        self.done += runs
        left = (self.total - self.done) * self.steps / self.rate
        clock = f"{int(left // 3600)}:{int(left // 60 % 60):02d}:{int(left % 60):02d}"
        self._tell(f"{self.done} of {self.total} runs, {self.rate:.3g} steps/s, {clock} left")
