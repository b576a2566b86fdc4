"""What zeros in the right half plane allow no controller: at such a zero some of z answers to w alone, and to some of w z alone.

Let M - s E = [A - s, B; C, D] be square and singular at s, Re s > 0, with [q; p]' (M - s E) = 0. Whatever controller makes the
loop stable, x and u exist at s, and p' z = (q' Bw + p' Dw) w there. The transposed plant with inputs C_y' says for the zeros from
w to y that some z = x follows from some w = v whatever controller of y there is, of any order. So the transfer function T from w
to z is known in directions at points of the right half plane,

    p_i' T(s_i) = y_i',        T(t_k) v_k = x_k,

and one of them with a norm of at most gamma exists only if Pick's matrix is positive semidefinite (Ball, Gohberg, Rodman 1990,
Interpolation of Rational Matrix Functions, chapter 18; Zames, Francis 1983):

    [ (gamma p_i' p_j* - y_i' y_j* / gamma) / (s_i + s_j*)    (p_i' x_k - y_i' v_k) / (t_k - s_i)                  ]
    [ *                                                       (gamma v_k* v_l - x_k* x_l / gamma) / (t_k* + t_l)   ]  >= 0.

No zero is a float. So each is enclosed: with (q, p, s) near a solution, R near the inverse of the derivative there, and the
residual bounded with its rounding, a solution lies within the radius r for which |R residual| + |I - R derivative| r +
|R| r^2 / 2 is at most r (Krawczyk; the equation is quadratic, and Brouwer's theorem does the rest). That a vector has a negative
form under Pick's matrix is asked of all that is enclosed.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.common.errors import InputError
from synth.certificate.side import transposed
from synth.plant import GeneralizedPlant
from synth.scaling import own_units

STEPS = 3  # of Newton's method from where a zero is said to be
SAFE = 4.0  # times what a sum of products may lose to rounding: they are complex, and norms of matrices are computed, too
SHORT = (1e-9, 1e-6, 1e-3)  # how far below the best bound one is tried: what is enclosed must fit in between
TINY = 1e-60  # gamma; the largest is 1 / TINY
APART = 1e-6  # relative; of zeros that are closer only the first is looked at

Zeros = tuple[Sequence[complex], Sequence[complex]]  # [rad/s], from u to z and from w to y


class Node(NamedTuple):
    """p' T(s) = y' of a zero, or of the transposed plant, and what is enclosed: each within `off` of what is said.

    Attributes:
        zero: s [rad/s].
        p: of length one, shape (d,).
        y: shape (r,).
        off: of s, of p and of y, each of its own.
    """

    zero: complex
    p: Array
    y: Array
    off: tuple[float, float, float]


def zero_limit(plant: GeneralizedPlant, Cy: Array | None = None) -> tuple[float, Zeros]:
    """The largest norm that zeros in the right half plane prove, and these, nearly; 0 and none where none do.

    Args:
        plant: n states, m inputs.
        Cy: shape (q, n); None for state feedback and more, of which only the zeros from u to z count.
    """
    left, right = (*(_zeros(each) for each in _sides(plant, Cy)), ())[:2]
    best: tuple[float, Zeros] = (0.0, ((), ()))
    for which in [(left, right), (left, ()), ((), right), *(((one,), ()) for one in left), *(((), (one,)) for one in right)]:
        gamma = limit_at_zeros(plant, Cy, which)
        if gamma > best[0]:
            best = gamma, which
    return best


@np.errstate(all="ignore")  # what is not finite proves nothing
def limit_at_zeros(plant: GeneralizedPlant, Cy: Array | None, near: Zeros) -> float:
    """A norm that no controller reaches, for zeros near some points; proved, and 0 where none is enclosed."""
    nodes: list[list[Node]] = [[], []]
    for kind, each, points in zip(nodes, _sides(plant, Cy), near, strict=False):
        for point in points:
            found = _enclosed(each, point)
            if found is not None and all(
                abs(found.zero - other.zero) > APART * abs(found.zero) for some in nodes for other in some
            ):
                kind.append(found)
    left, right = nodes
    if not left and not right:
        return 0.0
    pick = _Pick(left, right)
    best = pick.least()
    return next((gamma for short in SHORT if pick.refuses(gamma := best * (1 - short))), 0.0)


def _alike(one: Node, other: Node) -> bool:
    return abs(one.zero - other.zero) <= APART * abs(one.zero)


def _sides(plant: GeneralizedPlant, Cy: Array | None) -> Iterator[GeneralizedPlant]:
    """The plant, and the transposed one."""
    yield plant
    if Cy is not None:
        yield transposed(plant, Cy)


def _pencil(plant: GeneralizedPlant) -> tuple[Array, Array]:
    """M and E."""
    n, m = plant.B.shape
    E = np.zeros((n + len(plant.C), n + m))
    E[np.arange(n), np.arange(n)] = 1
    return plant.system_matrix[:, : n + m], E


@np.errstate(all="ignore")  # infinite zeros
def _zeros(plant: GeneralizedPlant) -> tuple[complex, ...]:
    """The zeros from u to z in the right half plane; none if not as many of u as of z, or in no units alike."""
    try:
        M, E = _pencil(own_units(plant).into(plant))
    except InputError:
        return ()
    if len(M) != M.shape[1]:
        return ()
    zeros = np.asarray(linalg.eigvals(M, E))
    return tuple(zero for zero in zeros.tolist() if np.isfinite(zero) and zero.real > 0)


def _enclosed(plant: GeneralizedPlant, near: complex) -> Node | None:
    """What the zero next to a point says; None where none is enclosed in the right half plane."""
    # In units in which all numbers have size one, each a power of two: nothing is rounded on the way there and back.
    units = own_units(plant)
    try:
        own, time = units.into(plant), _power(units.rate)
        z, w = _power(float(np.linalg.norm(np.hstack([own.C, own.D])))), time / _power(float(np.linalg.norm(own.Bw)))
        own = GeneralizedPlant(own.A / time, own.B / time, own.Bw * (w / time), own.C / z, own.D / z, own.Dw * (w / z))
    except InputError:  # there are none: numbers that are too far apart
        return None
    found = _enclosed_in_own(own, near / time)
    if found is None:
        return None
    off = found.off[0] * time, found.off[1], found.off[2] * (z / w)
    return Node(found.zero * time, found.p, found.y * (z / w), off)


def _power(size: float) -> float:
    """The power of two next to a size; 1 where there is none."""
    return float(np.exp2(np.round(np.log2(size)))) if size > 0 else 1.0


def _enclosed_in_own(plant: GeneralizedPlant, near: complex) -> Node | None:
    """The same for a plant whose numbers have size one."""
    n, (M, E) = len(plant.A), _pencil(plant)
    N = len(M)
    if M.shape[1] != N or not np.isfinite(near):
        return None
    try:
        last = np.linalg.svd(M - near * E)[0][:, -1]
        v, s = last.conj(), near
        for _ in range(STEPS):
            R, residual, _ = _newton(M, E, last, v, s)
            moved = R @ residual
            v, s = v - moved[:-1], complex(s - moved[-1])
        R, residual, derivative = _newton(M, E, last, v, s)
    except np.linalg.LinAlgError:  # a double zero, or every point one
        return None
    unit = SAFE * (N + 4) * np.finfo(float).eps
    rounding = unit * np.append((np.abs(M).T + abs(s) * E.T) @ np.abs(v), np.abs(last) @ np.abs(v) + 1)
    size = (1 + unit) * float(np.linalg.norm(R))
    first = (1 + unit) * float(np.linalg.norm(R @ residual)) + size * float(np.linalg.norm(rounding))
    contraction = float(np.linalg.norm(np.eye(N + 1) - R @ derivative)) + unit * size * float(np.linalg.norm(derivative))
    radius = 2 * first / (1 - contraction)
    length, from_w = float(np.linalg.norm(v[n:])), np.vstack([plant.Bw, plant.Dw])
    if not (contraction < 0.5 and first + contraction * radius + size * radius**2 / 2 <= radius < min(s.real, length)):
        return None
    off = radius + unit * float(np.linalg.norm(v))
    return Node(s, v[n:] / length, v @ from_w / length, (radius, off / length, off * float(np.linalg.norm(from_w)) / length))


def _newton(M: Array, E: Array, last: Array, v: Array, s: complex) -> tuple[Array, Array, Array]:
    """The inverse of the derivative of (M - s E)' v = 0, last' v = 1, the residual, and the derivative."""
    shifted = (M - s * E).T
    derivative = np.block([[shifted, -(E.T @ v)[:, None]], [last[None], np.zeros((1, 1))]])
    return np.linalg.inv(derivative), np.append(shifted @ v, last @ v - 1), derivative


class _Pick:
    """Pick's matrix gamma G + O - K / gamma, and by how much the entries of each may differ from those of what is enclosed."""

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
        """The matrix, in floats."""
        return gamma * self.parts[0] + self.parts[1] - self.parts[2] / gamma

    def least(self) -> float:
        """The gamma from which it is positive semidefinite, in floats."""
        low, high = TINY, 1 / TINY
        while high > low * (1 + SHORT[0] / 10):
            middle = (low * high) ** 0.5
            low, high = (middle, high) if np.linalg.eigvalsh(self.at(middle))[0] < 0 else (low, middle)
        return low

    def refuses(self, gamma: float) -> bool:
        """Whether it is not positive semidefinite, whatever it is of what is enclosed."""
        entries = self.at(gamma)
        direction = np.linalg.eigh(entries)[1][:, 0]
        form, size = float(np.real(direction.conj() @ entries @ direction)), np.abs(direction)
        sizes = gamma * np.abs(self.parts[0]) + np.abs(self.parts[1]) + np.abs(self.parts[2]) / gamma
        rounding = SAFE * (len(size) + 4) * np.finfo(float).eps * sizes
        return bool(form + size @ (gamma * self.off[0] + self.off[1] + self.off[2] / gamma + rounding) @ size < 0)


def _product(a: Array, da: float, b: Array, db: float) -> tuple[complex, float]:
    """A product of two vectors, each within some distance of what is meant, and how far it may be off, with rounding."""
    size_a, size_b = float(np.linalg.norm(a)), float(np.linalg.norm(b))
    return complex(a @ b), da * size_b + db * size_a + da * db + SAFE * (len(a) + 4) * np.finfo(float).eps * size_a * size_b


def _quotient(above: tuple[complex, float], below: complex, one: Node, other: Node) -> tuple[complex, float]:
    """What is above over a sum or difference of two zeros, and how far it may be off; infinitely where that may be zero."""
    moved = one.off[0] + other.off[0] + SAFE * np.finfo(float).eps * (abs(one.zero) + abs(other.zero))
    entry = above[0] / below
    return entry, (above[1] + abs(entry) * moved) / (abs(below) - moved) if abs(below) > moved else np.inf
