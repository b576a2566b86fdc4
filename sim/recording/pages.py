"""Pages of plots that viewers show for a recording. Rerun and Foxglove show the same pages."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from models.document.figure import BLACK, OTHERS, STYLES, styles
from models.kinds.signals import Signal, is_kept
from sim.drive.response import Response
from sim.recording.run_log import CONTINUOUS, DAMPERS, LOADS, MEASURED_TOPIC, MUJOCO, SAMPLED, RunLog

if TYPE_CHECKING:
    from sim.runs.force_diagram import Diagram

# Label, opacity and line width of each response. Rerun draws curves in the order of their names, so MuJoCo's line is drawn
# last, as a thin line over the broader lines.
RESPONSES = {CONTINUOUS: ("continuous", "80", 8.0), SAMPLED: ("sampled", "b8", 4.5), MUJOCO: ("MuJoCo", "ff", 1.5)}
NEUTRAL = "#8c8c8c"  # grey replaces the black of the report, because the background of a viewer can be dark or light
LOG_COLOUR = "#ff9f1c"  # colour of a measured log
# colours of curves that are not responses of a run
PALETTE = tuple(dict.fromkeys((*(style.color for style in STYLES.values()), *OTHERS)))[1:]

TRAVEL = "suspension_deflection"
# signals of one corner of a car that the first page shows
OVERVIEW = ("sprung_acceleration", TRAVEL, "tyre_deflection", "control_force")
ROADS = {"road_displacement": "m", "road_velocity": "m/s"}  # road quantities on the last page, with their units
UNGROUPED_SIGNALS = 8  # largest number of signals that are plotted without a division into groups
MOST_ACTIVE = 6  # largest number of controller states that are plotted; the log also contains all other states
CONTROLLER = "controller"  # name of the page that shows the states of a controller
SEEN = 6  # largest number of plots on one page; with more plots, each plot would be too flat
GAP = "difference"  # topic of the differences between the MuJoCo and sampled responses
DIFFERENCE = "difference: MuJoCo - sampled, relative to each signal's peak"


@dataclass(frozen=True, eq=False)
class Curve:
    """Signal in a plot: its run, topic and name, and the style of its line."""

    run: RunLog
    topic: str
    signal: str
    label: str
    color: str
    width: float = 1.5

    @property
    def response(self) -> Response:
        """Response that contains the signal."""
        gap = {} if self.run.gap is None else {GAP: self.run.gap}
        return {**self.run.responses, **self.run.other_signals, **gap}[self.topic]

    @property
    def values(self) -> Array:
        """Values of the signal in the response."""
        return self.response[self.signal]


@dataclass(frozen=True, eq=False)
class Plot:
    """Plot of curves over time or, if the plot has a diagram, of a force against its argument (velocity or deflection)."""

    title: str
    curves: tuple[Curve, ...]
    diagram: "Diagram | None" = None


@dataclass(frozen=True, eq=False)
class Page:
    """Page of plots: its title, its plots in rows, the group of its signals, and the differences of the same signals below the
    plots.
    """

    title: str
    plots: tuple[Plot, ...]
    group: str = ""
    difference: tuple[Curve, ...] = ()

    @property
    def columns(self) -> int:
        """Number of plots in a row of the page."""
        return 1 if len(self.plots) == 1 else 2 if len(self.plots) <= 4 else 3


def colour_of(runs: Sequence[RunLog], run: RunLog) -> str:
    """Returns the colour of a run's curves, which is the same as in the report, but grey instead of black."""
    color = styles(tuple(other.name for other in runs))[run.name].color
    return NEUTRAL if color == BLACK else color


def pages(runs: Sequence[RunLog], seen: Sequence[RunLog]) -> list[Page]:
    """Returns the pages of a single run with all its responses, loads and diagrams, or the pages of several runs with one curve
    for each run.

    The first page is the overview. The last page shows the road, which is the same for all responses.
    """
    run, color, alone, found = seen[0], colour_of(runs, seen[0]), len(seen) == 1, []
    for group, signals in groups(seen).items():
        curves = [response_curves(run, signal, color) if alone else _compared_curves(seen, signal) for signal in signals]
        plots = [Plot(_heading(signal), tuple(some)) for signal, some in zip(signals, curves, strict=True)]
        gap = differences(run, signals) if alone else ()
        found += [Page(name, part, group, gap) for name, part in _parts(_title(run, group), plots)]
    if alone and LOADS in run.other_signals:
        loads = [(_heading(signal), signal.name) for signal in run.other_signals[LOADS].signals]
        plots = [Plot(title, (Curve(run, LOADS, name, name.replace("_", " "), color),)) for title, name in loads]
        found.append(Page(LOADS, tuple(plots)))
    if alone and DAMPERS in run.other_signals:
        found.append(Page("dampers and springs", tuple(_diagram(run, one, color) for one in run.diagrams)))
    roads = tuple(plot for quantity in ROADS if (plot := _road(seen, quantity)).curves)
    return [*found, Page("road", roads)] if roads else found


def response_curves(run: RunLog, signal: Signal, color: str) -> Iterator[Curve]:
    """Yields the curves of a signal, one for each response of a run."""
    for topic, response in run.responses.items():
        if signal.name in response.names:
            label, opacity, width = RESPONSES[topic]
            yield Curve(run, topic, signal.name, label, color + opacity, width)
    yield from _measured_curve(run, signal)


def _measured_curve(run: RunLog, signal: Signal) -> Iterator[Curve]:
    """Yields the measured curve of a signal, if the run is compared with a measured log that contains this signal."""
    if MEASURED_TOPIC in run.other_signals and signal.name in run.other_signals[MEASURED_TOPIC].names:
        yield Curve(run, MEASURED_TOPIC, signal.name, "measured", LOG_COLOUR, 2.5)


def _compared_curves(runs: Sequence[RunLog], signal: Signal) -> Iterator[Curve]:
    # Rerun draws curves in the order of their names, and each line is thinner than the previous one, so that a curve behind
    # another curve remains visible.
    names = sorted((run.name for run in runs), reverse=True)
    for run in runs:
        if signal.name in run.responses[MUJOCO].names:
            yield Curve(run, MUJOCO, signal.name, run.name, colour_of(runs, run), min(1.5 + names.index(run.name), 5.0))
    yield from next(filter(None, ([*_measured_curve(run, signal)] for run in runs)), ())


def _road(runs: Sequence[RunLog], quantity: str) -> Plot:
    """Returns the plot of a road quantity. If several wheels or runs have equal curves, the curve is drawn once."""
    curves: dict[bytes, Curve] = {}
    for run in runs:
        for name in (name for name in run.responses[MUJOCO].names if name.startswith(quantity)):
            label = (" ".join(name.split("_")[2:]) or "road") + (f", {run.name}" if run is not runs[0] else "")
            curve = Curve(run, MUJOCO, name, label, PALETTE[len(curves) % len(PALETTE)])
            curves.setdefault(curve.values.tobytes(), curve)
    return Plot(f"{quantity.replace('_', ' ')}   [{ROADS[quantity]}]", tuple(curves.values()))


def _diagram(run: RunLog, one: "Diagram", color: str) -> Plot:
    lines = [Curve(run, DAMPERS, line.signal.name, line.label, NEUTRAL, line.width) for line in one.lines]
    title = f"{one.title}: force [{one.pull.unit}] over {one.over}"
    return Plot(title, (*lines, Curve(run, DAMPERS, one.pull.name, "MuJoCo", color)), one)


def differences(run: RunLog, signals: Sequence[Signal]) -> tuple[Curve, ...]:
    """Returns curves of the difference between the MuJoCo and the sampled response for some signals.

    Signals without a difference are omitted.
    """
    names = [signal.name for signal in signals if run.gap is not None and signal.name in run.gap.names]
    return tuple(Curve(run, GAP, name, name.replace("_", " "), PALETTE[i % len(PALETTE)]) for i, name in enumerate(names))


def signals_of(runs: Sequence[RunLog]) -> tuple[Signal, ...]:
    """Returns the signals of all responses, without duplicates, in the order in which they first appear."""
    signals = {signal.name: signal for run in runs for response in run.responses.values() for signal in response.signals}
    return tuple(signals.values())


def groups(runs: Sequence[RunLog]) -> dict[str, tuple[Signal, ...]]:
    """Returns the signals of runs by page, without the road signals.

    The groups of signals are the overview, all other signals and, for a single run, the states of its controller.

    The overview shows the signals of the corner with the largest suspension travel. If there are many other signals, these
    signals are grouped by type. Types with only one or two signals, such as heave and pitch, share a page.
    """
    signals = [signal for signal in signals_of(runs) if not is_kept(signal) and not signal.name.startswith((*ROADS,))]
    named = {signal.name: signal for signal in signals}
    corners = [name.removeprefix(TRAVEL) for name in named if name.startswith(TRAVEL)]
    corner = max(corners, key=lambda one: _peak(runs, TRAVEL + one), default="")
    overview = [named[name + corner] for name in OVERVIEW if name + corner in named]
    # for a vehicle with several corners, these pages compare the corners
    others = [signal for signal in signals if len(corners) > 1 or signal not in overview]
    kinds: dict[str, list[Signal]] = {}
    for signal in others:
        kinds.setdefault(signal.name.split("_")[0] if len(others) > UNGROUPED_SIGNALS else "others", []).append(signal)
    small = [signal for kind in kinds.values() if len(kind) <= 2 for signal in kind]
    large = {name: kind for name, kind in kinds.items() if len(kind) > 2}
    # each controller has its own page, because states of different controllers are different quantities
    active = runs[0].active[:MOST_ACTIVE] if len(runs) == 1 else ()
    kept = [signal for signal in signals_of(runs) if is_kept(signal) and signal.name in active]
    found = {"overview": overview, "car" if large else "others": small, **large, CONTROLLER: kept}
    return {name: tuple(some) for name, some in found.items() if some}


def _peak(runs: Sequence[RunLog], name: str) -> float:
    responses = [run.responses[MUJOCO] for run in runs]
    return max(float(np.nan_to_num(one.peak(name))) if name in one.names else 0.0 for one in responses)


def _title(run: RunLog, group: str) -> str:
    """Returns the title of a run's page, which names the group of its signals. For a controller with many states, the title
    includes how many states are shown.
    """
    if group != CONTROLLER or len(run.active) <= MOST_ACTIVE:
        return group
    return f"{group}: the {MOST_ACTIVE} of {len(run.active)} states that contribute most"


def _heading(signal: Signal) -> str:
    return f"{signal.name.replace('_', ' ')}   {signal.symbol} [{signal.unit}]"


def _parts(name: str, plots: Sequence[Plot]) -> list[tuple[str, tuple[Plot, ...]]]:
    """Returns the plots of a group of signals, divided evenly among pages of at most `SEEN` plots, with the titles of the
    pages.
    """
    count = -(-len(plots) // SEEN)
    each = -(-len(plots) // count)
    parts = [tuple(plots[start : start + each]) for start in range(0, len(plots), each)]
    return [(f"{name} {number}" if count > 1 else name, part) for number, part in enumerate(parts, start=1)]
