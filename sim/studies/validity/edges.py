"""Edges of a map of validity along one axis, at every value of the other: where the linear regime ends, and by which end."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from models.common.printed import finite
from models.roads.road import LIMITS
from models.vehicle.vehicle import Vehicle
from sim.response.regime import END_NAMES
from sim.studies.validity.grid import UNITS, GridAxis
from sim.studies.validity.regime_map import Cells

LINES = 4  # of a map, on a terminal
PARTS = 3  # of a line


def edges_object(cells: Cells, axes: Sequence[GridAxis], proportional: bool) -> dict[str, Any]:
    """Returns the edges as a JSON object, in SI units: the predicted ones along the height, if it is varied, and MuJoCo's.

    Args:
        axes: axes of the map, one or two.
        proportional: True if responses are proportional to the height, so that one response predicts the end.
    """
    along, *others = sorted(axes, key=lambda axis: axis.name != "height")
    members: dict[float, list[int]] = {}
    for i, bump in enumerate(cells.bumps):
        members.setdefault(getattr(bump, others[0].name) if others else 0.0, []).append(i)
    lines = []
    for value, mine in sorted(members.items()):
        parts: list[dict[str, Any]] = []
        for here, end in sorted((getattr(cells.bumps[i], along.name), cells.end_of(i) or None) for i in mine):
            if not parts or parts[-1]["end"] != end:
                parts.append({"end": end, "from": here})
            parts[-1]["to"] = here
        height, used = cells.bumps[mine[-1]].height, cells.used[mine[-1]]
        known = along.name == "height" and proportional and used.max() * LIMITS["height"][1] >= height
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


def edge_lines(edges: Mapping[str, Any], fixed: Mapping[str, float]) -> list[str]:
    """Returns a few edges in lines for a terminal.

    Args:
        edges: the edges as a JSON object.
        fixed: values of the quantities that are not varied.
    """
    along, every = edges["along"], edges["lines"]
    rest = " and ".join(f"a {name} of {value:g} {UNITS[name]}" for name, value in fixed.items())
    lines = [f"where the linear regime ends along the {along}, with {rest}:"]
    shown = sorted({round(i) for i in np.linspace(0, len(every) - 1, min(LINES, len(every)))})
    for edge in (every[i] for i in shown):
        name = next((name for name in UNITS if name in edge), "")
        parts = edge["breaks_first"]
        texts = [_part(part, UNITS[along], first=not i) for i, part in enumerate(parts[:PARTS])]
        texts += ["and so on"] if len(parts) > PARTS else []
        if end := edge["predicted"]:
            same = len(parts) == 2 and parts[1]["end"] == end
            texts[-1] += f"; predicted {'' if same else f'{end} '}from {edge['predicted_from']:.4g} m"
        found = [one for one in edges["enclosed"] if along == "height" and (not name or one[name] == edge[name])]
        for one in found[:1]:
            ended = f", {one['ended_by']} at {one['ended_at']:.4g} m" if one["ended_by"] else ""
            texts[-1] += f"; MuJoCo: nothing at {one['linear_at']:.4g} m{ended}"
        at = f"at a {name} of {edge[name]:.4g} {UNITS[name]}: " if name else ""
        lines.append(f"  {at}{', '.join(texts)}")
    left = len(every) - len(shown)
    return [*lines, f"  and {left} more between, in --json"] if left else lines


def _part(part: Mapping[str, Any], unit: str, first: bool) -> str:
    if first and not part["end"]:
        return f"nothing up to {part['to']:.4g} {unit}"
    return f"{part['end'] or 'nothing'} from {part['from']:.4g} {unit}"


def travel_line(vehicle: Vehicle, cells: Cells) -> list[str]:
    """Returns a line on how far a suspension without bump stops moves where nothing breaks; empty if every one has stops."""
    suspensions = vehicle.kind.suspensions
    whole = cells.travel[cells.predicted < 0]
    if not len(whole) or len(vehicle.limits.stops(suspensions)) == len(suspensions):
        return []
    return [f"no bump stops in the file: where nothing breaks a suspension moves up to {1e3 * whole.max():.3g} mm"]
