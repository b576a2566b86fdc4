"""Recorded data of one run: the contents of its log. `mcap_writer.py` and `run_records.py` define the format."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Annotated

from models.common.checks import Must
from sim.drive.response import Response, difference
from sim.recording.scene import Scene

if TYPE_CHECKING:
    from sim.runs.force_diagram import Diagram


FORMAT = 1
SIGNALS = 2  # version of signals at a sample; those of logs without it are as of `RoadInput.earlier`
NAME = re.compile(r"[\w-]{1,120}")  # of a run; a controller's, and what a command adds to it
RunName = Annotated[str, Must("letters, digits, '_' and '-', at most 120", lambda value: NAME.fullmatch(value) is not None)]
# Responses of a run: topics in an MCAP file, and entities in a Rerun file. In files and in result.json the exact sampled response
# is called `linear`; everywhere else it is "sampled".
MUJOCO, SAMPLED, CONTINUOUS = "mujoco", "linear", "continuous"
LOADS, DAMPERS = "loads", "dampers"  # topics of other forces; older logs of this format lack them
MEASURED_TOPIC = "measured"  # topic of a measured log, if any, at its own times
WHOLE = ("bump", "drive")  # commands whose logs have every run of the result, so that all of it can be recomputed


@dataclass(frozen=True, eq=False)
class RunLog:
    """Recorded data of one run.

    Attributes:
        name: the controller's name.
        responses: responses by topic: MuJoCo's, the exact sampled one, and that of the paper's continuous loop.
        metadata: claims about the run, as text by key; structured values as JSON.
        events: (time [s], text): lift-off and landing, divergence.
        summary: design and verdict as Markdown.
        scene: drawing of the vehicle.
        verdict: result of the comparison, in a few words; empty if nothing was compared.
        files: attachments that its metadata names, (media type, content) by name, as the points of a measured road.
        other_signals: other signals by topic: loads on the body, forces of dampers and springs, and a measured log.
        diagrams: diagrams of damper and spring forces, each over its argument.
        active: states of its controller by decreasing contribution to the force; viewers show the first of many.
    """

    public_name = "a log, such as sim.run_log returns"

    name: str
    responses: Mapping[str, Response]
    metadata: Mapping[str, str]
    events: tuple[tuple[float, str], ...]
    summary: str
    scene: Scene
    verdict: str = ""
    files: Mapping[str, tuple[str, bytes]] = field(default_factory=dict)
    other_signals: Mapping[str, Response] = field(default_factory=dict)
    diagrams: "tuple[Diagram, ...]" = ()
    active: tuple[str, ...] = ()

    @cached_property
    def gap(self) -> Response | None:
        """MuJoCo minus sampled, over each signal's peak, or None unless both responses exist."""
        if not {MUJOCO, SAMPLED} <= set(self.responses):
            return None
        return difference(self.responses[MUJOCO], self.responses[SAMPLED])
