"""The axis of values of a plot in Rerun: one that has numbers.

Rerun labels an axis at powers of ten and their multiples, and leaves out those that come too close. Where the range is left to
it, many a plot has one label, 0. So an axis goes on to the next label where that is near; where it is far, it would take the room
that the curve is seen in. What all of them have is the curves' extremes, in words.
"""

import math
from collections.abc import Iterable

import numpy as np
import rerun.blueprint as rrb

from models.common.arrays import Array

CLOSEST = 7  # steps between labels, from bottom to top; of more, Rerun labels only every tenth on a plot of 190 pixels
LABELS = 2  # are needed to read a value
FURTHEST = 1.3  # times the range: further an axis does not go on to a label
MARGIN = 0.04  # of the range, or of a step, so that neither a peak nor a label is on the border


def value_axis(curves: Iterable[Array]) -> rrb.ScalarAxis | None:
    """An axis that shows the whole of every curve, each of any shape.

    Values that are not finite are left out; where none is, there is no axis to give, and Rerun chooses.
    """
    found = extremes(curves)
    if found is None:
        return None
    low, high = labelled(*found)
    return rrb.ScalarAxis(range=(low, high)) if math.isfinite(high - low) else None


def extremes(curves: Iterable[Array]) -> tuple[float, float] | None:
    """The least and the greatest value of some curves; None where none is finite."""
    finite = [curve[np.isfinite(curve)] for curve in curves]
    ends = [(float(part.min()), float(part.max())) for part in finite if part.size]
    return (min(low for low, _ in ends), max(high for _, high in ends)) if ends else None


def extremes_text(curves: Iterable[Array]) -> str:
    """The same in words; empty where there are none."""
    found = extremes(curves)
    return "" if found is None else " to ".join(dict.fromkeys(f"{value + 0.0:.3g}" for value in found))


def labelled(low: float, high: float) -> tuple[float, float]:
    """The range and a margin; and more where fewer than two labels lie in it, and the next one on the nearer side is near."""
    if high <= low:  # nothing happens: the curve in the middle
        around = abs(low) or 1.0
        low, high = low - around, high + around
    margin = MARGIN * (high - low)
    low, high = low - margin, high + margin
    step, tight = spacing(high - low), (low, high)
    if not 0 < step < math.inf:
        return tight
    while count(low, high, step) < LABELS:
        below, above = step * (math.ceil(low / step) - 1 - MARGIN), step * (math.floor(high / step) + 1 + MARGIN)
        low, high = (below, high) if low - below < above - high else (low, above)
    return (low, high) if high - low <= FURTHEST * (tight[1] - tight[0]) else tight


def spacing(span: float) -> float:
    """From one label to the next on an axis of this length, in the axis's own unit."""
    return 10.0 ** math.ceil(math.log10(span) - math.log10(CLOSEST))


def count(low: float, high: float, step: float) -> int:
    """How many multiples of a step lie in a range."""
    return math.floor(high / step) - math.ceil(low / step) + 1
