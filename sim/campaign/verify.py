"""Verification of finished campaign results: checks the gains and the inputs of every row, and repeats a sample of the runs."""

import json
import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
import pyarrow as pa

from models.common.errors import InputError
from models.common.threads import one_thread
from sim.campaign.batch import run_batch
from sim.campaign.manifest import Gains
from sim.campaign.plan import Plan
from sim.campaign.store import Store

SAME, ROUNDING = 1e-9, 1e-12  # allowed relative and absolute difference between the results of two machines


@one_thread()
def verify(plan: Plan, store: Store, gains: Gains, count: int, seed: int, progress: Callable[[int], None]) -> dict[str, Any]:
    """Checks a finished campaign.

    Args:
        plan: runs of the campaign, with the gains that the results folder contains.
        store: results of the campaign.
        gains: gains that the results folder contains, by vehicle and controller.
        count: number of randomly chosen runs to repeat.
        seed: seed of the random choice of the runs to repeat.
        progress: function that receives the number of runs repeated so far.

    Returns:
        `rows`, the number of rows; `again`, the numbers of the repeated runs; `faults`, a sentence for each error in the
        results.

    Raises:
        InputError: the campaign is not finished.
    """
    if not store.finished:
        raise InputError(
            f"{store.folder}: {store.left} of {plan.count} runs of the campaign are not finished; run the campaign to its "
            "end first"
        )
    try:
        table = store.read(store.schema.names)
    except InputError as error:
        return {"rows": 0, "again": (), "faults": [str(error)]}
    faults = list(_wrong_inputs(plan, table))
    if json.loads((table.schema.metadata or {}).get(b"controllers", "null")) != gains:
        faults.append("the gains in the results differ from the gains in plan.json")
    drawn = np.random.default_rng(seed).choice(plan.count, size=min(count, plan.count), replace=False)
    again = () if faults else tuple(sorted(drawn.tolist()))
    for done, run in enumerate(again, 1):
        (there,) = table.slice(run, 1).to_pylist()
        (row,) = run_batch(plan, run, run + 1) or [{}]
        faults += _differences(f"run {run}", there, row, "in the repeated run")
        progress(done)
    return {"rows": len(table), "again": again, "faults": faults}


def _wrong_inputs(plan: Plan, table: pa.Table) -> Iterator[str]:
    """Yields a sentence if rows are missing, duplicated or in the wrong order; otherwise, yields a sentence about the first row
    with wrong inputs.
    """
    if not np.array_equal(table["run"].to_numpy(), np.arange(plan.count)):
        few = f"the results have {len(table)} rows for {plan.count} runs"
        yield few if len(table) != plan.count else "the rows of the results are not in the order of the runs"
        return
    names = ["vehicle", "controller", "road", "speed", "seed", "sample"]
    names += [name for name in table.schema.names if name == "variant" or name.startswith(("parameter_", "law_"))]
    for batch in table.select(["run", *names]).to_batches(max_chunksize=4096):
        for row in batch.to_pylist():
            run = row.pop("run")
            for wrong in _differences(f"run {run}", row, plan.inputs(run), "in the campaign"):
                yield wrong
                return


def _differences(run: str, there: Mapping[str, Any], now: Mapping[str, Any], where: str) -> Iterator[str]:
    """Yields a sentence if a row of the results differs from the expected values.

    Args:
        run: words that name the run in the sentence.
        there: values in the row that is checked, by column.
        now: expected values of the checked row, by column.
        where: words in the sentence that state where the expected values come from.
    """
    wrong = [name for name, value in there.items() if not _same(value, now.get(name))]
    if wrong:
        name, more = wrong[0], f"; {len(wrong) - 1} more columns differ" if len(wrong) > 1 else ""
        yield f"{run}: {name} is {there[name]!r} in the results, but {now.get(name)!r} {where}{more}"


def _same(there: Any, now: Any) -> bool:
    """Returns True if two cells of the results are equal. Two numbers count as equal if their difference may be due to rounding
    errors on a different machine.
    """
    if isinstance(there, float) and isinstance(now, float):
        return math.isclose(there, now, rel_tol=SAME, abs_tol=ROUNDING)
    return there == now
