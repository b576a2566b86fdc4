"""`--picture`: figure of the gain from the road to z as a function of frequency; the figure also shows the frequency bands of
goals.
"""

from collections.abc import Sequence

import numpy as np

from models.document.figure import Curve, Figure, Panel, Spans, styles
from models.laws.goals import NormBound, NormOf
from models.vehicle.vehicle import Vehicle
from synth.analysis.norm import Norm, largest_singular_values
from synth.command.table import Row
from synth.controller.report import NORM

SHOWN_BAND = (0.3, 30.0)  # frequency range of the figure [Hz]; a goal whose band lies outside this range extends the range
POINTS = 1500  # number of frequencies at which each curve is computed
ROOM = 1.5  # factor by which the figure extends beyond the frequency bands of the goals


def responses_figure(vehicle: Vehicle, rows: Sequence[Row]) -> Figure | None:
    """Returns the figure of the frequency responses; None if no loop is stable."""
    stable = [row for row in rows if row.controller is not None and row.controller.certificate.stable]
    if not stable:
        return None
    bands = dict.fromkeys(norm.band for row in stable for norm in _norms(vehicle, row))
    ends = [end for band in bands for end in band if 0 < end < np.inf]
    low, high = min([SHOWN_BAND[0], *(end / ROOM for end in ends)]), max([SHOWN_BAND[1], *(end * ROOM for end in ends)])
    style, curves, norms = styles(tuple(row.name for row in stable)), [], dict[str, Norm]()
    for row in stable:
        assert row.controller is not None
        whole = norms[row.name] = row.controller.certificate.norm
        at = whole.peak_frequency / (2 * np.pi)
        hertz = np.union1d(np.geomspace(low, high, POINTS), [at] if low < at < high else [])  # adds the peak frequency
        gains = largest_singular_values(row.controller.loop(vehicle).frequency_response(2 * np.pi * hertz))
        look = style[row.name]
        curves.append(Curve(hertz, gains, row.name, look.color, look.dash))
        # these levels hold for a single vehicle without gain errors
        proved = {one.what: one.proved for one in row.controller.specifications}
        for norm in _norms(vehicle, row):
            if np.isfinite(level := proved.get(norm.text) or np.inf):
                across, name = np.clip(np.array(norm.band), low, high), f"{row.name}: level proved in the band"
                curves.append(Curve(across, np.full(2, level), "", look.color, "solid", width=2.5, name=name))
    names = tuple(f"goal from {a:g} to {b:g} Hz" for a, b in bands)
    title = (
        f"{vehicle.kind.name.replace('_', ' ')}: largest gain from road velocity w to z over frequency; shaded are the "
        "frequency bands of goals, with a line at the level that is proved in the band"
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
    least = min(norms, key=lambda name: norms[name].value)
    finding = f"{least} has the lowest norm: {NORM.digits(norms[least].value)}." if len(stable) > 1 else ""
    return Figure("responses", title, (panel,), 1, finding)


def _norms(vehicle: Vehicle, row: Row) -> list[NormOf]:
    """Returns those goals of a controller that limit, in a frequency band, the norm of z as defined in `[performance]`."""
    goals = vehicle.controllers[row.name].goals if row.name in vehicle.controllers else None
    norms = [goals.minimise, *(bound for bound in goals.bounds if isinstance(bound, NormBound))] if goals else []
    return [norm for norm in norms if norm.narrow and norm.signals is None]
