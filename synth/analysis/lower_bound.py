"""Lower bounds on the norm for any controller, proved by dual solutions in exact arithmetic.

A controller of any order from y = C_y x + Dyw w reaches a norm below gamma only if there are X > 0 and S > 0 with [X I; I S]
>= 0. Here X solves the `SynthesisInequality` of the plant, eta = gamma^-2, and S that of the transposed plant (Gahinet, Apkarian
1994) with a disturbance of weight one and gamma^2 in place of I:

    He(Q X U') + eta b b' - c c' < 0,         He(Q2 S U2') + b2 b2' - gamma^2 c2 c2' < 0.

Positive semidefinite W1, W2 and V = [V2, V12; V12', V1] with V1 = He(U' W1 Q) >= 0, V2 likewise, pair with the three to

    (t1 - e1 / gamma^2) + (t2 gamma^2 - e2) > 2 f,     e = tr b' W b,  t = tr c' W c,  f = -tr(V12 (J2 J1')'),

and as W1 and W2 may be scaled each by itself gamma^2 is at least the largest eigenvalue of

    [ e1 / t1, . ; f (e1 / t1)^1/2 / (t1 t2)^1/2, f^2 / (t1 t2) + e2 / t2 ].

Its first entry is the bound for state feedback, which no controller that knows x and w and more, dynamic or nonlinear, beats
(Khargonekar, Petersen, Rotea 1988). On the central path W = (c c' - He(Q X U') - eta b b')^-1 is such a solution, so a point
(X, eta) suffices.

**The proof, and rounding.** W = L L' and V12 = Y2 K Y1' are *defined* by factors proposed in floats; any factors will do. From
them on all is exact: e, t, f and the entries of V are computed in integers, from the numbers of the plant, without a tolerance.
Only the definiteness of V is decided in floats, from entries that were rounded once, with a proved allowance
(`analysis/rigorous.py`); otherwise nothing is proved. The last eigenvalue is rounded down.
"""

from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from synth.analysis.rigorous import definiteness, floats, integers, product, root_below
from synth.analysis.synthesis_inequality import SynthesisInequality, meeting, transposed
from synth.plant.generalized import GeneralizedPlant

if TYPE_CHECKING:
    from synth.analysis.interpolation import Zeros


SHRINK = (1e-9, 1e-6, 1e-3)  # relative shortening of the best V12, so that V can be proved positive
DOWN = 1 - 2.0**-45  # more than the dozen operations of the last eigenvalue can round up


@dataclass(frozen=True, eq=False)
class DualCertificate:
    """A strictly feasible point of a `SynthesisInequality`; its inverse matrix is the dual solution.

    Attributes:
        X: shape (n, n); only J X J' matters.
        eta: gamma^-2.
    """

    X: Array
    eta: float


@dataclass(frozen=True, eq=False)
class LowerBound:
    """A lower bound on the norm for controllers of one kind, with its proof.

    Attributes:
        gamma: the bound; 0, which is always true, if nothing is proved.
        state: dual certificate of state feedback; None if an invariant point or zeros prove the bound.
        observer: dual certificate of the transposed plant; None if the bound is that of state feedback.
        limit_at: frequency [rad/s] at which `invariant_point.limit_at` proves the bound; None if others do.
        zeros: from u to z and from w to y [rad/s], by which `interpolation.limit_at_zeros` proves it; None if others do.
    """

    gamma: float
    state: DualCertificate | None = None
    observer: DualCertificate | None = None
    limit_at: float | None = None
    zeros: "Zeros | None" = None


def prove_lower_bound(
    plant: GeneralizedPlant,
    state: DualCertificate,
    Cy: Array | None = None,
    observer: DualCertificate | None = None,
    Dyw: Array | None = None,
) -> LowerBound:
    """Returns the bound that dual certificates prove. Before the end of the path it is weaker by (2 n + d) mu, but easier.

    Args:
        Cy: shape (q, n); given with an observer.
        Dyw: shape (q, r); zero if it is not given.

    Raises:
        ValueError: a dual certificate is not of the plant's shape.
    """
    one = SynthesisInequality.of(plant)
    if observer is None or Cy is None:
        return prove_from_inequalities(one, None, state, None)
    return prove_from_inequalities(one, SynthesisInequality.of(transposed(plant, Cy, Dyw)), state, observer)


def prove_from_inequalities(
    one: SynthesisInequality, other: SynthesisInequality | None, state: DualCertificate, observer: DualCertificate | None
) -> LowerBound:
    """Returns the bound of `prove_lower_bound` from inequalities that are known already."""
    first = _dual(one, state)
    if first is None:
        return LowerBound(0.0, state, observer)
    alone = LowerBound(root_below(first.e / first.t), state)
    second = _dual(other, observer) if other is not None and observer is not None else None
    if other is None or second is None:
        return alone
    f = _joined(first, second, *meeting(one, other))
    share = f * f / (first.t * second.t)
    try:
        p, q, s = float(first.e / first.t), float(share), float(second.e / second.t)
        largest = float(np.linalg.eigvalsh([[p, (p * q) ** 0.5], [(p * q) ** 0.5, q + s]])[-1]) * DOWN
    except (OverflowError, np.linalg.LinAlgError):
        return alone
    return LowerBound(largest**0.5, state, observer) if largest**0.5 > alone.gamma else alone


@dataclass(frozen=True, eq=False)
class _Dual:
    """The numbers e, t and V = T^-T V_T T^-1 of a dual solution.

    Attributes:
        e, t: exact.
        V: V_T in floats, every entry rounded once; near I on the path.
        T: floats, taken without rounding, shape (a, a).
        Y: floats near T^-T, likewise.
    """

    e: Fraction
    t: Fraction
    V: Array
    T: Array
    Y: Array


@np.errstate(all="ignore")  # what is not finite proves nothing
def _dual(side: SynthesisInequality, witness: DualCertificate) -> _Dual | None:
    """Returns the dual solution of a certificate, or None if it proves nothing."""
    a, n = side.J.shape
    if witness.X.shape != (n, n):
        raise ValueError(f"a witness has X of shape {witness.X.shape}; expected {(n, n)}")
    try:
        J = floats(side.J) / floats(side.J[np.arange(a), side.coordinates])[:, None]
        T = np.linalg.cholesky(J @ witness.X @ J.T) if a else np.zeros((0, 0))
        Y = np.linalg.inv(T).T
        L = _factor(side.floats(), T, witness.eta)
        if not (np.all(np.isfinite(L)) and np.all(np.isfinite(T)) and np.all(np.isfinite(Y))):
            return None
        return _evaluated(side, L, T, Y)
    except (np.linalg.LinAlgError, OverflowError):
        return None


def _factor(parts: tuple[Array, Array, Array, Array], T: Array, eta: float) -> Array:
    """Returns L with L L' = (c c' - He(Q X U') - eta b b')^-1, X = T T'."""
    U, Q, b, c = parts
    moved = (Q @ T) @ (U @ T).T
    inside = c @ c.T - moved - moved.T - eta * b @ b.T
    diagonal = np.diagonal(inside)
    if not np.all(diagonal > 0):
        raise np.linalg.LinAlgError("not inside")
    size = 1 / np.sqrt(diagonal)
    return size[:, None] * np.linalg.inv(np.linalg.cholesky(size[:, None] * inside * size)).T


def _evaluated(side: SynthesisInequality, L: Array, T: Array, Y: Array) -> _Dual | None:
    """Returns e, t and V_T of W = L L', exactly; None if V is not proved positive definite, or t is zero."""
    (factor, over), (coordinates, under) = integers(L), integers(T)
    low, steep = product(factor.T, product(side.U, coordinates)), product(factor.T, product(side.Q, coordinates))
    half = product(low.T, steep)
    size = side.scale * over
    V = floats(half + half.T, Fraction(1, side.unit * (size * under) ** 2))
    t = Fraction(int(np.sum(product(factor.T, side.c) ** 2)), size**2)
    e = Fraction(int(np.sum(product(factor.T, side.b) ** 2)), (size * side.unit) ** 2)
    return _Dual(e, t, V, T, Y) if t > 0 and definiteness(V).proved else None


def _joined(first: _Dual, second: _Dual, between: Array, over: int) -> Fraction:
    """Returns f of the best V12 that is proved to leave V positive definite; 0 if no V12 is."""
    if not between.size:
        return Fraction(0)
    (Y1, over1), (Y2, over2), (T1, under1), (T2, under2) = map(integers, (first.Y, second.Y, first.T, second.T))
    moved, size = product(product(Y1.T, between.T), Y2), over * over1 * over2  # Y1' J1 J2' Y2
    R1, R2 = np.linalg.cholesky(first.V), np.linalg.cholesky(second.V)
    left, _, right = np.linalg.svd(R1.T @ floats(moved, Fraction(1, size)) @ R2)
    k = min(left.shape[1], right.shape[0])
    best = R2 @ right[:k].T @ left[:, :k].T @ R1.T
    near2, near1 = product(T2.T, Y2), product(Y1.T, T1)
    for shrink in SHRINK:
        K, step = integers(-(1 - shrink) * best)
        off = floats(product(product(near2, K), near1), Fraction(1, step * over1 * over2 * under1 * under2))
        if definiteness(np.block([[second.V, off], [off.T, first.V]])).proved:
            return max(-Fraction(np.trace(product(K, moved)), step * size), Fraction(0))
    return Fraction(0)
