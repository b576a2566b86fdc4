"""Output of a trade-off as text, JSON, CSV and a figure."""

import math
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.printed import NORM_DIGITS, as_name, by_text, entry, finite
from models.document.document import Document, Table, notes
from models.document.field import Field, Record
from models.document.figure import BLACK, BLUE, VERMILLION, Curve, Figure, Panel, styles
from models.document.reading import write_rows
from models.vehicle.names import without_copies
from synth.controller.report import BOUND, NORM, judged_lines, line_notes
from synth.vehicle.trade_off.axes import AxisValue, FrontAxis
from synth.vehicle.trade_off.front import MARKED_POINTS, Front, Point
from synth.vehicle.trade_off.lower_bound import LowerBoundCurve

TRAVEL = Field[Point]("bump travel", lambda point: point.travel, ".4g", 1e3, "bump_travel", "mm")
VALUE = Field[float]("norm", lambda norm: norm, NORM_DIGITS)
SHARE = Field[float]("share", float, ".5g")
NUMBERS: tuple[Field[Point], ...] = (
    NORM.of(lambda point: point.controller.certificate),
    BOUND.of(lambda point: point.controller.certificate),
    TRAVEL,
)
Row = tuple[str, Point, Array | None, str]  # name of the controller, point, values in MuJoCo, and gain as text


def describe(front: Front, measured: Array | None = None, most: int = MARKED_POINTS) -> Document:
    """Returns a document that describes a trade-off front.

    The document contains the ranges of the norms, the comparison with other controllers, some designs, and the gap between
    designs and lower bounds.

    Args:
        front: trade-off front that the document describes.
        measured: values of M representative designs in MuJoCo, shape (M, K), NaN if missing; None if nothing was simulated.
        most: largest number of representative designs in the table.
    """
    shown = dict.fromkeys(round(i) for i in np.linspace(0, len(front.marked) - 1, min(most, len(front.marked))))
    others = {one.controller.name: one for one in front.others}
    rows: list[Row] = []
    for k in shown:
        i = front.marked[k]
        rows.append((str(i + 1), front.points[i], None if measured is None else measured[k], _gain(front.points[i])))
    if measured is None:  # the other controllers have no values from MuJoCo, because they are not simulated
        rows += [(name, others[name], None, "-") for name in without_copies(others)]
    fields: list[Field[Row]] = [Field("point", lambda row: row[0])]
    for k, axis in enumerate(front.axes):
        fields.append(Field(axis.name, lambda row, k=k: row[1].values[k], VALUE.form))
        if measured is not None:
            fields.append(Field(f"{axis.name}, MuJoCo", lambda row, k=k: None if row[2] is None else row[2][k], VALUE.form))
    if any(row[1].travel is not None for row in rows):
        fields.append(TRAVEL.of(itemgetter(1)))
    fields.append(Field("gain", lambda row: row[3]))
    meanings = "; ".join(f"{axis.label}: {axis.meaning}" for axis in front.axes)
    controller = front.points[0].controller
    spans, *beaten = _results(front)
    gains = f"All designs are static gains from the measurements {', '.join(controller.measured)}. {meanings}."
    caption = "Some designs of the front: proved norms and gains."
    return Document(
        "Trade-off between objectives",
        (
            *notes(spans, *line_notes(front.vehicle), detail="brief"),
            *notes(*beaten, gains, *judged_lines(controller)),
            Table.of("front", caption, fields, rows, detail="brief"),
            front_figure(front, measured),
            *notes(*_limit_texts(front), detail="brief"),
            *notes(*(f"{as_name(name)} is not shown: {why}" for name, why in front.missing.items())),
        ),
    )


def _results(front: Front) -> list[str]:
    """Describes the range of the front on each axis, and the number of designs that dominate each controller shown for
    comparison.
    """
    columns = zip(front.axes, front.values.T, strict=True)
    ends = ", ".join(f"{axis.name} from {VALUE.digits(values.min())} to {VALUE.digits(values.max())}" for axis, values in columns)
    beaten = {}
    for one in front.others:
        better = np.flatnonzero(np.all(front.values < one.values, axis=1)) + 1
        beaten[one.controller.name] = f"{len(better)} (such as point {better[len(better) // 2]})" if len(better) else "none"
    texts = [f"{len(front.points)} certified designs, none better than another on all axes: {ends}."]
    texts += [f"{front.unproved} other designs are omitted, because a claim about them is not proved."] if front.unproved else []
    alike = ", ".join(f"{text} than {names}" for text, names in by_text(beaten.items()).items())
    return [*texts, f"Designs of the front that are better on all axes: {alike}."] if alike else texts


AXIS = Record[FrontAxis](
    "name",
    "meaning",
    "unit",
    signals="norm.signals",
    band=lambda axis: axis.norm.band if axis.norm.narrow else None,
    off=lambda axis: axis.off or None,
)
CLAIM = Record[AxisValue]("value", "proved", frequency="at")
DESIGN = Record[Point](Record(measured="controller.measured", gain="controller.gain"), *NUMBERS)


def _design(front: Front, point: Point, /, **named: Any) -> dict[str, Any]:
    """Returns a design as JSON: first the entries of `named`, then the norms on all axes, and the gain."""
    axes = zip(front.axes, point.norms, strict=True)
    return {**named, "values": {axis.name: CLAIM(norm) for axis, norm in axes}, **DESIGN(point)}


RECORD = Record[Front](
    controller="name",
    axes=AXIS.all("axes"),
    points=lambda front: [_design(front, one, point=i) for i, one in enumerate(front.points, 1)],
    others=lambda front: [_design(front, one, name=one.controller.name) for one in front.others],
    missing="missing",
    limits=lambda front: [
        {"axes": [front.axes[k].name for k in one.axes], "weights": one.weights, "norms": one.norms} for one in front.limits
    ],
    loads=lambda front: dict(front.points[0].controller.hardware.loads) if front.points else {},
    designs="design_count",
    unproved="unproved",
    interrupted=lambda front: False,
)


def write_csv(front: Front, path: Path) -> None:
    """Writes a CSV file in SI units, with a row for each design on the front and each controller shown for comparison.

    Cells for unknown values, and for the gains of controllers shown for comparison, are empty.
    """
    names, (m, q) = [axis.name for axis in front.axes], front.points[0].controller.gain.shape
    entries = [f"gain_{i + 1}_{j + 1}" for i in range(m) for j in range(q)]
    rows: list[list[Any]] = [["point", *names, *(f"{name}_proved" for name in names), *(one.key for one in NUMBERS), *entries]]
    for i, one in enumerate((*front.points, *front.others)):
        own = i < len(front.points)
        numbers = [*one.values, *(norm.proved for norm in one.norms), *(field.value(one) for field in NUMBERS)]
        gain = one.controller.gain.ravel().tolist() if own else [None] * len(entries)
        rows.append([i + 1 if own else one.controller.name, *map(finite, numbers), *gain])
    write_rows(path, rows)


def _limit_texts(front: Front) -> list[str]:
    """Describes, in one sentence for each pair of axes, the gap between the front and the lower bound."""
    texts = []
    for limit in front.limits:
        first, second = (front.axes[k].name for k in limit.axes)
        shares = limit.share(front.values[:, list(limit.axes)])
        i = int(shares.argmin())
        near = f"point {i + 1} is nearest to the lower bound on {first} and {second}: {SHARE.digits(float(shares[i]))} times"
        no = f"no lower bound on {first} and {second} together is proved"
        texts.append(f"Limit: {f'{near} the bound' if math.isfinite(shares[i]) else no}.")
    return texts


def _gain(point: Point) -> str:
    """Formats all entries of the gain if they fit on a line; otherwise returns a text that states the number of entries."""
    entries = point.controller.gain.ravel()
    return " ".join(map(entry, entries)) if len(entries) <= 4 else f"{len(entries)} entries"


WIDER = 0.06  # margin of a panel around its points, relative to the range of the points
# a controller that is farther from the front than this, relative to the range of the front, is listed instead of drawn
BESIDE = 1.5
SAME = 0.005  # controllers share a mark if their distance, relative to the range of the panel, is smaller than this
FINE = 400  # number of points in each direction of the curve
DESIGNS, LINE, MEASURED = BLUE, BLACK, VERMILLION


def front_figure(front: Front, measured: Array | None = None) -> Figure:
    """Returns the figure of a front, with a panel for each pair of axes.

    Args:
        front: trade-off front that the figure shows.
        measured: values of M representative designs in MuJoCo, shape (M, K), NaN if missing; None if nothing was simulated.
    """
    panels = tuple(_panel(front, limit, measured) for limit in front.limits)
    kind = front.vehicle.kind.name.replace("_", " ")
    title = f"{kind}, controller {front.name}: {len(front.points)} certified designs, none better than another on all axes"
    return Figure("front", title, panels, 3 if len(panels) > 1 else 1)


def line(limit: LowerBoundCurve, x: tuple[float, float], y: tuple[float, float]) -> tuple[Array, Array]:
    """Returns the points of the lower-bound curve within the ranges of both axes, from the upper left to the lower right."""
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
    ranges, beyond = _shown_range(values, np.array(list(others.values())).reshape(-1, 2))
    x, y = values.T
    dots = Curve(x, y, "designs on the front", DESIGNS, "none", "+", name="design")
    joined = Curve(x, y, "designs on the front", DESIGNS, "solid", "", 2.2)
    low, bound = line(limit, *ranges)
    curves = [joined if len(front.axes) == 2 else dots]
    curves.append(Curve(low, bound, "lower bound for every controller", LINE, "dot", width=1.2))
    look = styles(tuple(others))
    for names in _together(others, beyond, ranges):
        (x, y), text, (color, _, marker) = np.array(others[names[0]])[:, None], ", ".join(names), look[names[0]]
        curves.append(Curve(x, y, text, color, "none", marker, name=f"controller {text}"))
    # If several wheels follow the same road, the gain in MuJoCo can be below the norm. Points from MuJoCo would then seem to
    # violate the lower bound.
    alone = len(front.vehicle.kind.wheels) == 1
    if alone and measured is not None and np.any(np.isfinite(measured[:, [i, j]]).all(axis=1)):
        label = "MuJoCo on one sinusoid, which approaches the norm from below"
        curves.append(Curve(measured[:, i], measured[:, j], label, MEASURED, "none", "x", name="MuJoCo"))
    away = [
        f"{name} ({VALUE.digits(x)}, {VALUE.digits(y)})"
        for (name, (x, y)), far in zip(others.items(), beyond, strict=True)
        if far
    ]
    title = f"{front.axes[i].name} and {front.axes[j].name}".replace("_", " ")
    if away:
        title += f"; outside the picture: {', '.join(away)}"
    return Panel(title, front.axes[i].label, front.axes[j].label, tuple(curves), xlim=ranges[0], ylim=ranges[1])


def _together(
    others: dict[str, tuple[float, float]], beyond: Array, ranges: tuple[tuple[float, float], tuple[float, float]]
) -> list[list[str]]:
    """Returns the names of the controllers that the figure shows; names of controllers at the same position are grouped."""
    size, groups = np.array([high - low for low, high in ranges]), list[list[str]]()
    for (name, place), far in zip(others.items(), beyond, strict=True):
        near = [names for names in groups if np.all(np.abs(np.subtract(place, others[names[0]])) < SAME * size)]
        if near and not far:
            near[0].append(name)
        elif not far:
            groups.append([name])
    return groups


def _shown_range(values: Array, others: Array) -> tuple[tuple[tuple[float, float], tuple[float, float]], Array]:
    """Returns the ranges of both axes, and a mask of the N controllers for comparison that lie outside these ranges, shape
    (N,).
    """
    low, high = values.min(axis=0), values.max(axis=0)
    size = np.where(high > low, high - low, np.where(high > 0, high, 1.0))
    beyond = np.any((others > high + BESIDE * size) | (others < low - BESIDE * size), axis=1)
    seen = np.vstack([values, others[~beyond]])
    low, high = seen.min(axis=0), seen.max(axis=0)
    room = WIDER * np.where(high > low, high - low, size)
    low, high = np.maximum(low - 2 * room, 0.0), high + room
    return ((float(low[0]), float(high[0])), (float(low[1]), float(high[1]))), beyond
