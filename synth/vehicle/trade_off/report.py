"""Output of a trade-off: text, JSON, CSV and a picture."""

import csv
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.files import whole_file
from models.common.printed import finite, table, wrapped
from models.document.field import Field, json_object
from models.document.figure import BLACK, BLUE, VERMILLION, Curve, Figure, Panel, styles
from models.vehicle.names import without_copies
from synth.controller.report import BOUND, NORM, judged_lines
from synth.vehicle.trade_off.front import AxisValue, Front, Point
from synth.vehicle.trade_off.lower_bound import LowerBoundCurve

TRAVEL = Field[Point]("bump travel", lambda point: point.travel, "{:.4g} mm".format, 1e3, "bump_travel")
NUMBERS: tuple[Field[Point], ...] = (
    NORM.of(lambda point: point.controller.certificate),
    BOUND.of(lambda point: point.controller.certificate),
    TRAVEL,
)


def front_lines(front: Front) -> list[str]:
    """The axes, the marked points, the other controllers, and what bounds them."""
    lines = []
    for axis in front.axes:
        lines += wrapped(f"{axis.name}: {axis.meaning}{f' [{axis.unit}]' if axis.unit else ''}", hang=2)
    for text in judged_lines(front.points[0].controller):
        lines += wrapped(text, hang=2)
    names = [axis.name for axis in front.axes]
    signals = front.points[0].controller.measured
    with_travel = any(point.travel is not None for point in front.points)
    rows: list[tuple[str, ...]] = [("point", *names, *([TRAVEL.title] * with_travel), "gain")]
    for i in front.marked:
        point = front.points[i]
        travel = [TRAVEL.cell(point)] * with_travel
        rows.append((str(i + 1), *(f"{value:.6g}" for value in point.values), *travel, _gain(point)))
    lines += ["", f"controller {front.name}: static gains on {', '.join(signals)}", *table(rows)]
    if front.others:
        rows = [("beside them", *names), *((o.controller.name, *(f"{v:.6g}" for v in o.values)) for o in front.others)]
        lines += ["", *table(rows)]
    for name, why in front.missing.items():
        lines += wrapped(f"controller {name} is not shown: {why}", hang=2)
    return [*lines, "", *(line for text in _limit_texts(front) for line in wrapped(text, hang=2))]


SHOWN = 3  # points of a short table


def short_lines(front: Front) -> list[str]:
    """Returns the same in short: some of the marked points, no printed copies of controllers, the nearest point to each bound."""
    signals, units = ", ".join(front.points[0].controller.measured), ", ".join(axis.label for axis in front.axes)
    lines = wrapped(f"controller {front.name}: static gains on {signals}; -v: all", hang=2)
    lines += wrapped(f"norms: {units}", hang=2)
    rows: list[tuple[str, ...]] = [("point", *(axis.name for axis in front.axes), TRAVEL.title, "gain")]
    marked = list(front.marked)
    for k in dict.fromkeys(round(i) for i in np.linspace(0, len(marked) - 1, min(SHOWN, len(marked)))):
        point = front.points[marked[k]]
        rows.append((str(marked[k] + 1), *(f"{value:.6g}" for value in point.values), TRAVEL.cell(point), _gain(point)))
    others = {one.controller.name: one.values for one in front.others}
    rows += [(name, *(f"{value:.6g}" for value in others[name]), "", "") for name in without_copies(others)]
    lines += table(rows)
    for name, why in front.missing.items():
        lines += wrapped(f"controller {name} is not shown: {why}", hang=2)
    for limit in front.limits:
        first, second = (front.axes[k].name for k in limit.axes)
        shares = limit.share(front.values[:, list(limit.axes)])
        i = int(shares.argmin())
        near = f"point {i + 1} is at {shares[i]:.5g} times what no controller beats in {first} and {second}"
        lines += wrapped(f"limit: {near if math.isfinite(shares[i]) else f'nothing is proved of {first} and {second}'}", hang=2)
    return lines


def sentences(front: Front) -> list[str]:
    """Returns the results, a sentence each."""
    ends = ", ".join(
        f"{axis.name} from {min(values):.5g} to {max(values):.5g}"
        for axis, values in zip(front.axes, front.values.T.tolist(), strict=True)
        if values
    )
    lines = [f"{len(front.points)} certified designs, none of which another beats in all: {ends}"]
    if front.unproved:
        lines.append(f"left out: {front.unproved} designs of which a claim could not be proved")
    by: dict[tuple[int, int], list[str]] = {}
    unbeaten = []
    for one in front.others:
        beaten = [i for i, point in enumerate(front.points) if _beats(point.values, one.values)]
        if beaten:
            by.setdefault((len(beaten), beaten[len(beaten) // 2] + 1), []).append(one.controller.name)
        else:
            unbeaten.append(one.controller.name)
    for (count, example), names in by.items():
        lines.append(f"{', '.join(names)}: beaten in all by {count} of them, e.g. point {example}")
    return [*lines, f"{', '.join(unbeaten)}: beaten in all by none"] if unbeaten else lines


def front_object(front: Front) -> dict[str, Any]:
    """Returns the front as a JSON object in SI units."""
    return {
        "controller": front.name,
        "axes": [
            {
                "name": axis.name,
                "meaning": axis.meaning,
                "unit": axis.unit,
                "signals": dict(axis.norm.signals) if axis.norm.signals is not None else None,
                "band": [finite(edge) for edge in axis.norm.band] if axis.norm.narrow else None,
                "off": axis.off or None,
            }
            for axis in front.axes
        ],
        "points": [{"point": i + 1, **_object(front, point)} for i, point in enumerate(front.points)],
        "others": [{"name": one.controller.name, **_object(front, one)} for one in front.others],
        "missing": front.missing,
        "limits": [_limit_object(front, limit) for limit in front.limits],
        "loads": dict(front.points[0].controller.hardware.loads) if front.points else {},
        "designs": front.tried,
        "unproved": front.unproved,
        "interrupted": False,
    }


def write_csv(front: Front, path: Path) -> None:
    """A row to a point and to every other controller, SI units; what is not known is left empty."""
    names = [axis.name for axis in front.axes]
    entries = [f"gain_{i + 1}_{j + 1}" for i, j in _indices(front)]
    with whole_file(path, "csv") as beside, beside.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["point", *names, *(f"{name}_proved" for name in names), *(one.key for one in NUMBERS), *entries])
        for i, point in enumerate(front.points):
            gain = point.controller.gain
            writer.writerow([i + 1, *_cells(point), *(gain[k] for k in _indices(front))])
        for one in front.others:
            writer.writerow([one.controller.name, *_cells(one), *("" for _ in entries)])


def _cells(point: Point) -> list[float | str]:
    numbers = [*point.values, *(norm.proved for norm in point.norms), *(one.value(point) for one in NUMBERS)]
    return ["" if value is None or not math.isfinite(value) else value for value in numbers]


def _object(front: Front, point: Point) -> dict[str, Any]:
    controller = point.controller
    return {
        "values": {axis.name: _norm(norm) for axis, norm in zip(front.axes, point.norms, strict=True)},
        "measured": list(controller.measured),
        "gain": controller.gain.tolist(),
        **json_object(NUMBERS, point),
    }


def _norm(norm: AxisValue) -> dict[str, float | None]:
    return {"value": finite(norm.value), "proved": finite(norm.proved), "frequency": finite(norm.at)}


def _limit_object(front: Front, limit: LowerBoundCurve) -> dict[str, Any]:
    return {
        "axes": [front.axes[k].name for k in limit.axes],
        "weights": limit.weights.tolist(),
        "norms": limit.norms.tolist(),
    }


def _limit_texts(front: Front) -> list[str]:
    """Returns the distance of the front from the lower bound, a sentence for every two axes."""
    texts = []
    for limit in front.limits:
        first, second = (front.axes[k].name for k in limit.axes)
        shares = limit.share(front.values[:, list(limit.axes)])
        i = int(shares.argmin())
        if math.isfinite(shares[i]):
            texts.append(
                f"limit: no controller, whatever it measures, comes below the line of {first} and {second}; point {i + 1} is "
                f"nearest to it, at {shares[i]:.5g} times its distance from the origin"
            )
        else:
            texts.append(f"limit: nothing is proved of {first} and {second} together")
    return texts


def _gain(point: Point) -> str:
    """All entries where they fit on a line."""
    entries = point.controller.gain.ravel()
    return " ".join(f"{entry:.6g}" for entry in entries) if len(entries) <= 4 else f"{len(entries)} entries"


def _indices(front: Front) -> list[tuple[int, int]]:
    """Returns the indices of the gain's entries."""
    m, q = front.points[0].controller.gain.shape
    return [(i, j) for i in range(m) for j in range(q)]


def _beats(one: Sequence[float], other: Sequence[float]) -> bool:
    return all(a < b for a, b in zip(one, other, strict=True))


WIDER = 0.06  # of what is shown, around it
BESIDE = 1.5  # times the front's own range: other controllers further off are named, not shown
SAME = 0.005  # of what is shown: what is nearer to one another has one mark
FINE = 400  # points of the line, each way
DESIGNS, LINE, MEASURED = BLUE, BLACK, VERMILLION


def front_figure(front: Front, measured: Array | None = None) -> Figure:
    """Returns the figure of a front.

    Args:
        measured: values of the marked points in MuJoCo, shape (M, K), NaN for missing ones; None without runs.
    """
    panels = tuple(_panel(front, limit, measured) for limit in front.limits)
    kind = front.vehicle.kind.name.replace("_", " ")
    title = f"{kind}, controller {front.name}: {len(front.points)} certified designs, none of which another beats in all"
    if len(panels) > 1:
        return Figure("front", title, panels, 3)
    return Figure("front", title, panels, 1)


def line(limit: LowerBoundCurve, x: tuple[float, float], y: tuple[float, float]) -> tuple[Array, Array]:
    """Returns the curve of the lower bound within ranges of both axes, from the upper left to the lower right."""
    first, second = np.linspace(*x, FINE), np.linspace(*y, FINE)
    turned = LowerBoundCurve((limit.axes[1], limit.axes[0]), limit.weights[:, ::-1], limit.norms)
    a, b = np.append(first, turned.lower_bound_on_second(second)), np.append(limit.lower_bound_on_second(first), second)
    kept = np.isfinite(a) & np.isfinite(b) & (a > 0)
    order = np.lexsort((-b[kept], a[kept]))
    return a[kept][order], b[kept][order]


def _panel(front: Front, limit: LowerBoundCurve, measured: Array | None) -> Panel:
    i, j = limit.axes
    values = front.values[:, [i, j]]
    others = {one.controller.name: (one.values[i], one.values[j]) for one in front.others}
    ranges, beyond = _shown(values, np.array(list(others.values())).reshape(-1, 2))
    dots = Curve(values[:, 0], values[:, 1], "designs on the front", DESIGNS, "none", "+", name="design")
    if len(front.axes) == 2:
        dots = Curve(values[:, 0], values[:, 1], "designs on the front", DESIGNS, "solid", "", 2.2)
    curves = [dots, Curve(*line(limit, *ranges), "no controller comes below this line", LINE, "dot", width=1.2)]
    look = styles(tuple(others))
    for names in _together(others, beyond, ranges):
        (x, y), text = others[names[0]], ", ".join(names)
        curves.append(
            Curve(
                np.array([x]), np.array([y]), text, look[names[0]].color, "none", look[names[0]].marker, name=f"controller {text}"
            )
        )
    # Several wheels that meet one road need not reach the norm; such a point would seem to cross the line.
    alone = len(front.vehicle.kind.wheels) == 1
    if alone and measured is not None and np.any(np.isfinite(measured[:, [i, j]]).all(axis=1)):
        label = "MuJoCo on one sinusoid, which reaches the norm from below"
        curves.append(Curve(measured[:, i], measured[:, j], label, MEASURED, "none", "x", name="MuJoCo"))
    away = [f"{name} ({x:.4g}, {y:.4g})" for (name, (x, y)), far in zip(others.items(), beyond, strict=True) if far]
    title = f"{front.axes[i].name} and {front.axes[j].name}".replace("_", " ")
    if away:
        title += f"; beyond: {', '.join(away)}"
    return Panel(title, front.axes[i].label, front.axes[j].label, tuple(curves), xlim=ranges[0], ylim=ranges[1])


def _together(
    others: dict[str, tuple[float, float]], beyond: Array, ranges: tuple[tuple[float, float], tuple[float, float]]
) -> list[list[str]]:
    """The names of those that are shown, such that lie in one place together."""
    size, groups = np.array([high - low for low, high in ranges]), list[list[str]]()
    for (name, place), far in zip(others.items(), beyond, strict=True):
        if far:
            continue
        for names in groups:
            if np.all(np.abs(np.subtract(place, others[names[0]])) < SAME * size):
                names.append(name)
                break
        else:
            groups.append([name])
    return groups


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
