"""Plots of signals over time. Lines show linear analysis, and points show MuJoCo; after the end of the linear regime, lines
also show MuJoCo.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.common.printed import as_name
from models.document.figure import BLUE, GREY, Curve, Figure, Panel, Style, axis_ends, drawn_indices, styles
from models.kinds.signals import Signal
from sim.drive.response import Response
from sim.observers.results import WHEN
from sim.runs.record import SIZE
from sim.runs.result import RunResult

POINTS = 24  # approximate number of points that show a MuJoCo run
OF_LINE = 600  # number of points of a drawn line
NAMED_RUNS = 2  # largest number of runs that leave the axis and are listed by name in the title of a panel
LINE, DENSE, FAINT = 1.5, 0.6, 0.4  # width of a line, also in a dense plot [points], and factor for a faint line
# largest number of oscillations that one panel shows legibly; if a run has more, additional panels show its most severe part
MOST_SWINGS = 80


@dataclass(frozen=True, eq=False)
class _Trace:
    """One signal of one run in the time interval that is plotted.

    Attributes:
        run: run to which the signal belongs.
        name: name of the signal.
        bounded: True if the run remains valid to its end and the loop is not unstable.
        line: linear response; if the run is not bounded, only up to the end of the linear regime.
        physics: simulated response, up to the time at which the run becomes invalid.
    """

    run: RunResult
    name: str
    bounded: bool
    line: Response
    physics: Response

    @property
    def until(self) -> float:
        """Time at which the linear regime ends [s]."""
        return self.run.agreement.until

    @property
    def values(self) -> Array:
        """Values of this run that the axis must contain. If the run is not bounded, the axis must contain only the values in
        the linear regime.
        """
        physics = self.physics if self.bounded else self.physics.until(self.until)
        return np.concatenate([self.line[self.name], physics[self.name]])

    def left(self, low: float, high: float) -> float:
        """Returns the time at which the simulated signal first leaves the axis from `low` to `high` [s], or infinity."""
        values = self.physics[self.name]
        outside = ~((low <= values) & (values <= high))
        return float(self.physics.time[outside.argmax()]) if outside.any() else math.inf

    def curves(self, style: Style, width: float, every: int, left: float) -> list[Curve]:
        """Returns lines, and points at about every `every`-th sample, until the signal leaves the axis.

        The line shows the linear response until the linear regime ends, and then the simulation. After the end of the linear
        regime, a thin line continues the linear response.
        """
        who, curves = self.run.controller.name, []
        line, physics = (response.until(np.nextafter(left, math.inf)) for response in (self.line, self.physics))
        after = physics.time >= self.until
        for over, wide, label, name in (
            (line.time <= self.until, width, who, ""),
            (line.time >= self.until, FAINT * width, "", f"{who}, linear"),
        ):
            if over.any():
                curves.append(_line(line.time[over], line[self.name][over], style, wide, label, name))
        if after.any():
            values = physics[self.name][after]
            curves.append(_line(physics.time[after], values, style, width, who, f"{who}, MuJoCo"))
        marked = _marker_indices(physics[self.name], every)
        for filled in (False, True):
            some = marked[after[marked] == filled]
            if len(some):
                points = physics.time[some], physics[self.name][some], who
                curves.append(Curve(*points, style.color, "none", style.marker, name=f"{who}, MuJoCo", filled=filled))
        return curves


def _line(time: Array, values: Array, style: Style, width: float, label: str, name: str) -> Curve:
    """Returns a line with at most about `OF_LINE` points, which include all peaks."""
    some = drawn_indices(values, -(-len(time) // OF_LINE))
    return Curve(time[some], values[some], label, style.color, style.dash, width=width, name=name)


def _marker_indices(values: Array, every: int) -> Array:
    """Returns the indices of samples to mark: about every `every`-th sample, moved to a nearby peak if possible, and the
    largest and smallest value.
    """
    if not len(values):
        return np.zeros(0, dtype=int)
    marked = [int(values.argmax()), int(values.argmin())]
    for k in range(0, len(values), every):
        first, last = max(0, k - every // 2), min(len(values), k + every // 2 + 1)
        near = values[first:last]
        peaks = [at for at in (int(near.argmax()), int(near.argmin())) if 0 < at < len(near) - 1]
        marked.append(first + max(peaks, key=lambda at, near=near: abs(float(near[at]))) if peaks else k)
    return np.unique(marked)


def history_panels(
    runs: Sequence[RunResult],
    looks: Mapping[str, Style],
    during: tuple[float, float] | None = None,
    measured: Response | None = None,
) -> list[Panel]:
    """Returns a panel for each weighted or measured signal that moves.

    An unstable run, or a run that becomes invalid, does not enlarge the axis of a panel. An unstable or invalid run is drawn
    until its signal leaves the axis, and the title states this time.

    Args:
        runs: runs over one road.
        looks: colour and line style of each controller, by name.
        during: start and end of the time interval that is plotted [s]; None for the whole run.
        measured: measured signals over the time of the runs, if any.
    """
    panels = []
    start, end = during or (0.0, _end(runs))
    every = max(1, round((end - start) / (POINTS * runs[0].prediction.timestep)))
    logged = None if measured is None else _between(measured, start, end)
    signals = _weighted_signals(runs) | ({} if measured is None else dict(zip(measured.names, measured.signals, strict=True)))
    for name, signal in signals.items():
        traces = [_trace(run, name, start, end) for run in runs if _moves(run, name)]
        if not any(len(trace.values) for trace in traces):
            continue
        words, unit = name.replace("_", " "), signal.unit.replace("s2", "s²")
        of_log = logged[name] if logged is not None and name in logged.names else np.zeros(0)
        low, high = axis_ends([*_seen(traces), *([of_log[np.isfinite(of_log)]] if np.isfinite(of_log).any() else [])])
        dense = during is None and max(_swings(trace.physics[name]) for trace in traces) > MOST_SWINGS
        left = [trace.left(low, high) for trace in traces]
        curves = [
            curve
            for trace, at in zip(traces, left, strict=True)
            for curve in trace.curves(looks[trace.run.controller.name], DENSE if dense else LINE, every, at)
        ]
        if logged is not None and len(of_log):
            curves.insert(0, Curve(logged.time, of_log, "measured", GREY, width=2 * LINE))
        title = f"{words}, {signal.symbol}"
        title += f", from {WHEN.digits(start)} to {WHEN.text(end)}" if during else ""
        gone = sorted((at, trace.run.controller.name) for trace, at in zip(traces, left, strict=True) if at < math.inf)
        named = ", ".join(f"{as_name(who)} at {WHEN.text(at)}" for at, who in gone[:NAMED_RUNS])
        more = f" and {len(gone) - NAMED_RUNS} more" if len(gone) > NAMED_RUNS else ""
        title += f"\nleaves the axis: {named}{more}" if gone and not during else ""
        panels.append(Panel(title, "time [s]", f"{words} [{unit}]", tuple(curves), None, xlim=(start, end), ylim=(low, high)))
    return panels


def _end(runs: Sequence[RunResult]) -> float:
    """Returns the time at which the last run became invalid if all runs did, otherwise the end of the simulated time [s]."""
    whole = float(runs[0].prediction.time[-1])
    return min(whole, max(run.broke_off[1] if run.broke_off is not None else whole for run in runs)) or whole


def _weighted_signals(runs: Sequence[RunResult]) -> dict[str, Signal]:
    """Returns, by name, the signals that have a weight in a vehicle of the runs."""
    vehicles = [run.vehicle for run in runs]
    return {name: one.kind.signal(name) for one in vehicles for name, weight in one.performance.items() if weight > 0}


def _moves(run: RunResult, name: str) -> bool:
    """Returns False if the vehicle does not have the signal, or if the signal is always zero, like the roll angle on a
    symmetrical road.
    """
    if not any(signal.name == name for signal in run.physics.signals):
        return False
    peak = float(run.physics.peak(name))
    return peak != 0 and not peak < run.physics.scale(name)


def _trace(run: RunResult, name: str, start: float, end: float) -> _Trace:
    """Returns the data of one signal of one run between two times [s]."""
    line = run.sampled if _stays_bounded(run) else run.sampled.until(run.agreement.until)
    physics = run.physics.until(run.broke_off[1]) if run.broke_off is not None else run.physics
    return _Trace(run, name, _stays_bounded(run), *(_between(response, start, end) for response in (line, physics)))


def _between(response: Response, start: float, end: float) -> Response:
    """Returns the samples of a response between two times [s]."""
    some = (response.time >= start) & (response.time <= end)
    return response if some.all() else response.samples(some)


def _swings(values: Array) -> int:
    """Returns the number of times that a signal crosses its mean."""
    return int(np.count_nonzero(np.diff(values > values.mean()))) if len(values) else 0


def history_figure(runs: Sequence[RunResult], where: str, measured: Response | None = None) -> Figure | None:
    """Returns the figure of runs over one road, with lines for the sampled loop; None if nothing moves.

    In a long run, the lines are too dense to distinguish. For a long run, the figure therefore also has panels that show only
    the hardest part of the run.

    Args:
        where: text that describes the road and follows the word "over".
        measured: measured signals over the time of the runs, if any.
    """
    looks = styles(tuple(run.controller.name for run in runs))
    panels = history_panels(runs, looks, measured=measured)
    if not panels:
        return None
    columns, note = min(len(panels), 2 if len(panels) <= 4 else 3), ""
    if (during := _hardest_stretch(runs)) is not None:
        near = history_panels(runs, looks, during, measured)
        panels, columns = [panel for pair in zip(panels, near, strict=True) for panel in pair], 2
        note = f". Each signal is shown over the whole run, then from {WHEN.digits(during[0])} to {WHEN.text(during[1])}"
    broken = [
        f"{as_name(run.controller.name)} ended early, at {WHEN.text(off[1])} ({off[0]})"
        for run in runs
        if (off := run.broke_off) is not None
    ]
    note += f". {', '.join(broken)}" if broken else ""
    kind = " and ".join(dict.fromkeys(run.vehicle.kind.name.replace("_", " ") for run in runs))
    lines = "Lines show the exact sampled response, markers show MuJoCo"
    if any(curve.filled for panel in panels for curve in panel.curves):
        lines += ". After the end of the linear regime, thick lines and full markers show MuJoCo, thin lines the sampled response"
    title = f"{kind} over {where}. {lines}{note}"
    return Figure("runs", title, tuple(panels), columns, finding=_least(runs))


def first_history(run: RunResult) -> list[Figure]:
    """Returns the figure of a run's first signal with a weight; an empty list if no such signal moves."""
    panels = history_panels([run], {run.controller.name: Style(BLUE, "solid", "o")})[:1]
    title = "Lines show the exact sampled response, markers show MuJoCo."
    return [Figure("run", title, tuple(panels), columns=1)] if panels else []


def _hardest_stretch(runs: Sequence[RunResult]) -> tuple[float, float] | None:
    """Returns the time interval around the largest peak of the first weighted signal [s]; None if the whole run can be shown
    clearly.

    This time interval contains about `MOST_SWINGS` oscillations of the signal that oscillates most often.
    """
    weighed = list(_weighted_signals(runs))
    bounded_runs = [run for run in runs if _stays_bounded(run)]
    swings = max((_swings(run.physics[name]) for run in bounded_runs for name in weighed if _moves(run, name)), default=0)
    if swings <= MOST_SWINGS:
        return None
    time = runs[0].prediction.time
    first = next(name for name in weighed if any(_moves(run, name) for run in bounded_runs))
    hardest = max((run for run in bounded_runs if _moves(run, first)), key=lambda run: float(run.physics.peak(first)))
    at, whole = float(time[int(np.abs(hardest.physics[first]).argmax())]), float(time[-1])
    length = whole * MOST_SWINGS / swings
    start = min(max(0.0, at - length / 2), whole - length)
    return start, start + length


def _stays_bounded(run: RunResult) -> bool:
    """Returns True if a run has not become invalid, and the loop is not known to be unstable."""
    return run.broke_off is None and not run.prediction.radius >= 1  # for a loop that is not linear, the spectral radius is NaN


def _least(runs: Sequence[RunResult]) -> str:
    """Returns a sentence that states which run has the lowest peak acceleration; empty if fewer than two runs can be compared."""
    name = next((name for name in runs[0].vehicle.performance if name.endswith("acceleration")), "")
    whole = [run for run in runs if name in {signal.name for signal in run.physics.signals} and run.broke_off is None]
    if len(whole) < 2:
        return ""
    peaks = {run.controller.name: float(run.physics.peak(name)) for run in whole}
    least, most = min(peaks, key=lambda one: peaks[one]), max(peaks, key=lambda one: peaks[one])
    words, unit = name.replace("_", " "), runs[0].vehicle.kind.signal(name).unit.replace("s2", "s²")
    lowest, highest = (SIZE.digits(peaks[one]) for one in (least, most))
    return f"{as_name(least)} has the lowest peak of {words}, {lowest} {unit}; {as_name(most)} has {highest}."


def _seen(traces: Sequence[_Trace]) -> list[Array]:
    """Returns the values of all runs that the axis of a panel must contain. Values of runs that are not bounded are clipped to
    three times the range of the bounded runs.

    If no run is bounded, the clipping range follows from the values in the linear regime.
    """
    within = [one.values for one in traces if one.bounded and len(one.values)]
    alone = not within
    within = within or [one.values for one in traces]
    low, high = (float(end(np.concatenate(within))) for end in (np.min, np.max))
    size = high - low
    return [
        one.values if one.bounded else np.clip(one.physics[one.name] if alone else one.values, low - size, high + size)
        for one in traces
    ]
