"""A batch of a campaign: many runs at once, measured and compared with their sampled twins as they go, one row each."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.printed import finite
from models.kinds.kind import MOST_SQUEEZE
from models.roads.road import RoadInput, track_width
from models.vehicle.limits_and_implementation import Implementation, steps_per_sample
from models.vehicle.vehicle import Vehicle
from sim.campaign.columns import EXPECTED, LINEAR
from sim.campaign.file import Campaign
from sim.campaign.plan import Plan, PlannedRun
from sim.linear.dampers import is_linear
from sim.linear.outputs import forces_ahead
from sim.physics.run_blocks import DIVERGED
from sim.physics.sensor_readout import reads_out
from sim.physics.simulate import MonitoredBatch
from sim.response.regime import DIVERGENCE, END_NAMES, LAW_OVERFLOW, RAN_AWAY
from sim.response.response import SILENT, loudest_alike
from sim.runs.steps import WHEN
from sim.studies.ride.expected import expect, settled
from sim.studies.ride.metrics import Meter
from sim.studies.ride.run_metrics import driven_roughness, roughness_object
from synth.controller.controller import AnyController
from synth.controller.loop_of import HEIGHT, HELD, MIDWAY, READ, SIGNAL, loop_of, named, pushes
from synth.plant.state_space import StateSpace


class ReferenceResponse:
    """Exact linear responses of the runs, sampled as in `sim.linear.sampled_response`, computed beside them and as fast.

    With the state xi before the road jumps, and inputs v, xi' = A xi + sum of B v and y = C xi + sum of D v. Sums run over states
    one by one, as in `sim.physics.simulate`.
    """

    def __init__(self, runs: Sequence[PlannedRun], watched: MonitoredBatch, first: int | None, loaded: bool) -> None:
        """Prepares monitored runs, measured from sample `first` on, as a `Meter` does, or not at all if that is None."""
        vehicle, self.watched, timestep = runs[0].vehicle, watched, watched.timestep
        vehicles = [run.vehicle for run in runs]
        self.outputs, road, held = vehicle.linear_model.outputs, vehicle.linear_model.disturbances, pushes(vehicle.linear_model)
        groups = [(watched.now, named(road, HEIGHT)), (watched.midway, named(road, MIDWAY))]
        if watched.held is not None:
            effects = {HELD: "held", SIGNAL: "in_signals", READ: "in_readings"}
            for ending, values in effects.items():
                groups.append((np.stack([getattr(one, values) for one in watched.inputs], axis=1), named(held, ending)))
        if any(run.controller.preview is not None for run in runs):
            ahead = np.zeros((len(watched.now), len(runs), len(vehicle.linear_model.inputs)))
            for i, (run, on) in enumerate(zip(runs, watched.inputs, strict=True)):
                if (preview := run.controller.preview) is not None:
                    ahead[:, i] = forces_ahead(preview, on, steps_per_sample(on.vehicle.implementation, timestep))
            groups.append((ahead, vehicle.linear_model.inputs))
        made = {run.system: _closed(run.vehicle, run.controller, timestep) for run in runs}
        systems = [made[run.system].part(self.outputs, made[run.system].inputs) for run in runs]
        # By entry of the matrices, runs last: shapes (n, n, N) and (p, n, N); of each input (T, N, r), (n, r, N) and (p, r, N).
        self.A, self.C, B, D = (np.stack([getattr(one, name) for one in systems], axis=-1) for name in "ACBD")
        columns = [systems[0].columns(names) for _, names in groups]
        self.inputs = [(values, B[:, some], D[:, some]) for (values, _), some in zip(groups, columns, strict=True)]
        signals = [signal.name for signal in vehicle.kind.signals]
        self.index = [signals.index(name) for name in self.outputs]
        self.units = [vehicle.kind.signal(name).unit for name in self.outputs]
        self.xi = np.zeros((self.A.shape[0], len(runs)))
        self.off, self.peak = np.zeros((len(self.outputs), len(runs))), np.zeros((len(self.outputs), len(runs)))
        self.states = [i for i, name in enumerate(self.outputs) if name in vehicle.linear_model.states]
        pushed = [run.road.loaded for run in runs]
        self.meter = None if first is None else Meter(vehicles, timestep, first, loaded, pushed, watched.inputs[0].earlier)

    def update(self, start: int, values: Array, until: Array, times: Array) -> None:
        """Compares the next block of signals, shape (B, S, N), before the times [s] until which it is linear, shape (N,)."""
        some = slice(start, start + len(values))
        inputs = [(np.moveaxis(one[some], 1, 2), B, D) for one, B, D in self.inputs]
        push = np.stack([sum(_row(B[i], one) for one, B, _ in inputs) for i in range(len(self.xi))], axis=1)
        states, products = np.empty_like(push), np.empty_like(self.A)
        before, moving = times[:, None] < until, list(self.watched.steady(some))
        with np.errstate(over="ignore", invalid="ignore"):  # an unstable loop overflows; its run says so
            for k in range(len(values)):
                states[k] = self.xi
                np.multiply(self.A, self.xi, out=products)
                np.add.reduce(products, axis=1, out=self.xi)
                self.xi += push[k]
            for i in self.states if self.meter is None else range(len(self.outputs)):
                output = _row(self.C[i], states) + sum(_row(D[i], one) for one, _, D in inputs)
                for run, steady in moving:
                    output[:, run] += steady[:, self.index[i]]
                apart, size = np.abs(values[:, self.index[i]] - output), np.abs(output)
                if not before.all():
                    apart, size = np.where(before, apart, 0.0), np.where(before, size, 0.0)
                self.off[i], self.peak[i] = np.maximum(self.off[i], apart.max(axis=0)), np.maximum(self.peak[i], size.max(axis=0))
                values[:, self.index[i]] = output
            if self.meter is not None:
                self.meter.update(np.clip(values, -DIVERGED, DIVERGED))

    def errors(self) -> Array:
        """Largest difference of any state from its twin, over the twin's peak, shape (N,)."""
        worst = np.zeros(self.off.shape[1])
        loudest = loudest_alike(self.peak[self.states].T, [self.units[i] for i in self.states])
        for k, i in enumerate(self.states):
            scale = np.maximum(self.peak[i], SILENT * loudest[:, k])
            worst = np.maximum(worst, np.divide(self.off[i], scale, out=np.zeros_like(scale), where=scale > 0))
        return worst


def _is_exact(runs: Sequence[PlannedRun]) -> bool:
    """Returns True if a `ReferenceResponse` is that of the runs: of linear laws that act at once on exact signals, or not at all,
    without curves or active forces through adjustable dampers.
    """
    vehicle = runs[0].vehicle
    linear = all(run.controller.linear is True and is_linear(run.vehicle, run.controller) for run in runs)
    silent = not any(run.controller.acts for run in runs)
    return linear and (silent or vehicle.implementation.ideal) and not vehicle.parts.nonlinear


def _closed(vehicle: Vehicle, controller: AnyController, timestep: float) -> StateSpace:
    """Returns the closed loop from step to step, of a law that acts at once or not at all."""
    assert controller.linear is True, "it is linear"
    return loop_of(replace(vehicle, implementation=Implementation()), controller, timestep).closed_loop


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
    campaign, runs, rows = plan.campaign, plan.runs(start, stop), {}
    # Random roads are measured once their start is forgotten, others, a bump, a hump, from the start.
    # Where one controller needs a sensor before the step, signals of all are read so: a rounding that must not depend on company.
    alike: dict[tuple[str, bytes, bool, bool], list[int]] = {}
    for i, run in enumerate(runs):
        of = (run.inputs["controller"], reads_out(run.vehicle, campaign.timestep), run.choice.stationary, bool(run.choice.loads))
        alike.setdefault(of, []).append(i)
    todo = list(alike.values())
    while todo:
        some = todo.pop()
        # A run alone would be summed along another axis than one among others: it gets company.
        pair = some * 2 if len(some) == 1 else some
        results = _drive(plan, [runs[i] for i in pair], stopped)
        if results is None:
            return None
        driven, failed = results
        rows |= {i: {"run": start + i, **row} for i, row in zip(pair, driven, strict=True)}
        # Which runs fail must not depend on the batch: doubtful ones are repeated in halves, until each is alone.
        doubtful = [some[i] for i in failed] if len(some) > 1 else []
        todo += [half for half in (doubtful[::2], doubtful[1::2]) if half]
    return [rows[i] for i in range(len(runs))]


def _drive(plan: Plan, runs: Sequence[PlannedRun], stopped: Callable[[], bool]) -> tuple[Rows, list[int]] | None:
    """Returns the rows of runs of one controller, and the indices of those that may have failed because of another run."""
    campaign, vehicles, time = plan.campaign, [run.vehicle for run in runs], plan.campaign.time
    on = [RoadInput(run.vehicle, run.road, time, campaign.earlier) for run in runs]
    watched = MonitoredBatch([run.controller for run in runs], on)
    random = runs[0].choice.stationary
    first = campaign.first if random else 0
    meter = Meter(vehicles, campaign.timestep, first, campaign.loaded, [run.road.loaded for run in runs], campaign.earlier)
    twin = ReferenceResponse(runs, watched, None if random else first, campaign.loaded) if _is_exact(runs) else None
    for block in watched.blocks():
        if stopped():
            return None
        meter.update(block.values)
        if twin is not None:
            twin.update(block.start, block.values, watched.until, time[block.start : block.start + len(block.values)])

    measured = meter.result()
    if twin is not None and twin.meter is not None:
        measured |= {f"{LINEAR}{name}": each for name, each in twin.meter.result().items()}
    errors = twin.errors() if twin is not None else np.full(len(runs), np.nan)
    expected: dict[Any, dict[str, Any]] = {}
    rows = []
    for i, run in enumerate(runs):
        row = {**run.inputs, **_roughness(plan, run)}
        rows.append(row)
        if i in watched.failures:
            row["reason"] = f"{FAILED}{watched.failures[i].why}"
            continue
        row |= _end(watched, i) | {"linear_error": finite(errors[i])}
        row |= {name: None if row["reason"] is not None else finite(values[i]) for name, values in measured.items()}
        if random:
            key = (*run.system, run.inputs["road"], run.inputs["speed"])
            if key not in expected:
                expected[key] = _expected(campaign, run)
            row |= expected[key]
    return rows, [i for i, failure in watched.failures.items() if failure.together]


def _end(watched: MonitoredBatch, i: int) -> dict[str, Any]:
    """Returns why a run broke off, or None, and when and how its linear regime ended."""
    flat, diverged, overflow = float(watched.ends.flat[i]), float(watched.diverged[i]), bool(watched.ran_away[i])
    reason = None
    if flat < diverged:
        reason = f"flat: a tyre is compressed by more than {MOST_SQUEEZE:g} m at {WHEN.text(flat)}"
    elif overflow:
        reason = f"{LAW_OVERFLOW}: {RAN_AWAY.format(when=WHEN.text(diverged))}"
    elif math.isfinite(diverged):
        reason = f"diverged: a signal is beyond {DIVERGED:g} at {WHEN.text(diverged)}"
    broken = LAW_OVERFLOW if overflow else DIVERGENCE
    ended = float(watched.until[i])
    by = broken if diverged <= watched.ends.first[i] else END_NAMES[watched.ends.which[i]]
    return {
        "reason": reason,
        "diverged_at": None if overflow else finite(diverged),
        "ended_by": by if math.isfinite(ended) else None,
        "ended_at": finite(ended),
    }


def _roughness(plan: Plan, run: PlannedRun) -> dict[str, float]:
    """Returns every IRI of the run's road as far as it is driven, by name; computed once, whatever drives over it."""
    key = (*(run.inputs[name] for name in ("road", "speed", "seed")), track_width(run.vehicle))
    if (kept := plan.roughness.get(key)) is None:
        roughness = roughness_object(driven_roughness(run.vehicle, run.road, plan.campaign.time))
        kept = {name: entry["road"] for name, entry in roughness.items()}
        if len(plan.roughness) >= MOST_ROADS:
            plan.roughness.clear()
        plan.roughness[key] = kept
    return kept


def _expected(campaign: Campaign, run: PlannedRun) -> dict[str, Any]:
    """Returns the columns of a row for expected metrics over a random road, and the remaining transient when measuring begins."""
    spectrum, controller, start = run.road.spectrum, run.controller, float(campaign.time[campaign.first])
    if spectrum is None:
        return {}
    window = (len(campaign.time) - campaign.first) * campaign.timestep
    values: dict[str, Any] = {}
    expected, line = expect(run.vehicle, controller, spectrum, campaign.timestep, window), run.vehicle.linearised
    if expected is not None:
        values = {f"{EXPECTED}{name}": finite(value) for name, value in expected.mean.items()}
        values["expected_error"], line = finite(expected.error), expected.line.vehicle
    if (begun := settled(line, controller, spectrum, campaign.timestep, start)) is not None:
        values |= {"settled": begun.share, "settled_signal": begun.signal}
    return values
