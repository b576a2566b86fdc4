"""Proofs of stability and of norms for a box of errors, in which every reading and force of a gain has its own factor.

The acting gain is S_u K S_y with diagonal S_y, S_u. As a function of one factor t, with the others fixed, A, C, Bw and Dw are
affine in t / (1 - c t), or in t if no measurement contains a force. That quotient is monotone while the algebraic loop through
the measurements is well-posed: everywhere in the box if its determinant, affine in every factor, has one sign at all corners. For
a fixed X the largest eigenvalue of LMI (20) is convex in the quotient, as the disturbance appears at most squared. So it is
largest at a corner: one X that satisfies (20) at all corners of a box proves stability and the bound everywhere in it (quadratic
stability, Boyd, El Ghaoui, Feron, Balakrishnan 1994, section 5.1).

One X for all errors also allows for rapidly changing errors, which is conservative for constant ones. Let A be one of the loops
of a box, in the convex hull of the A_i at its corners, and let

    [ F A_i + A_i' F'     X_i - F + A_i' G' ]
    [ X_i - F' + G A_i      -(G + G')       ]  <  0,     X_i > 0,

with F and G the same for all. With the weights of A = sum l_i A_i, X = sum l_i X_i satisfies the same inequality. Multiplied by
[I, A'] and its transpose, it is A' X + X A < 0 (de Oliveira, Skelton 2001, Stability tests for constrained linear systems, in
Perspectives in Robust Control). The rounding of each entry is bounded and allowed for (`analysis/rigorous.py`).
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from models.common.arrays import Array
from synth.analysis.certificate import bound_of
from synth.analysis.rigorous import UNIT, definite_beyond, definiteness
from synth.plant.generalized import Plant

MOST = 12  # uncertain factors of a box, which has 4096 corners then
REGULAR = 1e-6  # relative to the largest: smallest determinant of a well-posed loop through the measurements


@dataclass(frozen=True, eq=False)
class Box:
    """Intervals of the factors of q readings, followed by those of m forces.

    Attributes:
        low, high: the ends of the intervals, shapes (q + m,).
    """

    low: Array
    high: Array

    @cached_property
    def uncertain(self) -> Array:
        """Indices of the uncertain factors, shape (k,)."""
        return np.flatnonzero(self.high > self.low)

    @property
    def middle(self) -> Array:
        """Centre of the box, shape (q + m,)."""
        return (self.low + self.high) / 2

    @property
    def vertices(self) -> Array:
        """Vertices of the box, shape (2^k, q + m)."""
        k = len(self.uncertain)
        ends = np.array(list(itertools.product((False, True), repeat=k)), dtype=bool).reshape(2**k, k)
        corners = np.tile(self.low, (len(ends), 1))
        corners[:, self.uncertain] = np.where(ends, self.high[self.uncertain], self.low[self.uncertain])
        return corners

    def bisect(self, axis: int) -> "tuple[Box, Box]":
        """Returns the two boxes on either side of the middle of one factor."""
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
        plant: plant in continuous time with n states, m inputs, d controlled outputs, r disturbances and q measurements.
        K: shape (m, q).
        before: K0, subtracted from every gain, shape (m, q): see `plant.discrete.mapped`.
        readings, forces: number of leading columns and rows of K that are readings and forces; a law's own states follow.
    """

    plant: Plant
    K: Array
    before: Array
    readings: int
    forces: int

    def scaled(self, factors: Array) -> Array:
        """Returns S_u K S_y - K0, shape (..., m, q), for factors of shape (..., q + m)."""
        q = self.K.shape[1]
        return factors[..., q:, None] * self.K * factors[..., None, :q] - self.before

    def return_difference(self, K: Array) -> Array:
        """Returns I - K Dyu, shape (..., m, m)."""
        return np.eye(len(self.K)) - K @ self.plant.Dyu

    def acting(self, factors: Array) -> Array:
        """Returns the gains that act on C_y x + Dyw w, shape (..., m, q).

        Raises:
            LinAlgError: a loop through the measurements is not well-posed.
        """
        K = self.scaled(factors)
        return np.linalg.solve(self.return_difference(K), K) if np.any(self.plant.Dyu) else K

    def well_posed(self, box: Box) -> bool:
        """Returns True if every loop through the measurements is well-posed."""
        if not np.any(self.plant.Dyu):
            return True
        determinants = np.linalg.det(self.return_difference(self.scaled(box.vertices)))
        return bool(np.all(np.abs(determinants) > REGULAR * np.abs(determinants).max()) and np.ptp(np.sign(determinants)) == 0)

    def loops(self, factors: Array) -> Loops:
        """Returns the loops under factors of shape (..., q + m).

        Raises:
            LinAlgError: a loop through the measurements is not well-posed.
        """
        K, plant = self.acting(factors), self.plant
        G, through = K @ self.plant.Cy, K @ self.plant.Dyw
        A, C = plant.A + plant.B @ G, plant.C + plant.D @ G
        return Loops(A, plant.Bw + plant.B @ through, C, plant.Dw + plant.D @ through)

    def sizes(self, factors: Array) -> Loops:
        """Returns `loops` with every term replaced by its magnitude, to which the rounding is proportional."""
        scaled, plant = np.abs(self.scaled(factors)) + 2 * np.abs(self.before), self.plant
        if np.any(self.plant.Dyu):
            size = np.abs(np.linalg.inv(self.return_difference(self.scaled(factors))))
            scaled = size @ (scaled + (np.eye(len(self.K)) + scaled @ np.abs(self.plant.Dyu)) @ np.abs(self.acting(factors)))
        G, through = scaled @ np.abs(self.plant.Cy), scaled @ np.abs(self.plant.Dyw)
        B, D = np.abs(plant.B), np.abs(plant.D)
        A, C = np.abs(plant.A) + B @ G, np.abs(plant.C) + D @ G
        return Loops(A, np.abs(plant.Bw) + B @ through, C, np.abs(plant.Dw) + D @ through)


def lmi(loops: Loops, X: Array, eta: float, identity: float = -1.0) -> Array:
    """Returns the left side of (20) of a stack of loops, shape (..., n + d, n + d), with `identity` instead of its -1."""
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
        parts: boxes that fill the whole box, each with its X.
    """

    eta: float
    parts: Sequence[tuple[Box, Array]]

    @property
    def bound(self) -> float:
        """eta^-1/2, rounded upwards."""
        return bound_of(self.eta)

    def holds(self, gain: ScaledGain, box: Box) -> bool:
        """Returns True if the parts prove the bound for all gains of a box."""
        return _fill([part for part, _ in self.parts], box) and all(proves(gain, part, X, self.eta) for part, X in self.parts)


def proves(gain: ScaledGain, box: Box, X: Array, eta: float) -> bool:
    """Returns True if X satisfies (20) at every corner of a box, beyond rounding.

    Args:
        box: box with at most `MOST` uncertain factors.
        X: shape (n, n), exactly symmetric.
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
    """Returns True if boxes from repeated bisection fill the box: one contains it, or they fill both halves of a factor."""
    if any(np.all(part.low <= box.low) and np.all(part.high >= box.high) for part in parts):
        return True
    for axis in box.uncertain:
        lower, upper = box.bisect(axis)
        below = [part for part in parts if part.high[axis] <= lower.high[axis]]
        above = [part for part in parts if part.low[axis] >= upper.low[axis]]
        if below and above and len(below) + len(above) == len(parts):
            return _fill(below, lower) and _fill(above, upper)
    return False


@dataclass(frozen=True, eq=False)
class ParameterDependentLyapunov:
    """A parameter-dependent Lyapunov proof of stability in a box, and of a bound on its norms if gamma is finite.

    Attributes:
        X: matrices at the corners, in the order of `Box.vertices`, shape (2^k, n, n).
        F, G: slack matrices, the same for all corners, shapes (n, n).
        gamma: the bound; infinite for stability alone.
    """

    X: Array
    F: Array
    G: Array
    gamma: float = np.inf

    def holds(self, gain: ScaledGain, box: Box) -> bool:
        """Returns True if all loops of a box are proved stable, and their norms below the bound, beyond rounding."""
        corners = box.vertices
        if not gain.well_posed(box) or len(self.X) != len(corners) or not hermitian(self.X):
            return False
        (m, q), (n, r) = gain.K.shape, gain.plant.Bw.shape
        sizes = left_side(gain.sizes(corners), np.abs(self.X), np.abs(self.F), np.abs(self.G), self.gamma, sign=1.0)
        lost = 4 * (2 * n + m * m + m + q + r + 8) * UNIT * sizes
        positive = definite_beyond(self.X, np.zeros_like(self.X))
        return positive and definite_beyond(-left_side(gain.loops(corners), self.X, self.F, self.G, self.gamma), lost)


def left_side(loops: Loops, X: Array, F: Array, G: Array, gamma: float, sign: float = -1.0) -> Array:
    """Returns the left side of the inequality at all corners, shape (V, k, k); from magnitudes, with `sign` 1, its magnitudes.

    If gamma is finite, it is that of the bounded real lemma, bordered by [F Bw, C'; G Bw, 0] and [-gamma I, Dw'; Dw, -gamma I].
    """
    A, Bw, C, Dw = loops
    (V, n, r), d = Bw.shape, C.shape[1]
    k = 2 * n if np.isinf(gamma) else 2 * n + r + d
    M = np.zeros((V, k, k))
    M[:, :n, :n] = F @ A + A.swapaxes(-1, -2) @ F.T
    M[:, :n, n : 2 * n] = X + sign * F + A.swapaxes(-1, -2) @ G.T
    M[:, n : 2 * n, n : 2 * n] = sign * (G + G.T)
    if np.isfinite(gamma):
        w, z = slice(2 * n, 2 * n + r), slice(2 * n + r, k)
        M[:, :n, w], M[:, n : 2 * n, w] = F @ Bw, G @ Bw
        M[:, :n, z], M[:, w, z] = C.swapaxes(-1, -2), Dw.swapaxes(-1, -2)
        M[:, w, w], M[:, z, z] = sign * gamma * np.eye(r), sign * gamma * np.eye(d)
    upper = np.triu(M)
    return upper + np.triu(M, 1).swapaxes(-1, -2)


@dataclass(frozen=True, eq=False)
class ParameterDependentKYP:
    """A parameter-dependent KYP proof of a bound on the norm in a band, for all loops of a box, stable or not.

    Let (a, c, b) be (-1, (w1 + w2) / 2, -w1 w2) for a finite band, else (1, 0, -w1^2). For one loop a bound gamma follows from

        [ a Q        P + j c Q    0          0   ]
        [ P - j c Q  b Q          0          C'  ]  +  He [-I A Bw 0]' W  <  0,     Q > 0
        [ 0          0           -gamma I    Dw' ]
        [ 0          C            Dw        -gamma I ]

    (Iwasaki, Hara 2005, theorem 2, with Finsler's lemma): the term with W vanishes for all motions x' = A x + Bw w. As W is the
    same at all corners, the sum with weights l_i is the inequality of a loop inside the box.

    Attributes:
        P, Q: matrices at the corners, in the order of `Box.vertices`, complex, shapes (2^k, n, n).
        W: shape (n, 2 n + r).
        low, high: the band [rad/s].
        gamma: the bound.
    """

    P: Array
    Q: Array
    W: Array
    low: float
    high: float
    gamma: float

    def holds(self, gain: ScaledGain, box: Box) -> bool:
        """Returns True if the bound is proved for all loops of a box, beyond rounding."""
        corners = box.vertices
        if (
            not gain.well_posed(box)
            or not len(self.P) == len(self.Q) == len(corners)
            or not (hermitian(self.P) and hermitian(self.Q))
        ):
            return False
        (m, q), (n, r) = gain.K.shape, gain.plant.Bw.shape
        loops, sizes = gain.loops(corners), gain.sizes(corners)
        M = band_side(loops, self.P, self.Q, self.W, self.low, self.high, self.gamma)
        P, Q, W = (_size(one) for one in (self.P, self.Q, self.W))
        lost = band_side(sizes, P, Q, W, self.low, self.high, self.gamma, sign=1.0)
        lost *= 4 * (2 * n + m * m + m + q + r + 12) * UNIT
        positive = definite_beyond(_real(self.Q), np.zeros((len(corners), 2 * n, 2 * n)))
        return positive and definite_beyond(_real(-M), np.tile(lost, (2, 2)))


def band_side(loops: Loops, P: Array, Q: Array, W: Array, low: float, high: float, gamma: float, sign: float = -1.0) -> Array:
    """Returns the left side of `ParameterDependentKYP`, shape (V, k, k); from magnitudes, with `sign` 1, its magnitudes."""
    a, c, b = (sign, (low + high) / 2, sign * low * high) if np.isfinite(high) else (1.0, 0.0, sign * low**2)
    A, Bw, C, Dw = loops
    (V, n, r), d = Bw.shape, C.shape[1]
    turn = 1j * c if sign < 0 else c
    M = np.zeros((V, 2 * n + r + d, 2 * n + r + d), dtype=complex if sign < 0 else float)
    x, w, z = slice(n, 2 * n), slice(2 * n, 2 * n + r), slice(2 * n + r, None)
    M[:, :n, :n], M[:, :n, x], M[:, x, x] = a * Q, P + turn * Q, b * Q
    M[:, x, :n] = M[:, :n, x].conj().swapaxes(-1, -2)
    M[:, z, x], M[:, x, z], M[:, z, w], M[:, w, z] = C, C.swapaxes(-1, -2), Dw, Dw.swapaxes(-1, -2)
    M[:, w, w], M[:, z, z] = sign * gamma * np.eye(r), sign * gamma * np.eye(d)
    motion = np.concatenate([np.broadcast_to(sign * np.eye(n), A.shape), A, Bw, np.zeros((V, n, d))], axis=-1)
    of_motion = motion.swapaxes(-1, -2) @ np.hstack([W, np.zeros((n, d))])
    return M + of_motion + of_motion.conj().swapaxes(-1, -2)


def _real(M: Array) -> Array:
    """Returns the real symmetric matrices that are positive definite if and only if M is, shape (..., 2 k, 2 k)."""
    real, imaginary = np.real(M), np.imag(M)
    upper, lower = (np.concatenate(pair, axis=-1) for pair in ((real, -imaginary), (imaginary, real)))
    return np.concatenate([upper, lower], axis=-2)


def _size(M: Array) -> Array:
    """Returns an upper bound on the size of each complex entry."""
    return np.abs(np.real(M)) + np.abs(np.imag(M))


def hermitian(M: Array) -> bool:
    """Returns True if all matrices of a stack are Hermitian bit for bit."""
    return np.array_equal(M, M.conj().swapaxes(-1, -2))
