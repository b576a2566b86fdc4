"""Simulation of a batch of a campaign: many runs are simulated together, and each run gives one row of the results.

During the simulation, metrics are computed, and each run is compared with the exact response of the linear sampled loop.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from models.common.extensions import OBSERVERS
from models.common.printed import finite
from models.kinds.kind import MOST_SQUEEZE
from models.roads.road import track_width
from sim.campaign.columns import EXPECTED, LINEAR
from sim.campaign.file import Campaign
from sim.campaign.plan import Plan, PlannedRun
from sim.drive.case import Batch, Case
from sim.drive.drive import StoppedError, drive
from sim.drive.driver import Failure
from sim.drive.loop import DIVERGENCE_LIMIT, Block
from sim.drive.regime import FLAT, LAW_DIVERGED, LAW_OVERFLOW
from sim.observers.ends import Ends, RunEnd
from sim.observers.results import WHEN
from sim.studies.ride.expected import expect, remaining_transient
from sim.studies.ride.metrics import Meter
from sim.studies.ride.run_metrics import driven_roughness, roughness
from synth.controller.controller import is_linear


def _is_exact(runs: Sequence[PlannedRun]) -> bool:
    """Returns True if the linear response that `sim.observers.twin.Twin` computes is exact for the runs.

    The response is exact only for a vehicle without nonlinear springs and dampers, and for linear laws that do not set
    semi-active dampers. The control laws must either work without delay, noise and quantisation, or request no force.
    """
    vehicle = runs[0].vehicle
    linear = all(is_linear(run.controller, run.vehicle) for run in runs)
    silent = not any(run.controller.acts for run in runs)
    return linear and (silent or vehicle.implementation.ideal) and not vehicle.parts.nonlinear


Rows = list[dict[str, Any]]
MOST_ROADS = 4096  # largest number of roads whose IRIs are kept in memory; this is more than the roads of a batch
FAILED_LAW = "law: "  # a failure reason that begins with this text means that the run's Python law has failed


def run_batch(plan: Plan, start: int, stop: int, stopped: Callable[[], bool] = lambda: False) -> Rows | None:
    """Returns the rows of the results for consecutive runs of one vehicle, or None if `stopped` returned True.

    Args:
        plan: all runs of the campaign.
        start, stop: number of the first run, and number of the last run plus 1.
        stopped: function that returns True to abort; called repeatedly during the simulation.
    """
    runs, rows = plan.runs(start, stop), {}
    # On a random road, measurement starts after the time `settle`, when the transient has decayed. On a bump or a hump,
    # measurement starts at the beginning of the run.
    alike: dict[tuple[str, bool, bool], list[int]] = {}
    for i, run in enumerate(runs):
        alike.setdefault((run.inputs["controller"], run.choice.stationary, bool(run.choice.loads)), []).append(i)
    todo = list(alike.values())
    while todo:
        some = todo.pop()
        try:
            driven, failed = _drive(plan, [runs[i] for i in some], stopped)
        except StoppedError:
            return None
        rows |= {i: {"run": start + i, **row} for i, row in zip(some, driven, strict=True)}
        # A run must fail or succeed independently of the other runs in its batch. A run that may have failed because of another
        # run is therefore repeated: the suspect runs are split in halves until each one is simulated alone.
        doubtful = [some[i] for i in failed] if len(some) > 1 else []
        todo += [half for half in (doubtful[::2], doubtful[1::2]) if half]
    return [rows[i] for i in range(len(runs))]


class RowObserver:
    """Observes runs: computes metrics, finds the end of the linear regime, and compares the runs with linear analysis."""

    def __init__(self, plan: Plan, runs: Sequence[PlannedRun], batch: Batch) -> None:
        """Prepares the observer for a batch of runs.

        Args:
            plan: all runs of the campaign.
            runs: runs with the same controller.
            batch: batch that is simulated; the attribute `numbers` contains the indices of the batch's runs in `runs`.
        """
        campaign, runs = plan.campaign, [runs[i] for i in batch.numbers]
        random, loaded = runs[0].choice.stationary, [run.road.loaded for run in runs]
        speeds = [run.road.speed for run in runs]

        def meter(first: int) -> Meter:
            return Meter(batch.vehicles, campaign.timestep, first, campaign.loaded, loaded, campaign.earlier, speeds)

        first = campaign.first if random else 0
        self._meter, self._ends = meter(first), Ends(batch)
        twin = OBSERVERS.load_if_known("twin") if _is_exact(runs) else None
        self._linear = None if twin is None or random else meter(first)
        self._twin = None if twin is None else twin(batch, self._ends, self._linear)

    def take(self, block: Block) -> None:
        """Evaluates the next block of time steps of all runs."""
        self._ends.take(block)
        self._meter.update(block.values)
        if self._twin is not None:
            self._twin.take(block)

    def result(self) -> list[tuple[RunEnd, dict[str, Any]]]:
        """Returns, for each run, the end of the linear regime and the result columns that contain the metrics."""
        ends, measured = self._ends.result(), self._meter.result()
        if self._linear is not None:
            measured |= {f"{LINEAR}{name}": each for name, each in self._linear.result().items()}
        errors = [math.nan] * len(ends) if self._twin is None else self._twin.result()
        rows = [{name: finite(values[i]) for name, values in measured.items()} for i in range(len(ends))]
        return [
            (end, {"linear_error": finite(error)} | (row if end.broke_off is None else dict.fromkeys(row)))
            for end, error, row in zip(ends, errors, rows, strict=True)
        ]


def _drive(plan: Plan, runs: Sequence[PlannedRun], stopped: Callable[[], bool]) -> tuple[Rows, list[int]]:
    """Simulates runs with the same controller.

    Returns:
        Rows of the results, and the indices of failed runs whose failure may have been caused by a different run.

    Raises:
        StoppedError: `stopped` returned True.
    """
    campaign, failures = plan.campaign, dict[int, Failure]()
    cases = [Case(run.vehicle, run.controller, run.road, earlier=campaign.earlier) for run in runs]
    observer = partial(RowObserver, plan, runs)
    (results,) = drive(cases, campaign.time, observer, streamed=True, failures=failures, stopped=stopped)
    expected: dict[Any, dict[str, Any]] = {}
    rows = []
    for i, (run, (end, measured)) in enumerate(zip(runs, results, strict=True)):
        row = {**run.inputs, **_roughness(plan, run)}
        rows.append(row)
        if i in failures:
            row["reason"] = f"{FAILED_LAW}{failures[i].why}"
            continue
        row |= end_columns(end) | measured
        if run.choice.stationary:
            key = (*run.system, run.inputs["road"], run.inputs["speed"])
            if key not in expected:
                expected[key] = _expected_columns(campaign, run)
            row |= expected[key]
    return rows, [i for i, failure in failures.items() if failure.together]


def end_columns(end: RunEnd) -> dict[str, Any]:
    """Returns the columns that state when and why a run's linear regime ended, and why the run was aborted (None if it
    finished).
    """
    reason = None
    if end.broke_off == FLAT.name:
        reason = f"flat: a tyre is compressed by more than {MOST_SQUEEZE:g} m at {WHEN.text(end.flat)}"
    elif end.broke_off == LAW_OVERFLOW:
        reason = f"{LAW_OVERFLOW}: {LAW_DIVERGED.format(when=WHEN.text(end.diverged))}"
    elif end.broke_off is not None:
        reason = f"diverged: a signal is beyond {DIVERGENCE_LIMIT:g} at {WHEN.text(end.diverged)}"
    return {
        "reason": reason,
        "diverged_at": None if end.law_diverged else finite(end.diverged),
        "ended_by": end.by,
        "ended_at": finite(end.until),
    }


def _roughness(plan: Plan, run: PlannedRun) -> dict[str, float]:
    """Returns the international roughness indices (IRI) of the driven part of a run's road [m/km], by name.

    `plan` stores the roughness indices, so that they are not computed again for other runs over the same road.
    """
    key = (*(run.inputs[name] for name in ("road", "speed", "seed")), track_width(run.vehicle))
    if (kept := plan.roughness.get(key)) is None:
        named = roughness(driven_roughness(run.vehicle, run.road, plan.campaign.time))
        kept = {name: entry["road"] for name, entry in named.items()}
        if len(plan.roughness) >= MOST_ROADS:
            plan.roughness.clear()
        plan.roughness[key] = kept
    return kept


def _expected_columns(campaign: Campaign, run: PlannedRun) -> dict[str, Any]:
    """Returns the result columns for a run over a random road: expected metrics, and the transient that remains when
    measurement starts.

    No columns are returned if the road has no spectrum.
    """
    spectrum, controller, start = run.road.spectrum, run.controller, float(campaign.time[campaign.first])
    if spectrum is None:
        return {}
    window = (len(campaign.time) - campaign.first) * campaign.timestep
    values: dict[str, Any] = {}
    expected, line = expect(run.vehicle, controller, spectrum, campaign.timestep, window), run.vehicle.linearised
    if expected is not None:
        values = {f"{EXPECTED}{name}": finite(value) for name, value in expected.mean.items()}
        values["expected_error"], line = finite(expected.error), expected.line.vehicle
    if (begun := remaining_transient(line, controller, spectrum, campaign.timestep, start)) is not None:
        values |= {"settled": begun.share, "settled_signal": begun.signal}
    return values
