"""The design of a linear law that a controller's section requests, and the structure of a law that is designed."""

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
        order: number of its states; of each force's own law where there are `rows`. 0 for PI and PID, whose pattern has its own.
        rows: True if a measurement may act on a force, a row per force; each force then has a law of its own. None: one law.
        kind: "pi" or "pid"; empty for a law of a given order.
        filter: time constant of the derivative's low-pass [s]; 0 without a derivative.
    """

    order: int = 0
    rows: tuple[tuple[bool, ...], ...] | None = None
    kind: str = ""
    filter: float = 0.0

    @property
    def text(self) -> str:
        """The structure as in a vehicle file."""
        return f'structure = "{self.kind}"' if self.kind else f"order = {self.order}"

    @property
    def record(self) -> dict[str, Any]:
        """The key of a vehicle file that names the structure."""
        return {"structure": self.kind} if self.kind else {"order": self.order}

    def states(self, forces: int) -> int:
        """Returns how many states a law for so many forces has at most, without those of PI and PID."""
        return self.order * (forces if self.rows is not None else 1)


@dataclass(frozen=True, kw_only=True, eq=False)
class Demands(Section):
    """Keys of a controller's section that are the same in its `DesignRequest`."""

    stable: Annotated[bool, Flag("the law of full order is stable by itself")] = False
    fastest_pole: Annotated[float, SI("rad/s", "largest magnitude of the poles of the loop", high=1e9)] | None = None
    anti_windup: Annotated[float, SI("1/s", "rate of the anti-windup of the law's states", high=1e6)] | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class DesignRequest(Demands, LawSource):
    """Design of a linear law, by default in the paper's two steps.

    Attributes:
        design: "full" for the full-order H-infinity controller, or one of `DESIGNS`; empty for a `structure` and for two steps.
        structure: structure of the law; None for no restriction, or for a static gain.
        preview: time by which the design `PREVIEW` knows the road ahead [s]; 0 for all others.
        sampled: True if it is for the sampled loop.
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
        """True for a static gain, designed in two steps."""
        return not self.design and self.structure is None

    @property
    def record(self) -> dict[str, Any]:
        """See `LawSource`."""
        given = {key: value for key in (*keys(Demands), "sampled") if (value := getattr(self, key))}
        if self.structure is not None:
            return self.structure.record | given
        return ({"order" if self.design == FULL else "design": self.design} if self.design else {}) | given


def is_order(value: object) -> bool:
    """Returns True for a number of states that a law may have."""
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= MOST_STATES
