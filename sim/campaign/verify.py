"""Verification of a finished campaign's results: every row's inputs, and a sample of runs driven again."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.threads import one_thread
from models.laws.linear import LinearLaw, law_of
from sim.campaign.batch import run_batch
from sim.campaign.manifest import FaultError, Gains, gains_of
from sim.campaign.plan import Plan
from sim.campaign.store import Store
from synth.vehicle.designer import Designer

SAME_GAIN = 1e-9  # relative: how far rounding on another machine may move a designed gain
SAME_RESPONSE = 1e-6  # and a response of one with states, whose coordinates cost digits
FREQUENCIES = 100
ASIDE = 0.987  # so that none is that of a pole which stands on the axis


@dataclass(frozen=True)
class Verified:
    """Result of a verification.

    Attributes:
        rows: number of rows.
        again: the runs that were driven again.
        faults: differences, in words; empty if there are no faults.
        left_out: number of drawn runs that were not repeated, because of a law in Python whose execution was not requested.
    """

    rows: int
    again: tuple[int, ...]
    faults: tuple[str, ...]
    left_out: int = 0


@one_thread()
def verify(plan: Plan, store: Store, count: int, seed: int, own: bool, progress: Callable[[int], None]) -> Verified:
    """Checks a finished campaign.

    Args:
        plan: plan with the runs, and the gains in the campaign's folder.
        count: number of runs that are driven again.
        own: True to run laws in Python.
        progress: callback that receives the number of finished runs.

    Raises:
        InputError: the campaign is not finished.
        FaultError: the results of the campaign are not a Parquet file.
    """
    if not store.finished:
        left = sum(stop - start for start, stop in store.missing())
        raise InputError(f"{store.folder}: {left} of {plan.count} runs are not there yet; run the campaign to its end first")
    try:
        table = store.read(store.schema.names)
    except (pa.ArrowException, OSError, KeyError) as error:
        raise FaultError(f"results {store.results}: cannot be read as Parquet ({error}); restore it") from error
    faults = [*_gains(plan), *_shape(plan, table)]
    again: list[int] = []
    left_out = 0
    if not faults:
        faults += _inputs(plan, table)
        drawn = np.random.default_rng(seed).choice(plan.count, size=min(count, plan.count), replace=False)
        for run in sorted(drawn.tolist()):
            if plan.programmed(run) and not own:
                left_out += 1
                continue
            rows = run_batch(plan, run, run + 1)
            expected = pa.Table.from_pylist(rows or [], schema=store.schema)
            faults += _differences(run, table.slice(run, 1).to_pylist()[0], expected.to_pylist()[0])
            again.append(run)
            progress(len(again))
    return Verified(len(table), tuple(again), tuple(faults), left_out)


def _gains(plan: Plan) -> list[str]:
    """Designed gains that a design, made now, does not confirm."""
    faults, gains = [], gains_of(plan.controllers)
    for name, vehicle in plan.campaign.vehicles.items():
        designer = Designer(vehicle, search=False)
        linear = [one for one in plan.campaign.controllers if one in vehicle.linear_names]
        now: Gains = gains_of({name: {one: designer.design(one) for one in linear}})
        for one, entry in now[name].items():
            if not _same_law(gains[name][one], entry):
                faults.append(f"controller {one} of {name} is not the one that the vehicle file makes")
    return faults


def _same_law(there: Mapping[str, Any], here: Mapping[str, Any]) -> bool:
    """Returns True if two entries of `gains_of` measure the same and respond the same to rounding, in any coordinates of their
    states.
    """
    if {*there} - {"code"} != {*here} or there["measured"] != here["measured"]:
        return False
    one, two = law_of(there), law_of(here)
    if _made(one) != _made(two):
        return False
    if not _near(one.D, two.D, SAME_GAIN) or not _same_preview(there, here):
        return False
    return not two.states or all(_near(one.response(omega), two.response(omega), SAME_RESPONSE) for omega in _asked(two))


def _same_preview(there: Mapping[str, Any], here: Mapping[str, Any]) -> bool:
    """Returns True if both answer the road ahead alike, to rounding, or neither does."""
    if "preview" not in here:
        return "preview" not in there
    from models.laws.preview import preview_of

    one, two = preview_of(there), preview_of(here)
    return one is not None and two is not None and one.difference(two) <= SAME_RESPONSE


def _made(law: LinearLaw) -> tuple[object, ...]:
    """Returns the properties of a law, except its numbers, that are equal bit for bit if two laws are the same."""
    return law.D.shape, law.states, law.sample_period, law.anti_windup


def _near(one: Array, two: Array, share: float) -> bool:
    return bool(np.all(np.abs(one - two) <= share * np.abs(two).max(initial=0.0)))


def _asked(law: LinearLaw) -> list[float]:
    """Frequencies at which two dynamic controllers are compared [rad/s], from below its slowest pole to above its fastest."""
    poles = np.linalg.eigvals(law.A)
    if law.sample_period is None:
        rates = np.abs(poles)
        fastest, slowest = float(rates.max(initial=0.0)) or 1.0, float(rates[rates > 0].min(initial=1.0))
        return np.geomspace(ASIDE * slowest / 10, 10 * fastest, FREQUENCIES).tolist()
    return (np.geomspace(1e-4, 1.0, FREQUENCIES) * ASIDE * np.pi / law.sample_period).tolist()


def _shape(plan: Plan, table: pa.Table) -> list[str]:
    """Checks that there is one row per run, in order."""
    if len(table) != plan.count:
        return [f"{len(table)} rows for {plan.count} runs"]
    if not np.array_equal(table["run"].to_numpy(), np.arange(plan.count)):
        return ["the rows are not one a run, in their order"]
    return []


def _inputs(plan: Plan, table: pa.Table) -> list[str]:
    """Rows whose vehicle, controller, road, speed, seed or sample is not that of their run."""
    names = ["vehicle", "controller", "road", "speed", "seed", "sample"]
    names += [name for name in table.schema.names if name == "variant" or name.startswith(("parameter_", "law_"))]
    for batch in table.select(["run", *names]).to_batches(max_chunksize=4096):
        for row in batch.to_pylist():
            run = row.pop("run")
            expected = plan.inputs(plan.key(run))
            for name, value in row.items():
                if value != expected.get(name):
                    return [f"run {run}: {name} is {value!r}, and {expected.get(name)!r} in the campaign"]
    return []


def _differences(run: int, there: dict[str, Any], again: dict[str, Any]) -> list[str]:
    wrong = [name for name, value in again.items() if there[name] != value]
    if not wrong:
        return []
    name = wrong[0]
    more = f", and {len(wrong) - 1} more columns" if len(wrong) > 1 else ""
    return [f"run {run}: {name} is {there[name]!r}, and {again[name]!r} when driven again{more}"]
