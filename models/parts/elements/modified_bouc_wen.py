"""Modified Bouc-Wen model of a magnetorheological damper (Spencer, Dyke, Sain and Carlson, 1997).

The dashpot c1 with the extension y is in series with all other elements, except the spring k1 of the accumulator:

    F = c1 y' + k1 d,    (c0 + c1) y' = alpha z + c0 v + k0 (d - y),
    z' = A (v - y') - gamma |v - y'| |z|^(n-1) z - beta (v - y') |z|^n.

The symbols gamma and beta have the same meaning as in the paper of Spencer and others; Wen's paper exchanges the two. A voltage
u changes the parameters alpha, c0 and c1 to alpha + alpha_per_volt u, c0 + c0_per_volt u and c1 + c1_per_volt u. The force of
the accumulator in equilibrium (k1 x0 in the paper of Spencer and others) is part of the static load, so there is no key x0.
"""

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np

from models.common.arrays import Array
from models.common.printed import rough
from models.common.schema import SI, Section
from models.kinds.signals import Signal
from models.parts.elements.hysteresis import Bandwidth, Hysteretic, LargestVoltage, Voltage
from models.parts.part import Number


@dataclass(frozen=True)
class ModifiedBoucWen(Hysteretic, Section):
    """Hysteretic damper with a dashpot in series and an accumulator in parallel."""

    states = (
        Signal("dashpot_extension", "y", "m", "extension of the dashpot c1"),
        Signal("hysteresis", "z", "m", "hysteretic displacement"),
    )
    by_voltage: ClassVar[tuple[str, ...]] = ("alpha", "c0", "c1")
    friction: ClassVar[bool] = True  # pyright: ignore[reportIncompatibleVariableOverride]

    alpha: Annotated[float, SI("N/m", "force per hysteretic displacement z", 0.0)]
    c0: Annotated[float, SI("N s/m", "damping parallel to the hysteresis", 0.0)]
    c1: Annotated[float, SI("N s/m", "damping of the dashpot in series")]
    k0: Annotated[float, SI("N/m", "stiffness parallel to the hysteresis")]
    gamma: Annotated[float, SI("1", "factor of |v - y'| |z|^(n-1) z in the rate of z, in m^-n")]
    beta: Annotated[float, SI("1", "factor of (v - y') |z|^n in the rate of z, in m^-n", -1e12)]
    A: Annotated[float, SI("1", "rate of z over v - y' at z = 0")]
    exponent: Annotated[float, SI("1", "n, sharpness of yield", 1.0, 100.0)] = 2.0
    k1: Annotated[float, SI("N/m", "stiffness of the accumulator", 0.0)] = 0.0
    alpha_per_volt: Annotated[float, SI("N/m/V", "change of alpha with voltage", 0.0)] = 0.0
    c0_per_volt: Annotated[float, SI("N s/m/V", "change of c0 with voltage", 0.0)] = 0.0
    c1_per_volt: Annotated[float, SI("N s/m/V", "change of c1 with voltage", 0.0)] = 0.0
    voltage: Voltage = 0.0
    largest_voltage: LargestVoltage | None = None
    bandwidth: Bandwidth | None = None

    @property
    def law(self) -> tuple[Number, Number, Number, Number]:
        return self.A, self.gamma, self.beta, self.exponent

    def divisor(self, u: Array | float) -> Any:
        _, c0, c1 = self.at_voltage(u)
        return c0 + c1

    def _dashpot(self, d: Array, v: Array, z: Array, u: Array | float) -> Array:
        """Returns y' [m/s], shape (...)."""
        alpha, c0, c1 = self.at_voltage(u)
        return (alpha * z[..., 1] + c0 * v + self.k0 * (d - z[..., 0])) / (c0 + c1)

    def pull(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        return self.at_voltage(u)[2] * self._dashpot(d, v, z, u) + self.k1 * d

    def rate(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        speed = self._dashpot(d, v, z, u)
        return np.stack(np.broadcast_arrays(speed, self.evolution(v - speed, z[..., 1])), axis=-1)

    def springs(self, d: Array, z: Array) -> Array:
        return (self.k1 * np.square(d) + self.k0 * np.square(d - z[..., 0])) / 2

    @property
    def words(self) -> str:
        return f"a magnetorheological damper with a hysteretic force of up to {rough(self.at_voltage()[0] * self.z_max)} N"
