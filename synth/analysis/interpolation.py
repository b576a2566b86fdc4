"""Lower bounds from zeros in the right half plane: there no controller changes some directions of the response from w to z.

Let M - s E = [A - s, B; C, D] lose rank at s, Re s > 0, with [q; p]' (M - s E) = 0. Whatever controller makes the loop stable, x
and u exist at s, and p' z = (q' Bw + p' Dw) w there. The transposed plant says for the zeros from w to y = C_y x + Dyw w that
some z = x follows from some w = v whatever controller of y there is, of any order. So the transfer function T from w to z is
known in directions at points of the right half plane,

    p_i' T(s_i) = y_i',        T(t_k) v_k = x_k,

and one of them with a norm of at most gamma exists only if Pick's matrix is positive semidefinite (Ball, Gohberg, Rodman 1990,
Interpolation of Rational Matrix Functions, chapter 18; Zames, Francis 1983):

    [ (gamma p_i' p_j* - y_i' y_j* / gamma) / (s_i + s_j*)    (p_i' x_k - y_i' v_k) / (t_k - s_i)                  ]
    [ *                                                       (gamma v_k* v_l - x_k* x_l / gamma) / (t_k* + t_l)   ]  >= 0.

If inputs steer some states at no cost, M - s E is singular everywhere. So the pairs are taken as [q; p] = N k, k' (Q - s U) = 0,
of a `SynthesisInequality`: it has them all, and its pencil is not singular.

No zero is a float. So each is enclosed: with (k, s) near a solution, R near the inverse of the derivative there, and the residual
bounded with its rounding, a solution lies within the radius r for which |R residual| + |I - R derivative| r + |R| |U| r^2 / 2 is
at most r (Krawczyk; the equation is quadratic, and Brouwer's theorem does the rest). If there are several k at a zero, additional
rows select the one that proves most by itself. A vector must have a negative form under Pick's matrix for all that is enclosed.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from synth.analysis.synthesis_inequality import SynthesisInequality, transposed
from synth.plant.generalized import GeneralizedPlant
from synth.plant.units import own_units

STEPS = 3  # of Newton's method from the given approximation of a zero
SAFE = 4.0  # times what a sum of products may lose to rounding: they are complex, and norms of matrices are computed, too
SHORT = (1e-9, 1e-6, 1e-3)  # relative distance below the best bound in floats, to leave room for the enclosure
TINY = 1e-60  # gamma; the largest is 1 / TINY
SEED = 20261122
NEARLY = 1e-6  # relative; a singular value this small may be zero at a zero that is not a float
APART = 1e-6  # relative; of zeros that are closer only the first counts

Zeros = tuple[Sequence[complex], Sequence[complex]]  # [rad/s], from u to z and from w to y


class Node(NamedTuple):
    """The enclosed interpolation condition p' T(s) = y' at a zero of the plant or the transposed one.

    Attributes:
        zero: s [rad/s].
        p: of length one, shape (d,).
        y: shape (r,).
        off: radii of the enclosures of s, p and y.
    """

    zero: complex
    p: Array
    y: Array
    off: tuple[float, float, float]


@np.errstate(all="ignore")  # as below
def zero_limit(
    plant: GeneralizedPlant,
    Cy: Array | None = None,
    inequalities: tuple[SynthesisInequality, SynthesisInequality | None] | None = None,
    Dyw: Array | None = None,
) -> tuple[float, Zeros]:
    """Returns the largest norm that zeros in the right half plane prove, and approximations of these; 0 and none if none do.

    Args:
        Cy: shape (q, n); None for state feedback and more, for which only the zeros from u to z count.
        inequalities: of the plant, and of the transposed one, if they are known already.
        Dyw: shape (q, r); zero if it is not given.
    """
    one, other = _sides(plant, Cy, Dyw, inequalities)
    left, right = (_enclosed(side, side.zeros()) for side in (one, other))
    best: tuple[float, Zeros] = (0.0, ((), ()))
    for some in [(left, right), (left, []), ([], right), *(([one], []) for one in left), *(([], [one]) for one in right)]:
        gamma = _limit(*some)
        if gamma > best[0]:
            best = gamma, (tuple(node.zero for node in some[0]), tuple(node.zero for node in some[1]))
    near = best[1]  # the proof must be reproducible from these approximations alone
    return _limit(_enclosed(one, near[0]), _enclosed(other, near[1])), near


@np.errstate(all="ignore")  # what is not finite proves nothing
def limit_at_zeros(plant: GeneralizedPlant, Cy: Array | None, near: Zeros, Dyw: Array | None = None) -> float:
    """Returns a proved lower bound on the norm from the zeros near some points; 0 if none is enclosed."""
    left, right = (_enclosed(side, points) for side, points in zip(_sides(plant, Cy, Dyw), near, strict=True))
    return _limit(left, right)


def _limit(left: Sequence[Node], right: Sequence[Node]) -> float:
    """Returns the bound that nodes prove, without nodes that are too close to an earlier one."""
    nodes: list[list[Node]] = [[], []]
    for kind, given in zip(nodes, (left, right), strict=True):
        for one in given:
            if all(abs(one.zero - other.zero) > APART * abs(one.zero) for some in nodes for other in some):
                kind.append(one)
    if not any(nodes):
        return 0.0
    pick = _Pick(*nodes)
    best = pick.least()
    return next((gamma for short in SHORT if pick.refuses(gamma := best * (1 - short))), 0.0)


def _sides(
    plant: GeneralizedPlant,
    Cy: Array | None,
    Dyw: Array | None,
    inequalities: tuple[SynthesisInequality, SynthesisInequality | None] | None = None,
) -> "tuple[_Own, _Own]":
    """Returns the equations of the plant and of the transposed one; the latter are empty if nothing is measured."""
    one, other = inequalities or (SynthesisInequality.of(plant), None)
    if Cy is None:
        return _Own.of(plant, one), _NOTHING
    turned = transposed(plant, Cy, Dyw)
    return _Own.of(plant, one), _Own.of(turned, other or SynthesisInequality.of(turned))


class _Own(NamedTuple):
    """The equations k' (Q - s U) = 0, p = c' k, y = b' k of a `SynthesisInequality`, scaled to entries of size one.

    Attributes:
        U, Q, b, c: every entry rounded once.
        time: unit of s [rad/s].
        answer: unit of y.
    """

    U: Array
    Q: Array
    b: Array
    c: Array
    time: float = 1.0
    answer: float = 1.0

    @classmethod
    def of(cls, plant: GeneralizedPlant, side: SynthesisInequality) -> "_Own":
        """Returns the equations in units that are powers of two: scaling rounds nothing."""
        units = own_units(plant)
        time, states = _power(units.rate), units.states[side.coordinates]
        try:
            U, Q, b, c = side.floats()
        except OverflowError:  # numbers that are too far apart
            return _NOTHING
        U, Q = U * states, Q * states / time
        rows = np.array([_power(float(size)) for size in np.linalg.norm(np.hstack([U, Q]), axis=1)])[:, None]
        U, Q, b, c = U / rows, Q / rows, b / rows, c / rows
        y, p = _power(float(np.linalg.norm(b))), _power(float(np.linalg.norm(c)))
        return cls(U, Q, b / y, c / p, time, y / p)

    def zeros(self) -> list[complex]:
        """Returns approximate points of the right half plane where Q - s U loses rank; other points too if it is not square."""
        k, a = self.U.shape
        if not 0 < a <= k:
            return []
        mixed = np.eye(k) if k == a else np.random.default_rng(SEED).standard_normal((a, k))
        zeros = np.asarray(linalg.eigvals(mixed @ self.Q, mixed @ self.U)).tolist()
        return [zero * self.time for zero in zeros if np.isfinite(zero) and zero.real > 0 and self.loses_rank(zero)]

    def loses_rank(self, s: complex) -> bool:
        """Returns True if Q - s U may be rank deficient at s."""
        sizes = np.linalg.svd(self.Q - s * self.U, compute_uv=False)
        return bool(sizes[-1] <= NEARLY * sizes[0])

    def strongest(self, s: complex) -> tuple[Array, Array]:
        """Returns the unit vector k near k' (Q - s U) = 0 with the largest |y| / |p|, and rows that single it out."""
        basis = np.linalg.svd(self.Q - s * self.U)[0][:, self.U.shape[1] - 1 :].conj()
        own, answer = basis.T @ self.c, basis.T @ self.b
        directions, sizes, _ = np.linalg.svd(own, full_matrices=False)
        kept = sizes > NEARLY * sizes.max(initial=0.0)
        directions = directions[:, kept] / sizes[kept]
        best = directions @ np.linalg.svd(directions.conj().T @ answer)[0][:, :1]
        k = (basis @ best.conj())[:, 0] if basis.shape[1] > 1 and kept.any() else basis[:, 0]
        return k / np.linalg.norm(k), basis.conj().T


_NOTHING = _Own(*[np.zeros((0, 0))] * 4, time=1.0, answer=1.0)


def _power(size: float) -> float:
    """Returns the power of two next to a size; 1 if the size is 0."""
    return float(np.exp2(np.round(np.log2(size)))) if size > 0 else 1.0


def _enclosed(side: _Own, points: Sequence[complex]) -> list[Node]:
    """Returns the nodes of the zeros near some points that can be enclosed in the right half plane."""
    return [found for point in points if (found := _enclosed_near(side, complex(point) / side.time)) is not None]


def _enclosed_near(side: _Own, near: complex) -> Node | None:
    (k, a), U, Q = side.U.shape, side.U, side.Q
    if not 0 < a <= k or not np.isfinite(near):
        return None
    try:
        v, rows = side.strongest(near)
        target, s = rows @ v, near
        for _ in range(STEPS):
            R, residual, _ = _newton(side, rows, target, v, s)
            moved = R @ residual
            v, s = v - moved[:-1], complex(s - moved[-1])
        R, residual, derivative = _newton(side, rows, target, v, s)
    except np.linalg.LinAlgError:  # a double zero, or every point one
        return None
    unit = SAFE * (k + a + 4) * np.finfo(float).eps
    below = (np.abs(Q).T + abs(s) * np.abs(U).T) @ np.abs(v), np.abs(rows) @ np.abs(v) + np.abs(target)
    rounding = unit * np.concatenate(below)
    size, bend = (1 + unit) * float(np.linalg.norm(R)), (1 + unit) * float(np.linalg.norm(U))
    first = (1 + unit) * float(np.linalg.norm(R @ residual)) + size * float(np.linalg.norm(rounding))
    # The derivative, too, is rounded: in its own entries, and by cancellation in Q - s U and U' v.
    shaken = float(np.linalg.norm(derivative)) + float(np.linalg.norm(Q)) + (abs(s) + float(np.linalg.norm(v))) * bend
    contraction = float(np.linalg.norm(np.eye(k + 1) - R @ derivative)) + unit * size * shaken
    radius = 2 * first / (1 - contraction)
    if not (contraction < 0.5 and first + contraction * radius + size * bend * radius**2 / 2 <= radius < s.real):
        return None
    p, y, off = v @ side.c, v @ side.b, radius + unit * float(np.linalg.norm(v))
    length, off_p, off_y = float(np.linalg.norm(p)), off * float(np.linalg.norm(side.c)), off * float(np.linalg.norm(side.b))
    if not off_p < length:
        return None
    off_y = off_y / length * side.answer
    return Node(s * side.time, p / length, y / length * side.answer, (radius * side.time, off_p / length, off_y))


def _newton(side: _Own, rows: Array, target: Array, v: Array, s: complex) -> tuple[Array, Array, Array]:
    """Returns the inverse of the derivative of (Q - s U)' v = 0, rows v = target, the residual, and the derivative."""
    shifted = (side.Q - s * side.U).T
    derivative = np.block([[shifted, -(side.U.T @ v)[:, None]], [rows, np.zeros((len(rows), 1))]])
    return np.linalg.inv(derivative), np.concatenate([shifted @ v, rows @ v - target]), derivative


class _Pick:
    """Pick's matrix gamma G + O - K / gamma, with error bounds on the entries of each part."""

    def __init__(self, left: Sequence[Node], right: Sequence[Node]) -> None:
        k, nodes = len(left), [*left, *right]
        shape = 3, len(nodes), len(nodes)
        self.parts, self.off = np.zeros(shape, dtype=complex), np.zeros(shape)
        for i, one in enumerate(nodes):
            for j, other in enumerate(nodes):
                at = one.zero, other.zero
                if (i < k) == (j < k):
                    below = at[0] + np.conj(at[1])
                    products = (
                        _product(one.p, one.off[1], other.p.conj(), other.off[1]),
                        _product(one.y, one.off[2], other.y.conj(), other.off[2]),
                    )
                    for part, product in zip((0, 2), products, strict=True):
                        entry, off = _quotient(product, below, one, other)
                        self.parts[part, i, j] = entry if i < k else np.conj(entry)
                        self.off[part, i, j] = off
                elif i < k:
                    (first, lost), (second, more) = (
                        _product(one.p, one.off[1], other.y, other.off[2]),
                        _product(one.y, one.off[2], other.p, other.off[1]),
                    )
                    entry, off = _quotient((first - second, lost + more), at[1] - at[0], one, other)
                    self.parts[1, i, j], self.parts[1, j, i] = entry, np.conj(entry)
                    self.off[1, i, j] = self.off[1, j, i] = off

    def at(self, gamma: float) -> Array:
        """Returns the matrix in floats."""
        return gamma * self.parts[0] + self.parts[1] - self.parts[2] / gamma

    def least(self) -> float:
        """Returns the smallest gamma for which the matrix is positive semidefinite, in floats."""
        low, high = TINY, 1 / TINY
        while high > low * (1 + SHORT[0] / 10):
            middle = (low * high) ** 0.5
            low, high = (middle, high) if np.linalg.eigvalsh(self.at(middle))[0] < 0 else (low, middle)
        return low

    def refuses(self, gamma: float) -> bool:
        """Returns True if no matrix within the error bounds is positive semidefinite."""
        entries = self.at(gamma)
        direction = np.linalg.eigh(entries)[1][:, 0]
        form, size = float(np.real(direction.conj() @ entries @ direction)), np.abs(direction)
        sizes = gamma * np.abs(self.parts[0]) + np.abs(self.parts[1]) + np.abs(self.parts[2]) / gamma
        rounding = SAFE * (len(size) + 4) * np.finfo(float).eps * sizes
        return bool(form + size @ (gamma * self.off[0] + self.off[1] + self.off[2] / gamma + rounding) @ size < 0)


def _product(a: Array, da: float, b: Array, db: float) -> tuple[complex, float]:
    """Returns the product of two vectors with errors da and db, and a bound on its error with rounding."""
    size_a, size_b = float(np.linalg.norm(a)), float(np.linalg.norm(b))
    return complex(a @ b), da * size_b + db * size_a + da * db + SAFE * (len(a) + 4) * np.finfo(float).eps * size_a * size_b


def _quotient(above: tuple[complex, float], below: complex, one: Node, other: Node) -> tuple[complex, float]:
    """Returns a quotient by a sum or difference of two zeros, and a bound on its error; infinite if the divisor may be zero."""
    moved = one.off[0] + other.off[0] + SAFE * np.finfo(float).eps * (abs(one.zero) + abs(other.zero))
    entry = above[0] / below
    return entry, (above[1] + abs(entry) * moved) / (abs(below) - moved) if abs(below) > moved else np.inf
