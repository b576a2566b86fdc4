"""Recorded data of one run: the contents of its log, and the signals that viewers show together.

This file, `records` and `channels` of `mcap_writer.py`, and `run_records.py` define the format. `sim.inspect` computes a log
again by the same functions and compares the two, so that it finds missing, extra or changed parts.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any

from models.common.checks import Must
from models.common.errors import InputError
from models.figures.figure import OTHERS, STYLES
from models.kinds.signals import Signal, is_kept
from sim.recording.scene import Scene
from sim.response.response import Response, difference

if TYPE_CHECKING:
    from sim.runs.force_diagram import Diagram


FORMAT = 1
NAME = re.compile(r"[\w-]{1,120}")  # of a run; a controller's, and what a command adds to it
RunName = Annotated[str, Must("letters, digits, '_' and '-', at most 120", lambda value: NAME.fullmatch(value) is not None)]
# Responses of a run: topics in an MCAP file, and entities in a Rerun file. In files and in result.json the exact sampled response
# is called `linear`; everywhere else it is "sampled".
MUJOCO, SAMPLED, CONTINUOUS = "mujoco", "linear", "continuous"
LOADS, DAMPERS = "loads", "dampers"  # topics of other forces; older logs of this format lack them
SINCE = ("half_step",)  # claims of a run that logs without a format number lack
RESULTS: Mapping[str, tuple[str, ...]] = {  # keys of result.json, by command
    "bump": ("runs", "road", "timestep"),
    "drive": ("runs", "road", "timestep", "measured_from", "measured_until", "definitions", "iri"),
    "sweep": ("sweeps", "amplitude", "timestep", "speed"),
    "margins": ("controller", "gain", "phase", "disk", "delay", "sample_period", "loops", "robustness", "loop", "fragility"),
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
        "edges",
        "csv",
        "picture",
    ),
}
LATER = ("fragility", "disk", "iri", "loads", "edges", "measured_until")  # keys that older logs, or some results, lack
WHOLE = ("bump", "drive")  # commands whose logs have every run of the result, so that all of it can be recomputed


def check_keys(command: str, result: Mapping[str, Any]) -> None:
    """Checks that a result has the keys of its command.

    Raises:
        InputError: a key is missing or unknown, or the command records nothing.
    """
    if command not in RESULTS:
        raise InputError(f"its command is not one that records; known: {', '.join(RESULTS)}")
    absent = [key for key in RESULTS[command] if key not in result and key not in LATER]
    extra = [key for key in result if key not in RESULTS[command]]
    if absent or extra:
        what = f"lacks {absent[0]}" if absent else f"has the unknown key {extra[0][:40]!r}"
        raise InputError(f"the result of sim.{command} {what}")


@dataclass(frozen=True, eq=False)
class RunLog:
    """Recorded data of one run.

    Attributes:
        name: the controller's name.
        responses: responses by topic: MuJoCo's, the exact sampled one, and that of the paper's continuous loop.
        metadata: claims about the run, as text by key; structured values as JSON.
        events: (time [s], text): lift-off and landing, divergence.
        summary: design and verdict as Markdown.
        scene: its drawing.
        verdict: result of the comparison, in a few words; empty if nothing was compared.
        files: attachments that its metadata names, (media type, content) by name, as the points of a measured road.
        acting: other forces by topic: loads on the body, and forces of dampers and springs.
        diagrams: diagrams of damper and spring forces, each over its argument.
        active: states of its controller by decreasing contribution to the force; viewers show the first of many.
    """

    given_as = "a log, such as sim.run_log returns"

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
        """MuJoCo minus sampled, over each signal's peak, or None unless both responses exist."""
        if not {MUJOCO, SAMPLED} <= set(self.responses):
            return None
        return difference(self.responses[MUJOCO], self.responses[SAMPLED])


# By response: (label, share of white in the run's colour, width). Rerun draws in the order of names, so MuJoCo's comes last, as a
# thin line within broad ones.
RESPONSES = {CONTINUOUS: ("continuous", 0.78, 8.0), SAMPLED: ("sampled", 0.5, 4.5), MUJOCO: ("MuJoCo", 0.0, 1.5)}

PALETTE = tuple(dict.fromkeys((*(style.color for style in STYLES.values()), *OTHERS)))  # of curves that belong to no run

GROUPED = 8  # signals that fit on one page
MOST_ACTIVE = 6  # plotted states of a controller; the others are only in the log
CONTROLLER = "controller"  # page of these states


def signals_of(runs: Sequence[RunLog]) -> tuple[Signal, ...]:
    """Returns the signals of all responses, without duplicates, in order of appearance."""
    signals = {signal.name: signal for run in runs for response in run.responses.values() for signal in response.signals}
    return tuple(signals.values())


def plotted(run: RunLog) -> tuple[Signal, ...]:
    """Returns the signals of a run to plot, in the order of the log; of a controller's states only the most active."""
    return tuple(signal for signal in signals_of([run]) if not is_kept(signal) or signal.name in run.active[:MOST_ACTIVE])


def compared(runs: Sequence[RunLog]) -> tuple[Signal, ...]:
    """Returns the signals that are the same quantity in all runs: all except states of controllers."""
    return tuple(signal for signal in signals_of(runs) if not is_kept(signal))


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


def title(run: RunLog, group: str) -> str:
    """Returns the title of a run's page: its group and, if the controller has many states, the number shown."""
    if group != CONTROLLER or len(run.active) <= MOST_ACTIVE:
        return group
    return f"{group}: the {MOST_ACTIVE} of {len(run.active)} states that contribute most"


def shown(run: RunLog) -> str:
    """Returns the name of the response to show for a run: MuJoCo's, or the first one without MuJoCo."""
    return MUJOCO if MUJOCO in run.responses else next(iter(run.responses))
