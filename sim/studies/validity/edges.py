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
from sim.studies.validity.regime_map import Cells

LINES = 4  # of a map, on a terminal
PARTS = 3  # of a line


@dataclass(frozen=True)
class Edge:
    """First ends of the linear regime along an axis in MuJoCo, and the smallest height of one by linear analysis.

    Attributes:
        at: value of the other axis by name; empty for a map with one axis.
        parts: first end, or empty for none, with its first and last value on the axis, in order.
        end: end at the smallest height by linear analysis; empty if not requested, or none.
        height: smallest height [m]; infinite without one.
    """

    at: Mapping[str, float]
    parts: tuple[tuple[str, float, float], ...]
    end: str = ""
    height: float = math.inf


def edges(cells: Cells, axes: Sequence[GridAxis], proportional: bool) -> tuple[str, list[Edge]]:
    """Returns the axis along which there are edges, preferably the height, and the edges of the cells that were run.

    Args:
        axes: axes of the map, one or two.
        proportional: True if responses are proportional to the height, so that one response predicts the end.
    """
    along, *others = sorted(axes, key=lambda axis: axis.name != "height")
    lines: dict[float, list[int]] = {}
    for i in range(len(cells.bumps)):
        lines.setdefault(getattr(cells.bumps[i], others[0].name) if others else 0.0, []).append(i)
    found = []
    for value, mine in sorted(lines.items()):
        mine.sort(key=lambda i: getattr(cells.bumps[i], along.name))
        parts: list[tuple[str, float, float]] = []
        for i in mine:
            end, here = END_NAMES[cells.first[i]] if cells.first[i] >= 0 else "", getattr(cells.bumps[i], along.name)
            end = "a run that diverges" if not end and math.isinf(cells.error[i]) else end
            before = parts.pop() if parts and parts[-1][0] == end else (end, here, here)
            parts.append((end, before[1], here))
        edge = Edge({others[0].name: value} if others else {}, tuple(parts))
        last = mine[-1]
        if proportional and along.name == "height" and cells.used[last].max() > 0:
            height = cells.bumps[last].height / cells.used[last].max()
            if height <= LIMITS["height"][1]:
                edge = Edge(edge.at, edge.parts, END_NAMES[int(cells.used[last].argmax())], float(height))
        found.append(edge)
    return along.name, found


def edges_object(along: str, found: Sequence[Edge]) -> dict[str, Any]:
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
        lines.append(f"  {at}{', '.join(texts)}")
    left = len(found) - len(shown)
    return [*lines, f"  and {left} more between, in --json"] if left else lines


def _part(part: tuple[str, float, float], unit: str, first: bool) -> str:
    end, low, high = part
    return f"nothing up to {high:.4g} {unit}" if first and not end else f"{end or 'nothing'} from {low:.4g} {unit}"


def travel_line(vehicle: Vehicle, cells: Cells) -> list[str]:
    """Returns a line on how far a suspension without bump stops moves where nothing breaks; empty if every one has stops."""
    suspensions = vehicle.kind.suspensions
    whole = cells.travel[cells.first < 0]
    if not len(whole) or len(vehicle.limits.stops(suspensions)) == len(suspensions):
        return []
    return [f"no bump stops in the file: where nothing breaks a suspension moves up to {1e3 * whole.max():.3g} mm"]
