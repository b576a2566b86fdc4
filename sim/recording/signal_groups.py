"""What any viewer shows of runs' signals: which stand together, in which colours, and what stands for a run."""

from collections.abc import Sequence

from models.figures.figure import OTHERS, STYLES
from models.signals import Signal, is_kept
from sim.recording.format import CONTINUOUS, MUJOCO, SAMPLED
from sim.recording.run_log import RunLog

# Rerun draws in the order of names, so physics comes last: a thin line within broad ones. Where it leaves them, all are
# seen. By response: (label, share of white in the run's colour, width).
RESPONSES = {CONTINUOUS: ("continuous", 0.78, 8.0), SAMPLED: ("sampled", 0.5, 4.5), MUJOCO: ("MuJoCo", 0.0, 1.5)}

PALETTE = (*(color for color, _ in STYLES.values()), *OTHERS)  # of curves that stand for no run

GROUPED = 8  # signals; more than a screen holds in one grid
MOST_ACTIVE = 6  # states of a controller that have a plot; the others are in the log
CONTROLLER = "controller"  # the page of its states


def signals_of(runs: Sequence[RunLog]) -> tuple[Signal, ...]:
    """Every signal that some response has, once, by name, in order of appearance."""
    found = {signal.name: signal for run in runs for response in run.responses.values() for signal in response.signals}
    return tuple(found.values())


def plotted(run: RunLog) -> tuple[Signal, ...]:
    """The signals of a run that have a plot: of a controller's states those that do most, in the order of the log."""
    return tuple(signal for signal in signals_of([run]) if not is_kept(signal) or signal.name in run.active[:MOST_ACTIVE])


def compared(runs: Sequence[RunLog]) -> tuple[Signal, ...]:
    """The signals that are the same quantity in all runs: no controller's states, which every controller has its own of."""
    return tuple(signal for signal in signals_of(runs) if not is_kept(signal))


def groups(signals: Sequence[Signal]) -> dict[str, tuple[Signal, ...]]:
    """Signals as they share a page: all on one that is called `signals`, or, where they are many, by kind.

    The states of a controller have a page of their own, the last.
    """
    kept = tuple(signal for signal in signals if is_kept(signal))
    if kept:
        return {**groups([signal for signal in signals if not is_kept(signal)]), CONTROLLER: kept}
    if len(signals) <= GROUPED:
        return {"signals": tuple(signals)}
    kinds: dict[str, list[Signal]] = {}
    for signal in signals:
        kinds.setdefault(signal.name.split("_")[0], []).append(signal)
    # What comes once or twice, as heave and pitch do, shares a page, which is seen first.
    found = {"car": tuple(signal for kind in kinds.values() if len(kind) <= 2 for signal in kind)}
    found |= {name: tuple(kind) for name, kind in kinds.items() if len(kind) > 2}
    return {name: kind for name, kind in found.items() if kind}


def title(run: RunLog, group: str) -> str:
    """What a page of a run is called: its group and, where the states of a controller are many, how many of them it shows."""
    if group != CONTROLLER or len(run.active) <= MOST_ACTIVE:
        return group
    return f"{group}: the {MOST_ACTIVE} of {len(run.active)} states that ask for most"


def shown(run: RunLog) -> str:
    """The response that stands for a run: its physics."""
    return MUJOCO if MUJOCO in run.responses else next(iter(run.responses))
