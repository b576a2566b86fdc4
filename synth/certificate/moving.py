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
from synth.certificate.box import Box, Loops, ScaledGain
from synth.certificate.definite import UNIT, definite_beyond


@dataclass(frozen=True, eq=False)
class MovingX:
    """What proves the stability of a box, and a bound on its norms if it has one.

    Attributes:
        X: at every corner, in the order of `Box.corners`, shape (2^k, n, n).
        F, G: at all of them, shapes (n, n).
        gamma: the bound; infinite for stability alone.
    """

    X: Array
    F: Array
    G: Array
    gamma: float = np.inf

    def holds(self, gain: ScaledGain, box: Box) -> bool:
        """Whether it proves that all loops of a box are stable, and their norms below the bound, beyond rounding."""
        corners = box.corners
        if not gain.posed(box) or len(self.X) != len(corners) or not hermitian(self.X):
            return False
        (m, q), (n, r) = gain.K.shape, gain.plant.Bw.shape
        sizes = left_side(gain.sizes(corners), np.abs(self.X), np.abs(self.F), np.abs(self.G), self.gamma, sign=1.0)
        lost = 4 * (2 * n + m * m + m + q + r + 8) * UNIT * sizes
        alone = definite_beyond(self.X, np.zeros_like(self.X))
        return alone and definite_beyond(-left_side(gain.loops(corners), self.X, self.F, self.G, self.gamma), lost)


def left_side(loops: Loops, X: Array, F: Array, G: Array, gamma: float = np.inf, sign: float = -1.0) -> Array:
    """The left side of the inequality at all corners, shape (V, k, k); of sizes, and with `sign` 1, its terms' sizes.

    With a bound it is that of the bounded real lemma: beside the first rows stand [F Bw, C'] and [G Bw, 0], below them
    [-gamma I, Dw'; Dw, -gamma I].
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
class MovingBand:
    """What proves a bound on the norm in a band, of all loops of a box, stable or not: the generalized KYP lemma, moving.

    Let (a, c, b) be (-1, (w1 + w2) / 2, -w1 w2) of a band that ends, else (1, 0, -w1^2). For one loop a bound gamma follows from

        [ a Q        P + j c Q    0          0   ]
        [ P - j c Q  b Q          0          C'  ]  +  He [-I A Bw 0]' W  <  0,     Q > 0
        [ 0          0           -gamma I    Dw' ]
        [ 0          C            Dw        -gamma I ]

    (Iwasaki, Hara 2005, theorem 2, with Finsler's lemma): W vanishes on all motions x' = A x + Bw w. With one W for all corners
    the sum with weights l_i is the inequality of the loop between them.

    Attributes:
        P, Q: at every corner, in the order of `Box.corners`, complex, shapes (2^k, n, n).
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
        """Whether it proves its bound for all loops of a box, beyond rounding."""
        corners = box.corners
        if not gain.posed(box) or not len(self.P) == len(self.Q) == len(corners) or not (hermitian(self.P) and hermitian(self.Q)):
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
    """The left side of `MovingBand` at all corners, shape (V, k, k); of sizes, and with `sign` 1, its terms' sizes."""
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
    """The symmetric matrices that are positive definite where Hermitian ones are, shape (..., 2 k, 2 k)."""
    real, imaginary = np.real(M), np.imag(M)
    upper, lower = (np.concatenate(pair, axis=-1) for pair in ((real, -imaginary), (imaginary, real)))
    return np.concatenate([upper, lower], axis=-2)


def _size(M: Array) -> Array:
    """At least the size of each complex entry."""
    return np.abs(np.real(M)) + np.abs(np.imag(M))


def hermitian(M: Array) -> bool:
    """Whether all matrices of a stack are Hermitian, to the last bit."""
    return np.array_equal(M, M.conj().swapaxes(-1, -2))
