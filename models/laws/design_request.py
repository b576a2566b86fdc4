"""Request for the design of a linear law in a controller's section, and the structure of a law that is designed."""

from dataclasses import dataclass
from typing import Annotated, Any

from models.common.schema import SI, Flag, Section, keys
from models.laws.design_methods import FULL
from models.laws.law import LawSource
from models.laws.linear import MOST_STATES


@dataclass(frozen=True)
class LawStructure:
    """Structure of a law that is designed.

    Attributes:
        order: number of states of the law. If `rows` is not None, each force has its own law with `order` states. The order is
            0 for PI and PID, whose structure defines the number of states.
        rows: a row for each force, with True for each measurement that may act on this force. If `rows` is not None, each force
            has its own law. If `rows` is None, one law acts from all measurements to all forces.
        kind: "pi" or "pid"; empty for a law whose structure is defined by `order`.
        filter: time constant of the derivative's low-pass filter [s]; 0 without a derivative.
    """

    order: int = 0
    rows: tuple[tuple[bool, ...], ...] | None = None
    kind: str = ""
    filter: float = 0.0

    @property
    def text(self) -> str:
        """The structure as text, as in a line of a vehicle file."""
        return f'structure = "{self.kind}"' if self.kind else f"order = {self.order}"

    @property
    def record(self) -> dict[str, Any]:
        """The structure as a key and a value of a controller's section."""
        return {"structure": self.kind} if self.kind else {"order": self.order}

    def states(self, forces: int) -> int:
        """Returns the largest number of states of a law for the given number of forces; 0 for PI and PID laws."""
        return self.order * (forces if self.rows is not None else 1)


@dataclass(frozen=True, kw_only=True, eq=False)
class Demands(Section):
    """Keys that a controller's section and a `DesignRequest` have in common."""

    stable: Annotated[bool, Flag("the law of full order is stable by itself")] = False
    fastest_pole: Annotated[float, SI("rad/s", "largest magnitude of the poles of the loop", high=1e9)] | None = None
    anti_windup: (
        Annotated[float, SI("1/s", "rate at which the law's states follow clipped forces (anti-windup)", high=1e6)] | None
    ) = None


@dataclass(frozen=True, kw_only=True, eq=False)
class DesignRequest(Demands, LawSource):
    """Request for the design of a linear law; the default method is the paper's two-step design.

    Attributes:
        design: "full" for the full-order H-infinity controller, or one of `DESIGNS`. The text is empty for a law with a
            `structure`, and for the two-step design.
        structure: structure of the law; None for a law without restrictions, or for a static gain.
        preview: time for which the design `PREVIEW` knows the road ahead [s]; 0 for all other designs.
        sampled: True if the law is designed for the sampled loop.
    """

    public_name = "the design that a controller's section requests"
    given = None

    design: str = ""
    structure: LawStructure | None = None
    preview: float = 0.0
    sampled: bool = False

    @property
    def request(self) -> "DesignRequest":
        """See `LawSource`."""
        return self

    @property
    def two_steps(self) -> bool:
        """True if the law is a static gain from the two-step design."""
        return not self.design and self.structure is None

    @property
    def record(self) -> dict[str, Any]:
        """See `LawSource`."""
        given = {key: value for key in (*keys(Demands), "sampled") if (value := getattr(self, key))}
        if self.structure is not None:
            return self.structure.record | given
        return ({"order" if self.design == FULL else "design": self.design} if self.design else {}) | given


def is_order(value: object) -> bool:
    """Returns True if a value is an allowed number of states of a law."""
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= MOST_STATES
