"""Hysteresis of Bouc and Wen: a force alpha z whose state z first follows the travel and then saturates.

If w is the velocity across the hysteretic element,

    z' = A w - b |w| |z|^(n-1) z - g w |z|^n,    |z| <= z_max = (A / (b + g))^(1/n).

Motion that moves the state away from z = 0 dissipates energy. Motion that moves the state back to z = 0 returns the stored
energy

    alpha S(z),    S = integral of x / (A + (b - g) x^n) from 0 to |z|.

A parameter c with a key `..._per_volt` has the value c + c_per_volt u, where u is the voltage. This includes alpha. A change of
the voltage therefore changes the stored energy alpha S(z); the coil supplies the difference.

In the linearisation at equilibrium, z - A d is constant, where d is the travel and A a parameter of the hysteresis. The
constant z - A d is a mode without decay. No force excites the mode without decay, but controller design requires that all modes
decay. Linear analysis therefore assigns the eigenvalue -`DECAY` to the mode without decay. The eigenvalue does not change any
response from equilibrium.
"""

from abc import abstractmethod
from collections.abc import Sequence
from functools import cached_property
from typing import Annotated, Any, ClassVar

import numpy as np

from models.characteristics import LEAVES
from models.common.arrays import Array
from models.common.errors import InputError, list_names
from models.common.schema import SI
from models.parts.part import CURVE, STEP, Limit, Line, Number, Part

DECAY = 100.0  # rate at which the additional mode of the linearisation decays [1/s]
# The largest force of a damper is computed at the first velocity, and the largest rate of its state at the second velocity
# [m/s]
FAST, FASTEST = 1.0, 2.0

Voltage = Annotated[
    float, SI("V", "voltage, constant or without a command; or a current in A, if the other numbers are per ampere", 0.0)
]
LargestVoltage = Annotated[
    float, SI("V", "largest voltage that the suspension's controller can set, from 0; without this key, it sets no voltage")
]
Bandwidth = Annotated[float, SI("rad/s", "corner frequency of a first-order lag of the voltage, with largest_voltage")]


class Hysteretic(Part):
    """Part with Bouc-Wen hysteresis; the state z is the last of its internal states.

    Attributes:
        friction: True if the hysteretic force is friction, which linear analysis omits.
        by_voltage: names of the parameters that depend on the voltage; the first parameter is the force per unit of z.
        voltage: constant voltage, or voltage while the controller gives no command [V].
        largest_voltage: largest voltage that a controller sets [V]; None for a constant voltage.
        bandwidth: corner frequency of the lag of the voltage [rad/s]; None for a voltage without lag.
    """

    by_voltage: ClassVar[tuple[str, ...]]
    friction: bool
    voltage: float
    largest_voltage: float | None
    bandwidth: float | None

    def __post_init__(self) -> None:
        _, b, g, _ = self.law
        if b + g <= 0:
            raise InputError(f"beta + gamma = {b + g:g} is not allowed, because the force would be unbounded; give a sum above 0")
        if (most := self.largest_voltage) is None:
            if self.bandwidth is not None:
                raise InputError(
                    "bandwidth has no effect, because the voltage is constant if largest_voltage is not given; give "
                    "largest_voltage, or omit bandwidth"
                )
            return
        if self.voltage > most:
            raise InputError(
                f"voltage = {self.voltage:g} V, which applies while the controller gives no command, is above "
                f"largest_voltage = {most:g} V; give a smaller voltage"
            )
        if not any(getattr(self, f"{name}_per_volt") for name in self.by_voltage):
            numbers = list_names(f"{name}_per_volt" for name in self.by_voltage)
            raise InputError(f"largest_voltage has no effect without {numbers}; give one of these keys, or omit largest_voltage")

    @property
    def settable(self) -> tuple[Number, Number] | None:  # pyright: ignore[reportIncompatibleVariableOverride]
        most = self.largest_voltage
        return None if most is None else (-self.voltage, most - self.voltage)

    def at_voltage(self, u: Array | float = 0.0) -> tuple[Any, ...]:
        """Returns the values of the parameters in `by_voltage` at voltages u relative to `voltage` [V]."""
        # A constant voltage has this shortcut, because the code runs in each stage of a time step
        if isinstance(u, float) and not u:
            return self._without_command
        return self._at(self.voltage + u)

    def _at(self, volts: Any) -> tuple[Any, ...]:
        return tuple([number + per_volt * volts for number, per_volt in self._voltage_lines])

    @cached_property
    def _voltage_lines(self) -> tuple[tuple[Number, Number], ...]:
        """Value of each parameter in `by_voltage` at 0 V, and its change per volt."""
        return tuple((getattr(self, name), getattr(self, f"{name}_per_volt")) for name in self.by_voltage)

    @cached_property
    def _without_command(self) -> tuple[Number, ...]:
        return self._at(self.voltage)

    @property
    @abstractmethod
    def law(self) -> tuple[Number, Number, Number, Number]:
        """The parameters A, b, g and n."""

    @abstractmethod
    def springs(self, d: Array, z: Array) -> Array | float:
        """Returns the energy that the part stores, without the energy of the hysteresis [J], shape (...)."""

    def after_yield(self, v: Array, u: Array | float = 0.0) -> Array:
        """Returns the force in steady motion at constant velocities [m/s], without the force of springs [N], shape (...)."""
        z = np.zeros((*np.shape(v), len(self.states)))
        z[..., -1] = np.sign(v) * self.z_max
        return self.pull(np.zeros(np.shape(v)), v, z, u)

    @property
    def z_max(self) -> Number:
        """The largest value of the hysteretic state z."""
        A, b, g, n = self.law
        return (A / (b + g)) ** (1 / n)

    def evolution(self, w: Array, z: Array) -> Array:
        """Returns z', the rate of the hysteretic state z, shape (...), for the velocity w [m/s] and the state z, shape (...)."""
        A, b, g, n = self.law
        size, speed = _magnitude(z), _magnitude(w)
        return A * w - size ** (n - 1) * (b * speed * z + g * w * size)

    def rate(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        """See `Part.rate`.

        The method `rate` is for a part whose only state is z: the velocity of the part is then the velocity across the
        hysteretic element.
        """
        return self.evolution(v, z[..., 0])[..., None]

    def returned(self, z: Array) -> Array:
        """Returns S(z), shape (...)."""
        from scipy.special import hyp2f1

        A, b, g, n = self.law
        return np.square(z) / (2 * A) * hyp2f1(1.0, 2 / n, 1 + 2 / n, (g - b) / A * np.abs(z) ** n)

    def stored(self, d: Array, z: Any = None, u: Array | float = 0.0) -> Array:
        """See `Part.stored`. The voltages u are relative to `voltage` [V]."""
        return self.springs(d, z) + self.at_voltage(u)[0] * self.returned(z[..., -1])

    def storing(self, d: Array, v: Array, z: Array, u: Array | float = 0.0) -> Array:
        """Returns the rate of the stored energy at constant voltages [W], shape (...).

        The rest of the power `pull` times v is dissipated.
        """
        A, b, g, n = self.law
        rates, own = self.rate(d, v, z, u), z[..., -1]
        of_springs = np.imag(self.springs(d + STEP * 1j * v, z + STEP * 1j * rates)) / STEP
        return of_springs + self.at_voltage(u)[0] * own * rates[..., -1] / (A + (b - g) * np.abs(own) ** n)

    @cached_property
    def line(self) -> Line:
        """See `Part.line`.

        The linearisation includes the mode with the eigenvalue -`DECAY`. If the hysteretic force is friction, the linearisation
        omits it.
        """
        line, n = super().line, len(self.states)
        assert line.of_states is not None
        assert line.rates is not None
        of_states, rates = np.array(line.of_states), np.array(line.rates)
        if self.friction:
            of_states[..., -1] = rates[..., n - 1] = rates[..., -1, :] = 0.0
        else:
            rates[..., -1, n] += DECAY * self.law[0]
        rates[..., -1, n - 1] -= DECAY
        return Line(line.stiffness, line.damping, of_states=of_states, rates=rates)

    @property
    def kinked_at_rest(self) -> bool:
        """True, because the rate of z depends on the sign of the velocity even if the motion is very small."""
        return True

    @property
    def range(self) -> float:
        return float(self.after_yield(np.array(FAST)))

    def limits(self) -> Sequence[Limit]:
        """Returns the limit of the linear range, at which the force differs from its linearisation by the share `LEAVES` of the
        largest force.
        """
        return (Limit(CURVE, "force", 0.0, LEAVES * self.range),) if self.range else ()

    @property
    def fastest(self) -> float:  # pyright: ignore[reportIncompatibleVariableOverride]
        """See `Part.fastest`. The rate of z is largest while z approaches its limit, or while z returns from the limit."""
        _, b, g, n = self.law
        return float(max(b + g, abs(b - g)) * n * self.z_max ** (n - 1) * FASTEST)


def _magnitude(x: Array) -> Array:
    """Returns |x|.

    For a complex x, as in a complex-step derivative, the result is the sign of the real part, so that the derivative is
    correct.
    """
    return np.abs(x) if np.isrealobj(x) else np.where(np.real(x) < 0, -x, x)
