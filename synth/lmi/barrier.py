"""Newton's method on a sum of log-determinants, with what it needs to be quick and to lose few digits.

    minimise   c' p - sum_b log det(F0_b + sum_i p_i F_bi)

(Boyd, Vandenberghe, Convex Optimization, sections 9.6 and 11.6). LAPACK is called directly: the matrices are small, and the
checks of its usual wrappers cost more than its work.
"""

# pyright: reportAttributeAccessIssue=false
# scipy.linalg.lapack is made by f2py and carries no stubs.

import functools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from scipy.linalg import lapack

from models.common.arrays import Array

Block = tuple[Array, Array]  # an affine matrix F0 + sum_i p_i F_i that must stay positive definite: F0 (k, k), F (N, k, k)

QUADRATIC = 0.25  # a Newton decrement from which full steps converge quadratically (Boyd, Vandenberghe, 9.6.4)
STEPS = 200
TOGETHER = 24  # rows: so small blocks are one, for calls cost more than their work
PANEL = 64  # columns that a QR turns at once, where there are so many


class Barrier:
    """The blocks, laid out for what is computed from them again and again."""

    def __init__(self, blocks: Sequence[Block]) -> None:
        """Args:
        blocks: at least one, over the same unknowns.

        Raises:
            LinAlgError: they have fewer entries than there are unknowns, so that there is no one minimum.
        """
        if sum(len(F0) * (len(F0) + 1) // 2 for F0, _ in blocks) < len(blocks[0][1]):
            raise np.linalg.LinAlgError("some change of the unknowns changes no constraint")
        sizes = tuple(len(F0) for F0, _ in blocks)
        parts = [((size,), block) for size, block in zip(sizes, blocks, strict=True)]
        if sum(sizes) <= TOGETHER:
            parts = [(sizes, _beside(blocks))]
        self.blocks = [(F0, F, F.reshape(len(F), -1), *_upper(each)) for each, (F0, F) in parts]

    def at(self, p: Array) -> "Local | None":
        """The derivatives at a point, or None outside the feasible set.

        Raises:
            LinAlgError: some change of the unknowns changes no constraint, but for what underflows.
        """
        W, rows, trace = [], [], 0.0
        for F0, F, flat, upper, diagonal, weights in self.blocks:
            factor, outside = lapack.dpotrf(F0 + (p @ flat).reshape(F0.shape), lower=1, clean=1)
            if outside:
                return None
            inverse, singular = lapack.dtrtri(factor, lower=1)
            if singular:
                return None
            moved = (inverse @ F @ inverse.T).reshape(flat.shape)
            W.append(moved)
            rows.append(moved.take(upper, axis=1) * weights)
            trace = trace + moved.take(diagonal, axis=1).sum(axis=1)
        # The Hessian is G G' with rows G_i = vec(L^-1 F_i L^-T): a QR of G' gives its factor with half the digits lost.
        G = np.concatenate(rows, axis=1)
        squares = np.einsum("ij,ij->i", G, G)
        if not squares.all():
            raise np.linalg.LinAlgError("some change of the unknowns changes no constraint beyond rounding")
        scale = 1 / np.sqrt(squares)
        triangle = lapack.dgeqrf((G * scale[:, None]).T, lwork=PANEL * len(p), overwrite_a=1)[0][: len(p)]
        return Local(np.asarray(trace), scale, np.asfortranarray(triangle), W)


def _beside(blocks: Sequence[Block]) -> Block:
    """Blocks as one along its diagonal."""
    size = sum(len(F0) for F0, _ in blocks)
    F0, F, at = np.zeros((size, size)), np.zeros((len(blocks[0][1]), size, size)), 0
    for first, each in blocks:
        here = slice(at, at + len(first))
        F0[here, here], F[:, here, here] = first, each
        at += len(first)
    return F0, F


@functools.cache
def _upper(sizes: tuple[int, ...]) -> tuple[Array, Array, Array]:
    """Returns indices of the blocks' upper triangles and the diagonal in a flat symmetric matrix, and norm-preserving weights."""
    of = np.repeat(np.arange(len(sizes)), sizes)
    rows, columns = np.nonzero(np.triu(of[:, None] == of))
    return rows * len(of) + columns, np.arange(len(of)) * (len(of) + 1), np.where(rows == columns, 1.0, np.sqrt(2.0))


@dataclass(frozen=True, eq=False)
class Factored(ABC):
    """Derivatives of sum log det at a point: its gradient, and the Hessian as S^-1 R' R S^-1.

    Attributes:
        trace: the gradient, shape (N,).
        scale: S, shape (N,).
        triangle: R, shape (N, N), by rows or by columns; what lies below its diagonal means nothing.
    """

    trace: Array
    scale: Array
    triangle: Array

    def half(self, c: Array) -> Array:
        """R^-T S c: its norm is that of c in the metric of the inverse Hessian."""
        return _triangular(self.triangle, c * self.scale, transposed=True)

    def solve(self, half: Array) -> Array:
        """S R^-1 half, which with `half` above is the inverse Hessian times c."""
        return self.scale * _triangular(self.triangle, half, transposed=False)

    @abstractmethod
    def rates(self, step: Array) -> Array:
        """Eigenvalues r of the blocks' change in their own metric: along p + t step, log det changes by sum log(1 + t r)."""

    def lowest(self, slope: float, step: Array) -> float:
        """Returns the step length that minimises the sum with an added slope."""
        return _lowest(slope, self.rates(step))


def _triangular(R: Array, x: Array, transposed: bool) -> Array:
    """R^-1 x or R^-T x of an upper triangle. LAPACK counts by columns: one that lies by rows is its lower one, transposed."""
    if R.flags.f_contiguous:
        return lapack.dtrtrs(R, x, trans=int(transposed))[0]
    return lapack.dtrtrs(R.T, x, lower=1, trans=int(not transposed))[0]


@dataclass(frozen=True, eq=False)
class Local(Factored):
    """Derivatives at a point; L^-1 F_i L^-T of every block, shapes (N, k k)."""

    W: list[Array]

    def rates(self, step: Array) -> Array:
        """Returns `Factored.rates`."""
        return np.concatenate([_eigenvalues(step @ W) for W in self.W])


class Derivatives(Protocol):
    """A barrier with derivatives at a point: `Barrier`, `Raised`, or `structured_barrier.StructuredBarrier`."""

    def at(self, p: Array) -> Factored | None:
        """The derivatives at a point, or None outside the feasible set."""
        ...


@dataclass(frozen=True, eq=False)
class Raised:
    """A barrier with a weight times the logarithm of the last unknown, which must be positive.

    Where it is at rest the slope of the barrier alone is weight / p_N: the ratio of p_N to that slope's inverse is the weight.
    """

    barrier: Derivatives
    weight: float

    def at(self, p: Array) -> "RaisedLocal | None":
        """The derivatives at a point, or None outside the feasible set."""
        here = self.barrier.at(p) if p[-1] > 0 else None
        if here is None:
            return None
        trace, per = here.trace.copy(), 1 / float(p[-1])
        trace[-1] += self.weight * per
        # The logarithm adds to the Hessian's last entry alone, and so to that of its factor.
        corner = abs(float(here.triangle[-1, -1]))
        less = corner / math.hypot(corner, self.weight**0.5 * per * float(here.scale[-1]))
        return RaisedLocal(trace, here.scale, here.triangle, here, self.weight, per, less)


@dataclass(frozen=True, eq=False)
class RaisedLocal(Factored):
    """Derivatives of both at a point; `triangle` is that of the barrier alone.

    Attributes:
        here: those of the barrier alone.
        weight: of the logarithm.
        per: 1 / p_N.
        less: the last entry of R over that of both.
    """

    here: Factored
    weight: float
    per: float
    less: float

    def half(self, c: Array) -> Array:
        """Returns `Factored.half`."""
        return self._lessened(self.here.half(c))

    def solve(self, half: Array) -> Array:
        """Returns `Factored.solve`."""
        return self.here.solve(self._lessened(half.copy()))

    def rates(self, step: Array) -> Array:
        """Returns `Factored.rates` and that of the logarithm, once."""
        return np.append(self.here.rates(step), self.per * step[-1])

    def lowest(self, slope: float, step: Array) -> float:
        """Returns `Factored.lowest` with the weight of the logarithm."""
        rates = self.rates(step)
        weights = np.ones(len(rates))
        weights[-1] = self.weight
        return _lowest(slope, rates, weights)

    def _lessened(self, half: Array) -> Array:
        half[-1] *= self.less
        return half


def _eigenvalues(flat: Array) -> Array:
    size = int(len(flat) ** 0.5 + 0.5)
    return lapack.dsyevd(flat.reshape(size, size), compute_v=0)[0]


@np.errstate(over="ignore", invalid="ignore")  # a step too far: what is not finite has no Cholesky factor, and is halved
def newton(
    barrier: Derivatives,
    p: Array,
    c: Array,
    tolerance: float,
    leave: Callable[[Array], bool] = lambda p: False,
    here: Factored | None = None,
) -> tuple[Array, float, Factored]:
    """Minimises from a feasible p until the Newton decrement is below the tolerance, or rounding stops it.

    Args:
        c: the slope of what is minimised beside the barrier.
        leave: whether a point that short steps led to is too far away for these coordinates.
        here: the barrier's derivatives at the start, where they are known.

    Returns:
        The minimiser, its Newton decrement, and the derivatives there. The caller looks at the decrement, which is infinite where
        rounding leaves none.
    """
    here = here or barrier.at(p)
    assert here is not None, "the starting point is feasible"
    previous = decrement = np.inf
    for _ in range(STEPS):
        half = here.half(c - here.trace)
        decrement = math.sqrt(half @ half)
        if not decrement < np.inf:
            return p, np.inf, here
        if decrement < tolerance or (decrement < 1e-2 and decrement >= 0.5 * previous):
            break
        previous = decrement
        step = -here.solve(half)
        length = 1.0 if decrement < QUADRATIC else here.lowest(float(c @ step), step)
        moved = barrier.at(p + length * step)
        while moved is None and length > 1e-10:  # closer to the boundary than rounding allows
            length /= 2
            moved = barrier.at(p + length * step)
        if moved is None:
            break
        p, here = p + length * step, moved
        if decrement >= QUADRATIC and leave(p):
            break
    return p, decrement, here


def _lowest(slope: float, rates: Array, weights: Any = 1.0) -> float:
    """The t > 0 that minimises slope t - sum weights log(1 + t rates), by Newton's method within the bracket that it narrows."""
    high = 1 / -rates.min() if rates.min() < 0 else np.inf
    low, t = 0.0, min(1.0, 0.5 * high)
    for _ in range(30):
        terms = rates / (1 + t * rates)
        weighted = weights * terms
        rise = slope - float(weighted.sum())
        if rise < 0:
            low = t
        else:
            high = t
        curvature = float(weighted @ terms)
        if curvature == 0 or abs(rise) <= 0.1 * curvature * t:  # a tenth of the way: more does not pay
            break
        t = t - rise / curvature
        if not low < t < high:
            t = (low + high) / 2 if np.isfinite(high) else 4 * low
    return t


def boundary(here: Factored, step: Array) -> float:
    """Returns the largest t with p + t step feasible, at which a block becomes singular."""
    smallest = float(here.rates(step).min())
    return -1 / smallest if smallest < 0 else np.inf
