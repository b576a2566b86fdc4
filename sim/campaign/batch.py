"""A batch of a campaign: many runs at once, measured and compared with their sampled twins as they go, one row each."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.common.printed import finite
from models.kinds.kind import MOST_SQUEEZE
from models.roads.choice import RoadChoice
from models.roads.road import RoadInput, track_width
from models.vehicle.vehicle import Vehicle
from sim.campaign.columns import EXPECTED, LINEAR
from sim.campaign.file import Campaign
from sim.campaign.plan import Plan, PlannedRun
from sim.campaign.samples import with_sample
from sim.linear.dampers import is_linear
from sim.linear.sampled_response import readings_of_loads
from sim.physics.drivers import preview_forces
from sim.physics.run_blocks import DIVERGED
from sim.physics.sensor_readout import reads_out
from sim.physics.simulate import MonitoredBatch
from sim.response.regime import DIVERGENCE, END_NAMES, LAW_OVERFLOW, RAN_AWAY
from sim.response.response import SILENT
from sim.studies.ride.expected import Expected, Settled, expect, settled
from sim.studies.ride.metrics import Meter
from sim.studies.ride.run_metrics import driven_roughness, roughness_object
from synth.controller.controller import Controller
from synth.controller.open_loop import sampled
from synth.plant.discrete import held_inputs


class ReferenceResponse:
    """Exact linear responses of the runs, sampled as in `sim.linear.sampled_response`, computed beside them and as fast.

    Sums run over states one by one, as in `sim.physics.simulate`.
    """

    def __init__(self, runs: Sequence[PlannedRun], watched: MonitoredBatch, first: int | None, loaded: bool) -> None:
        """Prepares monitored runs, measured from sample `first` on, as a `Meter` does, or not at all if that is None."""
        vehicle, self.watched = runs[0].vehicle, watched
        self.signals, self.now, self.midway, self.loads = vehicle.kind.signals, watched.now, watched.midway, watched.held
        heights = np.concatenate([watched.now, watched.beyond]) if len(watched.beyond) else watched.now
        controllers, vehicles = [run.controller for run in runs], [run.vehicle for run in runs]
        self.ahead = preview_forces(controllers, vehicles, heights, watched.timestep, len(watched.now))
        timestep = watched.timestep
        systems: dict[Any, Any] = {}
        for run in runs:
            if run.system not in systems:
                assert isinstance(run.controller, Controller), "it is linear"
                systems[run.system] = _system(run.vehicle, run.controller, timestep)
        # By entry of the matrices, runs last: shapes (n, n, N), (n, r, N), (n, r, N), (n, r, N), (p, n, N), (p, r, N); of loads
        # (n, l, N), (n, l, N), (p, l, N), (p, l, N); and of forces from the road ahead (n, m, N), (p, m, N).
        self.loop, self.of_now, self.of_midway, self.jump, self.C, self.Cr, *of_loads, self.of_ahead, self.D = (
            np.stack([systems[run.system][i] for run in runs], axis=-1) for i in range(12)
        )
        self.of_loads, self.of_felt, self.Dl, self.D_felt = of_loads
        self.outputs = vehicle.linear_model.outputs
        place = [signal.name for signal in self.signals]
        self.index = [place.index(name) for name in self.outputs]
        self.xi = np.zeros((self.loop.shape[0], len(runs)))
        self.off, self.peak = np.zeros((len(self.outputs), len(runs))), np.zeros((len(self.outputs), len(runs)))
        self.known = [i for i, name in enumerate(self.outputs) if name in vehicle.linear_model.states]
        pushed = [run.road.loaded for run in runs]
        self.meter = None if first is None else Meter([run.vehicle for run in runs], timestep, first, loaded, pushed)

    def update(self, start: int, values: Array, until: Array, times: Array) -> None:
        """Compares the next block of signals, shape (B, S, N), before the times [s] until which it is linear, shape (N,)."""
        some = slice(start, start + len(values))
        now, midway = np.moveaxis(self.now[some], 1, 2), np.moveaxis(self.midway[some], 1, 2)
        push, jump = _applied(self.of_now, now) + _applied(self.of_midway, midway), _applied(self.jump, now)
        loads = felt = None
        if self.loads is not None:  # an acceleration is measured before a new load acts
            before = self.loads[start - 1 : start] if start else np.zeros_like(self.loads[:1])
            loads, felt = (np.moveaxis(one, 1, 2) for one in (self.loads[some], np.concatenate([before, self.loads[some]])[:-1]))
            push += _applied(self.of_loads, loads) + _applied(self.of_felt, felt)
        forces = None if self.ahead is None else np.moveaxis(self.ahead[some], 1, 2)
        if forces is not None:
            push += _applied(self.of_ahead, forces)
        states, products = np.empty_like(push), np.empty_like(self.loop)
        with np.errstate(over="ignore", invalid="ignore"):  # an unstable loop overflows; its run says so
            for k in range(len(values)):
                states[k] = self.xi
                np.multiply(self.loop, self.xi, out=products)
                np.add.reduce(products, axis=1, out=self.xi)
                self.xi += push[k]
            states += jump
            linear, moving = times[-1] < until, list(self.watched.steady(some))
            for i in self.known if self.meter is None else range(len(self.outputs)):
                output = states[:, i] if self.meter is None else _row(self.C[i], states) + _row(self.Cr[i], now)
                if self.meter is not None and loads is not None and felt is not None:
                    output = output + _row(self.Dl[i], loads) + _row(self.D_felt[i], felt)
                if self.meter is not None and forces is not None:
                    output = output + _row(self.D[i], forces)
                for run, steady in moving:
                    output[:, run] += steady[:, self.index[i]]
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
        """Largest difference of any state from its twin, over the twin's peak, shape (N,)."""
        units = [next(signal.unit for signal in self.signals if signal.name == name) for name in self.outputs]
        worst = np.zeros(self.off.shape[1])
        for i in self.known:
            loudest = np.max([self.peak[j] for j in self.known if units[j] == units[i]], axis=0)
            scale = np.maximum(self.peak[i], SILENT * loudest)
            worst = np.maximum(worst, np.divide(self.off[i], scale, out=np.zeros_like(scale), where=scale > 0))
        return worst

    def metrics(self) -> Mapping[str, Array]:
        """The twin's metrics, where a road that is not random asks for them."""
        return self.meter.result() if self.meter is not None else {}


def _is_exact(runs: Sequence[PlannedRun]) -> bool:
    """Returns True if a `ReferenceResponse` is that of the runs: of linear laws that act at once on exact signals, or not at all,
    without curves or active forces through adjustable dampers.
    """
    vehicle = runs[0].vehicle
    linear = all(isinstance(run.controller, Controller) and is_linear(run.vehicle, run.controller) for run in runs)
    silent = not any(isinstance(run.controller, Controller) and run.controller.law.acts for run in runs)
    return linear and (silent or vehicle.implementation.ideal) and not vehicle.is_curved


def _system(vehicle: Vehicle, controller: Controller, timestep: float) -> tuple[Array, ...]:
    """The sampled loop as in `sim.linear.sampled_response`: xi' = loop xi + of_now z_r + of_midway z_r(h/2), x = xi + jump
    z_r.

    Loads f add of_loads f, and of_felt times those of the step before, by way of measured accelerations; so do they to outputs.
    """
    cut = sampled(vehicle, controller, timestep)
    model, G = cut.model, cut.inputs(cut.asked)
    felt = cut.inputs(*np.split(readings_of_loads(cut, controller), [cut.forces]))
    Phi, Gamma_u, Gamma_r = held_inputs(model.A, timestep, linalg.expm, model.B, model.A @ model.jump + model.Br)
    Gamma_l = held_inputs(model.A, timestep, linalg.expm, model.Bh)[1]
    of_road = (Gamma_u @ G @ model.jump, Gamma_r, model.jump, model.C + model.D @ G, model.Cr)
    asked = cut.inputs(np.eye(cut.forces), np.zeros((len(cut.hold), cut.forces)))
    of_loads = (Gamma_l, Gamma_u @ felt, model.Dh, model.D @ felt)
    return Phi + Gamma_u @ G, *of_road, *of_loads, Gamma_u @ asked, model.D @ asked


def _applied(matrix: Array, inputs: Array) -> Array:
    """A matrix per run, shape (n, r, N), on inputs (B, r, N), shape (B, n, N)."""
    total = np.zeros((len(inputs), matrix.shape[0], matrix.shape[2]))
    for i in range(matrix.shape[0]):
        total[:, i] = _row(matrix[i], inputs)
    return total


def _row(row: Array, inputs: Array) -> Array:
    """Returns the product of a row of such a matrix, shape (r, N), and inputs (B, r, N), shape (B, N)."""
    total = np.zeros((len(inputs), row.shape[1]))
    for j in np.flatnonzero(row.any(axis=1)):
        total += row[j] * inputs[:, j]
    return total


Rows = list[dict[str, Any]]
MOST_ROADS = 4096  # whose IRIs are kept; more than a batch has
FAILED = "law: "  # how the reason begins why a run's law in Python has failed


def run_batch(plan: Plan, start: int, stop: int, stopped: Callable[[], bool] = lambda: False) -> Rows | None:
    """Returns the rows of some runs of one vehicle, or None if stopped.

    Args:
        stopped: function that returns True to abort; called from time to time.
    """
    keys = [plan.key(run) for run in range(start, stop)]
    campaign, rows = plan.campaign, {}
    name = list(campaign.vehicles)[keys[0].vehicle]
    sampled = {i: with_sample(campaign.vehicles[name], campaign.samples[name][i]) for i in {key.sample for key in keys}}
    # Random roads are measured once their start is forgotten, others, a bump, a hump, from the start.
    # Where one controller needs a sensor before the step, signals of all are read so: a rounding that must not depend on company.
    alike: dict[tuple[int, bytes, bool], list[int]] = {}
    for i, key in enumerate(keys):
        of = (key.controller, reads_out(sampled[key.sample], campaign.timestep), campaign.roads[key.road].stationary)
        alike.setdefault(of, []).append(i)
    for group in alike.values():
        todo = [group]
        while todo:
            some = todo.pop()
            # A run alone would be summed along another axis than one among others: it gets company.
            pair = some * 2 if len(some) == 1 else some
            runs = [PlannedRun(plan, keys[i], sampled[keys[i].sample]) for i in pair]
            results = _drive(campaign, runs, stopped)
            if results is None:
                return None
            rows |= {i: {"run": start + i, **row} for i, row in zip(pair, results.rows, strict=True)}
            # Which runs fail must not depend on the batch: doubtful ones are repeated in halves, until each is alone.
            doubtful = [some[i] for i in results.doubtful] if len(some) > 1 else []
            todo += [half for half in (doubtful[::2], doubtful[1::2]) if half]
    return [rows[i] for i in range(len(keys))]


@dataclass(frozen=True)
class _BatchRows:
    """Rows of runs, and the indices of those that may have failed because of another run."""

    rows: Rows
    doubtful: list[int]


def _drive(campaign: Campaign, runs: Sequence[PlannedRun], stopped: Callable[[], bool]) -> _BatchRows | None:
    vehicles, time = [run.vehicle for run in runs], campaign.time
    on = [RoadInput(run.vehicle, run.road, time) for run in runs]
    watched = MonitoredBatch([run.controller for run in runs], on)
    random = runs[0].choice.stationary
    first = campaign.first if random else 0
    meter = Meter(vehicles, campaign.timestep, first, campaign.loaded, [run.road.loaded for run in runs])
    twin = ReferenceResponse(runs, watched, None if random else first, campaign.loaded) if _is_exact(runs) else None
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
        inputs = {**run.inputs, **_roughness(campaign, run)}
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
            else f"{LAW_OVERFLOW}: {RAN_AWAY.format(when=diverged[i])}"
            if watched.ran_away[i]
            else f"diverged: a signal is beyond {DIVERGED:g} at {diverged[i]:.4g} s"
            if broken
            else None
        )
        absent = row["reason"] is not None
        row["diverged_at"] = float(diverged[i]) if broken and not watched.ran_away[i] else None
        last = LAW_OVERFLOW if watched.ran_away[i] else DIVERGENCE
        row["ended_by"] = None if np.isinf(ended) else last if diverged[i] <= ends.first[i] else END_NAMES[ends.which[i]]
        row["ended_at"] = float(ended) if np.isfinite(ended) else None
        row["linear_error"] = finite(errors[i])
        row |= {name: None if absent else finite(values[i]) for name, values in measured.items()}
        row |= {f"{LINEAR}{name}": None if absent else finite(values[i]) for name, values in linear.items()}
        if run.choice.stationary:
            row |= expected(run)
        rows.append(row)
    return _BatchRows(rows, [i for i, failure in watched.failures.items() if failure.together])


def _roughness(campaign: Campaign, run: PlannedRun) -> dict[str, float]:
    """Returns every IRI of the run's road as far as it is driven, by name; computed once, whatever drives over it."""
    kept = _kept_roughness(campaign, run.choice, track_width(run.vehicle), run.speed, run.seed)
    if not kept:
        roughness = roughness_object(driven_roughness(run.vehicle, run.road, campaign.time))
        kept.append({name: entry["road"] for name, entry in roughness.items()})
    return kept[0]


@lru_cache(maxsize=MOST_ROADS)
def _kept_roughness(campaign: Campaign, choice: RoadChoice, width: float, speed: float, seed: int) -> list[dict[str, float]]:
    """Returns a list for the IRIs of a road on tracks this far apart [m], empty at first: the cache keeps no road alive."""
    return []


class _Expectations:
    """Cache of expected metrics over random roads, and of remaining transients when measuring begins."""

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
            (key, expected.line.vehicle) if expected is not None and expected.line.rounds else (of, run.vehicle.linearised)
        )
        if where not in self.begun:
            self.begun[where] = settled(linear, controller, spectrum, c.timestep, float(c.time[c.first]))
        begun = self.begun[where]
        values: dict[str, Any] = {}
        if expected is not None:
            values |= {f"{EXPECTED}{name}": finite(value) for name, value in expected.mean.items()}
            values["expected_error"] = finite(expected.error)
        if begun is not None:
            values |= {"settled": begun.share, "settled_signal": begun.signal}
        return values
