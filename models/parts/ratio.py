"""Parts with a motion ratio, which is the travel between the part's own ends divided by the travel of the wheel.

The motion ratio is constant or depends on the travel. The part's own travel D(d) is the integral of the ratio r(d) from
equilibrium. If the part carries the load W at the wheel in equilibrium, the force at the wheel is

    F(d, v) = r(d) (f(D(d), r(d) v) - N) + W,    N = W / r(0),    F'(0) = r(0)^2 f'(0) - r'(0) N.

If the derivative r' has different values on the two sides of equilibrium, the linearisation uses the mean of both values. The
force of an inertial part with the inertance b is b times the second derivative of its own travel D. At the wheel, the force of
an inertial part is r^2 b v' + b r r' v^2, where v is the velocity at the wheel.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from models.characteristics.curve import ForceCurve
from models.characteristics.ratio_table import PLACES, RatioTable
from models.common.arrays import Array
from models.parts.native import Tendon
from models.parts.part import CURVE, Limit, Line, Number, Part

FINE = 801  # number of points of a spring's characteristic as a function of travel


@dataclass(frozen=True)
class Constant:
    """Constant motion ratio of 1, with the interface of a `RatioTable`."""

    at_rest: ClassVar[float] = 1.0
    relative_slope: ClassVar[float] = 0.0

    def ratio_and_travel(self, deflection: Array) -> tuple[Array | float, Array]:
        return 1.0, deflection

    def travel(self, deflection: Array) -> Array:
        return deflection

    def deflection(self, travel: Array) -> Array:
        return travel

    def slope(self, deflection: Array) -> float:
        return 0.0


@dataclass(frozen=True, eq=False)
class AtRatio(Part):
    """Part to which a motion ratio is applied.

    Attributes:
        part: part before the motion ratio is applied, which uses the travel and force between its own ends.
        table: the motion ratio as a function of travel, or `Constant`.
        scale: factor by which the ratios of the table are multiplied.
        load: load W that the part carries at the wheel in equilibrium [N].
    """

    part: Part
    table: RatioTable | Constant
    scale: float = 1.0
    load: float = 0.0

    def __post_init__(self) -> None:
        for name in ("states", "inputs", "argument", "contact", "stores", "fastest"):
            object.__setattr__(self, name, getattr(self.part, name))

    def pull(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        ratio, travel = self.table.ratio_and_travel(d)
        if not self._scaled:
            pull = ratio * self.part.pull(travel, ratio * v, z, u)
        else:
            r = self.scale * ratio
            pull = r * self.part.pull(self.scale * travel, r * v, z, u)
        pull = pull + self.centrifugal(d, v) if self._inertial else pull
        return pull - (ratio * self._lift - self.load) if self._loaded else pull

    def inertance_at(self, d: Array) -> Number:
        ratio, travel = self.table.ratio_and_travel(d)
        return (self.scale * ratio) ** 2 * self.part.inertance_at(self.scale * travel)

    def centrifugal(self, d: Array, v: Array) -> Array | float:
        ratio, travel = self.table.ratio_and_travel(d)
        r, slope = self.scale * ratio, self.scale * self.table.slope(d)
        b, own = self.part.inertance_at(self.scale * travel), self.part.centrifugal(self.scale * travel, r * v)
        return r * (b * slope * np.square(v) + own)

    @cached_property
    def _inertial(self) -> bool:
        return isinstance(self.table, RatioTable) and bool(np.any(self.line.inertance))

    @cached_property
    def _scaled(self) -> bool:
        return bool(np.any(self.scale != 1))

    @cached_property
    def _loaded(self) -> bool:
        return bool(np.any(self.load))

    @cached_property
    def _lift(self) -> Any:  # load between the ends of the part itself, before it is multiplied by `scale`
        return self.load / self.table.at_rest

    def own_motion(self, d: Array, v: Array) -> tuple[Array, Array]:
        ratio, travel = self.table.ratio_and_travel(d)
        return self.scale * travel, self.scale * ratio * v

    def rate(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        return self.part.rate(*self.own_motion(d, v), z, u)

    def stored(self, d: Array, z: Any = None) -> Array:
        travel = self.table.travel(d)
        return self.part.stored(self.scale * travel, z) - self.load * (travel / self.table.at_rest - d)

    @cached_property
    def line(self) -> Line:
        own, r = self.part.line, self.scale * self.table.at_rest
        of_preload = -self.table.relative_slope * self.load
        slopes = r**2 * own.stiffness + of_preload, r**2 * own.damping, r * own.gain, of_preload, r**2 * own.inertance
        if own.of_states is None or own.rates is None:
            return Line(*slopes)
        of_travel = np.ones(own.rates.shape[-1])
        of_travel[-3:-1] = 0.0
        factors = of_travel + np.asarray(r)[..., None] * (1 - of_travel)
        return Line(*slopes, np.asarray(r)[..., None] * own.of_states, factors[..., None, :] * own.rates)

    @property
    def is_nonlinear(self) -> bool:
        return self.part.is_nonlinear or (isinstance(self.table, RatioTable) and bool(np.ptp(self.table.ratio)))

    @property
    def kinked_at_rest(self) -> bool:
        """See `Part.kinked_at_rest`. A kink of the motion ratio at equilibrium also causes a kink in the force of a preload."""
        return self.part.kinked_at_rest or bool(self.load and super().kinked_at_rest)

    @cached_property
    def range(self) -> float:  # pyright: ignore[reportIncompatibleMethodOverride]
        """See `Part.range`. The tables of the ratio and of the part limit the force."""
        if (curve := self.curve) is not None:
            return curve.range
        most = 1.0 if isinstance(self.table, Constant) else float(np.max(self.table.ratio))
        return self.scale * most * self.part.range

    @cached_property
    def curve(self) -> ForceCurve | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """See `Part.curve`.

        For a spring, the characteristic is computed at the points of both tables and of a fine grid. For a damper, the
        characteristic is a `ForceSurface`.
        """
        own = self.part.curve
        if own is None or isinstance(self.table, Constant):
            return own and own.at_wheel(self.scale)
        if self.part.argument != "deflection":
            return self.table.scaled(self.scale * self.table.at_rest).damper(own)
        ends = [*self.table.x, *self.table.deflection(own.x / self.scale)]
        x = np.unique(np.round([0.0, *ends, *np.linspace(min(ends), max(ends), FINE)], PLACES))
        force = np.where(x == 0, 0.0, self.pull(x, np.zeros_like(x)))
        return ForceCurve(x, force, float(self.line.stiffness), f"{own.words}, at its motion ratio")

    def limits(self) -> Sequence[Limit]:
        """Returns the limits of the part, converted to limits at the wheel.

        If the ratio changes with travel, the limit of a characteristic becomes a limit of the force, because the force then
        depends on deflection and velocity.
        """
        own, constant = self.part.limits(), isinstance(self.table, Constant)
        limits = [self._at_wheel(limit) for limit in own if constant or limit.end != CURVE]
        return limits if constant else [*limits, *super().limits()]

    def _at_wheel(self, limit: Limit) -> Limit:
        if limit.of == "deflection":
            travel = np.array(limit.sign * limit.value / self.scale)
            return replace(limit, value=abs(float(self.table.deflection(travel))))
        return replace(limit, value=limit.value * (self.scale if limit.of == "force" else 1 / self.scale))

    def write_input(self, tendon: Tendon, by_motor: bool) -> None:
        self.part.write_input(tendon, by_motor)

    @property
    def words(self) -> str:
        return self.part.words


@dataclass(frozen=True, eq=False)
class Sum(Part):
    """Sum of the forces of two parts without states. At most one of the two parts has an input.

    Attributes:
        first: the first part, which may be a sum.
        second: the second part, which may be a sum.
    """

    first: Part
    second: Part

    def __post_init__(self) -> None:
        object.__setattr__(self, "inputs", max(self.first.inputs, self.second.inputs))

    def pull(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        return self.first.pull(d, v, z, u) + self.second.pull(d, v, z, u)

    def inertance_at(self, d: Array) -> Number:
        return self.first.inertance_at(d) + self.second.inertance_at(d)

    @cached_property
    def line(self) -> Line:
        one, other = self.first.line, self.second.line
        return Line(**{name: getattr(one, name) + getattr(other, name) for name in ("stiffness", "damping", "gain", "inertance")})


def together(parts: Sequence[Part]) -> Part | None:
    """Combines parts with the same motion ratio as a function of travel into one part, so that the ratio is evaluated only
    once.

    Returns None if the motion ratios differ.
    """
    own = [part for part in parts if isinstance(part, AtRatio) and not part.states]
    first = own[0] if own else None
    if first is None or len(own) < len(parts) or isinstance(first.table, Constant) or sum(part.inputs for part in own) > 1:
        return None
    if any(part.table is not first.table or part.scale != first.scale for part in own):
        return None
    return AtRatio(functools.reduce(Sum, (part.part for part in own)), first.table, first.scale, sum(part.load for part in own))
