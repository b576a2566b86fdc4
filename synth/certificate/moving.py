"""Stability of a whole box of errors by a Lyapunov function that moves with them.

One X for all errors (`box.py`) proves what also errors that change quickly cannot destroy, which is more than is asked of errors
that are what they are. Let A be one of the loops of a box, in the convex hull of those A_i at its corners, and let

    [ F A_i + A_i' F'     X_i - F + A_i' G' ]
    [ X_i - F' + G A_i      -(G + G')       ]  <  0,     X_i > 0,

with F and G the same for all. With the same weights as A = sum l_i A_i, X = sum l_i X_i satisfies the same inequality, and
between [I, A'] and its transpose that is A' X + X A < 0 (de Oliveira, Skelton 2001, Stability tests for constrained linear
systems, in Perspectives in Robust Control). What is computed in floating point is bounded entry by entry, and counted
(`definite.py`).
"""

from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from synth.certificate.box import Box, ScaledGain
from synth.certificate.definite import UNIT, definite_beyond


@dataclass(frozen=True, eq=False)
class MovingX:
    """What proves the stability of a box.

    Attributes:
        X: at every corner, in the order of `Box.corners`, shape (2^k, n, n).
        F, G: at all of them, shapes (n, n).
    """

    X: Array
    F: Array
    G: Array

    def proves_stable(self, gain: ScaledGain, box: Box) -> bool:
        """Whether it proves that all loops of a box are stable, beyond rounding."""
        corners = box.corners
        if not gain.posed(box) or len(self.X) != len(corners):
            return False
        (m, q), n, parts = gain.K.shape, len(self.F), (self.X, self.F, self.G)
        sizes = left_side(gain.sizes(corners).A, *map(np.abs, parts), sign=1.0)
        lost = 4 * (2 * n + m * m + m + q + 8) * UNIT * sizes
        alone = definite_beyond(self.X, np.zeros_like(self.X))
        return alone and definite_beyond(-left_side(gain.loops(corners).A, *parts), lost)


def left_side(A: Array, X: Array, F: Array, G: Array, sign: float = -1.0) -> Array:
    """The left side of the inequality at all corners, shape (V, 2 n, 2 n); of sizes, and with `sign` 1, its terms' sizes."""
    upper = F @ A
    across = X + sign * F + A.swapaxes(-1, -2) @ G.T
    low = np.broadcast_to(sign * (G + G.T), A.shape)
    return np.concatenate(
        [
            np.concatenate([upper + upper.swapaxes(-1, -2), across], axis=-1),
            np.concatenate([across.swapaxes(-1, -2), low], axis=-1),
        ],
        axis=-2,
    )
