"""What a campaign came to: controllers against roads, each number beside its linear prediction."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from models.arrays import Array
from sim.campaign_batch import EXPECTED, Plan
from sim.campaign_store import Store
from sim.metrics import dynamic_load, points

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

    Each headline has the mean and the 95th percentile over runs, and the mean of the linear predictions. A run counts as having
    left the linear regime where a tyre lifted, a stop was reached, an actuator saturated, or it diverged; one that diverged has
    no metrics.
    """
    lines = {name: headlines(plan, name) for name in plan.campaign.vehicles}
    metrics = list(dict.fromkeys(name for kinds in lines.values() for names in kinds.values() for name in names))
    predicted = [f"{EXPECTED}{name}" for name in metrics]
    table = store.read([*INPUTS, "ended_by", "reason", *metrics, *predicted])
    # Dictionary-encoded, so that rows are compared by number.
    codes = np.zeros(len(table), dtype=np.int64)
    values: list[list[Any]] = []
    for name in INPUTS:
        column = table[name].combine_chunks().dictionary_encode()
        values.append(column.dictionary.to_pylist())
        codes = codes * max(1, len(values[-1])) + column.indices.to_numpy(zero_copy_only=False)
    ended, broken = (~table[name].is_null().to_numpy() for name in ("ended_by", "reason"))
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
        entry |= {"runs": len(some), "left": int(ended[some].sum()), "diverged": int(broken[some].sum())}
        for line, names in lines[entry["vehicle"]].items():
            entry[line] = _statistics(columns, names, some)
        found.append(entry)
    vehicles, controllers = list(plan.campaign.vehicles), plan.campaign.controllers
    found.sort(key=lambda e: (vehicles.index(e["vehicle"]), order[e["road"]], e["speed"], controllers.index(e["controller"])))
    return found


def _statistics(columns: Mapping[str, Array], names: Sequence[str], some: Array) -> dict[str, float | None]:
    """Of the worst of some columns over some runs: mean, 95th percentile, and mean prediction."""
    measured, predicted = (np.max([columns[f"{prefix}{name}"][some] for name in names], axis=0) for prefix in ("", EXPECTED))
    measured, predicted = (values[np.isfinite(values)] for values in (measured, predicted))
    return {
        "mean": float(measured.mean()) if len(measured) else None,
        "p95": float(np.percentile(measured, 95)) if len(measured) else None,
        "predicted": float(predicted.mean()) if len(predicted) else None,
    }


def summary_lines(entries: Sequence[Mapping[str, Any]]) -> list[str]:
    """The table."""
    heads = ("mean", "95 %", "linear")
    title = "".join(f"{f'{name} [{UNITS[name]}]':>30}" for name in UNITS)
    width = max([len(str(entry["controller"])) for entry in entries] + [10])
    lines, before = [], None
    for entry in entries:
        where = (entry["vehicle"], entry["road"], entry["speed"])
        if where != before:
            lines += ["", f"{entry['vehicle']} over {entry['road']} at {entry['speed']:g} m/s"]
            lines += [f"  {'':{width}}{'':>8}{title}{'left linear':>14}"]
            lines += [f"  {'controller':{width}}{'runs':>8}" + "".join(f"{head:>10}" for head in heads * len(UNITS))]
            before = where
        cells = "".join(_cell(entry[name][key]) for name in UNITS for key in ("mean", "p95", "predicted"))
        diverged = f", {entry['diverged']} diverged" if entry["diverged"] else ""
        lines.append(f"  {entry['controller']:{width}}{entry['runs']:>8}{cells}{entry['left']:>14}{diverged}")
    return lines


def _cell(value: float | None) -> str:
    return f"{value:10.4g}" if value is not None else f"{'-':>10}"
