"""A trade-off in words, as `--json` has it, and as CSV."""

import csv
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from models.common.interrupt import LATE
from models.common.numbers import finite
from models.common.printed import table, wrapped
from models.common.whole_file import whole_file
from synth.front.front import DESIGNING, Front, Norm, Point
from synth.front.limits import Limit
from synth.words import judged_lines


def front_lines(found: Front) -> list[str]:
    """The axes, the marked points, the other controllers, and what bounds them."""
    lines = []
    for axis in found.axes:
        lines += wrapped(f"{axis.name}: {axis.meaning}{f' [{axis.unit}]' if axis.unit else ''}", hang=2)
    for text in judged_lines(found.points[0].controller):
        lines += wrapped(text, hang=2)
    names = [axis.name for axis in found.axes]
    signals = found.points[0].controller.measured
    with_travel = any(point.travel is not None for point in found.points)
    rows: list[tuple[str, ...]] = [("point", *names, *(["bump travel"] * with_travel), "gain")]
    for i in found.marked:
        point = found.points[i]
        travel = ["-" if point.travel is None else f"{1e3 * point.travel:.4g} mm"] * with_travel
        rows.append((str(i + 1), *(f"{value:.6g}" for value in point.values), *travel, _gain(point)))
    lines += ["", f"controller {found.name}: static gains on {', '.join(signals)}", *table(rows)]
    if found.others:
        rows = [("beside them", *names), *((o.controller.name, *(f"{v:.6g}" for v in o.values)) for o in found.others)]
        lines += ["", *table(rows)]
    for name, why in found.missing.items():
        lines += wrapped(f"controller {name} is not shown: {why}", hang=2)
    return [*lines, "", *(line for text in _limit_texts(found) for line in wrapped(text, hang=2))]


def sentences(found: Front) -> list[str]:
    """What it comes to, a sentence each."""
    ends = ", ".join(
        f"{axis.name} from {min(values):.5g} to {max(values):.5g}"
        for axis, values in zip(found.axes, found.values.T.tolist(), strict=True)
        if values
    )
    lines = [f"{len(found.points)} certified designs, none of which another beats in all: {ends}"]
    if found.interrupted not in ("", LATE):
        whole = f"after {found.tried} designs: the front" if found.interrupted == DESIGNING else f"at {found.interrupted}: that"
        lines.append(f"interrupted {whole} is not whole")
    if found.unproved:
        lines.append(f"left out: {found.unproved} designs of which a claim could not be proved")
    for one in found.others:
        beaten = [i for i, point in enumerate(found.points) if _beats(point.values, one.values)]
        if beaten:
            lines.append(
                f"{one.controller.name} is beaten in all by {len(beaten)} of them, e.g. point {beaten[len(beaten) // 2] + 1}"
            )
    return lines


def front_object(found: Front) -> dict[str, Any]:
    """The front as JSON has it: SI units."""
    return {
        "controller": found.name,
        "axes": [
            {
                "name": axis.name,
                "meaning": axis.meaning,
                "unit": axis.unit,
                "signals": dict(axis.norm.signals) if axis.norm.signals is not None else None,
                "band": [finite(edge) for edge in axis.norm.band] if axis.norm.narrow else None,
                "off": axis.off or None,
            }
            for axis in found.axes
        ],
        "points": [{"point": i + 1, **_object(found, point)} for i, point in enumerate(found.points)],
        "others": [{"name": one.controller.name, **_object(found, one)} for one in found.others],
        "missing": found.missing,
        "limits": [_limit_object(found, limit) for limit in found.limits],
        "loads": dict(found.points[0].controller.hardware.loads) if found.points else {},
        "designs": found.tried,
        "unproved": found.unproved,
        "interrupted": bool(found.interrupted),
    }


def write_csv(found: Front, path: Path) -> None:
    """A row to a point and to every other controller, SI units; what is not known is left empty."""
    names = [axis.name for axis in found.axes]
    entries = [f"gain_{i + 1}_{j + 1}" for i, j in _indices(found)]
    with whole_file(path, "csv") as beside, beside.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["point", *names, *(f"{name}_proved" for name in names), "norm", "bound", "bump_travel", *entries])
        for i, point in enumerate(found.points):
            gain = point.controller.gain
            writer.writerow([i + 1, *_cells(point), *(gain[k] for k in _indices(found))])
        for one in found.others:
            writer.writerow([one.controller.name, *_cells(one), *("" for _ in entries)])


def _cells(point: Point) -> list[float | str]:
    own = point.controller.certificate
    numbers = [*point.values, *(norm.proved for norm in point.norms), own.norm.value, own.bound, point.travel]
    return ["" if value is None or not math.isfinite(value) else value for value in numbers]


def _object(found: Front, point: Point) -> dict[str, Any]:
    own, controller = point.controller.certificate, point.controller
    return {
        "values": {axis.name: _norm(norm) for axis, norm in zip(found.axes, point.norms, strict=True)},
        "measured": list(controller.measured),
        "gain": controller.gain.tolist(),
        "norm": finite(own.norm.value),
        "bound": finite(own.bound),
        "bump_travel": point.travel,
    }


def _norm(norm: Norm) -> dict[str, float | None]:
    return {"value": finite(norm.value), "proved": finite(norm.proved), "frequency": finite(norm.at)}


def _limit_object(found: Front, limit: Limit) -> dict[str, Any]:
    return {
        "axes": [found.axes[k].name for k in limit.axes],
        "weights": limit.weights.tolist(),
        "norms": limit.norms.tolist(),
    }


def _limit_texts(found: Front) -> list[str]:
    """How near the front comes to the line, a sentence for every two axes."""
    texts = []
    for limit in found.limits:
        first, second = (found.axes[k].name for k in limit.axes)
        shares = limit.share(found.values[:, list(limit.axes)])
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


def _indices(found: Front) -> list[tuple[int, int]]:
    """Of the entries of the gain."""
    m, q = found.points[0].controller.gain.shape
    return [(i, j) for i in range(m) for j in range(q)]


def _beats(one: Sequence[float], other: Sequence[float]) -> bool:
    return all(a < b for a, b in zip(one, other, strict=True))
