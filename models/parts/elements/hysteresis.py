"""Hysteresis of Bouc and Wen: a force alpha z, whose state z follows the travel at first, and saturates.

With the velocity w across the hysteretic element,

    z' = A w - b |w| |z|^(n-1) z - g w |z|^n,    |z| <= z_max = (A / (b + g))^(1/n).

Motion away from z = 0 loses energy, and motion back to z = 0 returns the energy

    alpha S(z),    S = integral of x / (A + (b - g) x^n) from 0 to |z|.

At rest z - A d is constant, with d the travel: a mode without decay. No force moves this mode, but a design needs one that
decays. So linear analysis has the mode -`DECAY` there, which leaves each response from rest as it is.
"""

from abc import abstractmethod
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from models.characteristics import LEAVES
from models.common.arrays import Array
from models.common.errors import InputError
from models.parts.part import CURVE, Limit, Line, Number, Part

DECAY = 100.0  # 1/s
FAST, FASTEST = 1.0, 2.0  # m/s, of a damper: for its largest force, and for how fast its state can be


class Hysteretic(Part):
    """Part with such a state, its last one.

    Attributes:
        friction: True for a friction, which linear analysis leaves out.
    """

    friction: bool

    def __post_init__(self) -> None:
        _, b, g, _ = self.law
        if b + g <= 0:
            raise InputError(f"beta + gamma = {b + g:g} is not allowed; give a sum above 0, which limits the force")

    @property
    @abstractmethod
    def law(self) -> tuple[Number, Number, Number, Number]:
        """A, b, g and n."""

    @property
    @abstractmethod
    def largest_force(self) -> Number:
        """The force at a steady extension of `FAST`, without that of springs [N]."""

    @property
    def z_max(self) -> Number:
        """The largest z."""
        A, b, g, n = self.law
        return (A / (b + g)) ** (1 / n)

    def evolution(self, w: Array, z: Array) -> Array:
        """Returns z', shape (...), from w [m/s] and z, shape (...)."""
        A, b, g, n = self.law
        size, speed = (np.where(np.real(x) < 0, -x, x) for x in (z, w))  # also of complex steps
        return A * w - size ** (n - 1) * (b * speed * z + g * w * size)

    def rate(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        """See `Part.rate`; of a part without further states, whose velocity is that across the element."""
        return self.evolution(v, z[..., 0])[..., None]

    def returned(self, z: Array) -> Array:
        """Returns S(z), shape (...)."""
        from scipy.special import hyp2f1

        A, b, g, n = self.law
        return np.square(z) / (2 * A) * hyp2f1(1.0, 2 / n, 1 + 2 / n, (g - b) / A * np.abs(z) ** n)

    @cached_property
    def line(self) -> Line:
        """See `Part.line`, and the mode above; of a friction without its force."""
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
        """True: the rate of z bends with the sign of the velocity, at any motion."""
        return True

    @property
    def range(self) -> float:
        return float(self.largest_force)

    def limits(self) -> Sequence[Limit]:
        """Returns the force beyond the line of `LEAVES` of the largest one."""
        return (Limit(CURVE, "force", 0.0, LEAVES * self.range),) if self.range else ()

    @property
    def fastest(self) -> float:  # pyright: ignore[reportIncompatibleVariableOverride]
        """See `Part.fastest`: as z approaches its limit, or as it returns from there."""
        _, b, g, n = self.law
        return float(max(b + g, abs(b - g)) * n * self.z_max ** (n - 1) * FASTEST)
