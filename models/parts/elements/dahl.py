"""Dahl friction beside a damper (P. R. Dahl, 1968), as the model of a magnetorheological damper.

    F = c v + f w,    w' = rho (v - |v| w),

with w from -1 to 1. At a voltage u, c and f are c + damping_per_volt u and f + force_per_volt u.
"""

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from models.common.arrays import Array
from models.common.printed import rough
from models.common.schema import SI, Section
from models.kinds.signals import Signal
from models.parts.elements.hysteresis import FAST, Hysteretic
from models.parts.part import Number


@dataclass(frozen=True)
class Dahl(Hysteretic, Section):
    """Damper with Dahl friction."""

    states = (Signal("friction", "w", "1", "friction relative to its largest"),)
    friction: ClassVar[bool] = True  # pyright: ignore[reportIncompatibleVariableOverride]

    force: Annotated[float, SI("N", "f, largest friction", 0.0)]
    rho: Annotated[float, SI("1/m", "rate of w over the velocity at w = 0")]
    damping: Annotated[float, SI("N s/m", "c, damping parallel to the friction", 0.0)] = 0.0
    force_per_volt: Annotated[float, SI("N/V", "change of the largest friction with voltage", 0.0)] = 0.0
    damping_per_volt: Annotated[float, SI("N s/m/V", "change of the damping with voltage", 0.0)] = 0.0
    voltage: Annotated[float, SI("V", "constant voltage; or current in A, with numbers per ampere", 0.0)] = 0.0

    @property
    def law(self) -> tuple[Number, Number, Number, Number]:
        return self.rho, self.rho, 0.0, 1.0

    @property
    def _now(self) -> tuple[Number, Number]:
        return self.force + self.force_per_volt * self.voltage, self.damping + self.damping_per_volt * self.voltage

    def pull(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        force, damping = self._now
        return damping * v + force * z[..., 0]

    def stored(self, d: Array, z: Any = None) -> Array:
        return self._now[0] * self.returned(z[..., 0])

    @property
    def largest_force(self) -> Number:
        force, damping = self._now
        return force + damping * FAST

    @property
    def words(self) -> str:
        return f"a damper with Dahl friction of {rough(self._now[0])} N"
