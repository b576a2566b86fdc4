"""Sums and products with twice the digits of floats: pairs (high, low), whose sum is the number.

Knuth's sum and Dekker's product are exact: the rounding error is a float itself, and is kept (Ogita, Rump, Oishi 2005, Accurate
sum and dot product). Numbers must stay away from 1e300 and 1e-140; entries of a plant do.
"""

from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array

if TYPE_CHECKING:
    from synth.plant.generalized import Plant

SPLIT = 2.0**27 + 1  # halves a float: each half has 26 bits, so that products of halves are exact
LEFT = 1e-14  # relative; an iteration that moves by less has converged
MOST_TURNS = 12  # iterations; each gains the digits that the condition of A leaves, of sixteen


def added(a: Array, b: Array) -> tuple[Array, Array]:
    """Returns a + b without error, entry by entry."""
    high = a + b
    part = high - a
    return high, (a - (high - part)) + (b - part)


def multiplied(a: Array, b: Array) -> tuple[Array, Array]:
    """Returns a b without error, entry by entry."""
    high = a * b
    (a1, a2), (b1, b2) = _halves(a), _halves(b)
    return high, a2 * b2 - (((high - a1 * b1) - a2 * b1) - a1 * b2)


def product(left: Array, right: Array) -> tuple[Array, Array]:
    """Returns left @ right with twice the digits, for stacks of matrices of shapes (..., k, n) and (..., n, c)."""
    if not left.shape[-1]:
        whole = left @ right
        return whole, np.zeros_like(whole)
    terms, lost = multiplied(left[..., :, :, None], right[..., None, :, :])
    high, low = terms[..., 0, :], lost.sum(axis=-2)
    for i in range(1, terms.shape[-2]):
        high, off = added(high, terms[..., i, :])
        low = low + off
    return added(high, low)


def _halves(a: Array) -> tuple[Array, Array]:
    spread = SPLIT * a
    first = spread - (spread - a)
    return first, a - first


def transfer_matrix_closely(system: "Plant", omega: Array) -> tuple[Array, Array]:
    """Returns Dw + C (j omega - A)^-1 Bw (19) with twice the digits, and an estimate of its error.

    The residual of the linear system is computed with twice the digits and solved for again, until the answer converges
    (Higham 2002, Accuracy and Stability of Numerical Algorithms, chapter 12). It fails if A leaves floats no digit at all.

    Args:
        system: system from w to z, whose `beyond` counts.
        omega: angular frequencies [rad/s], shape (F,).

    Returns:
        T, complex, shape (F, d, r), and the largest change of its entries in the last iteration, shape (F,).
    """
    (n, r), Bw, A, C = system.Bw.shape, system.Bw, system.A, system.C
    beyond = np.zeros((n + len(C), n)) if system.beyond is None else system.beyond
    A_low, C_low = beyond[:n], beyond[n:]
    turned = omega[:, None, None]
    shifted, right = 1j * turned * np.eye(n) - A, np.hstack([Bw, np.zeros((n, r))])
    high, low = np.zeros((2, len(omega), n, 2 * r))  # real parts beside imaginary ones
    T, moved = np.zeros((len(omega), len(C), r), dtype=complex), np.full(len(omega), np.inf)
    for _ in range(MOST_TURNS):
        by, into = multiplied(turned, _times_j(high)), product(A, high)
        change, lost = added(into[0], -by[0])
        residual, rest = added(right, change)
        residual += rest + lost + into[1] - by[1] + A @ low + A_low @ high - turned * _times_j(low)
        step = np.linalg.solve(shifted, residual[..., :r] + 1j * residual[..., r:])
        high, lost = added(high, np.concatenate([np.real(step), np.imag(step)], axis=-1))
        high, low = added(high, low + lost)
        out, lost = product(C, high)
        out = out + lost + C @ low + C_low @ high
        before, T = T, out[..., :r] + 1j * out[..., r:] + system.Dw
        moved = np.abs(T - before).max(axis=(1, 2), initial=0.0)
        if np.all(moved <= LEFT * np.abs(T).max(axis=(1, 2), initial=0.0)):
            break
    return T, moved


def _times_j(x: Array) -> Array:
    r = x.shape[-1] // 2
    return np.concatenate([-x[..., r:], x[..., :r]], axis=-1)
