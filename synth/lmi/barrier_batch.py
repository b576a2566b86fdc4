"""Newton's method of `barrier.py` for many problems of one shape, side by side along a leading axis V.

A problem whose numbers break down (a matrix that is not positive definite) becomes NaN, and disturbs no other.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from synth.lmi.barrier import QUADRATIC, STEPS

Block = tuple[Array, Array]  # F0 (k, k) and F (V, k, N, k): F0 + sum_i p_i F[:, :, i] must stay positive definite


@dataclass(frozen=True, eq=False)
class Minima:
    """Where Newton's method ended.

    Attributes:
        p: the minimisers, shape (V, N).
        decrement: their Newton decrements, shape (V,). NaN where the start was not feasible, rounding put a step outside (then p
            is NaN, too), or the steps ran out.
        tangent: inverse Hessian times the last unit vector, shape (V, N).
        reach: how far one may go along the tangent before a block becomes singular, shape (V,).
    """

    p: Array
    decrement: Array
    tangent: Array
    reach: Array


@np.errstate(invalid="ignore", divide="ignore", over="ignore")
def minimise(blocks: Sequence[Block], p: Array, slope: Array, tolerance: Array) -> Minima:
    """Minimises slope p_N - sum_b log det(F0_b + sum_i p_i F_bi), each problem until its Newton decrement is below the tolerance.

    Args:
        blocks: F may have a leading axis of one, shared by all problems.
        p: where to start, shape (V, N).
        slope: shape (V,).
        tolerance: of the Newton decrement, shape (V,).
    """
    p = p.copy()
    decrement, tangent, reach = np.full(len(p), np.nan), np.zeros_like(p), np.zeros(len(p))
    going, x, previous = np.arange(len(p)), p, np.full(len(p), np.inf)
    for _ in range(STEPS):
        trace, W, scale, triangle = _derivatives(blocks, x)
        # R' R-solves of two right sides: the gradient, and the last unit vector.
        c = np.zeros((len(x), x.shape[1], 2))
        c[:, -1, 0], c[:, -1, 1] = slope[going], 1
        c[:, :, 0] -= trace
        half = substitute(triangle.swapaxes(1, 2), c * scale[:, :, None])
        both = scale[:, :, None] * substitute(triangle[:, ::-1, ::-1], half[:, ::-1])[:, ::-1]
        step, along = -both[:, :, 0], both[:, :, 1]
        now = np.linalg.norm(half[:, :, 0], axis=1)

        ended = ~(now >= tolerance[going]) | (now < 1e-2) & (now >= 0.5 * previous)  # or NaN
        if np.any(ended):
            where, good = going[ended], ended & np.isfinite(now)
            p[where] = np.where(np.isnan(now[ended, None]), np.nan, x[ended])
            decrement[where], tangent[where] = now[ended], along[ended]
            smallest = _rates(W, along, good).min(axis=1)
            reach[going[good]] = np.where(smallest < 0, -1 / smallest, np.inf)
            going, x, step, now = going[~ended], x[~ended], step[~ended], now[~ended]
            if not len(going):
                break
            W = [block[~ended] for block in W]
            blocks = [(F0, F[~ended] if len(F) > 1 else F) for F0, F in blocks]
        length = np.ones(len(going))
        far = now >= QUADRATIC
        if np.any(far):
            length[far] = _lowest(slope[going[far]] * step[far, -1], _rates(W, step, far))
        x, previous = x + length[:, None] * step, now
    return Minima(p, decrement, tangent, reach)


def _derivatives(blocks: Sequence[Block], p: Array) -> tuple[Array, list[Array], Array, Array]:
    """The gradient of sum log det, shape (V, N), then W, S and R as in `barrier.Local`; W has shape (V, k, N, k)."""
    V, N = p.shape
    trace, Ws, rows = np.zeros((V, N)), [], []
    for F0, F in blocks:
        k = len(F0)
        Z = inverse(cholesky(F0 + (p[:, None, None] @ F)[:, :, 0]))
        W = (Z @ F.reshape(len(F), k, N * k)).reshape(V, k * N, k) @ np.ascontiguousarray(Z.swapaxes(1, 2))
        triangle, diagonal, weights = _upper(k, N)
        rows.append(W.reshape(V, -1).take(triangle, axis=1).reshape(V, -1, N) * weights)
        trace += rows[-1][:, diagonal].sum(axis=1)
        Ws.append(W.reshape(V, k, N, k))
    G = np.concatenate(rows, axis=1)
    scale = 1 / np.sqrt(np.einsum("vri,vri->vi", G, G))
    return trace, Ws, scale, np.asarray(np.linalg.qr(G * scale[:, None], mode="r"))


@functools.cache
def _upper(k: int, N: int) -> tuple[Array, Array, Array]:
    """Where the upper triangle lies in a flat W, its diagonal within it, and weights that keep its norm: `barrier._upper`."""
    rows, columns = np.triu_indices(k)
    triangle = (rows[:, None] * N + np.arange(N)) * k + columns[:, None]
    return triangle.ravel(), np.flatnonzero(rows == columns), np.where(rows == columns, 1.0, np.sqrt(2.0))[:, None]


def _rates(W: Sequence[Array], step: Array, which: Array) -> Array:
    """Eigenvalues of the blocks' change along a step in their own metric, of some of the problems: `barrier.Local.rates`."""
    changes = [(step[which, None, None] @ block[which])[:, :, 0] for block in W]
    return np.concatenate([np.linalg.eigvalsh(change) for change in changes], axis=1)


def _lowest(slope: Array, rates: Array) -> Array:
    """The t > 0 that minimise slope t - sum log(1 + t rates), shapes (V,) and (V, k): `barrier._lowest`."""
    smallest = rates.min(axis=1)
    high = np.where(smallest < 0, -1 / smallest, np.inf)
    low, t = np.zeros(len(slope)), np.minimum(1.0, 0.5 * high)
    for _ in range(30):
        terms = rates / (1 + t[:, None] * rates)
        rise, curvature = slope - terms.sum(axis=1), (terms * terms).sum(axis=1)
        if np.all(np.abs(rise) <= 0.1 * curvature * t):
            break
        low, high = np.where(rise < 0, t, low), np.where(rise < 0, high, t)
        t = t - rise / curvature
        t = np.where((low < t) & (t < high), t, np.where(np.isfinite(high), (low + high) / 2, 4 * low))
    return t


@np.errstate(invalid="ignore", divide="ignore")
def cholesky(M: Array) -> Array:
    """Lower Cholesky factors of a stack, shape (V, k, k); NaN in the last row of one that is not positive definite."""
    L = np.zeros_like(M)
    for j in range(M.shape[1]):
        column = M[:, j:, j] - (L[:, j:, :j] @ L[:, j, :j, None])[:, :, 0]
        L[:, j:, j] = column / np.sqrt(column[:, :1])
    return L


def inverse(L: Array) -> Array:
    """Inverses of lower triangular matrices, shape (V, k, k)."""
    return substitute(L, np.broadcast_to(np.eye(L.shape[1]), L.shape))


def substitute(L: Array, b: Array) -> Array:
    """L^-1 b for lower triangular L, shapes (V, k, k) and (V, k, r). What is above the diagonal is not read."""
    x = np.empty(b.shape)
    for j in range(L.shape[1]):
        x[:, j] = (b[:, j] - (L[:, j, None, :j] @ x[:, :j])[:, 0]) / L[:, j, j, None]
    return x
