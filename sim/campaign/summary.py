"""What a campaign came to: controllers against roads, each number beside its linear prediction."""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.numbers import cell
from models.common.printed import table
from models.own.python_law import Programmed
from sim.campaign.batch import FAILED
from sim.campaign.columns import EXPECTED, LINEAR
from sim.campaign.plan import Plan
from sim.campaign.store import Store
from sim.ride.metrics import dynamic_load, points

INPUTS = ("vehicle", "controller", "road", "speed")


def headlines(plan: Plan, vehicle: str) -> dict[str, tuple[str, ...]]:
    """The metrics of the table, each the worst of some columns: ride, travel, and dynamic load."""
    where = points(plan.campaign.vehicles[vehicle])
    return {
        "ride": tuple(f"{name}_weighted" for name in where.accelerations),
        "travel": tuple(f"{name}_rms" for name in where.suspensions),
        "load": tuple(dynamic_load(name) for name in where.tyres),
    }


UNITS = {"ride": "m/s2", "travel": "m", "load": "-"}


def summarise(plan: Plan, store: Store) -> list[dict[str, Any]]:
    """One entry per vehicle, road, speed and controller of what is there, over its samples and seeds.

    Each headline is of the column that is worst, and has its root mean square and 95th percentile over runs, and the root mean
    square of what is predicted of the same runs: expected over random roads, the linear response over others. A run counts as
    having left the linear regime where a tyre lifted, a stop was reached, an actuator saturated, or it broke off, diverged or on
    a flat tyre; one that broke off has no metrics, and neither it nor its prediction counts. Of a law in Python nothing is
    predicted; a run whose law failed has no metrics, either.
    """
    lines = {name: headlines(plan, name) for name in plan.campaign.vehicles}
    metrics = list(dict.fromkeys(name for kinds in lines.values() for names in kinds.values() for name in names))
    predicted = [f"{prefix}{name}" for name in metrics for prefix in (EXPECTED, LINEAR)]
    table = store.read([*INPUTS, "ended_by", "reason", *metrics, *predicted])
    # Dictionary-encoded, so that rows are compared by number.
    codes = np.zeros(len(table), dtype=np.int64)
    values: list[list[Any]] = []
    for name in INPUTS:
        column = table[name].combine_chunks().dictionary_encode()
        values.append(column.dictionary.to_pylist())
        codes = codes * max(1, len(values[-1])) + column.indices.to_numpy(zero_copy_only=False)
    ended = ~table["ended_by"].is_null().to_numpy()
    reasons: list[str | None] = table["reason"].to_pylist()
    failed = np.array([reason is not None and reason.startswith(FAILED) for reason in reasons], dtype=bool)
    broken = ~table["reason"].is_null().to_numpy() & ~failed
    columns = {name: table[name].to_numpy() for name in (*metrics, *predicted)}
    order = {road.text: i for i, road in enumerate(plan.campaign.roads)}

    found = []
    by_code = np.argsort(codes, kind="stable")
    first = np.flatnonzero(np.diff(codes[by_code], prepend=-1))
    for some in np.split(by_code, first[1:]) if len(first) else []:
        where, rest = [], int(codes[some[0]])
        for names in reversed(values):
            rest, index = divmod(rest, max(1, len(names)))
            where.append(names[index])
        entry: dict[str, Any] = dict(zip(INPUTS, reversed(where), strict=True))
        entry |= {"runs": len(some), "left": int(ended[some].sum()), "broke_off": int(broken[some].sum())}
        if isinstance(law := plan.controllers[entry["vehicle"]][entry["controller"]], Programmed):
            why = [reason.removeprefix(FAILED) for i in some[failed[some]].tolist() if (reason := reasons[i])]
            entry |= {"law": law.law.law, "failed": len(why), "first_failure": why[0] if why else None}
        for line, names in lines[entry["vehicle"]].items():
            entry[line] = _statistics(columns, names, some)
        found.append(entry)
    vehicles, controllers = list(plan.campaign.vehicles), plan.campaign.controllers
    found.sort(key=lambda e: (vehicles.index(e["vehicle"]), order[e["road"]], e["speed"], controllers.index(e["controller"])))
    return found


def _statistics(columns: Mapping[str, Array], names: Sequence[str], some: Array) -> dict[str, Any]:
    """Of the worst of some columns over those runs that have metrics: root mean square, 95th percentile, and predicted.

    A kind of vehicle may have no such column, as one without a suspension has no travel.
    """
    there = some[np.all([np.isfinite(columns[name][some]) for name in names], axis=0)] if names else some[:0]
    if not len(there):
        return {"column": None, "rms": None, "p95": None, "predicted": None}
    rms = {name: _rms(columns[name][there]) for name in names}
    worst = max(names, key=lambda name: rms[name])
    # A run over a random road has an expectation, one over another road its own linear response.
    predicted = [columns[f"{prefix}{worst}"][there] for prefix in (EXPECTED, LINEAR)]
    known = next((values for values in predicted if np.isfinite(values).all()), None)
    return {
        "column": worst,
        "rms": rms[worst],
        "p95": float(np.percentile(columns[worst][there], 95)),
        "predicted": None if known is None else _rms(known),
    }


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def summary_lines(entries: Sequence[Mapping[str, Any]]) -> list[str]:
    """The table."""
    lines: list[str] = []
    places = itertools.groupby(entries, lambda entry: (entry["vehicle"], entry["road"], entry["speed"]))
    for (vehicle, road, speed), here in places:
        every = list(here)
        counted = {"runs": "runs", "left": "left linear"}
        counted |= {"broke_off": "broke off"} if any(entry["broke_off"] for entry in every) else {}
        counted |= {"failed": "failed"} if any(entry.get("failed") for entry in every) else {}
        rows: list[tuple[str, ...] | str] = [("", "rms", "95 %", "predicted", *counted.values())]
        for name, unit in UNITS.items():
            rows.append(f"{name} [{unit}]")
            for entry in every:
                numbers = (cell(entry[name][key], ".4g") for key in ("rms", "p95", "predicted"))
                rows.append((f"  {entry['controller']}", *numbers, *(str(entry.get(key, 0)) for key in counted)))
        lines += ["", f"{vehicle} over {road} at {speed:g} m/s", *table(rows), *_law_lines(every)]
    return lines


def _law_lines(entries: Sequence[Mapping[str, Any]]) -> list[str]:
    """What there is to say of laws in Python, a sentence each."""
    lines = []
    for entry in entries:
        if "law" in entry:
            said = f"{entry['controller']} is a law in Python, {entry['law']}: no linear claim, so nothing is predicted of it"
            if entry["failed"]:
                said += f"; {entry['failed']} of {entry['runs']} runs failed, the first: {entry['first_failure']}"
            lines.append(f"  {said}")
    return lines
