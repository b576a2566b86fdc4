"""Any part through a motion ratio: the travel of the part's own ends per travel of the wheel, constant or over travel.

With the ratio r(d), the part's own travel D, which is the integral of r from rest, and the load W that the part carries at rest,

    F(d, v) = r(d) (f(D(d), r(d) v) - N) + W,    N = W / r(0),    F'(0) = r(0)^2 f'(0) - r'(0) N.

Where r' differs on both sides of rest, the line has its mean.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from models.characteristics.curve import ForceCurve
from models.characteristics.ratio_table import RatioTable
from models.common.arrays import Array
from models.parts.native import Tendon
from models.parts.part import CURVE, Limit, Line, Part, Quantity


@dataclass(frozen=True)
class Constant:
    """Motion ratio of 1, with the interface of a `RatioTable`."""

    at_rest: ClassVar[float] = 1.0
    turn: ClassVar[float] = 0.0

    def ratio_and_travel(self, deflection: Array) -> tuple[Array | float, Array]:
        """See `RatioTable.ratio_and_travel`."""
        return 1.0, deflection

    def travel(self, deflection: Array) -> Array:
        """See `RatioTable.travel`."""
        return deflection

    def deflection(self, travel: Array) -> Array:
        """See `RatioTable.deflection`."""
        return travel


@dataclass(frozen=True, eq=False)
class AtRatio(Part):
    """Part at a motion ratio.

    Attributes:
        part: the part, in its own travel and force.
        table: the motion ratio over travel, or `Constant`.
        scale: factor on its ratios.
        load: W [N].
    """

    part: Part
    table: RatioTable | Constant
    scale: float = 1.0
    load: float = 0.0

    @property
    def states(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Number of the part's states."""
        return self.part.states

    @property
    def inputs(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Number of the part's inputs."""
        return self.part.inputs

    @property
    def argument(self) -> Quantity | None:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Argument of the part."""
        return self.part.argument

    @property
    def contact(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        """True if the part is a contact."""
        return self.part.contact

    @property
    def stores(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        """True if the part stores all energy."""
        return self.part.stores

    def pull(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        """See `Part.pull`."""
        ratio, travel = self.table.ratio_and_travel(d)
        r = self.scale * ratio
        pull = r * self.part.pull(self.scale * travel, r * v, z, u)
        return pull - (ratio / self.table.at_rest - 1.0) * self.load if np.any(self.load) else pull

    def rate(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        """See `Part.rate`."""
        ratio, travel = self.table.ratio_and_travel(d)
        return self.part.rate(self.scale * travel, self.scale * ratio * v, z, u)

    def stored(self, d: Array, z: Any = None) -> Array:
        """See `Part.stored`."""
        travel = self.table.travel(d)
        return self.part.stored(self.scale * travel, z) - self.load * (travel / self.table.at_rest - d)

    @cached_property
    def line(self) -> Line:
        """See `Part.line`."""
        own, r = self.part.line, self.scale * self.table.at_rest
        of_preload = -self.table.turn * self.load
        return Line(r**2 * own.stiffness + of_preload, r**2 * own.damping, r * own.gain, of_preload)

    @property
    def bent(self) -> bool:
        """See `Part.bent`."""
        return self.part.bent or (isinstance(self.table, RatioTable) and bool(np.ptp(self.table.ratio)))

    @property
    def kinked_at_rest(self) -> bool:
        """See `Part.kinked_at_rest`: a table with a kink at rest bends the force of a preload."""
        return self.part.kinked_at_rest or bool(self.load and super().kinked_at_rest)

    @cached_property
    def range(self) -> float:  # pyright: ignore[reportIncompatibleMethodOverride]
        """See `Part.range`: within the table of the ratio and those of the part."""
        if (curve := self.curve) is not None:
            return curve.range
        most = 1.0 if isinstance(self.table, Constant) else float(np.max(self.table.ratio))
        return self.scale * most * self.part.range

    @cached_property
    def curve(self) -> ForceCurve | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """See `Part.curve`: of a spring all points of a fine table, of a damper a `ForceSurface`."""
        own = self.part.curve
        if own is None or isinstance(self.table, Constant):
            return own and own.at_wheel(self.scale)
        table = self.table.scaled(self.scale * self.table.at_rest)
        return table.spring(own, self.load) if self.part.argument == "deflection" else table.damper(own)

    def limits(self) -> Sequence[Limit]:
        """Returns the part's limits at the wheel; those of a velocity become one of the force, which depends on more."""
        own, limits = self.part.limits(), list[Limit]()
        for limit in own:
            if limit.end == CURVE and isinstance(self.table, RatioTable):
                continue
            if limit.of == "deflection":
                travel = np.array(limit.sign * limit.value / self.scale)
                limits.append(replace(limit, value=abs(float(self.table.deflection(travel)))))
            else:
                limits.append(replace(limit, value=limit.value * (self.scale if limit.of == "force" else 1 / self.scale)))
        return limits if isinstance(self.table, Constant) else [*limits, *super().limits()]

    def write_input(self, tendon: Tendon, by_motor: bool) -> None:
        """See `Part.write_input`."""
        self.part.write_input(tendon, by_motor)

    @property
    def words(self) -> str:
        """See `Part.words`."""
        return self.part.words
