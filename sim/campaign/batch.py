"""A batch of a campaign: many runs at once, measured and compared with their linear twins as they go, one row each."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.kind import MOST_SQUEEZE
from models.vehicle import Vehicle
from sim.campaign.columns import EXPECTED, LINEAR
from sim.campaign.file import Campaign, with_sample
from sim.linear.loop import driven, held_inputs
from sim.physics.readout import reads_out
from sim.physics.simulate import BLOCK, DIVERGED, in_blocks, runs_at_once
from sim.response.regime import ENDS, Ends
from sim.response.response import SILENT
from sim.ride.expected import Expected, expect
from sim.ride.metrics import Meter
from sim.ride.settled import Settled, settled
from sim.roads.iso8608 import Iso8608
from sim.roads.road import Road, under_wheels
from synth.controller import Controller


@dataclass(frozen=True)
class RunKey:
    """One run of a campaign, by index into its lists."""

    vehicle: int
    controller: int
    road: int
    speed: int
    sample: int
    seed: int


@dataclass(frozen=True, eq=False)
class Plan:
    """Every run of a campaign, numbered: vehicles slowest, seeds fastest. Roads without a seed run once.

    Attributes:
        campaign: the campaign.
        gains: the controllers, by vehicle and name.
    """

    campaign: Campaign
    controllers: Mapping[str, Mapping[str, Controller]]

    @cached_property
    def _blocks(self) -> list[tuple[int, int, int, int, int]]:
        """(first run, vehicle, controller, road, speed) of every combination, ascending; sample and seed count within."""
        c, found, start = self.campaign, [], 0
        for v, name in enumerate(c.vehicles):
            for k in range(len(c.controllers)):
                for r, road in enumerate(c.roads):
                    for s in range(len(c.speeds)):
                        found.append((start, v, k, r, s))
                        start += len(c.samples[name]) * (len(c.seeds) if road.random else 1)
        return [*found, (start, -1, -1, -1, -1)]

    @property
    def count(self) -> int:
        """How many runs there are."""
        return self._blocks[-1][0]

    @cached_property
    def _starts(self) -> Array:
        return np.array([block[0] for block in self._blocks])

    def key(self, run: int) -> RunKey:
        """What run it is."""
        start, v, k, r, s = self._blocks[int(np.searchsorted(self._starts, run, side="right")) - 1]
        seeds = len(self.campaign.seeds) if self.campaign.roads[r].random else 1
        sample, seed = divmod(run - start, seeds)
        return RunKey(v, k, r, s, sample, seed)

    def batches(self, gaps: Iterable[tuple[int, int]], most: Callable[[], int]) -> Iterator[tuple[int, int]]:
        """The runs of gaps (start, stop), cut into batches of one vehicle that fit into memory.

        Args:
            gaps: ascending.
            most: asked before each batch how many runs it may have.
        """
        vehicles = list(self.campaign.vehicles.values())
        for start, stop in gaps:
            while start < stop:
                v = self.key(start).vehicle
                same = next((block[0] for block in self._blocks if block[0] > start and block[1] != v), self.count)
                size = runs_at_once(len(self.campaign.time), len(vehicles[v].kind.wheels))
                end = min(stop, same, start + min(size, most()))
                yield start, end
                start = end

    def inputs(self, key: RunKey) -> dict[str, Any]:
        """What a run is, as its row says."""
        c = self.campaign
        name, road = list(c.vehicles)[key.vehicle], c.roads[key.road]
        sample = c.samples[name][key.sample]
        return {
            "vehicle": name,
            "controller": c.controllers[key.controller],
            "road": road.text,
            "speed": c.speeds[key.speed],
            "seed": c.seeds[key.seed] if road.random else None,
            "sample": key.sample if sample else None,
            **{f"parameter_{parameter}": value for parameter, value in sample.items()},
        }


def run_batch(plan: Plan, start: int, stop: int, stopped: Callable[[], bool] = lambda: False) -> list[dict[str, Any]] | None:
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
        of = (key.controller, reads_out(made[key.sample], campaign.timestep), campaign.roads[key.road].random)
        alike.setdefault(of, []).append(i)
    for group in alike.values():
        # A run alone would be summed along another axis than one among others: it gets company.
        pair = group * 2 if len(group) == 1 else group
        runs = [_Run(plan, keys[i], made[keys[i].sample]) for i in pair]
        found = _drive(campaign, runs, stopped)
        if found is None:
            return None
        rows |= {i: {"run": start + i, **row} for i, row in zip(pair, found, strict=True)}
    return [rows[i] for i in range(len(keys))]


class _Run:
    """One run, with everything that it needs."""

    def __init__(self, plan: Plan, key: RunKey, vehicle: Vehicle) -> None:
        c = plan.campaign
        self.name, self.vehicle, self.key = list(c.vehicles)[key.vehicle], vehicle, key
        self.controller = plan.controllers[self.name][c.controllers[key.controller]]
        self.choice, self.speed, self.seed = c.roads[key.road], c.speeds[key.speed], c.seeds[key.seed]
        self.road: Road = self.choice.build(vehicle, self.speed, self.seed, self.speed * c.duration)
        self.system = (id(vehicle), key.controller)
        self.inputs = plan.inputs(key)


def _drive(campaign: Campaign, runs: Sequence[_Run], stopped: Callable[[], bool]) -> list[dict[str, Any]] | None:
    vehicles, time, h = [run.vehicle for run in runs], campaign.time, campaign.timestep
    halves = np.arange(2 * len(time)) * (h / 2)
    heights = np.empty((len(halves), len(runs), len(vehicles[0].kind.wheels)))
    for i, run in enumerate(runs):
        heights[:, i] = under_wheels(run.road.displacement, run.road, run.vehicle, halves)
    now, midway = heights[::2], heights[1::2]

    random = runs[0].choice.random
    first = campaign.first if random else 0
    meter = Meter(vehicles, h, first)
    twin = _Twin(runs, now, midway, h, None if random else first)
    ends = Ends(vehicles, time)
    diverged = np.full(len(runs), np.inf)
    for block in in_blocks(vehicles, [run.controller for run in runs], now, midway, h, 1, BLOCK):
        if stopped():
            return None
        times = time[block.start : block.start + len(block.values)]
        diverged = np.minimum(diverged, block.diverged(time))
        if np.isfinite(diverged).any():
            block.bound()
        meter.update(block.values)
        ends.update(block.start, block.values)
        twin.update(block.start, block.values, np.minimum(ends.first, diverged), times)

    measured, errors, linear = meter.result(), twin.errors(), twin.metrics()
    expected = _Expectations(campaign)
    rows = []
    for i, run in enumerate(runs):
        broken = bool(np.isfinite(diverged[i]))
        ended = min(diverged[i], ends.first[i])
        row = dict(run.inputs)
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
        row["ended_by"] = None if np.isinf(ended) else "divergence" if diverged[i] <= ends.first[i] else ENDS[ends.which[i]]
        row["ended_at"] = float(ended) if np.isfinite(ended) else None
        row["linear_error"] = _finite(errors[i])
        row |= {name: None if absent else _finite(values[i]) for name, values in measured.items()}
        row |= {f"{LINEAR}{name}": None if absent else _finite(values[i]) for name, values in linear.items()}
        if run.choice.random:
            row |= expected(run)
        rows.append(row)
    return rows


class _Expectations:
    """What is expected over random roads, and how far runs are from it when measuring begins, each made once."""

    def __init__(self, campaign: Campaign) -> None:
        self.campaign = campaign
        self.made: dict[Any, Expected | None] = {}
        self.begun: dict[Any, Settled | None] = {}

    def __call__(self, run: _Run) -> dict[str, Any]:
        assert isinstance(run.road, Iso8608)
        c, of = self.campaign, (*run.system, run.speed)
        key = (*of, run.road.road_class)
        if key not in self.made:
            self.made[key] = expect(run.vehicle, run.controller, run.road, c.timestep, (len(c.time) - c.first) * c.timestep)
        if of not in self.begun:
            self.begun[of] = settled(run.vehicle, run.controller, run.road, c.timestep, float(c.time[c.first]))
        expected, begun = self.made[key], self.begun[of]
        found: dict[str, Any] = {}
        if expected is not None:
            found |= {f"{EXPECTED}{name}": _finite(value) for name, value in expected.mean.items()}
            found["expected_error"] = _finite(expected.error)
        if begun is not None:
            found |= {"settled": begun.share, "settled_signal": begun.signal}
        return found


class _Twin:
    """The exact linear responses of the runs, sampled as in `sim.linear.loop`, beside them and as fast.

    Sums run over states one by one, as in `sim.physics.simulate`. A controller that is more than a gain has no twin here.
    """

    def __init__(self, runs: Sequence[_Run], now: Array, midway: Array, timestep: float, first: int | None) -> None:
        """Measured from sample `first` on; not at all, if that is None."""
        vehicle = runs[0].vehicle
        self.signals, self.now, self.midway = vehicle.kind.signals, now, midway
        self.ideal = vehicle.implementation.ideal
        systems: dict[Any, Any] = {}
        for run in runs:
            if run.system not in systems:
                systems[run.system] = _system(run.vehicle, run.controller, timestep)
        # By entry of the matrices, runs last: shapes (n, n, N), (n, r, N), (n, r, N), (n, r, N), (p, n, N), (p, r, N).
        self.loop, self.of_now, self.of_midway, self.jump, self.C, self.Cr = (
            np.stack([systems[run.system][i] for run in runs], axis=-1) for i in range(6)
        )
        self.outputs = vehicle.linear_model.outputs
        place = [signal.name for signal in self.signals]
        self.index = [place.index(name) for name in self.outputs]
        self.xi = np.zeros((self.loop.shape[0], len(runs)))
        self.off, self.peak = np.zeros((len(self.outputs), len(runs))), np.zeros((len(self.outputs), len(runs)))
        self.known = [i for i, name in enumerate(self.outputs) if name in vehicle.linear_model.states]
        self.meter = None if first is None else Meter([run.vehicle for run in runs], timestep, first)

    def update(self, start: int, values: Array, until: Array, times: Array) -> None:
        """Compares the next block of signals, shape (B, S, N), before the times [s] until which it is linear, shape (N,)."""
        if not self.ideal:
            return
        some = slice(start, start + len(values))
        now, midway = np.moveaxis(self.now[some], 1, 2), np.moveaxis(self.midway[some], 1, 2)
        push, jump = _applied(self.of_now, now) + _applied(self.of_midway, midway), _applied(self.jump, now)
        states = np.empty_like(push)
        with np.errstate(over="ignore", invalid="ignore"):  # an unstable loop overflows; its run says so
            for k in range(len(values)):
                states[k] = self.xi
                self.xi = (self.loop * self.xi).sum(axis=1) + push[k]
            states += jump
            linear = times[-1] < until
            for i in self.known if self.meter is None else range(len(self.outputs)):
                output = states[:, i] if self.meter is None else _row(self.C[i], states) + _row(self.Cr[i], now)
                apart = np.abs(values[:, self.index[i]] - output)
                size = np.abs(output)
                if not linear.all():
                    before = times[:, None] < until
                    apart, size = np.where(before, apart, 0.0), np.where(before, size, 0.0)
                self.off[i] = np.maximum(self.off[i], apart.max(axis=0))
                self.peak[i] = np.maximum(self.peak[i], size.max(axis=0))
                if self.meter is not None:
                    values[:, self.index[i]] = output
            if self.meter is not None:
                self.meter.update(np.clip(values, -DIVERGED, DIVERGED))

    def errors(self) -> Array:
        """Largest difference of any state from its twin, over the twin's peak, shape (N,); NaN where there is no twin."""
        if not self.ideal:
            return np.full(self.off.shape[1], np.nan)
        units = [next(signal.unit for signal in self.signals if signal.name == name) for name in self.outputs]
        worst = np.zeros(self.off.shape[1])
        for i in self.known:
            loudest = np.max([self.peak[j] for j in self.known if units[j] == units[i]], axis=0)
            scale = np.maximum(self.peak[i], SILENT * loudest)
            worst = np.maximum(worst, np.divide(self.off[i], scale, out=np.zeros_like(scale), where=scale > 0))
        return worst

    def metrics(self) -> Mapping[str, Array]:
        """The twin's metrics, where a road that is not random asks for them."""
        return self.meter.result() if self.meter is not None and self.ideal else {}


def _system(vehicle: Vehicle, controller: Controller, timestep: float) -> tuple[Array, ...]:
    """The sampled loop as `sim.linear.loop` has it: xi' = loop xi + of_now z_r + of_midway z_r(h/2), x = xi + jump z_r."""
    model, G = driven(vehicle, controller)
    Phi, Gamma_u, Gamma_r = held_inputs(model.A, timestep, linalg.expm, model.B, model.A @ model.Bw + model.Br)
    return Phi + Gamma_u @ G, Gamma_u @ G @ model.Bw, Gamma_r, model.Bw, model.C + model.D @ G, model.Cr


def _applied(matrix: Array, inputs: Array) -> Array:
    """A matrix per run, shape (n, r, N), on inputs (B, r, N), shape (B, n, N)."""
    total = np.zeros((len(inputs), matrix.shape[0], matrix.shape[2]))
    for i in range(matrix.shape[0]):
        total[:, i] = _row(matrix[i], inputs)
    return total


def _row(row: Array, inputs: Array) -> Array:
    """One row of such a matrix, shape (r, N), on inputs (B, r, N), shape (B, N)."""
    total = np.zeros((len(inputs), row.shape[1]))
    for j in np.flatnonzero(row.any(axis=1)):
        total += row[j] * inputs[:, j]
    return total


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
