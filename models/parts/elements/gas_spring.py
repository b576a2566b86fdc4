"""Gas spring: a piston of area A compresses a gas of volume V, as in an air spring, a hydropneumatic strut or a gas strut.

In equilibrium, the gas has the volume V_0 and carries the load W. The atmospheric pressure p_a acts on the other side of the
piston:

    F = W - (p - p_a) A,    p = p_0 (V_0 / V)^n,    p_0 = p_a + W / A,    V = V_0 + A d.

The polytropic exponent n is 1 for slow motion at constant temperature, and 1.4 for fast motion of air or nitrogen. The
stiffness in equilibrium is n p_0 A^2 / V_0, where p_0 is the gas pressure in equilibrium (J. Reimpell, H. Stoll, J. W. Betzler,
The Automotive Chassis, 2nd ed., section 5.3).

At a temperature T that differs from T_0, the load and the pressure in equilibrium are the same as at T_0. The model assumes
that a level control with oil keeps the ride height, as in hydropneumatic suspensions. The volume of the gas therefore changes:
V_0 is the volume in the file times T / T_0.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.schema import SI, Section
from models.parts.part import Line, Number, Part

ATMOSPHERE = 101325.0  # ambient pressure [Pa]
USUAL = 293.15  # usual gas temperature [K]
# Smallest gas volume, relative to the volume in equilibrium; a real spring reaches its stop at a larger volume
NARROWEST = 0.02
DRAWN_SHARE = 0.5  # the characteristic is drawn up to this deflection, relative to the length of the gas column in equilibrium


@dataclass(frozen=True)
class GasSpring(Part, Section):
    """Gas spring in a cylinder."""

    argument = "deflection"
    stores = True

    area: Annotated[float, SI("m2", "A, area of the piston", 1e-6, 1.0)]
    volume: Annotated[float, SI("m3", "V_0, volume of the gas at rest", 1e-7, 10.0)]
    load: Annotated[float, SI("N", "W, force that the gas carries at rest; instead of pressure", 0.0, 1e7)] | None = None
    pressure: (
        Annotated[float, SI("Pa", "pressure of the gas at rest, relative to the atmosphere; instead of load", 0.0, 1e9)] | None
    ) = None
    exponent: Annotated[float, SI("", "n, polytropic exponent: 1 for slow motion, 1.4 for fast motion", 1.0, 2.0)] = 1.3
    temperature: Annotated[float, SI("K", "temperature of the gas, at the same load and ride height", 150.0, 600.0)] = USUAL
    volume_temperature: Annotated[float, SI("K", "temperature at which the gas has the volume in the file", 150.0, 600.0)] = USUAL

    def __post_init__(self) -> None:
        if (self.load is None) == (self.pressure is None):
            raise InputError(
                "needs either load (the force that the gas carries at rest) or pressure; give exactly one of the two keys"
            )

    @property
    def whole(self) -> Number:
        """The force of the gas on the piston in equilibrium, including atmospheric pressure [N]."""
        load = self.pressure * self.area if self.load is None else self.load  # pyright: ignore[reportOptionalOperand]
        return load + ATMOSPHERE * self.area

    @property
    def column(self) -> Number:
        """Length of the gas column in equilibrium [m]."""
        return self.volume / self.area * self.temperature / self.volume_temperature

    @property
    def reach(self) -> float:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Largest deflection that the plot of the characteristic contains [m]."""
        return float(DRAWN_SHARE * np.min(self.column))

    def _inside(self, d: Array) -> Array:
        """Returns the deflections [m], limited so that the gas keeps at least its smallest volume.

        Beyond the limit of the deflection, the pressure of the gas stays constant.
        """
        return np.maximum(d, (NARROWEST - 1) * self.column)

    def pull(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        """See `Part.pull`. The force is W - (p - p_a) A = -(W + p_a A) ((V_0 / V)^n - 1)."""
        return -self.whole * np.expm1(-self.exponent * np.log1p(self._inside(d) / self.column))

    def stored(self, d: Array, z: Any = None) -> Array:
        """See `Part.stored`. The stored energy is the energy of the gas minus the work of the load and of the atmosphere."""
        inside, m = self._inside(d), np.maximum(self.exponent - 1, 1e-12)
        stored = self.whole * (inside + self.column * np.expm1(-m * np.log1p(inside / self.column)) / m)
        return stored + self.pull(d, np.zeros(())) * (d - inside)

    @cached_property
    def line(self) -> Line:
        """See `Part.line`. The stiffness is n p_0 A^2 / V_0."""
        return Line(self.exponent * self.whole / self.column)

    @property
    def words(self) -> str:
        return f"a gas spring of {self.volume:g} m3 with a piston of {self.area:g} m2"
