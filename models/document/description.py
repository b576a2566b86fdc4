"""Text descriptions of the panels of figures; every figure has such a description as its text alternative."""

import numpy as np

from models.document.figure import Bars, Classes, Panel, Spans


def quantity(label: str) -> tuple[str, str]:
    """Returns the name and the unit in an axis label `name [unit]`. The name or the unit may be empty."""
    name, _, unit = label.partition("[")
    return name.strip(), unit.removesuffix("]").strip()


def about(panel: Panel) -> tuple[str, str]:
    """Returns a panel's title on one line, and a description of its content."""
    across, down = (" ".join(filter(None, quantity(label))) for label in (panel.xlabel, panel.ylabel))
    title = panel.title.replace("\n", "; ") or f"{down} over {across}"
    return title, " ".join([*_ground(panel), *_curves(panel)])


def _ground(panel: Panel) -> list[str]:
    ground = panel.ground
    if isinstance(ground, Bars):
        return [f"{name}: {words}." for name, words in zip(ground.names, ground.words, strict=True)]
    if isinstance(ground, Spans):
        return [f"Shaded: {', '.join(ground.names)}."] if ground.names else []
    if isinstance(ground, Classes):
        shares = [(name, float(np.mean(ground.kind == i))) for i, name in enumerate(ground.names)]
        return ["Shares of the map:", *(f"{name}, {100 * share:.3g} %;" for name, share in shares if share), "and on it:"]
    return []


def _curves(panel: Panel) -> list[str]:
    """Returns a text description of each curve: the extremes and the last value of a line, or the number of points."""
    (_, unit), (_, per) = quantity(panel.ylabel), quantity(panel.xlabel)
    descriptions = []

    def at(x: float) -> str:
        return panel.xnames[panel.xticks.index(x)] if x in panel.xticks and panel.xnames else f"{x:.3g} {per}".rstrip()

    for curve in panel.curves:
        name, there = curve.name or curve.label, np.isfinite(curve.y) & np.isfinite(curve.x)
        if not name or not there.any():
            continue
        x, y = np.asarray(curve.x)[there], np.asarray(curve.y)[there] + 0.0  # adding 0.0 turns -0.0 into 0.0
        if curve.dash == "none":
            descriptions.append(f"{name}: {len(x)} point{'s' if len(x) > 1 else ''}.")
        else:
            top, low = int(y.argmax()), int(y.argmin())
            size = f"{y[top]:.3g} {unit}".rstrip()
            largest, least = f"largest {size} at {at(x[top])}", f"least {y[low]:.3g} at {at(x[low])}"
            descriptions.append(f"{name}: {largest}, {least}, at the end {y[-1]:.3g}.")
    return ["As drawn,", *descriptions] if any(" largest " in words for words in descriptions) else descriptions
