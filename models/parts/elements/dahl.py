"""Dahl friction in parallel with a damper (P. R. Dahl, 1968), as a model of a magnetorheological damper.

    F = c v + f w,    w' = rho (v - |v| w),

where the state w is between -1 and 1. A voltage u changes the parameters c and f to c + damping_per_volt u and f +
force_per_volt u.
"""

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from models.common.arrays import Array
from models.common.printed import rough
from models.common.schema import SI, Section
from models.kinds.signals import Signal
from models.parts.elements.hysteresis import Bandwidth, Hysteretic, LargestVoltage, Voltage
from models.parts.part import Number


@dataclass(frozen=True)
class Dahl(Hysteretic, Section):
    """Damper in parallel with Dahl friction."""

    states = (Signal("friction", "w", "1", "friction relative to its largest value"),)
    by_voltage: ClassVar[tuple[str, ...]] = ("force", "damping")
    friction: ClassVar[bool] = True  # pyright: ignore[reportIncompatibleVariableOverride]

    force: Annotated[float, SI("N", "f, largest friction", 0.0)]
    rho: Annotated[float, SI("1/m", "rate of w over the velocity at w = 0")]
    damping: Annotated[float, SI("N s/m", "c, damping parallel to the friction", 0.0)] = 0.0
    force_per_volt: Annotated[float, SI("N/V", "change of the largest friction with voltage", 0.0)] = 0.0
    damping_per_volt: Annotated[float, SI("N s/m/V", "change of the damping with voltage", 0.0)] = 0.0
    voltage: Voltage = 0.0
    largest_voltage: LargestVoltage | None = None
    bandwidth: Bandwidth | None = None

    @property
    def law(self) -> tuple[Number, Number, Number, Number]:
        return self.rho, self.rho, 0.0, 1.0

    def pull(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        force, damping = self.at_voltage(u)
        return damping * v + force * z[..., 0]

    def springs(self, d: Array, z: Array) -> float:
        return 0.0

    @property
    def words(self) -> str:
        return f"a damper with Dahl friction of {rough(self.at_voltage()[0])} N"
