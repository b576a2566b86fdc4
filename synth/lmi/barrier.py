"""Newton's method on a sum of log-determinants, with what it needs to be quick and to lose few digits.

    minimise   c' p - sum_b log det(F0_b + sum_i p_i F_bi)

(Boyd, Vandenberghe, Convex Optimization, sections 9.6 and 11.6). LAPACK is called directly: the matrices are small, and the
checks of its usual wrappers cost more than its work.
"""

# pyright: reportAttributeAccessIssue=false
# scipy.linalg.lapack is made by f2py and carries no stubs.

import functools
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.linalg import lapack

from models.common.arrays import Array

Block = tuple[Array, Array]  # an affine matrix F0 + sum_i p_i F_i that must stay positive definite: F0 (k, k), F (N, k, k)

QUADRATIC = 0.25  # a Newton decrement from which full steps converge quadratically (Boyd, Vandenberghe, 9.6.4)
STEPS = 200


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
        self.blocks = [(F0, F, F.reshape(len(F), -1), *_upper(len(F0))) for F0, F in blocks]

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
        triangle = lapack.dgeqrf((G * scale[:, None]).T, overwrite_a=1)[0][: len(p)]
        return Local(np.asarray(trace), scale, np.asfortranarray(triangle), W)


@functools.cache
def _upper(size: int) -> tuple[Array, Array, Array]:
    """Where the upper triangle and the diagonal of a flat symmetric matrix lie, and weights that keep the former's norm."""
    rows, columns = np.triu_indices(size)
    return rows * size + columns, np.arange(size) * (size + 1), np.where(rows == columns, 1.0, np.sqrt(2.0))


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
        """As `Factored.rates`."""
        return np.concatenate([_eigenvalues(step @ W) for W in self.W])


class Derivatives(Protocol):
    """What gives the derivatives at a point: `Barrier`, or `structured.StructuredBarrier`."""

    def at(self, p: Array) -> Factored | None:
        """The derivatives at a point, or None outside the feasible set."""
        ...


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
        barrier: of the feasible set.
        p: the start.
        c: the slope of what is minimised beside the barrier.
        tolerance: of the Newton decrement.
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
        decrement = float(np.linalg.norm(half))
        if not decrement < np.inf:
            return p, np.inf, here
        if decrement < tolerance or (decrement < 1e-2 and decrement >= 0.5 * previous):
            break
        previous = decrement
        step = -here.solve(half)
        length = 1.0 if decrement < QUADRATIC else _lowest(float(c @ step), here.rates(step))
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


def _lowest(slope: float, rates: Array) -> float:
    """The t > 0 that minimises slope t - sum log(1 + t rates), by Newton's method within the bracket that it narrows."""
    high = 1 / -rates.min() if rates.min() < 0 else np.inf
    low, t = 0.0, min(1.0, 0.5 * high)
    for _ in range(30):
        terms = rates / (1 + t * rates)
        rise = slope - float(terms.sum())
        if rise < 0:
            low = t
        else:
            high = t
        curvature = float(terms @ terms)
        if curvature == 0 or abs(rise) <= 0.1 * curvature * t:  # a tenth of the way: more does not pay
            break
        t = t - rise / curvature
        if not low < t < high:
            t = (low + high) / 2 if np.isfinite(high) else 4 * low
    return t


def boundary(here: Factored, step: Array) -> float:
    """How far a step may go before a block becomes singular: the largest t with p + t step feasible."""
    smallest = float(here.rates(step).min())
    return -1 / smallest if smallest < 0 else np.inf
