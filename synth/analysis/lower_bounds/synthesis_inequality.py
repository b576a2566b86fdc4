"""Inequality of a plant by Gahinet and Apkarian, which does not contain the controller, in exact integers and in floats.

For state feedback, LMI (21) has a solution Y if and only if N' M N < 0, where M is the left side of (21) at Y = 0. Here N is a
basis of all q with [B; D]' q = 0 (the elimination lemma; Gahinet, Apkarian 1994). For output feedback from y = C_y x + Dyw w,
an unknown matrix S must also satisfy the corresponding inequality for the transposed plant.

**Directions without cost.** If an input v does not appear in z (D v = 0), X can grow without bound along B v. X can also grow
along A B v, A^2 B v and so on, as long as the directions found in this way are not observable in z. The columns of F span all
directions without cost (`_closure`). A dual solution cannot give weight to directions without cost. Therefore, N is also
orthogonal to [F; 0] and [A F; C F], and X appears only as J X J', where J is a basis of all rows with J F = 0. For the
transposed plant (B = C_y', D = Dyw'), the rows of F' give the combinations of states that can be computed from y and its
derivatives, whatever w is.

X can also grow without bound along stable states that are unobservable in z.

**Discrete plants.** The inequality of a discrete plant is Q X Q' - U X U' + eta b b' - c c' < 0. Since 2 (Q X Q' - U X U') =
He((Q - U) X (Q + U)'), the matrices (Q - U) / 2 and Q + U replace Q and U, without rounding. In discrete plants, an input v
with D v = 0 does not cause directions without cost, because its zeros at infinity lie outside the unit circle. Instead, F
contains the states that the inputs can bring to zero within a finite number of samples while z remains zero.

All ranks are determined in integers from the exact entries of the plant, without tolerances. The result therefore depends
neither on the magnitude of a direction nor on the units of states, inputs, time, w and z.

**Stable zeros.** If U is square and Q - s U loses rank at a stable zero s, X can also grow without bound along the direction of
this zero. Dual solutions then belong to the left deflating subspace of the zeros that are not stable. With a basis L of this
left deflating subspace,

    L Q = Lambda L U,    W = L' W' L,    He(U' W Q) = (L U)' He(W' Lambda) (L U),

and W' solves the inequality with I, Lambda, L b, L c and L U X U' L' instead of U, Q, b, c and X. Floats cannot represent L and
Lambda exactly. L and Lambda are therefore approximated, with proved error bounds (`AntistablePart`), like the zeros in
`interpolation.py`. Zeros that lie on the imaginary axis up to rounding are ignored, which makes the bound weaker, but not
invalid.
"""

import math
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from synth.analysis.lower_bounds.exact_algebra import Nullspace, identity, radius_of_solution, span_all, without_factors
from synth.analysis.rigorous import floats, integers, product, zeros
from synth.plant.generalized import Plant
from synth.plant.units import nearest_power

GROWTH = 1e-9  # a mode counts as growing if its real part, relative to |A|, exceeds this value
AXIS = 1e-9  # a zero counts as lying on the imaginary axis if its real part, relative to the largest zero, is below this value
STEPS = 3  # number of Newton steps that improve the approximation of a zero
SAFE = 4.0  # safety factor by which the estimated rounding error of a sum of products is multiplied


@dataclass(frozen=True, eq=False)
class AntistablePart:
    """Inequality He(Lambda X') + eta b b' - c c' < 0, the part that belongs to the zeros in the open right half plane.

    Attributes:
        P: product L U, whose columns are divided by `columns`, shape (a', a).
        columns: powers of two that scale the columns, shape (a,).
        Q: matrix Lambda, whose eigenvalues are the zeros, shape (a', a').
        b: matrix b of the inequality, with one column for each disturbance w, shape (a', r).
        c: matrix c of the inequality, with a column for each output in z, shape (a', d).
        off: bounds on the error of each entry of P, Q, b and c.
    """

    P: Array
    columns: Array
    Q: Array
    b: Array
    c: Array
    off: tuple[float, float, float, float]

    def reduced(self, X: Array) -> Array:
        """Returns the X' of the antistable part that corresponds to an X of the whole inequality, shape (a', a')."""
        P = self.P * self.columns
        return P @ X @ P.T

    def whole(self, X: Array) -> Array:
        """Returns an X of the whole inequality that corresponds to an X' of the antistable part, shape (a, a)."""
        back = np.linalg.pinv(self.P) / self.columns[:, None]
        return back @ X @ back.T


@dataclass(frozen=True, eq=False)
class SynthesisInequality:
    """Inequality He(Q X U') + eta b b' - c c' < 0, LMI (21) without the controller; see the module docstring.

    Attributes:
        J: matrix of integers whose rows are orthogonal to the directions without cost (see the module docstring), shape (a, n).
        coordinates: indices of those a states for which the columns of J form a diagonal matrix.
        U, Q, b, c: matrices of integers, shapes (k, a), (k, a), (k, r), (k, d). In the inequality, these matrices of integers
            are divided by `scale`; Q and b are also divided by `unit`.
        unit, scale: powers of two by which the matrices of integers are divided.
        N: integer matrix, shape (n + d, k), whose columns are a basis of all q with [B; D]' q = 0 that are orthogonal to the
            directions without cost.
    """

    J: Array
    coordinates: list[int]
    U: Array
    Q: Array
    b: Array
    c: Array
    unit: int
    scale: int
    N: Array

    @classmethod
    def of(cls, plant: Plant) -> "SynthesisInequality":
        """Returns the inequality for state feedback. For the transposed plant, the result is the inequality for the observer."""
        n, (system, unit) = len(plant.A), integers(plant.system_matrix)
        m = plant.B.shape[1]
        states, inputs = system[:, :n], system[:, n : n + m]
        F = np.hstack([(_closure if plant.dt is None else _zeroed_states)(states, inputs), _hidden_states(plant, states)])
        F = F[:, Nullspace(F).independent]
        steered = Nullspace(F)
        J, _ = without_factors(steered.complete(identity(len(steered.free))))
        columns = np.hstack([inputs, np.vstack([F, 0 * system[n:, : F.shape[1]]]), product(states, F)])
        N = Nullspace(columns)
        basis, scale = without_factors(N.complete(identity(len(N.free))))
        low, at = basis.T, steered.free
        U, Q = low[:, at], product(low, states)[:, at]
        b, c = product(low, system[:, n + m :]), low[:, n:]
        if plant.dt is not None:
            U, Q, b, c, unit, scale = Q + unit * U, Q - unit * U, 2 * b, unit * c, 2, scale * unit
        return cls(J=J.T, coordinates=at, U=U, Q=Q, b=b, c=c, unit=unit, scale=scale, N=basis)

    @cached_property
    def antistable(self) -> AntistablePart | None:
        """Part of the inequality that belongs to the unstable zeros; None if this part cannot be separated
        (`_antistable_part`).
        """
        return _antistable_part(self)

    def floats(self) -> tuple[Array, Array, Array, Array]:
        """Returns U, Q, b and c in floats, with every entry rounded once."""
        one, two = Fraction(1, self.scale), Fraction(1, self.scale * self.unit)
        return floats(self.U, one), floats(self.Q, two), floats(self.b, two), floats(self.c, one)


def cross_gram(one: SynthesisInequality, other: SynthesisInequality) -> tuple[Array, int]:
    """Returns J_other J_one' as integers, shape (a_other, a_one), and their denominator.

    The rows of each J are scaled so that the columns `coordinates` of J form the identity matrix.
    """
    columns, rows = (each.J[np.arange(len(each.J)), each.coordinates] for each in (one, other))
    denominator = math.lcm(*columns) * math.lcm(*rows)
    return product(other.J, one.J.T) * denominator // np.multiply.outer(rows, columns), denominator


def _closure(states: Array, inputs: Array) -> Array:
    """Returns the directions without cost of a continuous plant, as columns, shape (n, f).

    The columns span the smallest space that contains two kinds of directions: every B v with D v = 0 and, for every f in the
    space, every A f + B v with C f + D v = 0.
    """
    n = states.shape[1]
    F = inputs[:n, :0]
    while True:
        both = np.hstack([inputs, product(states, F)])
        silent = Nullspace(both[n:].T)
        new, _ = without_factors(product(both[:n], silent.complete(identity(len(silent.free)))))
        wider = np.hstack([F, new])
        wider = wider[:, Nullspace(wider).independent]
        if wider.shape[1] == F.shape[1]:
            return F
        F = wider


def _zeroed_states(states: Array, inputs: Array) -> Array:
    """Returns the states that the inputs can bring to zero within a finite number of samples while z remains zero, as columns,
    shape (n, f).
    """
    n = states.shape[1]
    F = inputs[:n, :0]
    while True:
        into = np.vstack([F, zeros(len(states) - n, F.shape[1])])
        silent = Nullspace(np.hstack([states, inputs, into]).T)
        kept = silent.complete(identity(len(silent.free)))[:n]
        wider, _ = without_factors(kept[:, Nullspace(kept).independent])
        if wider.shape[1] == F.shape[1]:
            return F
        F = wider


def _hidden_states(plant: Plant, states: Array) -> Array:
    """Returns the states that are unobservable in z without control, as columns, shape (n, h); no columns if some of these
    states grow.

    If the growth of a state is judged wrongly, the bound becomes weaker, but not invalid.
    """
    n = len(plant.A)
    if not n or span_all(states[n:], states[:n]):
        return zeros(n, 0)
    silent = Nullspace(states[n:].T)
    V, _ = without_factors(silent.complete(identity(len(silent.free))))
    while V.shape[1]:
        staying = Nullspace(np.hstack([product(states[:n], V), V]).T)  # the vectors [c; e] with A V c = -V e
        kept = product(V, staying.complete(identity(len(staying.free)))[: V.shape[1]])
        kept = kept[:, Nullspace(kept).independent]
        if kept.shape[1] == V.shape[1]:
            break
        V, _ = without_factors(kept)
    directions = V / np.max(np.abs(V), axis=0, initial=1)
    within = np.linalg.lstsq(directions.astype(float), plant.A @ directions.astype(float))[0]
    modes, size = np.linalg.eigvals(within), float(np.linalg.norm(plant.A))
    grows = np.any(modes.real > GROWTH * size) if plant.dt is None else np.any(np.abs(modes) > 1 + GROWTH * size)
    return V[:, :0] if grows else V


@np.errstate(all="ignore")  # a value that is infinite or NaN never counts as an enclosure
def _antistable_part(side: SynthesisInequality) -> AntistablePart | None:
    """Returns the part of the inequality that belongs to the unstable zeros, if this part can be separated.

    The result is None if all zeros are unstable, if U is not square, or if L and Lambda cannot be enclosed.
    """
    try:
        U, Q, b, c = side.floats()
        if not len(U) or len(U) != U.shape[1]:
            return None
        M = np.linalg.solve(U.T, Q.T).T
        rows = np.asarray(linalg.matrix_balance(M, permute=False, separate=True)[1][0])
        U, Q, b, c = (part / rows[:, None] for part in (U, Q, b, c))
        balanced = M / rows[:, None] * rows
        rate = nearest_power(float(np.linalg.norm(balanced)))
        edge = AXIS * float(np.abs(np.linalg.eigvals(balanced)).max()) / rate
        N, vectors, count = linalg.schur(balanced.T / rate, sort=lambda real, imaginary: real > edge)  # pyright: ignore[reportAssignmentType]
    except (OverflowError, ValueError, np.linalg.LinAlgError):
        return None
    if count == len(U):
        return None
    columns = np.array([nearest_power(float(size)) for size in np.linalg.norm(np.vstack([U, Q / rate]), axis=0)])
    U, Q = U / columns, Q / rate / columns
    enclosed = _enclosed_subspace(U, Q, vectors[:, :count], N[:count, :count])
    if enclosed is None:
        return None
    W, N, radius = enclosed
    unit, size = _unit(len(U)), float(np.linalg.norm(W))

    def times(matrix: Array) -> tuple[Array, float]:
        length = float(np.linalg.norm(matrix))
        return W.T @ matrix, (radius + unit * size) * length

    (P, off_p), (b, off_b), (c, off_c) = map(times, (U, b, c))
    return AntistablePart(P, columns, N.T * rate, b, c, (off_p, radius * rate, off_b, off_c))


def _enclosed_subspace(U: Array, Q: Array, W: Array, N: Array) -> tuple[Array, Array, float] | None:
    """Returns W and N for which Q' W is nearly U' W N, and a radius within which an exact solution provably lies; None without
    a proof.
    """
    a, k = W.shape
    if not k:
        return W, N, 0.0
    first_basis = W
    try:
        for _ in range(STEPS):
            derivative, residual = _equation(U, Q, W, N, first_basis)
            step = np.linalg.solve(derivative, residual)
            W, N = W - step[: a * k].reshape(k, a).T, N - step[a * k :].reshape(k, k).T
        derivative, residual = _equation(U, Q, W, N, first_basis)
        R = np.linalg.inv(derivative)
    except np.linalg.LinAlgError:
        return None
    unit = _unit(a)
    below = np.abs(Q).T @ np.abs(W) + np.abs(U).T @ np.abs(W) @ np.abs(N), np.abs(first_basis).T @ np.abs(W) + np.eye(k)
    rounding = unit * np.concatenate([below[0].ravel("F"), below[1].ravel("F")])
    size, bend = (1 + unit) * float(np.linalg.norm(R, 2)), (1 + unit) * float(np.linalg.norm(U))
    first = (1 + unit) * float(np.linalg.norm(R @ residual)) + size * float(np.linalg.norm(rounding))
    # The derivative has rounding errors, too: its entries are rounded, and digits cancel in Q - s U and U' W.
    own, turned = float(np.linalg.norm(W)), float(np.linalg.norm(N))
    shaken = float(np.linalg.norm(derivative)) + k**0.5 * (float(np.linalg.norm(Q)) + bend * (own + turned))
    contraction = float(np.linalg.norm(np.eye(len(R)) - R @ derivative)) + unit * len(R) * size * shaken
    radius = radius_of_solution(first, contraction, size * bend)
    return None if radius is None else (W, N, radius)


def _equation(U: Array, Q: Array, W: Array, N: Array, basis: Array) -> tuple[Array, Array]:
    """Returns the derivative and the residual of the equations Q' W - U' W N = 0 and basis' W = I, stacked by columns."""
    k = len(N)
    eye = np.eye(k)
    derivative = np.block(
        [[np.kron(eye, Q.T) - np.kron(N.T, U.T), -np.kron(eye, U.T @ W)], [np.kron(eye, basis.T), np.zeros((k * k, k * k))]]
    )
    return derivative, np.concatenate([(Q.T @ W - U.T @ W @ N).ravel("F"), (basis.T @ W - eye).ravel("F")])


def _unit(a: int) -> float:
    """Returns a bound on the relative rounding error of sums of `a` products."""
    return SAFE * (2 * a + 4) * float(np.finfo(float).eps)
