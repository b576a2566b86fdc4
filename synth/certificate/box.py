"""A norm over a whole box of errors: every reading and every force of a gain is off by a factor of its own, between two ends.

The gain that acts is S_u K S_y with diagonal S_y, S_u. Every factor enters the loop through one column and one row: along each of
them, with the others held, A, C, Bw and Dw are straight lines in t / (1 - c t), which is t itself where nothing measured has a
force in it. That is monotone as long as the loop through the measurements has an answer, which it has everywhere in the box if
its determinant, of first degree in every factor, has one sign at all corners. And for a fixed X the largest eigenvalue of LMI
(20), in which the disturbance may stand as a square, is convex in these lines. So it is largest at a corner: one X that
satisfies (20) at all corners of a box proves stability and the bound everywhere in it (quadratic stability, Boyd, El Ghaoui,
Feron, Balakrishnan 1994, section 5.1).

What is computed in floating point is bounded entry by entry, and counted (`definite.py`).
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from models.common.arrays import Array
from synth.certificate.certificate import bound_of
from synth.certificate.definite import UNIT, definite_beyond, definiteness
from synth.plant import GeneralizedPlant

MOST = 12  # factors that are free in a box whose corners are looked at, all 4096 of them
REGULAR = 1e-6  # of its largest, the smallest determinant of the loop through what is measured


@dataclass(frozen=True, eq=False)
class Box:
    """Factors of q readings, and after them of m forces.

    Attributes:
        low, high: the ends of each, shapes (q + m,).
    """

    low: Array
    high: Array

    @cached_property
    def free(self) -> Array:
        """Which factors have two ends, shape (k,)."""
        return np.flatnonzero(self.high > self.low)

    @property
    def middle(self) -> Array:
        """Shape (q + m,)."""
        return (self.low + self.high) / 2

    @property
    def corners(self) -> Array:
        """Shape (2^k, q + m)."""
        k = len(self.free)
        ends = np.array(list(itertools.product((False, True), repeat=k)), dtype=bool).reshape(2**k, k)
        corners = np.tile(self.low, (len(ends), 1))
        corners[:, self.free] = np.where(ends, self.high[self.free], self.low[self.free])
        return corners

    def halves(self, axis: int) -> "tuple[Box, Box]":
        """The two boxes on either side of the middle of one factor."""
        high, low = self.high.copy(), self.low.copy()
        high[axis] = low[axis] = self.middle[axis]
        return Box(self.low, high), Box(low, self.high)


class Loops(NamedTuple):
    """A stack of loops from w to z: shapes (..., n, n), (..., n, r), (..., d, n) and (..., d, r)."""

    A: Array
    Bw: Array
    C: Array
    Dw: Array


@dataclass(frozen=True, eq=False)
class ScaledGain:
    """Loops under the gains S_u K S_y.

    Attributes:
        plant: continuous, n states, m inputs, d controlled outputs, r disturbances.
        K: shape (m, q).
        Cy, Dyw, Dyu: y = C_y x + Dyw w + Dyu u, shapes (q, n), (q, r) and (q, m).
        before: what is taken from every gain, shape (m, q): see `discrete.bilinear.Mapped`.
        readings, forces: how many of the columns and rows of K, the first, are readings and forces that may be off; what follows
            is a law's own states.
    """

    plant: GeneralizedPlant
    K: Array
    Cy: Array
    Dyw: Array
    Dyu: Array
    before: Array
    readings: int
    forces: int

    def scaled(self, factors: Array) -> Array:
        """S_u K S_y - K0, shape (..., m, q), for factors of shape (..., q + m)."""
        q = self.K.shape[1]
        return factors[..., q:, None] * self.K * factors[..., None, :q] - self.before

    def back(self, K: Array) -> Array:
        """I - K Dyu, shape (..., m, m)."""
        return np.eye(len(self.K)) - K @ self.Dyu

    def acting(self, factors: Array) -> Array:
        """The gains as they act on C_y x + Dyw w, shape (..., m, q).

        Raises:
            LinAlgError: a loop through what is measured has no answer.
        """
        K = self.scaled(factors)
        return np.linalg.solve(self.back(K), K) if np.any(self.Dyu) else K

    def posed(self, box: Box) -> bool:
        """Whether every loop through what is measured has an answer."""
        if not np.any(self.Dyu):
            return True
        determinants = np.linalg.det(self.back(self.scaled(box.corners)))
        return bool(np.all(np.abs(determinants) > REGULAR * np.abs(determinants).max()) and np.ptp(np.sign(determinants)) == 0)

    def loops(self, factors: Array) -> Loops:
        """The loops under factors of shape (..., q + m).

        Raises:
            LinAlgError: a loop through what is measured has no answer.
        """
        K, plant = self.acting(factors), self.plant
        G, through = K @ self.Cy, K @ self.Dyw
        A, C = plant.A + plant.B @ G, plant.C + plant.D @ G
        return Loops(A, plant.Bw + plant.B @ through, C, plant.Dw + plant.D @ through)

    def sizes(self, factors: Array) -> Loops:
        """The sums of the sizes of all terms in `loops`: what rounding did to them is this times some eps."""
        scaled, plant = np.abs(self.scaled(factors)) + 2 * np.abs(self.before), self.plant
        if np.any(self.Dyu):
            size = np.abs(np.linalg.inv(self.back(self.scaled(factors))))
            scaled = size @ (scaled + (np.eye(len(self.K)) + scaled @ np.abs(self.Dyu)) @ np.abs(self.acting(factors)))
        G, through = scaled @ np.abs(self.Cy), scaled @ np.abs(self.Dyw)
        B, D = np.abs(plant.B), np.abs(plant.D)
        A, C = np.abs(plant.A) + B @ G, np.abs(plant.C) + D @ G
        return Loops(A, np.abs(plant.Bw) + B @ through, C, np.abs(plant.Dw) + D @ through)


def lmi(loops: Loops, X: Array, eta: float, identity: float = -1.0) -> Array:
    """The left side of (20) of a stack of loops, shape (..., n + d, n + d), with `identity` in the place of its -1."""
    A, Bw, C, Dw = loops
    left = np.concatenate([A @ X, C @ X], axis=-2)
    n, d = A.shape[-1], C.shape[-2]
    W = np.concatenate([Bw, Dw], axis=-2)
    F = eta * W @ W.swapaxes(-1, -2)
    F[..., :, :n] += left
    F[..., :n, :] += left.swapaxes(-1, -2)
    F[..., n:, n:] += identity * np.eye(d)
    return F


@dataclass(frozen=True, eq=False)
class BoxProof:
    """The proof of a bound on a box: the box in parts, and an X of (20) for each.

    Attributes:
        eta: gamma^-2.
        parts: they fill the box.
    """

    eta: float
    parts: Sequence[tuple[Box, Array]]

    @property
    def bound(self) -> float:
        """eta^-1/2, rounded upwards."""
        return bound_of(self.eta)

    def holds(self, gain: ScaledGain, box: Box) -> bool:
        """Whether it proves its bound for all gains of a box."""
        return _fill([part for part, _ in self.parts], box) and all(proves(gain, part, X, self.eta) for part, X in self.parts)


def proves(gain: ScaledGain, box: Box, X: Array, eta: float) -> bool:
    """Whether X satisfies (20) at every corner of a box, beyond rounding.

    Args:
        gain: its loops.
        box: of no more than `MOST` free factors.
        X: shape (n, n), symmetric to the last bit.
        eta: gamma^-2.
    """
    if len(box.free) > MOST or not gain.posed(box) or not definiteness(X).proved:
        return False
    corners = box.corners
    (m, q), (n, r) = gain.K.shape, gain.plant.Bw.shape
    terms = 4 * (2 * n + m * m + m + q + r + 8) * UNIT
    lost = terms * np.abs(lmi(gain.sizes(corners), np.abs(X), eta, identity=1.0))
    return definite_beyond(-lmi(gain.loops(corners), X, eta), lost)


def _fill(parts: Sequence[Box], box: Box) -> bool:
    """Whether boxes that halving made of one fill it: each is it, or they fall on either side of a middle, and fill both."""
    if any(np.all(part.low <= box.low) and np.all(part.high >= box.high) for part in parts):
        return True
    for axis in box.free:
        lower, upper = box.halves(axis)
        below = [part for part in parts if part.high[axis] <= lower.high[axis]]
        above = [part for part in parts if part.low[axis] >= upper.low[axis]]
        if below and above and len(below) + len(above) == len(parts):
            return _fill(below, lower) and _fill(above, upper)
    return False
