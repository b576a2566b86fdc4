"""Newton's method of `barrier.py` for many problems of one shape, side by side along a leading axis V.

A problem whose numbers break down (a matrix that is not positive definite) becomes NaN, and disturbs no other.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.arrays import Array
from synth.barrier import QUADRATIC, STEPS, packed_triangle

Block = tuple[Array, Array]  # F0 (k, k) and F (V, k, N, k): F0 + sum_i p_i F[:, :, i] must stay positive definite


@dataclass(frozen=True, eq=False)
class Minima:
    """Where Newton's method ended.

    Attributes:
        p: the minimisers, shape (V, N).
        decrement: their Newton decrements, shape (V,). It is NaN, and so is p, where the start was not feasible, or rounding put
            a step outside.
        tangent: inverse Hessian times the last unit vector, shape (V, N).
        reach: how far one may go along the tangent before a block becomes singular, shape (V,).
    """

    p: Array
    decrement: Array
    tangent: Array
    reach: Array


@np.errstate(invalid="ignore", divide="ignore", over="ignore")
def minimise(blocks: Sequence[Block], p: Array, slope: Array, tolerance: float) -> Minima:
    """Minimises slope p_N - sum_b log det(F0_b + sum_i p_i F_bi), each problem until its Newton decrement is below the tolerance.

    Args:
        blocks: F may have a leading axis of one, shared by all problems.
        p: where to start, shape (V, N).
        slope: shape (V,).
        tolerance: of the Newton decrement.
    """
    p = p.copy()
    decrement, tangent, reach = np.full(len(p), np.nan), np.zeros_like(p), np.zeros(len(p))
    going, x, previous = np.arange(len(p)), p, np.full(len(p), np.inf)
    for _ in range(STEPS):
        trace, W, scale, triangle = _derivatives(blocks, x)
        c = np.zeros((len(x), x.shape[1], 2))
        c[:, -1, 0], c[:, -1, 1] = slope[going], 1
        c[:, :, 0] -= trace
        half = substitute(triangle.swapaxes(1, 2), c * scale[:, :, None])
        step, along = np.moveaxis(scale[:, :, None] * substitute(triangle[:, ::-1, ::-1], half[:, ::-1])[:, ::-1], 2, 0)
        now = np.linalg.norm(half[:, :, 0], axis=1)

        ended = ~(now >= tolerance) | (now < 1e-2) & (now >= 0.5 * previous)
        if np.any(ended):
            where = going[ended]
            decrement[where], tangent[where] = now[ended], along[ended]
            p[where] = np.where(np.isnan(now[ended, None]), np.nan, x[ended])
            good = ended & np.isfinite(now)
            smallest = _rates(W, along, good).min(axis=1)
            reach[going[good]] = np.where(smallest < 0, -1 / smallest, np.inf)
            going, x, step, now = going[~ended], x[~ended], -step[~ended], now[~ended]
            if not len(going):
                break
            W = [block[~ended] for block in W]
            blocks = [(F0, F[~ended] if len(F) > 1 else F) for F0, F in blocks]
        else:
            step = -step
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
        Z = inverse(cholesky(F0 + np.einsum("vaib,vi->vab", F, p)))
        W = (Z @ F.reshape(len(F), k, N * k)).reshape(V, k * N, k) @ Z.swapaxes(1, 2)
        W = W.reshape(V, k, N, k)
        upper, diagonal, weights = packed_triangle(k)
        flat = np.moveaxis(W, 3, 2).reshape(V, k * k, N)
        trace += flat[:, diagonal].sum(axis=1)
        rows.append(flat[:, upper] * weights[:, None])
        Ws.append(W)
    G = np.concatenate(rows, axis=1)
    scale = 1 / np.linalg.norm(G, axis=1)
    return trace, Ws, scale, np.asarray(np.linalg.qr(G * scale[:, None], mode="r"))


def _rates(W: Sequence[Array], step: Array, which: Array) -> Array:
    """Eigenvalues of the blocks' change along a step in their own metric, of some of the problems: `barrier.Local.rates`."""
    changes = [np.einsum("vaib,vi->vab", block[which], step[which]) for block in W]
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
