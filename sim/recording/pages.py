"""Pages of plots that viewers show of a recording, the same for Rerun and Foxglove."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from models.common.arrays import Array
from models.document.figure import OTHERS, STYLES, styles, tint
from models.kinds.signals import Signal, is_kept
from sim.recording.run_log import CONTINUOUS, DAMPERS, LOADS, MUJOCO, SAMPLED, RunLog, shown
from sim.response.response import Response

if TYPE_CHECKING:
    from sim.runs.force_diagram import Diagram

# By response: (label, share of white in the run's colour, width). Rerun draws in the order of names, so MuJoCo's comes last, as a
# thin line within broad ones.
RESPONSES = {CONTINUOUS: ("continuous", 0.78, 8.0), SAMPLED: ("sampled", 0.5, 4.5), MUJOCO: ("MuJoCo", 0.0, 1.5)}
ANY_RESPONSE = (0.3, 2.0)
PALETTE = tuple(dict.fromkeys((*(style.color for style in STYLES.values()), *OTHERS)))  # of curves that belong to no run

GROUPED = 8  # signals that need no groups
MOST_ACTIVE = 6  # plotted states of a controller; the others are only in the log
CONTROLLER = "controller"  # page of these states
SEEN = 6  # plots on one page; more would be too flat to read
GAP = "difference"  # topic of differences
DIFFERENCE = "difference: MuJoCo - sampled, of each signal's peak"


@dataclass(frozen=True, eq=False)
class Curve:
    """A signal in a plot: run, topic and name of the signal, and how it is drawn."""

    run: RunLog
    topic: str
    signal: str
    label: str
    color: str
    width: float = 1.5

    @property
    def response(self) -> Response:
        """The response that has the signal."""
        gap = {} if self.run.gap is None else {GAP: self.run.gap}
        return {**self.run.responses, **self.run.acting, **gap}[self.topic]

    @property
    def values(self) -> Array:
        """The signal's values."""
        return self.response[self.signal]


@dataclass(frozen=True, eq=False)
class Plot:
    """Curves over time, or a force over its argument if there is a diagram."""

    title: str
    curves: tuple[Curve, ...]
    diagram: "Diagram | None" = None


@dataclass(frozen=True, eq=False)
class Page:
    """Plots that are seen together.

    Attributes:
        title: title of the page.
        plots: the plots, in rows.
        columns: plots in a row.
        group: the group of signals whose differences are shown below; empty without.
        difference: curves of these differences.
    """

    title: str
    plots: tuple[Plot, ...]
    columns: int
    group: str = ""
    difference: tuple[Curve, ...] = ()


def colour_of(runs: Sequence[RunLog], run: RunLog) -> str:
    """Returns the report's colour of a run."""
    return styles(tuple(other.name for other in runs))[run.name].color


def look(response: str) -> tuple[str, float, float]:
    """Returns label, share of white and width of a response."""
    return RESPONSES.get(response, (response, *ANY_RESPONSE))


def run_pages(run: RunLog, color: str) -> list[Page]:
    """Returns the pages of one run: its responses, the loads, and the diagrams of dampers and springs."""
    pages = []
    for group, signals in groups(plotted(run)).items():
        gap = differences(run, signals)
        for name, part in _parts(_title(run, group), signals):
            plots = []
            for signal in part:
                topics = [topic for topic, response in run.responses.items() if signal.name in response.names]
                looks = [(topic, *look(topic)) for topic in topics]
                curves = (Curve(run, topic, signal.name, label, tint(color, white), wide) for topic, label, white, wide in looks)
                plots.append(Plot(_heading(signal), tuple(curves)))
            pages.append(Page(name, tuple(plots), 2, group, gap))
    if LOADS in run.acting:
        plots = [
            Plot(_heading(signal), (Curve(run, LOADS, signal.name, signal.name.replace("_", " "), color),))
            for signal in run.acting[LOADS].signals
        ]
        pages.append(Page(LOADS, tuple(plots), 2 if len(plots) > 3 else 1))
    if DAMPERS in run.acting:
        plots = [
            Plot(
                f"{one.title}: force [{one.pull.unit}] over {one.over}",
                (
                    *(Curve(run, DAMPERS, line.signal.name, line.label, "#111111", line.width) for line in one.lines),
                    Curve(run, DAMPERS, one.pull.name, "MuJoCo", color),
                ),
                one,
            )
            for one in run.diagrams
        ]
        pages.append(Page("dampers and springs", tuple(plots), 2 if len(plots) > 1 else 1))
    return pages


def differences(run: RunLog, signals: Sequence[Signal]) -> tuple[Curve, ...]:
    """Returns MuJoCo minus sampled of some signals, without those that have no difference."""
    names = [signal.name for signal in signals if run.gap is not None and signal.name in run.gap.names]
    return tuple(Curve(run, GAP, name, name.replace("_", " "), PALETTE[i % len(PALETTE)]) for i, name in enumerate(names))


def compared_pages(runs: Sequence[RunLog]) -> list[Page]:
    """Returns the pages of all runs: each signal of MuJoCo, with a curve for each run."""
    signals = [signal for signal in signals_of(runs) if not is_kept(signal)]  # states of controllers are different quantities
    # Rerun draws in the order of names: thinner towards the last one, so that a curve behind another stays visible.
    names = sorted((run.name for run in runs), reverse=True)
    looks = {run.name: (colour_of(runs, run), min(1.5 + names.index(run.name), 5.0)) for run in runs}
    pages = []
    for group, members in groups(signals).items():
        for name, part in _parts(group, members):
            plots = []
            for signal in part:
                having = [run for run in runs if signal.name in run.responses[shown(run)].names]
                curves = (Curve(run, shown(run), signal.name, run.name, *looks[run.name]) for run in having)
                plots.append(Plot(_heading(signal), tuple(curves)))
            pages.append(Page(name, tuple(plots), 3 if len(part) > 4 else 2))
    return pages


def signals_of(runs: Sequence[RunLog]) -> tuple[Signal, ...]:
    """Returns the signals of all responses, without duplicates, in order of appearance."""
    signals = {signal.name: signal for run in runs for response in run.responses.values() for signal in response.signals}
    return tuple(signals.values())


def plotted(run: RunLog) -> tuple[Signal, ...]:
    """Returns the signals of a run to plot, in the order of the log; of a controller's states only the most active."""
    return tuple(signal for signal in signals_of([run]) if not is_kept(signal) or signal.name in run.active[:MOST_ACTIVE])


def groups(signals: Sequence[Signal]) -> dict[str, tuple[Signal, ...]]:
    """Returns signals by page: one page `signals` or, for many signals, one for each kind; controller states come last."""
    kept = tuple(signal for signal in signals if is_kept(signal))
    if kept:
        return {**groups([signal for signal in signals if not is_kept(signal)]), CONTROLLER: kept}
    if len(signals) <= GROUPED:
        return {"signals": tuple(signals)}
    kinds: dict[str, list[Signal]] = {}
    for signal in signals:
        kinds.setdefault(signal.name.split("_")[0], []).append(signal)
    # Kinds with one or two signals, as heave and pitch, share the first page.
    grouped = {"car": tuple(signal for kind in kinds.values() if len(kind) <= 2 for signal in kind)}
    grouped |= {name: tuple(kind) for name, kind in kinds.items() if len(kind) > 2}
    return {name: kind for name, kind in grouped.items() if kind}


def _title(run: RunLog, group: str) -> str:
    """Returns the title of a run's page: its group and, if the controller has many states, the number shown."""
    if group != CONTROLLER or len(run.active) <= MOST_ACTIVE:
        return group
    return f"{group}: the {MOST_ACTIVE} of {len(run.active)} states that contribute most"


def _heading(signal: Signal) -> str:
    return f"{signal.name.replace('_', ' ')}   {signal.symbol} [{signal.unit}]"


def _parts(name: str, group: Sequence[Signal]) -> list[tuple[str, Sequence[Signal]]]:
    """Returns a group's signals, divided evenly among pages of at most `SEEN`, with their titles."""
    count = -(-len(group) // SEEN)
    each = -(-len(group) // count)
    parts = [group[start : start + each] for start in range(0, len(group), each)]
    return [(f"{name} {number}" if count > 1 else name, part) for number, part in enumerate(parts, start=1)]
