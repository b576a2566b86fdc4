"""A batch of a campaign: many runs at once, measured and compared with their sampled twins as they go, one row each."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from models.common.numbers import finite
from models.kind import MOST_SQUEEZE
from models.roads.choice import RoadChoice
from models.roads.road import track_width
from models.vehicle import Vehicle
from sim.campaign.columns import EXPECTED, LINEAR
from sim.campaign.file import Campaign
from sim.campaign.plan import Plan, PlannedRun
from sim.campaign.samples import with_sample
from sim.campaign.twin import Twin
from sim.physics.blocks import DIVERGED
from sim.physics.readout import reads_out
from sim.physics.watched import Watched
from sim.response.regime import END_NAMES
from sim.ride.expected import Expected, expect
from sim.ride.metrics import Meter
from sim.ride.roughness import driven_roughness, roughness_object
from sim.ride.settled import Settled, settled
from synth.controller import Controller

Rows = list[dict[str, Any]]
MOST_ROADS = 4096  # whose IRIs are kept; more than a batch has
FAILED = "law: "  # how the reason begins why a run's law in Python has failed


def run_batch(plan: Plan, start: int, stop: int, stopped: Callable[[], bool] = lambda: False) -> Rows | None:
    """The rows of some runs of one vehicle, None where it was stopped.

    Args:
        plan: the campaign.
        start, stop: which runs.
        stopped: asked now and then whether to give up.
    """
    keys = [plan.key(run) for run in range(start, stop)]
    campaign, rows = plan.campaign, {}
    name = list(campaign.vehicles)[keys[0].vehicle]
    made = {i: with_sample(campaign.vehicles[name], campaign.samples[name][i]) for i in {key.sample for key in keys}}
    # Random roads are measured once their start is forgotten, others, a bump, a hump, from the start.
    # Where one controller needs a sensor before the step, signals of all are read so: a rounding that must not depend on company.
    alike: dict[tuple[int, bytes, bool], list[int]] = {}
    for i, key in enumerate(keys):
        of = (key.controller, reads_out(made[key.sample], campaign.timestep), campaign.roads[key.road].stationary)
        alike.setdefault(of, []).append(i)
    for group in alike.values():
        todo = [group]
        while todo:
            some = todo.pop()
            # A run alone would be summed along another axis than one among others: it gets company.
            pair = some * 2 if len(some) == 1 else some
            runs = [PlannedRun(plan, keys[i], made[keys[i].sample]) for i in pair]
            found = _drive(campaign, runs, stopped)
            if found is None:
                return None
            rows |= {i: {"run": start + i, **row} for i, row in zip(pair, found.rows, strict=True)}
            # Of runs whose law was called for all of them, and failed, each is tried alone: who fails must not depend on company.
            todo += [[some[i]] for i in found.doubtful] if len(some) > 1 else []
    return [rows[i] for i in range(len(keys))]


@dataclass(frozen=True)
class _Driven:
    """Rows of runs, and which of them may have failed by the fault of another."""

    rows: Rows
    doubtful: list[int]


def _drive(campaign: Campaign, runs: Sequence[PlannedRun], stopped: Callable[[], bool]) -> _Driven | None:
    vehicles, time = [run.vehicle for run in runs], campaign.time
    watched = Watched(vehicles, [run.controller for run in runs], [run.road for run in runs], time)
    random = runs[0].choice.stationary
    first = campaign.first if random else 0
    meter = Meter(vehicles, campaign.timestep, first, campaign.loaded, [run.road.loaded for run in runs])
    linear_runs = [run for run in runs if isinstance(run.controller, Controller)]  # all, or none
    twin = Twin(linear_runs, watched, None if random else first, campaign.loaded) if linear_runs else None
    for block in watched.blocks():
        if stopped():
            return None
        meter.update(block.values)
        if twin is not None:
            twin.update(block.start, block.values, watched.until, time[block.start : block.start + len(block.values)])

    ends, diverged, until = watched.ends, watched.diverged, watched.until
    measured, errors = meter.result(), twin.errors() if twin is not None else np.full(len(runs), np.nan)
    linear = twin.metrics() if twin is not None else {}
    expected = _Expectations(campaign)
    rows = []
    for i, run in enumerate(runs):
        inputs = {**run.inputs, **_roughness(campaign, run.choice, _as_wide(run, campaign), run.speed, run.seed)}
        if i in watched.failures:
            rows.append({**inputs, "reason": f"{FAILED}{watched.failures[i].why}"})
            continue
        broken = bool(np.isfinite(diverged[i]))
        ended = until[i]
        row = dict(inputs)
        flat = float(ends.flat[i])
        row["reason"] = (
            f"flat: a tyre is squeezed by more than {MOST_SQUEEZE:g} m at {flat:.4g} s"
            if flat < diverged[i]
            else f"diverged: a signal is beyond {DIVERGED:g} at {diverged[i]:.4g} s"
            if broken
            else None
        )
        absent = row["reason"] is not None
        row["diverged_at"] = float(diverged[i]) if broken else None
        row["ended_by"] = None if np.isinf(ended) else "divergence" if diverged[i] <= ends.first[i] else END_NAMES[ends.which[i]]
        row["ended_at"] = float(ended) if np.isfinite(ended) else None
        row["linear_error"] = finite(errors[i])
        row |= {name: None if absent else finite(values[i]) for name, values in measured.items()}
        row |= {f"{LINEAR}{name}": None if absent else finite(values[i]) for name, values in linear.items()}
        if run.choice.stationary:
            row |= expected(run)
        rows.append(row)
    return _Driven(rows, [i for i, failure in watched.failures.items() if failure.together])


def _as_wide(run: PlannedRun, campaign: Campaign) -> Vehicle:
    """The vehicle of a run as its file has it, where what is sampled leaves its tracks as they are: IRIs know no more."""
    vehicle = campaign.vehicles[run.name]
    return vehicle if track_width(vehicle) == track_width(run.vehicle) else run.vehicle


@lru_cache(maxsize=MOST_ROADS)
def _roughness(campaign: Campaign, choice: RoadChoice, vehicle: Vehicle, speed: float, seed: int) -> dict[str, float]:
    """Every IRI of a road as far as it is driven, by name; reckoned once, whatever drives over it."""
    road = choice.build(vehicle, speed, seed, speed * campaign.duration)
    found = roughness_object(driven_roughness(vehicle, road, campaign.time))
    return {name: entry["road"] for name, entry in found.items()}


class _Expectations:
    """What is expected over random roads, and how far runs are from it when measuring begins, each made once."""

    def __init__(self, campaign: Campaign) -> None:
        self.campaign = campaign
        self.made: dict[Any, Expected | None] = {}
        self.begun: dict[Any, Settled | None] = {}

    def __call__(self, run: PlannedRun) -> dict[str, Any]:
        spectrum, controller = run.road.spectrum, run.controller
        assert spectrum is not None, "the road is random"
        if not isinstance(controller, Controller):
            return {}
        c, of = self.campaign, (*run.system, run.speed)
        key = (*of, spectrum.density)
        if key not in self.made:
            self.made[key] = expect(run.vehicle, controller, spectrum, c.timestep, (len(c.time) - c.first) * c.timestep)
        expected = self.made[key]
        # How rough the road is does not matter, but for what of a curve is met on it.
        where, linear = (
            (key, expected.line.vehicle) if expected is not None and expected.line.rounds else (of, run.vehicle.straight)
        )
        if where not in self.begun:
            self.begun[where] = settled(linear, controller, spectrum, c.timestep, float(c.time[c.first]))
        begun = self.begun[where]
        found: dict[str, Any] = {}
        if expected is not None:
            found |= {f"{EXPECTED}{name}": finite(value) for name, value in expected.mean.items()}
            found["expected_error"] = finite(expected.error)
        if begun is not None:
            found |= {"settled": begun.share, "settled_signal": begun.signal}
        return found
