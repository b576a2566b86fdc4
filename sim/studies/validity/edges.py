"""Edges of a map of validity, which are the limits that end the linear regime along one axis for each value of the other axis."""

from collections.abc import Mapping
from itertools import groupby
from typing import Any

import numpy as np

from models.common.printed import finite
from models.document.document import Document, Table, notes
from models.document.field import Field
from models.roads.road import HIGHEST
from sim.drive.regime import END_NAMES
from sim.studies.validity.grid import UNITS
from sim.studies.validity.regime_map import Cells

LINES = 4  # largest number of lines that show the map in the printed table
PARTS = 2  # largest number of limits in one row of the table
HEIGHT = Field[float]("height", float, ".4g", unit="m")
TRAVEL = Field[float]("travel", float, ".3g", 1e3, unit="mm")


def edges(cells: Cells) -> dict[str, Any]:
    """Returns the edges of the map as a JSON object in SI units.

    `lines` contains the predicted limits as a function of the height, for each value of the other axis of the map. If the
    height does not vary, `lines` contains the limits along the first axis of the map. `enclosed` contains the edge heights that
    lie between two MuJoCo runs.
    """
    # if True, the response for one height predicts the responses for all heights
    proportional = not (cells.loads or cells.vehicle.parts.nonlinear)
    along, *others = sorted(cells.axes, key=lambda axis: axis.name != "height")
    members: dict[float, list[int]] = {}
    for i, bump in enumerate(cells.bumps):
        members.setdefault(getattr(bump, others[0].name) if others else 0.0, []).append(i)
    lines = []
    for value, mine in sorted(members.items()):
        points = sorted((getattr(cells.bumps[i], along.name), cells.end_of(i) or None) for i in mine)
        spans = ((end, [at for at, _ in some]) for end, some in groupby(points, lambda point: point[1]))
        parts = [{"end": end, "from": at[0], "to": at[-1]} for end, at in spans]
        height, used = cells.bumps[mine[-1]].height, cells.used[mine[-1]]
        known = along.name == "height" and proportional and used.max() * HIGHEST >= height
        predicted = {"predicted": END_NAMES[int(used.argmax())], "predicted_from": float(height / used.max())} if known else {}
        at = {others[0].name: value} if others else {}
        lines.append({**at, "breaks_first": parts, "predicted": None, "predicted_from": None, **predicted})
    enclosed = [
        {
            "length": cells.bumps[i].length,
            "speed": cells.bumps[i].speed,
            "predicted": end.predicted_end,
            "predicted_from": end.predicted,
            "linear_at": end.stays,
            "ended_at": finite(end.leaves),
            "ended_by": end.end or None,
            "agrees": end.confirmed,
        }
        for i, end in cells.ends.items()
    ]
    return {"along": along.name, "lines": lines, "enclosed": enclosed}


def edge_document(cells: Cells) -> Document:
    """Returns the printed document about the edges of the map, with at most `LINES` lines."""
    whole = edges(cells)
    along, every = whole["along"], whole["lines"]
    other = next((axis.name for axis in cells.axes if axis.name != along), "")
    shown = [every[i] for i in sorted({round(i) for i in np.linspace(0, len(every) - 1, min(LINES, len(every)))})]
    found = {one.get(other): one for one in reversed(whole["enclosed"])} if along == "height" else {}

    def ended(edge: Mapping[str, Any]) -> list[dict[str, Any]]:
        return [part for part in edge["breaks_first"] if part["end"]]

    def limits(edge: Mapping[str, Any]) -> str:
        names = [part["end"] for part in ended(edge)]
        return ", ".join([*names[:PARTS], *["..."] * (len(names) > PARTS)]) or edge["predicted"] or "none"

    fields: list[Field[dict[str, Any]]] = [
        Field(other, lambda edge: edge.get(other), ".4g", unit=UNITS.get(other, "")),
        Field("first limit", limits),
        Field("first cell", lambda edge: next((part["from"] for part in ended(edge)), None), ".4g", unit=UNITS[along]),
        Field("predicted", lambda edge: edge["predicted_from"], HEIGHT.form, unit="m"),
        Field("MuJoCo", lambda edge: _enclosing_heights(found.get(edge.get(other))), unit="m"),
    ]
    fields = [field for field in fields if any(field.cell(edge) != "-" for edge in shown)]
    left = len(every) - len(shown)
    texts = [f"--json contains {left} more line{'s' * (left > 1)} of the map."] if left else []
    table = Table.of("edges", "First limit along the map.", fields, shown)
    return Document(f"First limit along the {along}, with {cells.fixed_text}", (table, *notes(*texts, *travel_texts(cells))))


def _enclosing_heights(one: Mapping[str, Any] | None) -> str:
    """Returns the two bump heights between which MuJoCo reaches a limit, and the name of this limit if it was not predicted."""
    if one is None:
        return "-"
    if one["ended_at"] is None:
        return f"above {HEIGHT.digits(one['linear_at'])}"
    name = "" if one["ended_by"] == one["predicted"] else f" {one['ended_by']}"
    return f"{HEIGHT.digits(one['linear_at'])} to {HEIGHT.digits(one['ended_at'])}{name}"


def travel_texts(cells: Cells) -> list[str]:
    """Returns a sentence about the largest suspension travel at which no limit is reached; empty if all suspensions have bump
    stops.
    """
    suspensions = cells.vehicle.kind.suspensions
    whole = cells.travel[cells.predicted < 0]
    if not len(whole) or len(cells.vehicle.parts.strokes) == len(suspensions):
        return []
    return [f"Below the limits, travel reaches {TRAVEL.text(whole.max())}; the vehicle file has no bump stops."]
