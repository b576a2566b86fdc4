"""What is recorded of one run: everything a log needs, in plain data, so that the writers know no MuJoCo and no LMI."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from sim.acting.diagram import Diagram
from sim.recording.scene import Scene
from sim.response.response import Response


@dataclass(frozen=True, eq=False)
class RunLog:
    """One run, as it is written down.

    Attributes:
        name: the controller's name.
        responses: by topic, see `sim.recording.format`: the physics, its exact sampled counterpart, the paper's continuous loop.
        metadata: what is claimed of the run, as text by key; JSON where a value has structure.
        events: (time [s], text): lift-off and landing, divergence.
        summary: design and verdict as Markdown.
        scene: what it looks like.
        verdict: what the comparison came to, in a few words; empty where nothing was compared.
        files: attachments that its metadata names, (media type, content) by name: the points of a measured road.
        acting: what acted beside its signals, by topic: loads on the body, and what dampers and springs pulled with.
        diagrams: of the latter, as they are drawn, each over its argument.
        active: of its controller's states those that ask for most, the first of them first: what viewers show of many.
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
    diagrams: tuple[Diagram, ...] = ()
    active: tuple[str, ...] = ()
