"""The limits of the central paths of many plants of one shape, side by side: `barrier.py` and `central_path.py` on stacks.

A problem whose numbers break down (a matrix that is not positive definite) becomes NaN, and disturbs no other.

The matrices of one design are so small that its time goes into calls, not into arithmetic; a stack of them takes hardly more
calls than one. A plant like them says in which coordinates and with which gain to begin. The limits depend on neither.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.common.threads import one_thread
from synth.lmi.barrier import QUADRATIC, STEPS
from synth.lmi.central_path import CENTRED, INSIDE, LIMIT, CentralPoint, next_rest
from synth.lmi.structured_barrier import Basis
from synth.plant.generalized import GeneralizedPlant

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


FROM = 3.0  # mu over the eta of the first feasible point, where the paths are entered: the fewest steps in all
ON_THE_WAY = 0.1  # Newton decrement at points short of the limit
TOGETHER = 2**19  # numbers in the largest array of a stack: fewer are more calls, more leave the caches


def path_limits(plants: Sequence[GeneralizedPlant], Q: Array, R: Array, nominal: CentralPoint) -> dict[int, CentralPoint]:
    """The last point of the central path of (25), or of (22) with an empty Q and R = I, of each of V plants.

    Args:
        plants: of the same shapes; each of their inputs does something of its own.
        Q: shape (V, n, n - q).
        R: shape (V, n, q); [Q R] is regular.
        nominal: a point on the path of a plant like them, not too close to its optimum.

    Returns:
        The points by index of their plant, without those of plants for which the problem is infeasible, or whose path rounding
        ended early.
    """
    if not plants:
        return {}
    together = max(TOGETHER // Basis.of(plants[0], Q.shape[2]).F.size, 1)
    arrived = {}
    with one_thread():
        for first in range(0, len(plants), together):
            some = slice(first, first + together)
            points = _Paths(plants[some], Q[some], R[some], nominal).follow()
            arrived |= {first + index: point for index, point in points.items()}
    return arrived


class _Paths:
    """Points that walk along their paths: `central_path._Path` for a stack. Those that arrive or fail leave it."""

    def __init__(self, plants: Sequence[GeneralizedPlant], Q: Array, R: Array, nominal: CentralPoint) -> None:
        self.n, self.m = n, m = plants[0].B.shape
        self.free = a = Q.shape[2]
        self.T = np.concatenate([Q, R], axis=2)
        self.index = np.arange(len(plants))
        self.system = np.array([plant.system_matrix for plant in plants])  # [A B Bw; C D Dw] in the current coordinates
        self.S = np.broadcast_to(np.eye(n), self.T.shape)  # from the current coordinates to those of T
        self.eta = self.mu = np.zeros(len(plants))
        self.K = np.zeros((len(plants), *nominal.K.shape))  # the gain absorbed so far, in those of T

        # To where the nominal plant was. What is measured means the same in all plants: X_R = C_y X C_y' is alike.
        self.system[:, :, :n] = self.system[:, :, :n] @ self.T
        self.system[:, :n] = np.linalg.solve(self.T, self.system[:, :n])
        X = np.linalg.solve(self.T, np.linalg.solve(self.T, nominal.X).swapaxes(1, 2))
        X[:, a:, :a] = X[:, :a, a:] = 0
        self._move_to(X, np.concatenate([np.zeros((len(plants), m, a)), nominal.K @ X[:, a:, a:]], axis=2))

        # Units in which A, B, Bw and C have size one.
        A, B, Bw, C = self._parts()
        self.rate, self.output_unit = _size(A), 1 / _size(C)
        self.input_unit, self.disturbance_unit = self.rate / _size(B), self.rate / _size(Bw)
        self.K /= self.input_unit
        self.system[:, :n] /= self.rate
        self.system[:, n:] *= self.output_unit
        self.system[:, :, n : n + m] *= self.input_unit
        self.system[:, :, n + m :] *= self.disturbance_unit

        self._find_feasible_points()

    def _find_feasible_points(self) -> None:
        """A strictly feasible point for each, as `central_path._Path.find_feasible_point` finds it."""
        n, m = self.n, self.m
        basis = self._basis()
        lyapunov = -basis.F[:, :, :n, :n].swapaxes(1, 2)
        lyapunov[:, :, -1] = np.eye(n)  # the last unknown is s here, eta later
        box = np.zeros((1, m + n, basis.size, m + n))
        box[0, :m, :, m:], box[0, m:, :, :m] = basis.Y.swapaxes(0, 1), basis.Y.transpose(2, 0, 1)
        X = basis.X.swapaxes(0, 1)[None]
        shared = [(np.zeros((n, n)), X), (np.eye(n), -X), (10 * np.eye(m + n), box)]
        A, _, _, _ = self._parts()
        p = np.tile(basis.pack(np.eye(n) / 2, np.zeros((m, n)), 0.0), (len(A), 1))
        s = np.linalg.eigvalsh(A + A.swapaxes(1, 2))[:, -1] / 2
        mu = np.maximum(np.abs(s), 1e-3)
        p[:, -1] = s + mu
        inside = s < 0
        trying = ~inside
        while np.any(trying):
            blocks = [(np.zeros((n, n)), lyapunov[trying]), *shared]
            p[trying] = minimise(blocks, p[trying], 1 / mu[trying], np.full(np.count_nonzero(trying), 0.3)).p
            inside = p[:, -1] < 0
            mu /= 10
            trying = ~inside & (mu > 1e-10)
        (p,) = self._keep(inside, p)
        X, Y, _ = basis.unpack(p)
        self._move_to(X, Y)

        # X scaled down until (24) holds, and half of the eta that it then allows.
        A, _, _, C = self._parts()
        W = inverse(cholesky(-A - A.swapaxes(1, 2)))
        C, W = self._keep(_regular(W), C, W)
        shrink = 0.5 / np.maximum(_size(C @ W.swapaxes(1, 2)) ** 2, 1e-12)
        self._move_to(shrink * np.eye(n), np.zeros((len(W), m, n)))
        basis = self._basis()
        W = inverse(cholesky(-basis.F0 - np.tensordot(basis.F, basis.pack(np.eye(n), np.zeros((m, n)), 0.0), ([1], [0]))))
        (W,) = self._keep(_regular(W), W)
        self.eta = 0.5 / _size(W @ self.system[:, :, n + m :])[:, 0, 0] ** 2
        self.mu = FROM * self.eta

    def follow(self) -> dict[int, CentralPoint]:
        """Walks along the paths. Returns their limits, by the index of the plant."""
        n, m = self.n, self.m
        limits = {}
        while len(self.index):
            basis = self._basis()
            p = np.tile(basis.pack(np.eye(n), np.zeros((m, n)), 0.0), (len(self.index), 1))
            p[:, -1] = self.eta
            blocks = [(-basis.F0, -basis.F.swapaxes(1, 2)), (np.zeros((n, n)), basis.X.swapaxes(0, 1)[None])]
            last = self.mu <= 1.001 * LIMIT * self.eta
            here = minimise(blocks, p, -1 / self.mu, np.where(last, CENTRED, ON_THE_WAY))
            p, tangent, reach, last = self._keep(here.decrement <= 0.5, here.p, here.tangent, here.reach, last)
            X, Y, self.eta = basis.unpack(p)
            limits |= self._points(last, X[last], Y[last])

            # Along the tangent of the path in mu, but inside.
            relative = np.where(self.eta > 0, self.mu / np.abs(self.eta), np.inf)
            ratio = np.where(self.eta > 0, next_rest(relative, LIMIT) / relative, 0.1)
            length = np.minimum(1 - ratio, INSIDE * reach * self.mu)
            p = p + (length / self.mu)[:, None] * tangent
            self.mu = ratio * self.mu
            (p,) = self._keep(~last, p)
            X, Y, self.eta = basis.unpack(p)
            self._move_to(X, Y)
        return limits

    def _points(self, which: Array, X: Array, Y: Array) -> dict[int, CentralPoint]:
        """Pairs of the current coordinates as points in the user's coordinates and units."""
        index = self.index[which]
        T = self.T[index] @ self.S[which]
        X_user = T @ X @ T.swapaxes(1, 2) * self.rate[index] * self.output_unit[index] ** 2
        K = (self.K[which] + self._gain(which, X, Y)) * self.input_unit[index]
        eta = self.eta[which] * (self.disturbance_unit * self.output_unit)[index, 0, 0] ** 2
        points = zip(index.tolist(), X_user, K, eta, self.mu[which] / self.eta[which], strict=True)
        return {i: CentralPoint(*point) for i, *point in points}

    def _move_to(self, X: Array, Y: Array) -> None:
        """Changes the coordinates so that X becomes I and Y becomes 0."""
        n, m = self.n, self.m
        S = cholesky(X)
        W = inverse(S)
        self.K = self.K + self._gain(slice(None), X, Y)
        self.system[:, :, :n] += self.system[:, :, n : n + m] @ (Y @ W.swapaxes(1, 2) @ W)
        self.system[:, :, :n] = self.system[:, :, :n] @ S
        self.system[:, :n] = W @ self.system[:, :n]
        self.S = self.S @ S

    def _gain(self, which: Array | slice, X: Array, Y: Array) -> Array:
        """Y_R X_R^-1 in the coordinates of T."""
        a = self.free
        W = inverse(cholesky(X[:, a:, a:]))
        return Y[:, :, a:] @ W.swapaxes(1, 2) @ W @ inverse(self.S[which, a:, a:])

    def _basis(self) -> Basis:
        return Basis(self.system, self.n, self.m, self.free)

    def _parts(self) -> tuple[Array, Array, Array, Array]:
        """A, B, Bw and C."""
        n, m = self.n, self.m
        top = self.system[:, :n]
        return top[:, :, :n], top[:, :, n : n + m], top[:, :, n + m :], self.system[:, n:, :n]

    def _keep(self, which: Array, *others: Array) -> list[Array]:
        """Leaves all but some behind, in the stacks of its own and in others."""
        for name in ("index", "system", "S", "K", "eta", "mu"):
            setattr(self, name, getattr(self, name)[which])
        return [other[which] for other in others]


def _regular(W: Array) -> Array:
    """Which of a stack of lower triangular matrices are made of numbers, shape (V,)."""
    return np.all(np.isfinite(W[:, -1]), axis=1)


def _size(matrices: Array) -> Array:
    """The 2-norms of a stack, 1 for one that is zero, shape (V, 1, 1)."""
    norms = np.linalg.norm(matrices, 2, axis=(1, 2), keepdims=True)
    return np.where(norms == 0, 1.0, norms)
