"""Newton's method on a logarithmic barrier,

    minimise   c' p - sum_b log det(F0_b + sum_i p_i F_bi)

(Boyd, Vandenberghe, Convex Optimization, sections 9.6 and 11.6). LAPACK is called directly: for small matrices the checks of its
usual wrappers take longer than its work.
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
TOGETHER = 24  # rows in all, up to which the blocks are joined: fewer calls are faster; of more the blocks of one row
PANEL = 64  # columns of a QR's panel


class Barrier:
    """The barrier of one or more blocks over the same unknowns."""

    def __init__(self, blocks: Sequence[Block]) -> None:
        """Prepares the blocks for repeated evaluation.

        Raises:
            LinAlgError: the blocks have fewer entries than there are unknowns, so the minimum is not unique.
        """
        if sum(len(F0) * (len(F0) + 1) // 2 for F0, _ in blocks) < len(blocks[0][1]):
            raise np.linalg.LinAlgError("the constraints do not determine every unknown")
        sizes = tuple(len(F0) for F0, _ in blocks)
        parts, numbers = (
            [((len(F0),), (F0, F)) for F0, F in blocks if len(F0) > 1],
            [block for block in blocks if len(block[0]) == 1],
        )
        if sum(sizes) <= TOGETHER:
            parts, numbers = [(sizes, _block_diagonal(blocks))], []
        self.blocks = [(F0, F, F.reshape(len(F), -1), *_upper(each)) for each, (F0, F) in parts]
        self.numbers = None
        if numbers:
            self.numbers = np.concatenate([F0[0] for F0, _ in numbers]), np.concatenate([F[:, 0] for _, F in numbers], axis=1)

    def at(self, p: Array) -> "Local | None":
        """Returns the derivatives at a point, or None outside the feasible set.

        Raises:
            LinAlgError: a change of the unknowns changes no constraint, except by an underflow.
        """
        W, rows, trace = [], [], 0.0
        for F0, F, flat, upper, diagonal, weights in self.blocks:
            factor, outside = lapack.dpotrf(F0 + (p @ flat).reshape(F0.shape), lower=1, clean=1)
            if outside:
                return None
            inverse, singular = lapack.dtrtri(factor, lower=1)
            if singular:
                return None
            scaled = (inverse @ F @ inverse.T).reshape(flat.shape)
            W.append(scaled)
            rows.append(scaled.take(upper, axis=1) * weights)
            trace = trace + scaled.take(diagonal, axis=1).sum(axis=1)
        numbers = None
        if self.numbers is not None:
            values = self.numbers[0] + p @ self.numbers[1]
            if not (values > 0).all():
                return None
            numbers = self.numbers[1] / values
            rows.append(numbers)
            trace = trace + numbers.sum(axis=1)
        # The Hessian is G G' with rows G_i = vec(L^-1 F_i L^-T). A QR of G' gives its factor, and loses half as many digits.
        G = np.concatenate(rows, axis=1)
        squares = np.einsum("ij,ij->i", G, G)
        if not squares.all():
            raise np.linalg.LinAlgError("the constraints do not determine every unknown, to rounding")
        scale = 1 / np.sqrt(squares)
        triangle = lapack.dgeqrf((G * scale[:, None]).T, lwork=PANEL * len(p), overwrite_a=1)[0][: len(p)]
        return Local(np.asarray(trace), scale, np.asfortranarray(triangle), W, numbers)


def _block_diagonal(blocks: Sequence[Block]) -> Block:
    """Returns the blocks as one block-diagonal block."""
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
class FactoredDerivatives(ABC):
    """Derivatives of sum log det at a point: its gradient, and the Hessian as S^-1 R' R S^-1.

    Attributes:
        trace: the gradient, shape (N,).
        scale: S, shape (N,).
        triangle: upper triangular R, shape (N, N), in C or Fortran order; entries below its diagonal are arbitrary.
    """

    trace: Array
    scale: Array
    triangle: Array

    def half(self, c: Array) -> Array:
        """Returns R^-T S c, whose length is that of c in the metric of the inverse Hessian."""
        return _triangular(self.triangle, c * self.scale, transposed=True)

    def solve(self, half: Array) -> Array:
        """Returns S R^-1 half: for `half(c)` the inverse Hessian times c."""
        return self.scale * _triangular(self.triangle, half, transposed=False)

    @abstractmethod
    def rates(self, step: Array) -> Array:
        """Returns the eigenvalues r for which log det changes by sum log(1 + t r) along p + t step."""

    def lowest(self, slope: float, step: Array) -> float:
        """Returns the step length that minimises the sum with an added slope."""
        return _lowest(slope, self.rates(step))


def _triangular(R: Array, x: Array, transposed: bool) -> Array:
    """Returns R^-1 x or R^-T x for an upper triangular R; in C order R is, to LAPACK, the transpose of a lower one."""
    if R.flags.f_contiguous:
        return lapack.dtrtrs(R, x, trans=int(transposed))[0]
    return lapack.dtrtrs(R.T, x, lower=1, trans=int(not transposed))[0]


@dataclass(frozen=True, eq=False)
class Local(FactoredDerivatives):
    """Derivatives of a `Barrier` at a point.

    Attributes:
        W: L^-1 F_i L^-T of every block, shapes (N, k k).
        numbers: the same of all blocks of one row that are not joined with others, shape (N, k); None without.
    """

    W: list[Array]
    numbers: Array | None = None

    def rates(self, step: Array) -> Array:
        """Returns `FactoredDerivatives.rates`."""
        rates = [_eigenvalues(step @ W) for W in self.W]
        return np.concatenate(rates if self.numbers is None else [*rates, step @ self.numbers])


class Derivatives(Protocol):
    """A barrier with derivatives: `Barrier`, `WithLogTerm`, or `structured_barrier.StructuredBarrier`."""

    def at(self, p: Array) -> FactoredDerivatives | None:
        """Returns the derivatives at a point, or None outside the feasible set."""
        ...


@dataclass(frozen=True, eq=False)
class WithLogTerm:
    """A barrier plus weight * log(p_N), where the last unknown p_N must be positive.

    At its maximum the barrier alone has the slope -weight / p_N along p_N.
    """

    barrier: Derivatives
    weight: float

    def at(self, p: Array) -> "RaisedLocal | None":
        """Returns the derivatives at a point, or None outside the feasible set."""
        here = self.barrier.at(p) if p[-1] > 0 else None
        if here is None:
            return None
        trace, slope = here.trace.copy(), 1 / float(p[-1])
        trace[-1] += self.weight * slope
        # The logarithm changes only the last diagonal entry of the Hessian, and so of its factor.
        corner = abs(float(here.triangle[-1, -1]))
        ratio = corner / math.hypot(corner, self.weight**0.5 * slope * float(here.scale[-1]))
        return RaisedLocal(trace, here.scale, here.triangle, here, self.weight, slope, ratio)


@dataclass(frozen=True, eq=False)
class RaisedLocal(FactoredDerivatives):
    """Derivatives of a `WithLogTerm` barrier at a point; `triangle` is that of the barrier without the logarithm.

    Attributes:
        alone: derivatives without the logarithm.
        weight: weight of the logarithm.
        slope: 1 / p_N.
        ratio: last diagonal entry of R without the logarithm, over that with it.
    """

    alone: FactoredDerivatives
    weight: float
    slope: float
    ratio: float

    def half(self, c: Array) -> Array:
        """Returns `FactoredDerivatives.half`."""
        return self._scaled(self.alone.half(c))

    def solve(self, half: Array) -> Array:
        """Returns `FactoredDerivatives.solve`."""
        return self.alone.solve(self._scaled(half.copy()))

    def rates(self, step: Array) -> Array:
        """Returns `FactoredDerivatives.rates`, with the rate of the logarithm as the last."""
        return np.append(self.alone.rates(step), self.slope * step[-1])

    def lowest(self, slope: float, step: Array) -> float:
        """Returns `FactoredDerivatives.lowest` with the weight of the logarithm."""
        rates = self.rates(step)
        weights = np.ones(len(rates))
        weights[-1] = self.weight
        return _lowest(slope, rates, weights)

    def _scaled(self, half: Array) -> Array:
        half[-1] *= self.ratio
        return half


def _eigenvalues(flat: Array) -> Array:
    size = int(len(flat) ** 0.5 + 0.5)
    return lapack.dsyevd(flat.reshape(size, size), compute_v=0)[0]


@np.errstate(over="ignore", invalid="ignore")  # a step to infinity has no Cholesky factor, and is halved
def newton(
    barrier: Derivatives,
    p: Array,
    c: Array,
    tolerance: float,
    leave: Callable[[Array], bool] = lambda p: False,
    here: FactoredDerivatives | None = None,
) -> tuple[Array, float, FactoredDerivatives]:
    """Minimises c' p plus the barrier from a feasible p until the Newton decrement is below the tolerance, or rounding stops it.

    Args:
        c: linear cost, shape (N,).
        leave: returns True if a point needs other coordinates; the iteration then stops.
        here: the barrier's derivatives at the start, if they are known.

    Returns:
        The minimiser, its Newton decrement, which callers must check, and the derivatives there. The decrement is infinite if
        rounding makes it so.
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
    """Returns the t > 0 that minimises slope t - sum weights log(1 + t rates), by a bracketed Newton method."""
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
        if curvature == 0 or abs(rise) <= 0.1 * curvature * t:  # accurate to a tenth: more saves no Newton step
            break
        t = t - rise / curvature
        if not low < t < high:
            t = (low + high) / 2 if np.isfinite(high) else 4 * low
    return t


def boundary(here: FactoredDerivatives, step: Array) -> float:
    """Returns the largest t with p + t step feasible, at which a block becomes singular."""
    smallest = float(here.rates(step).min())
    return -1 / smallest if smallest < 0 else np.inf


FASTER = 8.0  # how much weight the last unknown gains from one centre to the next
CENTRES = 24  # of the path, at most
CENTRE_DECREMENT = 0.1  # Newton decrement at a centre
WITHIN = 0.95  # of the way to the boundary, where a step along the path would leave
SHORTEST = 1e-10  # likewise, of that step
SURE = 1.1  # times as far as the least can be from a centre's


def lowest_last(barrier: Derivatives, p: Array, rows: int, enough: float, close: float = np.inf) -> Array:
    """Minimises the last unknown along the central path, until it is below a value or certain not to be.

    Args:
        p: feasible point, the last unknown above `enough`.
        rows: number of rows of all blocks of the barrier.
        enough: value of the last unknown below which the path ends.
        close: distance from the least value at which the path ends if that is not below `enough`.

    Returns:
        The last point of the path.

    Raises:
        LinAlgError: rounding makes the first point infeasible.
    """
    c, along = np.zeros(len(p)), np.zeros(len(p))
    along[-1], weight, here = 1.0, rows / (p[-1] - enough), barrier.at(p)
    if here is None:
        raise np.linalg.LinAlgError("rounding leaves no feasible point")
    for _ in range(CENTRES):
        c[-1] = weight
        p, _, here = newton(barrier, p, c, CENTRE_DECREMENT, lambda p: p[-1] < enough, here)
        gap = SURE * rows / weight
        if p[-1] < enough or (gap <= close and p[-1] - gap > enough):
            break
        # Along the tangent of the path, but inside: near the boundary rounding may say otherwise, and then less far.
        step = -(1 - 1 / FASTER) * weight * here.solve(here.half(along))
        length, start, here = min(1.0, WITHIN * boundary(here, step)), p, None
        while here is None and length > SHORTEST:
            p, length = start + length * step, length / 2
            here = barrier.at(p)
        if here is None:
            return start
        if p[-1] < enough:
            break
        weight *= FASTER
    return p
