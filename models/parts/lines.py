"""Keys and words of the curves of parts."""

from collections.abc import Sequence

from models.characteristics.curve_reading import Argument
from models.common.printed import rough
from models.kinds.kind import Suspension
from models.parts.part import SuspensionPart
from models.parts.registry import PARTS, part_class


def curvable(suspensions: Sequence[Suspension]) -> dict[str, Argument]:
    """Returns the parameters that a curve can replace, each with the curve's argument."""
    over = dict[str, Argument]()
    for name in PARTS:
        if (replaces := part_class(name).replaces) is not None:
            over |= {parameter: replaces[1] for one in suspensions if (parameter := getattr(one, replaces[0]))}
    return over


def lines_at_rest(curves: Sequence[SuspensionPart]) -> str:
    """Describes the lines of curves in linear analysis: slope at rest, and the range of slopes; empty if all are straight.

    Slopes are the elements' own, as in `[parameters]`, without what a preload adds.
    """
    bent = {one.name: one for one in curves if one.curve.bent}
    slopes = {
        name: [(slope - one.part.line.of_preload) / one.ratio**2 for slope in (one.curve.slope, *one.curve.slope_range)]
        for name, one in bent.items()
    }
    return ", ".join(
        f"{name} {rough(at)} (slope of the whole curve: {rough(low)} to {rough(high)})"
        for name, (at, low, high) in slopes.items()
    )
