"""A closed loop as the landscape keeps it, and what a change of its gain acts through."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from models.common.arrays import Array

FAR = 1e4  # times the fastest pole


@dataclass(frozen=True, eq=False)
class Ports:
    """A change of K acts through B and D, on what C_y, Dyw and Dyu say of states, of w and of the change itself.

    Attributes:
        B, D, Cy, Dyw, Dyu: shapes (n, m), (d, m), (q, n), (q, r) and (q, m).
        after: (I - K Dyu)^-1, shape (m, m).
    """

    B: Array
    D: Array
    Cy: Array
    Dyw: Array
    Dyu: Array
    after: Array


@dataclass(frozen=True, eq=False)
class Loop:
    """A closed loop.

    Attributes:
        A, Bw, C, Dw: A + B K C_y, Bw + B K Dyw, C + D K C_y and Dw + D K Dyw.
        poles: shape (n,).
        residues: C v w' Bw of every mode, with its right and left eigenvectors v and w, shape (n, d r), which make frequency
            responses cheap; None where eigenvectors lose too many digits.
    """

    A: Array
    Bw: Array
    C: Array
    Dw: Array
    poles: Array
    residues: Array | None

    @cached_property
    def far(self) -> Array:
        """A frequency at which the gain is next to that at infinity, for cuts stand at finite ones [rad/s], shape (1,)."""
        return FAR * np.abs(self.poles).max(keepdims=True)

    @cached_property
    def at_infinity(self) -> float:
        """The gain at an infinite frequency."""
        return float(np.linalg.norm(self.Dw, 2))
