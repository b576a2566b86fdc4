"""Recorded data of one run, which is the content of the run's log. The modules `mcap_writer.py` and `run_records.py` define the
format of the recorded data.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Annotated

from models.common.checks import Must
from sim.drive.response import Response, difference

if TYPE_CHECKING:
    from sim.recording.scene import Scene
    from sim.runs.force_diagram import Diagram


FORMAT = 1
# Version that defines the values of signals at a sample; a log without a version follows the definition of `RoadInput.earlier`
SIGNALS = 2
NAME = re.compile(r"[\w-]{1,120}")  # allowed name of a run: its controller's name, to which a command may add text
RunName = Annotated[str, Must("letters, digits, '_' and '-', at most 120", lambda value: NAME.fullmatch(value) is not None)]
# Names of a run's responses: topics in an MCAP file, entities in a Rerun file. The exact sampled response is called `linear` in
# files and in result.json, but "sampled" everywhere else.
MUJOCO, SAMPLED, CONTINUOUS = "mujoco", "linear", "continuous"
LOADS, DAMPERS = "loads", "dampers"  # topics of loads and damper forces, which older logs of this format do not have
MEASURED_TOPIC = "measured"  # topic of the measured log, if there is one; a measured log has its own times
WHOLE = ("bump", "drive")  # commands that write all runs to their log, so that the whole result can be recomputed


@dataclass(frozen=True, eq=False)
class RunLog:
    """Recorded data of one run.

    Attributes:
        name: name of the run, usually that of its controller.
        responses: responses by topic: the response simulated by MuJoCo, the exact response of the sampled loop, and that of the
            paper's continuous loop.
        metadata: claims about the run (its properties and results), as text by key. Structured values of the metadata are in
            JSON.
        events: time [s] and text of each event, such as lift-off, landing or divergence.
        summary: description of the controller's design and the verdict on the run, as Markdown.
        scene: drawing of the vehicle over time.
        verdict: short result of the comparison with linear analysis; empty if nothing was compared.
        files: attachments to which the metadata refer, for example the points of a measured road; each is (media type,
            content), by name.
        other_signals: signals that are not part of the responses, by topic: loads on the body, forces of dampers and springs,
            and a measured log.
        diagrams: diagrams of damper and spring forces against velocity or deflection.
        active: names of the controller's states, sorted by their contribution to the force; the largest contribution comes
            first. Viewers show only the first few states in this order.
    """

    public_name = "a log, such as sim.run_log returns"

    name: str
    responses: Mapping[str, Response]
    metadata: Mapping[str, str]
    events: tuple[tuple[float, str], ...]
    summary: str
    scene: "Scene"
    verdict: str = ""
    files: Mapping[str, tuple[str, bytes]] = field(default_factory=dict)
    other_signals: Mapping[str, Response] = field(default_factory=dict)
    diagrams: "tuple[Diagram, ...]" = ()
    active: tuple[str, ...] = ()

    @cached_property
    def gap(self) -> Response | None:
        """MuJoCo's response minus the sampled response, relative to the peak of each signal; None if one of the two responses
        is missing.
        """
        if not {MUJOCO, SAMPLED} <= set(self.responses):
            return None
        return difference(self.responses[MUJOCO], self.responses[SAMPLED])
