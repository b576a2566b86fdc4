"""Edges of a map of validity along one axis, at every value of the other: where the linear regime ends, and by which end."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.common.printed import finite
from models.roads.road import LIMITS
from models.vehicle.vehicle import Vehicle
from sim.response.regime import END_NAMES
from sim.studies.validity.grid import UNITS, GridAxis
from sim.studies.validity.regime_end import RegimeEnd
from sim.studies.validity.regime_map import Cells

LINES = 4  # of a map, on a terminal
PARTS = 3  # of a line


@dataclass(frozen=True)
class Edge:
    """First ends of the linear regime along an axis, and the smallest height of one, by analysis and in MuJoCo.

    Attributes:
        at: value of the other axis by name; empty for a map with one axis.
        parts: predicted first end, or empty for none, with its first and last value on the axis, in order.
        end: end at the smallest height by linear analysis; empty if not requested, or none.
        height: smallest height [m]; infinite without one.
        found: the same end, enclosed by MuJoCo; None if MuJoCo was not run there.
    """

    at: Mapping[str, float]
    parts: tuple[tuple[str, float, float], ...]
    end: str = ""
    height: float = math.inf
    found: RegimeEnd | None = None


def edges(cells: Cells, axes: Sequence[GridAxis], proportional: bool) -> tuple[str, list[Edge]]:
    """Returns the axis along which there are edges, preferably the height, and the edges.

    Args:
        axes: axes of the map, one or two.
        proportional: True if responses are proportional to the height, so that one response predicts the end.
    """
    along, *others = sorted(axes, key=lambda axis: axis.name != "height")
    lines: dict[float, list[int]] = {}
    for i, bump in enumerate(cells.bumps):
        lines.setdefault(getattr(bump, others[0].name) if others else 0.0, []).append(i)
    edges = []
    for value, mine in sorted(lines.items()):
        mine.sort(key=lambda i: getattr(cells.bumps[i], along.name))
        parts: list[tuple[str, float, float]] = []
        for i in mine:
            end, here = cells.end_of(i), getattr(cells.bumps[i], along.name)
            before = parts.pop() if parts and parts[-1][0] == end else (end, here, here)
            parts.append((end, before[1], here))
        end, height, found, used = "", math.inf, None, cells.predicted.used[mine[-1]]
        if along.name == "height":
            found = next((cells.ends[i] for i in mine if i in cells.ends), None)
            if proportional and used.max() * LIMITS["height"][1] >= cells.bumps[mine[-1]].height:
                end, height = END_NAMES[int(used.argmax())], float(cells.bumps[mine[-1]].height / used.max())
        edges.append(Edge({others[0].name: value} if others else {}, tuple(parts), end, height, found))
    return along.name, edges


def edges_object(along: str, found: Sequence[Edge], cells: Cells) -> dict[str, Any]:
    """Returns edges as JSON objects, in SI units."""
    return {
        "along": along,
        "lines": [
            {
                **edge.at,
                "breaks_first": [{"end": end or None, "from": low, "to": high} for end, low, high in edge.parts],
                "predicted": edge.end or None,
                "predicted_from": finite(edge.height),
            }
            for edge in found
        ],
        "enclosed": [
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
        ],
    }


def edge_lines(along: str, found: Sequence[Edge], fixed: Mapping[str, float]) -> list[str]:
    """Returns a few edges in lines for a terminal.

    Args:
        found: the edges along it.
        fixed: description of the quantities that are not varied.
    """
    rest = " and ".join(f"a {name} of {value:g} {UNITS[name]}" for name, value in fixed.items())
    lines = [f"where the linear regime ends along the {along}, with {rest}:"]
    shown = sorted({round(i) for i in np.linspace(0, len(found) - 1, min(LINES, len(found)))})
    for edge in (found[i] for i in shown):
        at = "".join(f"at a {name} of {value:.4g} {UNITS[name]}: " for name, value in edge.at.items())
        texts = [_part(part, UNITS[along], first=not i) for i, part in enumerate(edge.parts[:PARTS])]
        texts += ["and so on"] if len(edge.parts) > PARTS else []
        if edge.end:
            same = len(edge.parts) == 2 and edge.parts[1][0] == edge.end
            texts[-1] += f"; predicted {'' if same else f'{edge.end} '}from {edge.height:.4g} m"
        if edge.found is not None:
            low, high, end = edge.found.stays, edge.found.leaves, edge.found.end
            texts[-1] += f"; MuJoCo: nothing at {low:.4g} m" + (f", {end} at {high:.4g} m" if end else "")
        lines.append(f"  {at}{', '.join(texts)}")
    left = len(found) - len(shown)
    return [*lines, f"  and {left} more between, in --json"] if left else lines


def _part(part: tuple[str, float, float], unit: str, first: bool) -> str:
    end, low, high = part
    return f"nothing up to {high:.4g} {unit}" if first and not end else f"{end or 'nothing'} from {low:.4g} {unit}"


def travel_line(vehicle: Vehicle, cells: Cells) -> list[str]:
    """Returns a line on how far a suspension without bump stops moves where nothing breaks; empty if every one has stops."""
    suspensions = vehicle.kind.suspensions
    whole = cells.predicted.travel[cells.predicted.first < 0]
    if not len(whole) or len(vehicle.limits.stops(suspensions)) == len(suspensions):
        return []
    return [f"no bump stops in the file: where nothing breaks a suspension moves up to {1e3 * whole.max():.3g} mm"]
