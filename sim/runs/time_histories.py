"""Signals of runs over time, drawn: MuJoCo's points over the lines of analysis."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.figures.axis import axis_of
from models.figures.figure import Curve, Figure, Panel, Style, styles, thinned
from sim.runs.run import Run

POINTS = 24  # of MuJoCo
OF_LINE = 600  # points of a line


@dataclass(frozen=True, eq=False)
class _Drawn:
    """Curves of one run in a panel.

    Attributes:
        curves: its line and its points.
        values: values that the axis should hold.
        bounded: True if they have a bound.
    """

    curves: tuple[Curve, ...]
    values: Array
    bounded: bool


def history_panels(
    runs: Sequence[Run], looks: Mapping[str, Style], bounded: Callable[[Run], bool], continuous: bool
) -> list[Panel]:
    """Returns a panel for each weighed signal that moves.

    Args:
        runs: over one road.
        looks: of the controllers, by name.
        bounded: returns False of a run whose motion after the linear regime is no vehicle's: an unstable loop, or one that broke
            off. Its line ends with its linear regime, its points where it breaks off.
        continuous: True for lines of the continuous loop; else of the sampled one.
    """
    vehicle, panels = runs[0].vehicle, []
    for name in (name for name, weight in vehicle.performance.items() if weight > 0):
        drawn = [one for run in runs if (one := _drawn(run, name, looks[run.controller.name], bounded(run), continuous))]
        curves = [curve for one in drawn for curve in one.curves]
        if not curves:
            continue
        signal = vehicle.kind.signal(name)
        words, unit = name.replace("_", " "), signal.unit.replace("s2", "s²")
        seen = axis_of(_seen(drawn), None, log=False)
        limits = (0.0, float(runs[0].prediction.time[-1])), (seen.low, seen.high)
        title = f"{words}, {signal.symbol}"
        panels.append(Panel(title, "time [s]", f"{words} [{unit}]", tuple(curves), None, xlim=limits[0], ylim=limits[1]))
    return panels


def columns_of(panels: Sequence[Panel]) -> int:
    """Returns the number of columns that they are drawn in."""
    return min(len(panels), 2 if len(panels) <= 4 else 3)


def history_figure(runs: Sequence[Run], where: str) -> Figure | None:
    """Returns the figure of runs over one road, lines of the sampled loop; None if nothing moves.

    Args:
        where: the road in words, after "over".
    """
    panels = history_panels(runs, styles(tuple(run.controller.name for run in runs)), _bounded, continuous=False)
    if not panels:
        return None
    full = any(curve.filled for panel in panels for curve in panel.curves)
    ended = "; full ones once the linear regime has ended" if full else ""
    kind = runs[0].vehicle.kind.name.replace("_", " ")
    title = f"{kind} over {where}. Lines: exact sampled response. Markers: MuJoCo{ended}"
    return Figure("runs", title, tuple(panels), columns_of(panels), (5.0, 3.2), finding=_least(runs))


def _bounded(run: Run) -> bool:
    """Returns True if a run has not broken off and its loop is stable."""
    return run.broke_off is None and run.prediction.radius < 1


def acceleration_peaks(runs: Sequence[Run]) -> tuple[str, dict[str, float]]:
    """Returns the first weighed acceleration and its peaks in MuJoCo by controller, without runs that broke off.

    Without a choice, of fewer than two, the name and the peaks are empty.
    """
    name = next((name for name in runs[0].vehicle.performance if name.endswith("acceleration")), "")
    peaks = {run.controller.name: float(run.physics.peak(name)) for run in runs if name and run.broke_off is None}
    return (name, peaks) if len(peaks) > 1 else ("", {})


def _least(runs: Sequence[Run]) -> str:
    """Returns a sentence on the run with the lowest peak of the acceleration, or an empty one without a choice."""
    name, peaks = acceleration_peaks(runs)
    if not name:
        return ""
    least, most = min(peaks, key=lambda one: peaks[one]), max(peaks, key=lambda one: peaks[one])
    words, unit = name.replace("_", " "), runs[0].vehicle.kind.signal(name).unit.replace("s2", "s²")
    return f"{least} has the lowest peak of {words}, {peaks[least]:.3g} {unit}; {most} has {peaks[most]:.3g}"


def _drawn(run: Run, name: str, style: Style, bounded: bool, continuous: bool) -> _Drawn | None:
    """Draws one signal of one run, or returns None if the signal is silent: no control force, or no roll on a symmetric road."""
    if float(run.physics.peak(name)) < run.physics.scale(name):
        return None
    until = run.agreement.until
    end = run.broke_off[1] if run.broke_off is not None else math.inf
    every = max(1, len(run.physics.time) // POINTS)
    curves, seen = [], [np.zeros(0)]
    line = (run.continuous if continuous else run.sampled).until(math.inf if bounded else until)
    if len(line.time):
        thin = thinned(line[name], max(1, len(line.time) // OF_LINE))
        curves.append(Curve(line.time[thin], line[name][thin], run.controller.name, style.color, style.dash))
        seen.append(line[name])
    time, values = run.physics.time[::every], run.physics[name][::every]
    for filled, some in ((False, time < until), (True, (until <= time) & (time < end))):
        if some.any():
            seen_as = f"{run.controller.name}, MuJoCo"
            points = time[some], values[some], run.controller.name
            curves.append(Curve(*points, style.color, "none", style.marker, name=seen_as, filled=filled))
        if bounded or not filled:
            seen.append(values[some])
    return _Drawn(tuple(curves), np.concatenate(seen), bounded)


def _seen(drawn: Sequence[_Drawn]) -> list[Array]:
    """Returns the values that an axis has to hold: all bounded ones, and others up to three times as far."""
    within = [one.values for one in drawn if one.bounded]
    if not within:
        return [one.values for one in drawn]
    low, high = (float(end(np.concatenate(within))) for end in (np.min, np.max))
    size = high - low
    return [one.values if one.bounded else np.clip(one.values, low - size, high + size) for one in drawn]
