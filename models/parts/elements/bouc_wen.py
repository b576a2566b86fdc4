"""Bouc-Wen hysteresis (Y. K. Wen, 1976), which models a bushing, a wire-rope isolator or a simple magnetorheological damper.

    F = k0 d + c0 v + alpha z,    z' = A v - beta |v| |z|^(n-1) z - gamma v |z|^n.

A voltage u changes the parameters c0 and alpha to c0 + c0_per_volt u and alpha + alpha_per_volt u.
"""

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np

from models.common.arrays import Array
from models.common.printed import rough
from models.common.schema import SI, Flag, Section
from models.kinds.signals import Signal
from models.parts.elements.hysteresis import Bandwidth, Hysteretic, LargestVoltage, Voltage
from models.parts.part import Number


@dataclass(frozen=True)
class BoucWen(Hysteretic, Section):
    """Bouc-Wen hysteresis in parallel with a spring and a damper."""

    states = (Signal("hysteresis", "z", "m", "hysteretic displacement"),)
    by_voltage: ClassVar[tuple[str, ...]] = ("alpha", "c0")

    alpha: Annotated[float, SI("N/m", "force per hysteretic displacement z", 0.0)]
    beta: Annotated[float, SI("1", "factor of |v| |z|^(n-1) z in the rate of z, in m^-n")]
    gamma: Annotated[float, SI("1", "factor of v |z|^n in the rate of z, in m^-n", -1e12)]
    A: Annotated[float, SI("1", "rate of z over the velocity v at z = 0")] = 1.0
    exponent: Annotated[float, SI("1", "n, sharpness of yield", 1.0, 100.0)] = 1.0
    k0: Annotated[float, SI("N/m", "stiffness parallel to the hysteresis", 0.0)] = 0.0
    c0: Annotated[float, SI("N s/m", "damping parallel to the hysteresis", 0.0)] = 0.0
    alpha_per_volt: Annotated[float, SI("N/m/V", "change of alpha with voltage", 0.0)] = 0.0
    c0_per_volt: Annotated[float, SI("N s/m/V", "change of c0 with voltage", 0.0)] = 0.0
    voltage: Voltage = 0.0
    largest_voltage: LargestVoltage | None = None
    bandwidth: Bandwidth | None = None
    friction: Annotated[bool, Flag("true for a damper: designs and norms neglect alpha z, as they neglect friction")] = False

    @property
    def law(self) -> tuple[Number, Number, Number, Number]:
        return self.A, self.beta, self.gamma, self.exponent

    def pull(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        alpha, c0 = self.at_voltage(u)
        return self.k0 * d + c0 * v + alpha * z[..., 0]

    def springs(self, d: Array, z: Array) -> Array:
        return self.k0 * np.square(d) / 2

    @property
    def words(self) -> str:
        return f"Bouc-Wen hysteresis with a force of up to {rough(self.at_voltage()[0] * self.z_max)} N"
