"""Recorded data of one run: the contents of its log, and the signals that viewers show together.

Together with the writers of a log (`records` and `channels` of `mcap_writer.py`, and `run_records.py`) this is the format.
`sim.inspect` writes a log anew by the same functions and compares the two, so that missing, extra or changed parts show.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

from models.common.errors import InputError
from models.figures.figure import OTHERS, STYLES
from models.kinds.signals import Signal, is_kept
from sim.recording.scene import Scene
from sim.response.response import Response, difference

if TYPE_CHECKING:
    from sim.runs.force_diagram import Diagram


FORMAT = 1
# The responses of a run: its topics in an MCAP file, and names of entities in a Rerun file. The exact sampled response has been
# called `linear` there, and in result.json, since there are logs; to people it is "sampled", as it is wherever no file is kept.
MUJOCO, SAMPLED, CONTINUOUS = "mujoco", "linear", "continuous"
LOADS, DAMPERS = "loads", "dampers"  # what acted beside: topics that older logs of this format have not
SINCE = ("half_step",)  # claims of a run that came with the first format that has a number: no older log has them
RESULTS: Mapping[str, tuple[str, ...]] = {  # of the commands that record, the keys of result.json
    "bump": ("runs", "road", "timestep"),
    "drive": ("runs", "road", "timestep", "measured_from", "definitions", "iri"),
    "sweep": ("sweeps", "amplitude", "timestep", "speed"),
    "margins": ("controller", "gain", "phase", "delay", "sample_period", "loops", "robustness", "loop", "fragility"),
    "envelope": (
        "controller",
        "axes",
        "threshold",
        "loads",
        "agreement",
        "unexplained",
        "done",
        "complete",
        "cells",
        "csv",
        "picture",
    ),
}
LATER = ("fragility", "iri", "loads")  # of these, what came when there were logs of this format: an older one lacks it
WHOLE = ("bump", "drive")  # whose log holds every run that the result is of, so that all of it is computed again


def check_keys(command: str, result: Mapping[str, Any]) -> None:
    """Checks that a result has the keys of its command.

    Raises:
        InputError: a key is missing or unknown, or there is no such command.
    """
    if command not in RESULTS:
        raise InputError("it is of no command that records")
    absent = [key for key in RESULTS[command] if key not in result and key not in LATER]
    extra = [key for key in result if key not in RESULTS[command]]
    if absent or extra:
        what = f"lacks {absent[0]}" if absent else f"has {extra[0][:40]!r}, which is none of it"
        raise InputError(f"the result of sim.{command} {what}")


@dataclass(frozen=True, eq=False)
class RunLog:
    """Recorded data of one run.

    Attributes:
        name: the controller's name.
        responses: by topic, see `sim.recording.run_log`: the physics, its exact sampled counterpart, the paper's continuous loop.
        metadata: claims about the run, as text by key; structured values as JSON.
        events: (time [s], text): lift-off and landing, divergence.
        summary: design and verdict as Markdown.
        scene: its drawing.
        verdict: result of the comparison, in a few words; empty if nothing was compared.
        files: attachments that its metadata names, (media type, content) by name: the points of a measured road.
        acting: further forces by topic: loads on the body, and forces of dampers and springs.
        diagrams: of damper and spring forces, each over its argument.
        active: its controller's states by decreasing contribution to the force; viewers show the first of many.
    """

    name: str
    responses: Mapping[str, Response]
    metadata: Mapping[str, str]
    events: tuple[tuple[float, str], ...]
    summary: str
    scene: Scene
    verdict: str = ""
    files: Mapping[str, tuple[str, bytes]] = field(default_factory=dict)
    acting: Mapping[str, Response] = field(default_factory=dict)
    diagrams: "tuple[Diagram, ...]" = ()
    active: tuple[str, ...] = ()

    @cached_property
    def gap(self) -> Response | None:
        """Returns MuJoCo minus sampled, over each signal's peak, or None unless both responses exist."""
        if not {MUJOCO, SAMPLED} <= set(self.responses):
            return None
        return difference(self.responses[MUJOCO], self.responses[SAMPLED])


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
    """Returns the title of a run's page: its group and, if the controller has many states, the number shown."""
    if group != CONTROLLER or len(run.active) <= MOST_ACTIVE:
        return group
    return f"{group}: the {MOST_ACTIVE} of {len(run.active)} states that ask for most"


def shown(run: RunLog) -> str:
    """The response that stands for a run: its physics."""
    return MUJOCO if MUJOCO in run.responses else next(iter(run.responses))
