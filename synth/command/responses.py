"""`--picture`: how much of every frequency of the road comes to z, and the bands that goals speak of."""

from collections.abc import Sequence

import numpy as np

from models.document.figure import Curve, Figure, Panel, Spans, styles
from models.laws.goals import NormBound
from models.vehicle.vehicle import Vehicle
from synth.analysis.norm import largest_singular_values
from synth.command.table import Row
from synth.controller.report import NORM

SHOWN = (0.3, 30.0)  # Hz; a band that lies further out widens it
POINTS = 1500
ROOM = 1.5  # times a band that is shown whole


def responses_figure(vehicle: Vehicle, rows: Sequence[Row]) -> Figure | None:
    """Returns the figure of frequency responses, or None if no loop is stable."""
    stable = [row for row in rows if row.controller is not None and row.controller.certificate.stable]
    if not stable:
        return None
    bands = _bands(vehicle, stable)
    ends = [end for band in bands for end in band if 0 < end < np.inf]
    low, high = min([SHOWN[0], *(end / ROOM for end in ends)]), max([SHOWN[1], *(end * ROOM for end in ends)])
    hertz, style, curves = np.geomspace(low, high, POINTS), styles(tuple(row.name for row in stable)), []
    for row in stable:
        assert row.controller is not None
        gains = largest_singular_values(row.controller.loop(vehicle).frequency_response(2 * np.pi * hertz))
        look = style[row.name]
        curves.append(Curve(hertz, gains, row.name, look.color, look.dash))
        for band, level in _levels(vehicle, row):
            across = np.clip(np.array(band), low, high)
            curves.append(
                Curve(across, np.full(2, level), "", look.color, "solid", width=2.5, name=f"{row.name}, proved in the band")
            )
    names = tuple(f"{a:g} to {b:g} Hz, a goal's band" for a, b in bands)
    title = (
        f"{vehicle.kind.name.replace('_', ' ')}: the most of a sinusoid of the road's velocity that comes to z; a band that a "
        "goal speaks of is shaded, and what is proved in it drawn across"
    )
    panel = Panel(
        "",
        "frequency [Hz]",
        "largest gain from w to z",
        tuple(curves),
        ground=Spans(tuple(bands), names) if bands else None,
        xlog=True,
        ylog=True,
        xlim=(low, high),
    )
    least = min((one for one in curves if one.label), key=lambda one: float(np.max(one.y)))
    finding = f"{least.label} has the lowest peak: {NORM.digits(float(np.max(least.y)))}." if len(stable) > 1 else ""
    return Figure("responses", title, (panel,), 1, finding)


def _bands(vehicle: Vehicle, rows: Sequence[Row]) -> list[tuple[float, float]]:
    """The bands of the rows' goals of `[performance]` [Hz], each once."""
    bands = {}
    for row in rows:
        goals = vehicle.controllers[row.name].goals if row.name in vehicle.controllers else None
        norms = [goals.minimise, *(bound.norm for bound in goals.bounds if isinstance(bound, NormBound))] if goals else []
        bands |= dict.fromkeys(norm.band for norm in norms if norm.narrow and norm.signals is None)
    return list(bands)


def _levels(vehicle: Vehicle, row: Row) -> list[tuple[tuple[float, float], float]]:
    """Returns the proved levels in the bands of a controller's goals, without errors."""
    goals = vehicle.controllers[row.name].goals if row.name in vehicle.controllers else None
    if goals is None or row.controller is None or goals.family:
        return []
    proved = {promise.what: promise.proved for promise in row.controller.specifications}
    norms = [goals.minimise, *(bound.norm for bound in goals.bounds if isinstance(bound, NormBound))]
    levels = [(norm.band, proved.get(norm.text)) for norm in norms if norm.narrow and norm.signals is None]
    return [(band, level) for band, level in levels if level is not None and np.isfinite(level)]
