"""Proofs of stability and of norm bounds for a box of gain errors: each measurement and force is multiplied by its own factor.

If the factors are the diagonal entries of S_y (measurements) and S_u (forces), the acting gain is S_u K S_y. Consider one
factor t, with the other factors fixed. The matrices A, C, Bw and Dw of the loop are affine functions of the quotient t / (1 - c
t) with a constant c, or of t if no measurement contains a force. The quotient is monotone in t as long as the algebraic loop
through the measurements is well-posed. The algebraic loop is well-posed in the whole box if its determinant, which is affine in
every factor, has the same sign at all corners.

For a fixed X, the largest eigenvalue of LMI (20) is convex in the quotient, because the disturbance matrices appear at most
squared. The eigenvalue is therefore largest at a corner of the box. One X that satisfies (20) at all corners proves stability
and the bound in the whole box (quadratic stability, Boyd, El Ghaoui, Feron, Balakrishnan 1994, section 5.1).
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from models.common.arrays import Array
from synth.analysis.certificate import bound_of
from synth.analysis.rigorous import UNIT, definite_beyond, definiteness
from synth.plant.generalized import Plant

MOST = 12  # largest number of uncertain factors; the box then has 4096 corners
# smallest determinant, relative to the largest determinant, for which the algebraic loop through the measurements counts as
# well-posed
REGULAR = 1e-6


@dataclass(frozen=True, eq=False)
class Box:
    """Box of factors: one interval for the factor of each of q measurements, then one for the factor of each of m forces.

    Attributes:
        low, high: lower and upper ends of the intervals, shapes (q + m,).
    """

    low: Array
    high: Array

    @cached_property
    def uncertain(self) -> Array:
        """Indices of the k factors whose intervals contain more than one value, shape (k,)."""
        return np.flatnonzero(self.high > self.low)

    @property
    def middle(self) -> Array:
        """Centre of the box, shape (q + m,)."""
        return (self.low + self.high) / 2

    @property
    def vertices(self) -> Array:
        """Corners of the box, shape (2^k, q + m)."""
        k = len(self.uncertain)
        ends = np.array(list(itertools.product((False, True), repeat=k)), dtype=bool).reshape(2**k, k)
        corners = np.tile(self.low, (len(ends), 1))
        corners[:, self.uncertain] = np.where(ends, self.high[self.uncertain], self.low[self.uncertain])
        return corners

    def bisect(self, axis: int) -> "tuple[Box, Box]":
        """Returns the two halves of the box, split at the middle of the interval with the index `axis`."""
        high, low = self.high.copy(), self.low.copy()
        high[axis] = low[axis] = self.middle[axis]
        return Box(self.low, high), Box(low, self.high)


@dataclass(frozen=True, eq=False)
class ScaledGain:
    """Closed loops with the gains S_u K S_y, where the factors of the measurements and forces vary.

    Attributes:
        plant: plant in continuous time with n states, m inputs, d outputs z, r disturbances w and q measurements.
        K: nominal gain, shape (m, q).
        before: gain K0 that is subtracted from every gain, shape (m, q); see `mapped` in `plant/discrete.py`.
        readings, forces: number of those columns of K that belong to measurements, and number of those rows that belong to
            forces. The columns of the measurements and the rows of the forces come first. The remaining columns and rows belong
            to the states of the control law.
    """

    plant: Plant
    K: Array
    before: Array
    readings: int
    forces: int

    def scaled(self, factors: Array) -> Array:
        """Returns the gains S_u K S_y - K0, shape (..., m, q), for factors of shape (..., q + m)."""
        q = self.K.shape[1]
        return factors[..., q:, None] * self.K * factors[..., None, :q] - self.before

    def return_difference(self, K: Array) -> Array:
        """Returns I - K Dyu, shape (..., m, m)."""
        return np.eye(len(self.K)) - K @ self.plant.Dyu

    def acting(self, factors: Array) -> Array:
        """Returns the gains that act on C_y x + Dyw w, shape (..., m, q), for factors of shape (..., q + m).

        Raises:
            LinAlgError: the algebraic loop through the measurements is not well-posed for some factors.
        """
        K = self.scaled(factors)
        return np.linalg.solve(self.return_difference(K), K) if np.any(self.plant.Dyu) else K

    def well_posed(self, box: Box) -> bool:
        """Returns True if the algebraic loop through the measurements is well-posed in the whole box."""
        if not np.any(self.plant.Dyu):
            return True
        determinants = np.linalg.det(self.return_difference(self.scaled(box.vertices)))
        return bool(np.all(np.abs(determinants) > REGULAR * np.abs(determinants).max()) and np.ptp(np.sign(determinants)) == 0)

    @cached_property
    def _parts(self) -> tuple[Array, Array, Array]:
        """Matrices [A Bw; C Dw], [B; D] and [C_y Dyw] of the plant."""
        plant = self.plant
        system = np.block([[plant.A, plant.Bw], [plant.C, plant.Dw]])
        return system, np.vstack([plant.B, plant.D]), np.hstack([plant.Cy, plant.Dyw])

    def loops(self, factors: Array) -> Array:
        """Returns [A Bw; C Dw] of the closed loops, shape (..., n + d, n + r), for factors of shape (..., q + m).

        Raises:
            LinAlgError: the algebraic loop through the measurements is not well-posed for some factors.
        """
        system, inputs, outputs = self._parts
        return system + inputs @ (self.acting(factors) @ outputs)

    def loop(self, factors: Array) -> Plant:
        """Returns the closed loop for factors of shape (q + m,), as a plant from w to z; see `loops`."""
        n, M = len(self.plant.A), self.loops(factors)
        return Plant.without_inputs(M[:n, :n], M[:n, n:], M[n:, :n], M[n:, n:])

    def stable(self, factors: Array) -> bool:
        """Returns True if the computed poles of all closed loops are stable, for factors of shape (..., q + m)."""
        n = len(self.plant.A)
        return bool(np.all(np.linalg.eigvals(self.loops(factors)[..., :n, :n]).real < 0))

    def sizes(self, factors: Array) -> Array:
        """Returns the sums that `loops` computes, but with the absolute value of every term.

        The rounding errors of `loops` are proportional to the returned sums.
        """
        scaled = np.abs(self.scaled(factors)) + 2 * np.abs(self.before)
        if np.any(self.plant.Dyu):
            size = np.abs(np.linalg.inv(self.return_difference(self.scaled(factors))))
            scaled = size @ (scaled + (np.eye(len(self.K)) + scaled @ np.abs(self.plant.Dyu)) @ np.abs(self.acting(factors)))
        system, inputs, outputs = (np.abs(part) for part in self._parts)
        return system + inputs @ (scaled @ outputs)


def lmi(loops: Array, X: Array, eta: float, identity: float = -1.0) -> Array:
    """Returns the left side of (20) for loops [A Bw; C Dw], with `identity` times I instead of -I, shape (..., n + d, n + d)."""
    n = len(X)
    left, W = loops[..., :n] @ X, loops[..., n:]
    F = eta * W @ W.swapaxes(-1, -2)
    F[..., :, :n] += left
    F[..., :n, :] += left.swapaxes(-1, -2)
    F[..., n:, n:] += identity * np.eye(F.shape[-1] - n)
    return F


@dataclass(frozen=True, eq=False)
class BoxProof:
    """Proof of a bound for a box of gain errors: the box is split into parts, and each part has a matrix X that satisfies LMI
    (20).

    Attributes:
        eta: gamma^-2.
        parts: smaller boxes that together fill the whole box, each with a matrix X of shape (n, n).
    """

    kind: ClassVar[str] = "common X, exact"

    eta: float
    parts: Sequence[tuple[Box, Array]]

    @property
    def bound(self) -> float:
        """Proved bound gamma = eta^-1/2 on the norm, rounded up."""
        return bound_of(self.eta)

    def holds(self, gain: ScaledGain, box: Box) -> bool:
        """Returns True if the parts prove the bound for all gains in the box."""
        return _fill([part for part, _ in self.parts], box) and all(proves(gain, part, X, self.eta) for part, X in self.parts)


def proves(gain: ScaledGain, box: Box, X: Array, eta: float) -> bool:
    """Returns True if X satisfies LMI (20) at every corner of a box, despite rounding.

    Args:
        gain: closed loops as a function of the factors of measurements and forces.
        box: box with at most `MOST` uncertain factors.
        X: exactly symmetric matrix, shape (n, n).
        eta: gamma^-2.
    """
    if len(box.uncertain) > MOST or not gain.well_posed(box) or not definiteness(X).proved:
        return False
    corners = box.vertices
    (m, q), (n, r) = gain.K.shape, gain.plant.Bw.shape
    terms = 4 * (2 * n + m * m + m + q + r + 8) * UNIT
    lost = terms * np.abs(lmi(gain.sizes(corners), np.abs(X), eta, identity=1.0))
    return definite_beyond(-lmi(gain.loops(corners), X, eta), lost)


def _fill(parts: Sequence[Box], box: Box) -> bool:
    """Returns True if parts that were made by repeated bisection fill a box.

    The parts fill the box if one of them contains the box, or if the parts fill both halves of the box along some factor.
    """
    if any(np.all(part.low <= box.low) and np.all(part.high >= box.high) for part in parts):
        return True
    for axis in box.uncertain:
        lower, upper = box.bisect(axis)
        below = [part for part in parts if part.high[axis] <= lower.high[axis]]
        above = [part for part in parts if part.low[axis] >= upper.low[axis]]
        if below and above and len(below) + len(above) == len(parts):
            return _fill(below, lower) and _fill(above, upper)
    return False
