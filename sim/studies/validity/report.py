"""A map of validity in words, as JSON, as a table, and drawn so that it needs no explanation."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.files import whole_file
from models.common.printed import as_name, finite, percent
from models.figures.figure import GREEN, VERMILLION, Classes, Curve, Figure, Marker, Panel, level
from models.roads.load import Load
from models.suspension import LEAVES
from models.vehicle.names import PLUS
from models.vehicle.vehicle import Vehicle
from sim.response.regime import CURVE, END_NAMES, REGIME_ENDS, End
from sim.studies.validity.grid import UNITS, GridAxis
from sim.studies.validity.regime_map import Cells
from synth.controller.controller import Controller
from synth.controller.report import built_words


def write_csv(path: Path, cells: Cells, threshold: float) -> None:
    """Writes a row per cell, in SI units; events that never happen are left empty."""
    names = [end.replace(" ", "_").replace("-", "_") for end in END_NAMES]
    with whole_file(path, "csv") as beside, beside.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        columns = ("error", "holds", "broke_first", "at", "predicted", "predicted_at", "agrees")
        dampers = ("missing_force",) if np.isfinite(cells.missing).any() else ()
        shares = (f"linear_share_of_{name}" for name in names)
        writer.writerow([*UNITS, *columns, *shares, *dampers, "map_complete"])
        for i, bump in enumerate(cells.bumps):
            row = _cell(cells, i, threshold)
            of_cell = [bump.height, bump.length, bump.speed, *(row[name] for name in columns), *cells.used[i].tolist()]
            writer.writerow([*of_cell, *(row[name] for name in dampers), True])


def envelope_object(cells: Cells, axes: Sequence[GridAxis], controller: str, threshold: float) -> dict[str, Any]:
    """The map as in JSON: SI units, None for what never happens."""
    return {
        "controller": controller,
        "axes": {axis.name: list(axis.values) for axis in axes},
        "threshold": threshold,
        "agreement": cells.agreement,
        "unexplained": cells.unexplained,
        "done": len(cells.bumps),
        "complete": True,
        "cells": [
            {name: getattr(bump, name) for name in UNITS} | _cell(cells, i, threshold) for i, bump in enumerate(cells.bumps)
        ],
    }


def loads_object(given: Sequence[str]) -> dict[str, list[str]]:
    """Returns the requested loads over every bump as a JSON object; empty without loads."""
    return {"loads": list(given)} if given else {}


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


def compared_lines(vehicle: Vehicle, controller: Controller) -> list[str]:
    """Returns lines on the parts of computer and actuators in linear analysis, and those in MuJoCo only."""
    how = vehicle.implementation
    if not controller.law.acts or (how.ideal and vehicle.limits.actuator_bandwidth is None):
        return []
    linear = built_words(vehicle)
    lines = [f"linear analysis is of the loop as built: {linear}"] if linear else []
    if not how.has_measurement_noise:
        return lines
    return [*lines, f"{how.noise_text} is in MuJoCo alone, and makes most of the error over small bumps"]


def envelope_lines(cells: Cells, threshold: float) -> list[str]:
    """Returns a map in lines for a terminal."""

    def share(which: Array) -> str:
        return f"{100 * which.mean():5.1f} % of the cells"

    lines = ["how far MuJoCo is from linear analysis:"]
    lines.append(f"  {share(cells.error <= threshold)}: linear analysis holds to {threshold:g} of every peak")
    lines += ["", "what breaks first in MuJoCo, or ends the linear regime:", f"  {share(cells.first < 0)}: nothing breaks"]
    lines += [f"  {share(cells.first == i)}: {end} comes first" for i, end in enumerate(END_NAMES) if np.any(cells.first == i)]
    if np.any(cells.first == END_NAMES.index(CURVE.name)):
        lines.append(f"  curve: a damper's or spring's force is off its line at rest by {100 * LEAVES:g} % of its largest")
    if cells.ran_away.any():
        lines.append(f"  {share(cells.ran_away)}: the law's own states run away until it asks for no finite force")
    if cells.short:
        lines.append(f"  {cells.short}, so that linear analysis holds at no height;")
        lines.append("  what comes first ends the analysis with its adjustable dampers, which goes on without that force")
    count = len(cells.bumps) - round(cells.agreement * len(cells.bumps))
    others = f"; of the other {count}, {cells.unexplained or 'none'} lies away from a boundary" if count else ""
    lines.append(
        f"{'agrees' if cells.as_predicted else 'DOES NOT AGREE'}: {100 * cells.agreement:.2f} % of {cells.counted('cells')} "
        f"break as {'the analysis with its dampers' if cells.short else 'linear analysis'} predicts{others}"
    )
    return lines


LABELS = {"height": "bump height [m]", "length": "bump length [m]", "speed": "speed [m/s]"}
NOTHING = "#dcefdc"
RUNS: tuple[tuple[bool, str, Marker, str], ...] = (
    (False, GREEN, "o", "MuJoCo: nothing breaks"),
    (True, VERMILLION, "x", "MuJoCo: it ends"),
)


def envelope_figure(
    vehicle: Vehicle,
    controller: Controller,
    cells: Cells,
    axes: "Sequence[GridAxis]",
    fixed: Mapping[str, float],
    threshold: float,
    loads: Sequence[Load] = (),
) -> Figure:
    """Returns the map: colours show the first end in MuJoCo, the solid line its prediction, the dashed line the error threshold.

    Args:
        cells: cells of the grid, the last axis running fastest.
        axes: axes of the map, one or two; with one, the shares of the way to each end are drawn.
        fixed: values that are not varied.
        threshold: error up to which linear analysis holds.
        loads: loads on the body over every bump.
    """
    rest = ", ".join(
        f"{LABELS[name].split(' [')[0]} {value:g} {LABELS[name].split('[')[1][:-1]}" for name, value in fixed.items()
    )
    rest += f", under {PLUS.join(load.label for load in loads)}" if loads else ""
    if len(axes) == 1:
        return _line_figure(controller, cells, axes[0], _title(vehicle, controller, cells, rest), threshold)
    # Height, or else length, is vertical, whatever order was asked for.
    shape = (len(axes[0].values), len(axes[1].values))
    turned = axes[1].name == "height" or axes[0].name == "speed"
    vertical, horizontal = (axes[1], axes[0]) if turned else (axes[0], axes[1])

    def plane(values):
        return values.reshape(shape).T if turned else values.reshape(shape)

    x, y = np.array(horizontal.values), np.array(vertical.values)
    colors = (NOTHING, *(end.color for end in REGIME_ENDS))
    first = (f"{end.name} breaks first{_at(vehicle, end)}" for end in REGIME_ENDS)
    nothing = "nothing breaks: the regime is linear" if not cells.short else "nothing breaks; its dampers are short of force"
    ground = Classes(x, y, plane(cells.first + 1), colors, (nothing, *first))

    curves = []

    used = plane(cells.used.max(axis=-1))
    if np.nanmin(used) < 1 < np.nanmax(used):
        whose = "from its response with dampers" if cells.short else "from one linear run"
        whose = "from responses with its curves" if vehicle.is_curved else whose
        whose = whose.replace("one linear run", "linear runs") + " under the loads" if loads else whose
        curves.append(Curve(*level(x, y, np.log(used), 0.0), f"predicted end, {whose}", "#000000", width=1.8))
    error = plane(np.clip(cells.error, threshold / 10, 10 * threshold))
    if np.nanmin(error) < threshold < np.nanmax(error):
        text = f"linear prediction off by {100 * threshold:g} % of a peak"
        curves.append(Curve(*level(x, y, np.log(error), float(np.log(threshold))), text, VERMILLION, "dash", width=1.6))
    wrong = ~cells.agrees
    if np.any(wrong):
        row, column = np.nonzero(plane(wrong))
        curves.append(Curve(x[column], y[row], "another end than predicted", "#000000", "none", "x"))

    panel = Panel("", LABELS[horizontal.name], LABELS[vertical.name], tuple(curves), ground)
    return _figure(controller, cells, _title(vehicle, controller, cells, rest), panel, threshold)


def _title(vehicle: Vehicle, controller: Controller, cells: Cells, rest: str) -> str:
    """Returns the title of a map; `rest` is what is not varied, in words."""
    which = "analysis with adjustable dampers" if cells.short else "linear analysis"
    ends = (
        f"end the analysis with its dampers as predicted; {cells.short}" if cells.short else "end the linear regime as predicted"
    )
    return (
        f"How far {which} may be trusted: {vehicle.kind.name.replace('_', ' ')}, controller {controller.name}, {rest}. "
        f"{100 * cells.agreement:.4g} % of {cells.counted('MuJoCo runs')} {ends}"
    )


def _figure(controller: Controller, cells: Cells, title: str, panel: Panel, threshold: float) -> Figure:
    holds = float(np.mean(cells.error <= threshold))
    finding = f"With {as_name(controller.name)} linear analysis holds for {percent(holds)} of these bumps."
    return Figure("envelope", title, (panel,), columns=1, size=(9.0, 5.2), finding=finding)


def _line_figure(controller: Controller, cells: Cells, axis: GridAxis, title: str, threshold: float) -> Figure:
    """Draws the way to each end along one axis by the linear response, and what MuJoCo's runs made of it."""
    x, used = np.array(axis.values), cells.used
    curves = [
        Curve(x, used[:, i], f"{end.name}, linear analysis", end.color, width=1.8)
        for i, end in enumerate(REGIME_ENDS)
        if np.any(used[:, i] > 0)
    ]
    curves.append(Curve(x[[0, -1]], np.ones(2), "the linear regime ends", "#000000", "dash", width=1.0))
    for broke, color, marker, label in RUNS:
        mine = (cells.first >= 0) == broke
        curves.append(Curve(x[mine], used[mine].max(axis=-1, initial=0.0), label, color, "none", marker))
    panel = Panel("", LABELS[axis.name], "share of the way to an end", tuple(curves))
    return _figure(controller, cells, title, panel, threshold)


def _at(vehicle: Vehicle, end: End) -> str:
    """Describes the vehicle's own limit that is the same either way; for a curve, the share off its line."""
    if end is CURVE:
        return f" (off its line by {100 * LEAVES:g} % of its largest force)"
    values = {(limit.value, vehicle.kind.signal(limit.signal).unit) for limit in end.thresholds(vehicle) if not limit.sign}
    return "".join(f" (at ±{value:g} {unit})" for value, unit in values)
