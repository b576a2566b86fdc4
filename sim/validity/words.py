"""A map of validity in words, as JSON, and as a table."""

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.numbers import finite
from models.common.whole_file import whole_file
from models.curves.curve import LEAVES
from sim.response.regime import CURVE, END_NAMES
from sim.validity.cells import Cells
from sim.validity.grid import UNITS, Axis


def write_csv(path: Path, cells: Cells, threshold: float) -> None:
    """One line per cell that was run, SI units; what never happens is left empty; in every line whether all cells are there."""
    names = [end.replace(" ", "_").replace("-", "_") for end in END_NAMES]
    with whole_file(path, "csv") as beside, beside.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        complete = bool(cells.done.all())
        columns = ("error", "holds", "broke_first", "at", "predicted", "predicted_at", "agrees")
        dampers = ("missing_force",) if np.isfinite(cells.missing).any() else ()
        shares = (f"linear_share_of_{name}" for name in names)
        writer.writerow([*UNITS, *columns, *shares, *dampers, "map_complete"])
        for i in np.flatnonzero(cells.done):
            bump, row = cells.bumps[i], _cell(cells, int(i), threshold)
            of_cell = [bump.height, bump.length, bump.speed, *(row[name] for name in columns), *cells.used[i].tolist()]
            writer.writerow([*of_cell, *(row[name] for name in dampers), complete])


def envelope_object(cells: Cells, axes: Sequence[Axis], controller: str, threshold: float) -> dict[str, Any]:
    """The map as JSON has it: SI units, None for what never happens."""
    done = np.flatnonzero(cells.done)
    return {
        "controller": controller,
        "axes": {axis.name: list(axis.values) for axis in axes},
        "threshold": threshold,
        "agreement": cells.agreement,
        "unexplained": cells.unexplained,
        "done": len(done),
        "complete": len(done) == len(cells.bumps),
        "cells": [{name: getattr(cells.bumps[i], name) for name in UNITS} | _cell(cells, int(i), threshold) for i in done],
    }


def loads_object(asked: Sequence[str]) -> dict[str, list[str]]:
    """The loads over every bump, as they were asked for; no key where there are none."""
    return {"loads": list(asked)} if asked else {}


def _cell(cells: Cells, i: int, threshold: float) -> dict[str, Any]:
    return {
        "error": finite(cells.error[i]),
        "holds": bool(cells.error[i] <= threshold),
        "broke_first": END_NAMES[cells.first[i]] if cells.first[i] >= 0 else None,
        "at": finite(cells.time[i]),
        "predicted": END_NAMES[cells.predicted[i]] if cells.predicted[i] >= 0 else None,
        "predicted_at": finite(cells.predicted_time[i]),
        "agrees": bool(cells.agrees[i]),
        **({"missing_force": float(cells.missing[i])} if np.isfinite(cells.missing[i]) else {}),
    }


def envelope_lines(cells: Cells, threshold: float) -> list[str]:
    """What a map shows, in lines for a terminal."""
    done = cells.done
    that = "" if done.all() else " that were run"

    def share(which: Array) -> str:
        return f"{100 * which[done].mean():5.1f} % of the cells{that}" if done.any() else "-"

    lines = [f"  {share(cells.error <= threshold)}: linear analysis holds to {threshold:g} of every peak"]
    lines.append(f"  {share(cells.first < 0)}: nothing breaks")
    lines += [
        f"  {share(cells.first == i)}: {end} comes first" for i, end in enumerate(END_NAMES) if np.any(cells.first[done] == i)
    ]
    if np.any(cells.first[done] == END_NAMES.index(CURVE.name)):
        lines.append(f"  curve: a damper's or spring's force is off its line at rest by {100 * LEAVES:g} % of its largest")
    if cells.short:
        lines.append(f"  {cells.short}, so that linear analysis holds at no height;")
        lines.append("  what comes first ends the analysis with its adjustable dampers, which goes on without that force")
    count = int(done.sum()) - round(cells.agreement * int(done.sum()))
    others = f"; of the other {count}, {cells.unexplained or 'none'} lies away from a boundary" if count else ""
    lines.append(
        f"{'agrees' if cells.as_predicted else 'DOES NOT AGREE'}: {100 * cells.agreement:.2f} % of {cells.counted('cells')} "
        f"break as {'the analysis with its dampers' if cells.short else 'linear analysis'} predicts{others}"
    )
    return lines
