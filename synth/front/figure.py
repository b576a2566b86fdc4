"""A trade-off, drawn: a panel for every two axes, with the line that nobody crosses."""

import numpy as np

from models.common.arrays import Array
from models.figures.figure import Curve, Figure, Panel, styles
from synth.front.front import Front
from synth.front.limits import Limit

WIDER = 0.06  # of what is shown, around it
BESIDE = 1.5  # times the front's own range: other controllers further off are named, not shown
SAME = 0.005  # of what is shown: what is nearer to one another has one mark
FINE = 400  # points of the line, each way
DESIGNS, LINE, MEASURED = "#1f77b4", "#000000", "#d62728"


def front_figure(found: Front, measured: Array | None = None) -> Figure:
    """The figure.

    Args:
        found: the front.
        measured: its marked points in MuJoCo, shape (M, K), NaN where they were not; None where nobody drove them.
    """
    panels = tuple(_panel(found, limit, measured) for limit in found.limits)
    kind = found.vehicle.kind.name.replace("_", " ")
    title = f"{kind}, controller {found.name}: {len(found.points)} certified designs, none of which another beats in all"
    if len(panels) > 1:
        return Figure("front", title, panels, 3)
    return Figure("front", title, panels, 1, (6.5, 4.6))


def line(limit: Limit, x: tuple[float, float], y: tuple[float, float]) -> tuple[Array, Array]:
    """What nobody crosses, within a range of both axes: from the upper left to the lower right."""
    first, second = np.linspace(*x, FINE), np.linspace(*y, FINE)
    turned = Limit((limit.axes[1], limit.axes[0]), limit.weights[:, ::-1], limit.norms)
    a, b = np.append(first, turned.least(second)), np.append(limit.least(first), second)
    kept = np.isfinite(a) & np.isfinite(b) & (a > 0)
    order = np.lexsort((-b[kept], a[kept]))
    return a[kept][order], b[kept][order]


def _panel(found: Front, limit: Limit, measured: Array | None) -> Panel:
    i, j = limit.axes
    values = found.values[:, [i, j]]
    others = {one.controller.name: (one.values[i], one.values[j]) for one in found.others}
    ranges, beyond = _shown(values, np.array(list(others.values())).reshape(-1, 2))
    dots = Curve(values[:, 0], values[:, 1], "designs on the front", DESIGNS, "none", "+", name="design")
    if len(found.axes) == 2:
        dots = Curve(values[:, 0], values[:, 1], "designs on the front", DESIGNS, "solid", "", 2.2)
    curves = [dots, Curve(*line(limit, *ranges), "no controller comes below this line", LINE, "dot", width=1.2)]
    look = styles(tuple(others))
    for names in _together(others, beyond, ranges):
        (x, y), text = others[names[0]], ", ".join(names)
        curves.append(Curve(np.array([x]), np.array([y]), text, look[names[0]][0], "none", "o", name=f"controller {text}"))
    if measured is not None and np.any(np.isfinite(measured[:, [i, j]]).all(axis=1)):
        curves.append(Curve(measured[:, i], measured[:, j], "MuJoCo", MEASURED, "none", "x", name="MuJoCo"))
    away = [f"{name} ({x:.4g}, {y:.4g})" for (name, (x, y)), far in zip(others.items(), beyond, strict=True) if far]
    title = f"{found.axes[i].name} and {found.axes[j].name}".replace("_", " ")
    if away:
        title += f"; beyond: {', '.join(away)}"
    return Panel(title, found.axes[i].label, found.axes[j].label, tuple(curves), xlim=ranges[0], ylim=ranges[1])


def _together(
    others: dict[str, tuple[float, float]], beyond: Array, ranges: tuple[tuple[float, float], tuple[float, float]]
) -> list[list[str]]:
    """The names of those that are shown, such that lie in one place together."""
    size, found = np.array([high - low for low, high in ranges]), list[list[str]]()
    for (name, place), far in zip(others.items(), beyond, strict=True):
        if far:
            continue
        for names in found:
            if np.all(np.abs(np.subtract(place, others[names[0]])) < SAME * size):
                names.append(name)
                break
        else:
            found.append([name])
    return found


def _shown(values: Array, others: Array) -> tuple[tuple[tuple[float, float], tuple[float, float]], Array]:
    """The range of both axes, and which of the other controllers lie beyond it, shape (N,)."""
    low, high = values.min(axis=0), values.max(axis=0)
    size = np.where(high > low, high - low, np.where(high > 0, high, 1.0))
    beyond = np.any((others > high + BESIDE * size) | (others < low - BESIDE * size), axis=1)
    seen = np.vstack([values, others[~beyond]])
    low, high = seen.min(axis=0), seen.max(axis=0)
    room = WIDER * np.where(high > low, high - low, size)
    low, high = np.maximum(low - 2 * room, 0.0), high + room
    return ((float(low[0]), float(high[0])), (float(low[1]), float(high[1]))), beyond
