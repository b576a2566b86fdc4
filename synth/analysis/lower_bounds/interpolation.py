"""Lower bounds on the norm from zeros in the closed right half plane, at which no controller affects some directions of z or w.

Assume that M - s E = [A - s, B; C, D] loses rank at a point s with Re s > 0, and that [q; p]' (M - s E) = 0. In every stable
loop, the Laplace transforms of x and u are finite at s. Therefore p' z = (q' Bw + p' Dw) w at s for every controller.
The transposed plant gives a second condition. Let t be a zero of the transfer function from w to y = C_y x + Dyw w. At t, some
w = v leads to the same output z = x, whatever controller uses the measurements y. The transfer matrix T from w to z thus
satisfies the interpolation conditions

    p_i' T(s_i) = y_i',        T(t_k) v_k = x_k.

A stable T with a norm of at most gamma can satisfy the interpolation conditions only if Pick's matrix is positive semidefinite:

    [ (gamma p_i' p_j* - y_i' y_j* / gamma) / (s_i + s_j*)    (p_i' x_k - y_i' v_k) / (t_k - s_i)                  ]
    [ *                                                       (gamma v_k* v_l - x_k* x_l / gamma) / (t_k* + t_l)   ]  >= 0.

Sources: Ball, Gohberg, Rodman 1990, Interpolation of Rational Matrix Functions, chapter 18; Zames, Francis 1983.

If some inputs do not appear in z, M - s E can be singular at every s. The pairs [q; p] are therefore computed as [q; p] = N
k with k' (Q - s U) = 0. Here Q - s U is the pencil of a `SynthesisInequality`. The pencil Q - s U is regular, and it yields all
pairs [q; p].

On the imaginary axis, one interpolation condition is enough to prove that the norm is at least |x_k| / |v_k|. On the imaginary
axis, the interpolation conditions of the plant come from its invariant points (see `invariant_point.py`). The interpolation
conditions of the transposed plant come from disturbances that do not reach y at some frequency, or at infinity.

A zero in the open half plane is usually not a floating-point number, so it is enclosed in a disk. Let (k, s) be close to a
solution of the equations k' (Q - s U) = 0 with a normalised k, and let R approximate the inverse of their derivative at (k, s).
The residual in the inequality below includes a bound on the rounding error of the residual. An exact solution lies within the
radius r around (k, s) if |R residual| + |I - R derivative| r + |R| |U| r^2 / 2 <= r (`radius_of_solution`). If several vectors
k belong to the same zero, additional equations select the vector that gives the largest bound. No controller reaches the norm
gamma if some vector v satisfies v* P v < 0 for every Pick matrix P within the enclosures.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from synth.analysis.lower_bounds.exact_algebra import radius_of_solution
from synth.analysis.lower_bounds.invariant_point import limit_at, limit_at_infinity
from synth.analysis.lower_bounds.synthesis_inequality import SynthesisInequality
from synth.plant.generalized import Plant
from synth.plant.units import nearest_power, own_units

STEPS = 3  # number of Newton steps that improve the approximation of a zero
# factor by which the rounding error of a real sum of products is multiplied, so that the error bound also covers complex
# products and matrix norms
SAFE = 4.0
# Relative amounts by which the best floating-point bound is reduced before a proof is tried, in this order. The reduction
# leaves room for the errors of the enclosures
SHORT = (1e-9, 1e-6, 1e-3)
TINY = 1e-60  # smallest gamma that the search tries; the largest is 1 / TINY
SEED = 20261122
# a singular value below this multiple of the largest one counts as zero, because the position of the plant's zero is rounded
NEARLY = 1e-6
APART = 1e-6  # if the relative distance between two zeros is smaller than this, only the first zero is used

Zeros = tuple[Sequence[complex], Sequence[complex]]  # zeros from u to z, and zeros from w to y [rad/s]


class Node(NamedTuple):
    """Interpolation condition p' T(s) = y' at a zero of the plant or of the transposed plant, with enclosures of s, p and y.

    Attributes:
        zero: approximate zero s [rad/s].
        p: approximate direction p in the space of z, of length 1, shape (d,).
        y: approximate vector y, shape (r,).
        radii: radii of the disks around `zero`, `p` and `y` that contain the exact values.
    """

    zero: complex
    p: Array
    y: Array
    radii: tuple[float, float, float]


@np.errstate(all="ignore")  # a value that is infinite or NaN never counts as a proof
def zero_limit(
    plant: Plant, inequalities: tuple[SynthesisInequality, SynthesisInequality | None] | None = None
) -> tuple[float, Zeros]:
    """Returns the largest lower bound that zeros in the right half plane prove, and approximations of these zeros.

    The bound is 0 if the zeros do not prove any bound.

    Args:
        plant: plant to which the bound applies. If the plant has no measurements, all states count as measured, and only zeros
            from u to z are used.
        inequalities: synthesis inequalities of the plant and of the transposed plant; None if they are not computed yet. The
            inequality of the transposed plant is None if the transposed plant is not used.
    """
    one, other = _sides(plant, inequalities)
    left, right = (_enclosed_nodes(side, side.zeros()) for side in (one, other))
    best: tuple[float, Zeros] = (0.0, ((), ()))
    for some in [(left, right), (left, []), ([], right), *(([one], []) for one in left), *(([], [one]) for one in right)]:
        gamma = _limit(*some)
        if gamma > best[0]:
            best = gamma, (tuple(node.zero for node in some[0]), tuple(node.zero for node in some[1]))
    # The bound is computed again from the approximate zeros only, because a later check of the proof has nothing else.
    near = best[1]
    return _limit(_enclosed_nodes(one, near[0]), _enclosed_nodes(other, near[1])), near


@np.errstate(all="ignore")  # a value that is infinite or NaN never counts as a proof
def limit_at_zeros(plant: Plant, near: Zeros) -> float:
    """Returns the lower bound on the norm that zeros near the given points prove; 0 if no zero can be enclosed."""
    left, right = (_enclosed_nodes(side, points) for side, points in zip(_sides(plant), near, strict=True))
    others = [0.0]
    if len(plant.Cy) and plant.dt is None:
        turned = plant.transposed
        others.append(limit_at_infinity(plant))
        others += [limit_at(turned, zero.imag) for zero in near[1] if zero.real == 0]
    return max(_limit(left, right), *others)


def _limit(left: Sequence[Node], right: Sequence[Node]) -> float:
    """Returns the lower bound on the norm that several interpolation conditions prove together; 0 if the conditions prove no
    bound.

    An interpolation condition whose zero is too close to the zero of an earlier condition is ignored.
    """
    nodes: list[list[Node]] = [[], []]
    for kind, given in zip(nodes, (left, right), strict=True):
        for one in given:
            if all(abs(one.zero - other.zero) > APART * abs(one.zero) for some in nodes for other in some):
                kind.append(one)
    if not any(nodes):
        return 0.0
    pick = _Pick(*nodes)
    best = pick.least()
    return next((gamma for short in SHORT if pick.excludes(gamma := best * (1 - short))), 0.0)


def _sides(
    plant: Plant, inequalities: tuple[SynthesisInequality, SynthesisInequality | None] | None = None
) -> "tuple[_Pencil, _Pencil]":
    """Returns the equations (`_Pencil`) of the plant and of the transposed plant; the latter are empty if nothing is measured."""
    if inequalities is None:
        inequalities = SynthesisInequality.of(plant), SynthesisInequality.of(plant.transposed) if len(plant.Cy) else None
    one, other = inequalities
    return _Pencil.of(plant, one), _EMPTY if other is None else _Pencil.of(plant.transposed, other)


class _Pencil(NamedTuple):
    """Equations k' (Q - s U) = 0, p = c' k, y = b' k of a `SynthesisInequality`, scaled so that the entries are near 1.

    Attributes:
        U, Q, b, c: matrices of the equations, with every matrix entry rounded once.
        rate: unit in which s is expressed [rad/s].
        unit: unit in which the vector y is expressed.
    """

    U: Array
    Q: Array
    b: Array
    c: Array
    rate: float = 1.0
    unit: float = 1.0

    @classmethod
    def of(cls, plant: Plant, side: SynthesisInequality) -> "_Pencil":
        """Returns the equations in units that are powers of two, so that scaling causes no rounding error."""
        units = own_units(plant)
        rate, states = nearest_power(units.rate) if plant.dt is None else 1.0, units.states[side.coordinates]
        try:
            U, Q, b, c = side.floats()
        except OverflowError:  # the matrix entries differ by too many orders of magnitude
            return _EMPTY
        U, Q = U * states, Q * states / rate
        rows = np.array([nearest_power(float(size)) for size in np.linalg.norm(np.hstack([U, Q]), axis=1)])[:, None]
        U, Q, b, c = U / rows, Q / rows, b / rows, c / rows
        y, p = nearest_power(float(np.linalg.norm(b))), nearest_power(float(np.linalg.norm(c)))
        return cls(U, Q, b / y, c / p, rate, y / p)

    def zeros(self) -> list[complex]:
        """Returns approximations of the points in the right half plane at which Q - s U loses rank.

        If U and Q are not square, the result may also contain points at which Q - s U does not lose rank.
        """
        k, a = self.U.shape
        if not 0 < a <= k:
            return []
        mixed = np.eye(k) if k == a else np.random.default_rng(SEED).standard_normal((a, k))
        zeros = np.asarray(linalg.eigvals(mixed @ self.Q, mixed @ self.U)).tolist()
        return [zero * self.rate for zero in zeros if np.isfinite(zero) and zero.real > 0 and self.loses_rank(zero)]

    def loses_rank(self, s: complex) -> bool:
        """Returns True if the matrix Q - s U may lose rank at s."""
        sizes = np.linalg.svd(self.Q - s * self.U, compute_uv=False)
        return bool(sizes[-1] <= NEARLY * sizes[0])

    def strongest(self, s: complex) -> tuple[Array, Array]:
        """Returns the unit vector k with the largest |y| / |p| of all k for which k' (Q - s U) is near 0, and equations (rows)
        that select this k.
        """
        basis = np.linalg.svd(self.Q - s * self.U)[0][:, self.U.shape[1] - 1 :].conj()
        p, y = basis.T @ self.c, basis.T @ self.b
        directions, sizes, _ = np.linalg.svd(p, full_matrices=False)
        mask = sizes > NEARLY * sizes.max(initial=0.0)
        directions = directions[:, mask] / sizes[mask]
        best = directions @ np.linalg.svd(directions.conj().T @ y)[0][:, :1]
        k = (basis @ best.conj())[:, 0] if basis.shape[1] > 1 and mask.any() else basis[:, 0]
        return k / np.linalg.norm(k), basis.conj().T


_EMPTY = _Pencil(*[np.zeros((0, 0))] * 4, rate=1.0, unit=1.0)


def _enclosed_nodes(side: _Pencil, points: Sequence[complex]) -> list[Node]:
    """Returns the interpolation conditions at those zeros near the given points that can be enclosed in the right half plane."""
    return [enclosure for point in points if (enclosure := _enclosed_near(side, complex(point) / side.rate)) is not None]


def _enclosed_near(side: _Pencil, near: complex) -> Node | None:
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
    except np.linalg.LinAlgError:  # the zero is a double zero, or the pencil is singular
        return None
    unit = SAFE * (k + a + 4) * np.finfo(float).eps
    terms = (np.abs(Q).T + abs(s) * np.abs(U).T) @ np.abs(v), np.abs(rows) @ np.abs(v) + np.abs(target)
    rounding = unit * np.concatenate(terms)
    size, curvature = (1 + unit) * float(np.linalg.norm(R)), (1 + unit) * float(np.linalg.norm(U))
    first = (1 + unit) * float(np.linalg.norm(R @ residual)) + size * float(np.linalg.norm(rounding))
    # The derivative has rounding errors, too: its entries are rounded, and digits cancel in Q - s U and U' v.
    slopes = float(np.linalg.norm(derivative)) + float(np.linalg.norm(Q)) + (abs(s) + float(np.linalg.norm(v))) * curvature
    contraction = float(np.linalg.norm(np.eye(k + 1) - R @ derivative)) + unit * size * slopes
    radius = radius_of_solution(first, contraction, size * curvature)
    if radius is None or not radius < s.real:
        return None
    p, y, of_v = v @ side.c, v @ side.b, radius + unit * float(np.linalg.norm(v))
    length, of_p, of_y = float(np.linalg.norm(p)), of_v * float(np.linalg.norm(side.c)), of_v * float(np.linalg.norm(side.b))
    if not of_p < length:
        return None
    of_y = of_y / length * side.unit
    return Node(s * side.rate, p / length, y / length * side.unit, (radius * side.rate, of_p / length, of_y))


def _newton(side: _Pencil, rows: Array, target: Array, v: Array, s: complex) -> tuple[Array, Array, Array]:
    """Returns the inverse derivative, the residual and the derivative of the equations (Q - s U)' v = 0, `rows` v = `target`."""
    shifted = (side.Q - s * side.U).T
    derivative = np.block([[shifted, -(side.U.T @ v)[:, None]], [rows, np.zeros((len(rows), 1))]])
    return np.linalg.inv(derivative), np.concatenate([shifted @ v, rows @ v - target]), derivative


class _Pick:
    """Pick's matrix, written as gamma G + O - K / gamma, and bounds on the errors of the entries of G, O and K."""

    def __init__(self, left: Sequence[Node], right: Sequence[Node]) -> None:
        k, nodes = len(left), [*left, *right]
        shape = 3, len(nodes), len(nodes)
        self.parts, self.errors = np.zeros(shape, dtype=complex), np.zeros(shape)
        for i, one in enumerate(nodes):
            for j, other in enumerate(nodes):
                if (i < k) == (j < k):
                    products = (
                        _product(one.p, one.radii[1], other.p.conj(), other.radii[1]),
                        _product(one.y, one.radii[2], other.y.conj(), other.radii[2]),
                    )
                    for part, product in zip((0, 2), products, strict=True):
                        entry, error = _quotient(product, one.zero + np.conj(other.zero), one, other)
                        self.parts[part, i, j] = entry if i < k else np.conj(entry)
                        self.errors[part, i, j] = error
                elif i < k:
                    (first, first_error), (second, second_error) = (
                        _product(one.p, one.radii[1], other.y, other.radii[2]),
                        _product(one.y, one.radii[2], other.p, other.radii[1]),
                    )
                    difference = first - second, first_error + second_error
                    entry, error = _quotient(difference, other.zero - one.zero, one, other)
                    self.parts[1, i, j], self.parts[1, j, i] = entry, np.conj(entry)
                    self.errors[1, i, j] = self.errors[1, j, i] = error

    def at(self, gamma: float) -> Array:
        """Returns Pick's matrix for `gamma`, computed in floats."""
        return gamma * self.parts[0] + self.parts[1] - self.parts[2] / gamma

    def least(self) -> float:
        """Returns the smallest gamma for which Pick's matrix is positive semidefinite, computed in floats."""
        low, high = TINY, 1 / TINY
        while high > low * (1 + SHORT[0] / 10):
            middle = (low * high) ** 0.5
            low, high = (middle, high) if np.linalg.eigvalsh(self.at(middle))[0] < 0 else (low, middle)
        return low

    def excludes(self, gamma: float) -> bool:
        """Returns True if no Pick matrix within the error bounds is positive semidefinite for `gamma`."""
        entries = self.at(gamma)
        direction = np.linalg.eigh(entries)[1][:, 0]
        form, size = float(np.real(direction.conj() @ entries @ direction)), np.abs(direction)
        sizes = gamma * np.abs(self.parts[0]) + np.abs(self.parts[1]) + np.abs(self.parts[2]) / gamma
        rounding = SAFE * (len(size) + 4) * np.finfo(float).eps * sizes
        errors = gamma * self.errors[0] + self.errors[1] + self.errors[2] / gamma + rounding
        return bool(form + size @ errors @ size < 0)


def _product(a: Array, da: float, b: Array, db: float) -> tuple[complex, float]:
    """Returns the product of the vectors a and b, whose errors are at most da and db, and a bound on the error of the product."""
    size_a, size_b = float(np.linalg.norm(a)), float(np.linalg.norm(b))
    return complex(a @ b), da * size_b + db * size_a + da * db + SAFE * (len(a) + 4) * np.finfo(float).eps * size_a * size_b


def _quotient(dividend: tuple[complex, float], divisor: complex, one: Node, other: Node) -> tuple[complex, float]:
    """Returns the quotient of two numbers and a bound on the error of this quotient. The divisor is the sum or the difference
    of two zeros.

    The error bound is infinite if the divisor may be zero.
    """
    error = one.radii[0] + other.radii[0] + SAFE * np.finfo(float).eps * (abs(one.zero) + abs(other.zero))
    entry = dividend[0] / divisor
    return entry, (dividend[1] + abs(entry) * error) / (abs(divisor) - error) if abs(divisor) > error else np.inf
