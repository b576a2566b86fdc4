"""A controller after `--refine`, and what that took."""

from dataclasses import dataclass

from synth.controller import Controller
from synth.search.refine import Refinement


@dataclass(frozen=True, eq=False)
class Refined:
    """A controller whose norm was lowered, and what that took.

    Attributes:
        controller: the refined one, with its certificate.
        start: what it was refined from; None where the two steps find no gain.
        origin: where the descent began instead, in words; empty where at `start`.
        refinement: the norms before and after, the growth of the gain, and what was refused.
    """

    controller: Controller
    start: Controller | None
    origin: str
    refinement: Refinement

    @property
    def traded(self) -> str:
        """What was traded, in words."""
        return f"refined: {f'from {self.origin}; ' if self.origin else ''}{self.refinement.traded}"
