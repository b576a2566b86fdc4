"""What any viewer shows of runs' signals: which stand together, in which colours, and what stands for a run."""

from collections.abc import Sequence

from models.signals import Signal
from sim.figures.figure import OTHERS, STYLES
from sim.recording.format import CONTINUOUS, MUJOCO, SAMPLED
from sim.recording.run_log import RunLog

# Rerun draws in the order of names, so physics comes last: a thin line within broad ones. Where it leaves them, all are
# seen. By response: (label, share of white in the run's colour, width).
RESPONSES = {CONTINUOUS: ("continuous", 0.78, 8.0), SAMPLED: ("sampled", 0.5, 4.5), MUJOCO: ("MuJoCo", 0.0, 1.5)}

PALETTE = (*(color for color, _ in STYLES.values()), *OTHERS)  # of curves that stand for no run

GROUPED = 8  # signals; more than a screen holds in one grid


def signals_of(runs: Sequence[RunLog]) -> tuple[Signal, ...]:
    """Every signal that some response has, once, by name, in order of appearance."""
    found = {signal.name: signal for run in runs for response in run.responses.values() for signal in response.signals}
    return tuple(found.values())


def groups(signals: Sequence[Signal]) -> dict[str, tuple[Signal, ...]]:
    """Signals as they share a page: all on one that is called `signals`, or, where they are many, by kind."""
    if len(signals) <= GROUPED:
        return {"signals": tuple(signals)}
    kinds: dict[str, list[Signal]] = {}
    for signal in signals:
        kinds.setdefault(signal.name.split("_")[0], []).append(signal)
    # What comes once or twice, as heave and pitch do, shares a page, which is seen first.
    found = {"car": tuple(signal for kind in kinds.values() if len(kind) <= 2 for signal in kind)}
    found |= {name: tuple(kind) for name, kind in kinds.items() if len(kind) > 2}
    return {name: kind for name, kind in found.items() if kind}


def shown(run: RunLog) -> str:
    """The response that stands for a run: its physics."""
    return MUJOCO if MUJOCO in run.responses else next(iter(run.responses))
