"""A map of validity in words, as JSON, as a table, and drawn so that it needs no explanation."""

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.files import whole_file
from models.common.printed import as_name, finite, percent
from models.document.figure import GREEN, VERMILLION, Classes, Curve, Figure, Marker, Panel
from models.document.picture import level
from models.roads.load import Load
from models.suspension import LEAVES
from models.vehicle.names import PLUS
from models.vehicle.vehicle import Vehicle
from sim.response.regime import CURVE, END_NAMES, LAW_OVERFLOW, REGIME_ENDS, End
from sim.studies.validity.grid import UNITS, GridAxis
from sim.studies.validity.regime_map import Cells
from synth.controller.controller import Controller
from synth.controller.report import built_words


def write_csv(path: Path, cells: Cells, threshold: float) -> None:
    """Writes a row per cell, in SI units; events that never happen, and results of MuJoCo where it was not run, are empty."""
    names = [end.replace(" ", "_").replace("-", "_") for end in END_NAMES]
    with whole_file(path, "csv") as beside, beside.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        columns = ("error", "holds", "broke_first", "at", "predicted", "predicted_at", "agrees")
        dampers = ("missing_force",) if _has_dampers(cells) else ()
        shares = (f"linear_share_of_{name}" for name in names)
        writer.writerow([*UNITS, *columns, *shares, *dampers, "simulated", "map_complete"])
        for row, used in zip(_cells(cells, threshold), cells.used.tolist(), strict=True):
            of_cell = [*(row[name] for name in (*UNITS, *columns)), *used]
            writer.writerow([*of_cell, *(row[name] for name in dampers), row["simulated"], True])


def envelope_object(cells: Cells, axes: Sequence[GridAxis], controller: str, threshold: float) -> dict[str, Any]:
    """The map as in JSON: SI units, None for what never happens, and for results of MuJoCo where it was not run."""
    return {
        "controller": controller,
        "axes": {axis.name: list(axis.values) for axis in axes},
        "threshold": threshold,
        "agreement": cells.agreement,
        "unexplained": cells.unexplained,
        "done": len(cells.bumps),
        "complete": True,
        "cells": _cells(cells, threshold),
    }


def loads_object(given: Sequence[str]) -> dict[str, list[str]]:
    """Returns the requested loads over every bump as a JSON object; empty without loads."""
    return {"loads": list(given)} if given else {}


def _cells(cells: Cells, threshold: float) -> list[dict[str, Any]]:
    """Returns a JSON object for each cell."""
    rows = []
    for i, bump in enumerate(cells.bumps):
        row: dict[str, Any] = {name: getattr(bump, name) for name in UNITS}
        row |= dict.fromkeys(("error", "holds", "broke_first", "at"))
        row |= {"predicted": cells.end_of(i) or None, "predicted_at": finite(cells.predicted_time[i]), "agrees": None}
        row |= {"simulated": i in cells.driven} | ({"missing_force": None} if _has_dampers(cells) else {})
        if (one := cells.driven.get(i)) is not None:
            row |= {"error": finite(one.error), "holds": one.error <= threshold, "at": finite(one.time)}
            row |= {"broke_first": END_NAMES[one.first] if one.first >= 0 else None, "agrees": i not in cells.others}
            row |= {"missing_force": one.missing} if _has_dampers(cells) else {}
        rows.append(row)
    return rows


def _has_dampers(cells: Cells) -> bool:
    """Returns True if the vehicle has adjustable dampers."""
    return any(math.isfinite(one.missing) for one in cells.driven.values())


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

    def share(share: float, of: str = "the cells") -> str:
        return f"  {100 * share:5.1f} % of {of}"

    analysis = "the analysis with its dampers" if cells.short else "linear analysis"
    first, count, others = cells.predicted, len(cells.driven), len(cells.others)
    lines = [f"what ends the linear regime first, as {analysis} predicts:", f"{share(float(np.mean(first < 0)))}: nothing breaks"]
    lines += [f"{share(float(np.mean(first == i)))}: {end} comes first" for i, end in enumerate(END_NAMES) if np.any(first == i)]
    if np.any(first == END_NAMES.index(CURVE.name)):
        lines.append(f"  curve: a damper's or spring's force is off its line at rest by {100 * LEAVES:g} % of its largest")
    lines += ["", f"MuJoCo, run in {count} of {len(cells.bumps)} cells:"]
    holds = cells.share(lambda one: one.error <= threshold)
    lines.append(f"{share(holds, 'these')}: linear analysis holds to {threshold:g} of every peak")
    if away := cells.share(lambda one: one.broke_off == LAW_OVERFLOW):
        lines.append(f"{share(away, 'these')}: the law's own states run away until it asks for no finite force")
    if cells.short:
        lines.append(f"  {cells.short}, so that linear analysis holds at no height;")
        lines.append("  what comes first ends the analysis with its adjustable dampers, which goes on without that force")
    text = f"; of the other {others}, {cells.unexplained or 'none'} lies away from a boundary" if others else ""
    text = f"{count - others} of {count} cells break as {analysis} predicts{text}"
    if cells.ends:
        agree = sum(end.confirmed for end in cells.ends.values())
        text += (
            f"; {agree} of {len(cells.ends)} ends along the edge are the predicted ones, within {_within(cells)} of the height"
        )
    return [*lines, f"{'agrees' if cells.as_predicted else 'DOES NOT AGREE'}: {text}"]


def _within(cells: Cells) -> str:
    """Describes how near the runs that enclose an end are to its predicted height."""
    return percent(math.ceil(1e3 * cells.furthest - 1e-6) / 1e3) if math.isfinite(cells.furthest) else "no height"


LABELS = {"height": "bump height [m]", "length": "bump length [m]", "speed": "speed [m/s]"}
NOTHING = "#dcefdc"


def envelope_figure(
    vehicle: Vehicle,
    controller: Controller,
    cells: Cells,
    axes: "Sequence[GridAxis]",
    fixed: Mapping[str, float],
    threshold: float,
    loads: Sequence[Load] = (),
) -> Figure:
    """Returns the map: colours show the predicted first end, the line where the regime ends, and markers what MuJoCo says.

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
    first = (f"{end.name} breaks first{_at(vehicle, end)}" for end in REGIME_ENDS)
    nothing = "nothing breaks: the regime is linear" if not cells.short else "nothing breaks; its dampers are short of force"
    ground = Classes(x, y, plane(cells.predicted + 1), (NOTHING, *(end.color for end in REGIME_ENDS)), (nothing, *first))

    curves, used = [], plane(cells.used.max(axis=-1))
    if np.nanmin(used) < 1 < np.nanmax(used):
        whose = "from its response with dampers" if cells.short else "from one linear run"
        whose = "from responses with its curves" if vehicle.is_curved else whose
        whose = whose.replace("one linear run", "linear runs") + " under the loads" if loads else whose
        curves.append(Curve(*level(x, y, np.log(used), 0.0), f"predicted end, {whose}", "#000000", width=1.8))
    places = np.array([[getattr(bump, axis.name) for axis in (horizontal, vertical)] for bump in cells.bumps])
    ends = {i: end for i, end in cells.ends.items() if end.end}
    at = [(places[i, 0], end.found if vertical.name == "height" else places[i, 1]) for i, end in ends.items()]
    curves += [_marks(np.array(at), ENCLOSED, "#000000", "D")] if at else []
    curves += _markers(cells, places, threshold)
    panel = Panel("", LABELS[horizontal.name], LABELS[vertical.name], tuple(curves), ground)
    return _figure(controller, cells, _title(vehicle, controller, cells, rest), panel)


ENCLOSED = "MuJoCo: two runs enclose the height of the end"


def _markers(cells: Cells, places: Array, threshold: float) -> list[Curve]:
    """Returns markers of the cells that MuJoCo ran, at the places of all cells, shape (N, 2)."""
    within, kinds = f"{100 * threshold:g} % of a peak", dict[tuple[str, str, Marker], list[int]]()
    for i, one in cells.driven.items():
        kind: tuple[str, str, Marker] = ("nothing breaks", GREEN, "o")
        if i in cells.others:
            kind = ("another end than predicted", "#000000", "x")
        elif one.end and one.error <= threshold:
            kind = (f"it ends, linear analysis is within {within}", VERMILLION, "+")
        elif one.end:
            kind = (f"it ends, linear analysis is off by more than {within}", VERMILLION, "x")
        kinds.setdefault(kind, []).append(i)
    return [_marks(places[mine], f"MuJoCo: {label}", color, marker) for (label, color, marker), mine in kinds.items()]


def _marks(points: Array, label: str, color: str, marker: Marker) -> Curve:
    """Returns markers at points, shape (N, 2)."""
    return Curve(points[:, 0], points[:, 1], label, color, "none", marker)


def _title(vehicle: Vehicle, controller: Controller, cells: Cells, rest: str) -> str:
    """Returns the title of a map; `rest` is what is not varied, in words."""
    which = "analysis with adjustable dampers" if cells.short else "linear analysis"
    count = f"{len(cells.ends)} end{'s' * (len(cells.ends) > 1)}"
    edge = f", and at {count}, within {_within(cells)} of the predicted height" if cells.ends else ""
    ends = (
        f"end the analysis with its dampers as predicted; {cells.short}" if cells.short else "end the linear regime as predicted"
    )
    return (
        f"How far {which} may be trusted: {vehicle.kind.name.replace('_', ' ')}, controller {controller.name}, {rest}. Colours "
        f"and lines: predicted. Markers: MuJoCo, in {len(cells.driven)} of {len(cells.bumps)} cells, of which "
        f"{100 * cells.agreement:.4g} % {ends}{edge}"
    )


def _figure(controller: Controller, cells: Cells, title: str, panel: Panel) -> Figure:
    holds = float(np.mean(cells.predicted < 0))
    finding = f"With {as_name(controller.name)} nothing breaks over {percent(holds)} of these bumps."
    return Figure("envelope", title, (panel,), columns=1, finding=finding)


def _line_figure(controller: Controller, cells: Cells, axis: GridAxis, title: str, threshold: float) -> Figure:
    """Draws the way to each end along one axis by the linear response, and what MuJoCo's runs made of it."""
    x, used = np.array(axis.values), cells.used
    curves = [
        Curve(x, used[:, i], f"{end.name}, linear analysis", end.color, width=1.8)
        for i, end in enumerate(REGIME_ENDS)
        if np.any(used[:, i] > 0)
    ]
    curves.append(Curve(x[[0, -1]], np.ones(2), "the linear regime ends", "#000000", "dash", width=1.0))
    if axis.name == "height" and (at := [(end.found, 1.0) for end in cells.ends.values() if end.end]):
        curves.append(_marks(np.array(at), ENCLOSED, "#000000", "D"))
    curves += _markers(cells, np.stack([x, used.max(axis=-1, initial=0.0)], axis=-1), threshold)
    panel = Panel("", LABELS[axis.name], "share of the way to an end", tuple(curves))
    return _figure(controller, cells, title, panel)


def _at(vehicle: Vehicle, end: End) -> str:
    """Describes the vehicle's own limit that is the same either way; for a curve, the share off its line."""
    if end is CURVE:
        return f" (off its line by {100 * LEAVES:g} % of its largest force)"
    values = {(limit.value, vehicle.kind.signal(limit.signal).unit) for limit in end.thresholds(vehicle) if not limit.sign}
    return "".join(f" (at ±{value:g} {unit})" for value, unit in values)
