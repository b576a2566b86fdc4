"""Lower bounds on the norm for all controllers, proved by dual solutions in exact arithmetic.

A controller of any order from y = C_y x + Dyw w can reach a norm below gamma only if positive definite matrices X and S exist
such that [X I; I S] is positive semidefinite. Here the matrix X satisfies the inequality (`SynthesisInequality`) of the plant
with eta = gamma^-2. The matrix S solves the inequality of the transposed plant (Gahinet, Apkarian 1994), in which 1 replaces
eta, and gamma^2 c2 c2' replaces c c':

    He(Q X U') + eta b b' - c c' < 0,         He(Q2 S U2') + b2 b2' - gamma^2 c2 c2' < 0.

The dual variables are positive semidefinite matrices W1, W2 and V = [V2, V12; V12', V1] with V1 = He(U' W1 Q), and V2 likewise.
The sum of the products of W1, W2 and V with the three inequalities is

    (t1 - e1 / gamma^2) + (t2 gamma^2 - e2) > 2 f,     e = tr b' W b,  t = tr c' W c,  f = -tr(V12 (J2 J1')').

W1 and W2 may be scaled independently of each other. Therefore, gamma^2 is at least the largest eigenvalue of the matrix

    [ e1 / t1, . ; f (e1 / t1)^1/2 / (t1 t2)^1/2, f^2 / (t1 t2) + e2 / t2 ].

The first entry of the matrix is the square of the bound for state feedback. No controller reaches a norm below the bound for
state feedback, even if the controller is dynamic or nonlinear and measures w (Khargonekar, Petersen, Rotea 1988). On the
central path, the matrix W = (c c' - He(Q X U') - eta b b')^-1 is a dual solution. A point (X, eta) therefore determines a dual
solution.

**The proof, and rounding.** The matrices W = L L' and V12 = Y2 K Y1' are *defined* by the factors, which are computed in
floats. The bound is valid for any values of the factors L, Y1, Y2 and K. The numbers e, t and f and the entries of V are then
computed in integers from the entries of the plant's matrices, without a tolerance. Only whether V is positive definite is
checked in floats. This check uses entries of V that were rounded once, and a proved bound on the rounding errors
(`analysis/rigorous.py`). The largest eigenvalue of the matrix is rounded down.
"""

from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from synth.analysis.lower_bounds.exact_algebra import root_below
from synth.analysis.lower_bounds.synthesis_inequality import AntistablePart, SynthesisInequality, cross_gram
from synth.analysis.rigorous import UNIT, definite_beyond, definiteness, floats, integers, product
from synth.plant.generalized import Plant

if TYPE_CHECKING:
    from synth.analysis.lower_bounds.interpolation import Zeros


# relative reductions of the best V12, tried in this order until V is proved to be positive definite
SHRINK = (1e-9, 1e-6, 1e-3)
SAFE = 4.0  # safety factor by which the estimated rounding error of a sum of products is multiplied
# factor that rounds a value down. The reduction exceeds the rounding errors of the dozen operations that compute the largest
# eigenvalue
DOWN = 1 - 2.0**-45


@dataclass(frozen=True, eq=False)
class DualCertificate:
    """Strictly feasible point (X, eta) of a `SynthesisInequality`. The inverse of the inequality's matrix at the point (X, eta)
    is the dual solution.

    Attributes:
        X: matrix of shape (n, n); only J X J' is used, where J is a matrix of the `SynthesisInequality`.
        eta: gamma^-2.
    """

    X: Array
    eta: float


@dataclass(frozen=True, eq=False)
class LowerBound:
    """Lower bound on the norm for all controllers with the same measurements, with its proof.

    Attributes:
        gamma: lower bound on the norm; 0 if nothing is proved.
        state: dual certificate for state feedback; None if an invariant point or zeros prove the bound.
        observer: dual certificate of the transposed plant; None if the bound is the one for state feedback.
        limit_at: frequency [rad/s] at which `invariant_point.limit_at` proves the bound; None if the bound has a different
            proof.
        zeros: zeros from u to z and from w to y [rad/s] with which `interpolation.limit_at_zeros` proves the bound; None if the
            bound has a different proof.
        reason: text that explains why the lower bound may be far below the norms of all controllers; empty if no reason is
            known.
    """

    public_name = "a lower bound, such as synth.find_lower_bound returns"

    gamma: float
    state: DualCertificate | None = None
    observer: DualCertificate | None = None
    limit_at: float | None = None
    zeros: "Zeros | None" = None
    reason: str = ""


BEYOND = 1e-8  # relative change that rounding may cause in the discrete plant


@dataclass(frozen=True, eq=False)
class SampledBound:
    """Lower bound on the L2 gain of a sampled-data loop, for controllers of any order.

    Each level of the L2 gain has an equivalent discrete plant (`synth/analysis/sampled_loop.py`). The level is a lower
    bound if no controller brings the norm of the equivalent discrete plant below 1.

    Attributes:
        level: lower bound on the L2 gain.
        proof: lower bound on the norm of the equivalent discrete plant for `level`, with its proof.
        inside: True if `level` has no equivalent discrete plant. If no such plant exists, the gain within one period
            is at least `level` before any force can respond.
    """

    level: float
    proof: LowerBound
    inside: bool = False

    @property
    def holds(self) -> bool:
        """True if the proof is valid despite rounding errors of the discrete plant."""
        return self.inside or self.proof.gamma >= 1 + BEYOND


def prove_lower_bound(plant: Plant, state: DualCertificate, observer: DualCertificate | None = None) -> LowerBound:
    """Returns the lower bound that follows from dual certificates.

    A point earlier on the central path, where the barrier parameter mu is larger, gives a bound that is weaker by (2 n + d) mu
    but easier to prove.

    Raises:
        ValueError: the shape of a dual certificate does not fit the plant.
    """
    one = SynthesisInequality.of(plant)
    other = SynthesisInequality.of(plant.transposed) if observer is not None else None
    return prove_from_inequalities(one, other, state, observer)


def prove_from_inequalities(
    one: SynthesisInequality, other: SynthesisInequality | None, state: DualCertificate, observer: DualCertificate | None
) -> LowerBound:
    """Returns the same bound as `prove_lower_bound`, from the inequalities of the plant and of the transposed plant."""
    first = _dual(one, state)
    if first is None:
        return LowerBound(0.0, state, observer)
    alone = LowerBound(root_below(first.e / first.t), state)
    second = _dual(other, observer) if other is not None and observer is not None else None
    if other is None or second is None:
        return alone
    f = _best_coupling(first, second, CouplingMatrix.of(one, other))
    share = f * f / (first.t * second.t)
    try:
        p, q, s = float(first.e / first.t), float(share), float(second.e / second.t)
        largest = float(np.linalg.eigvalsh([[p, (p * q) ** 0.5], [(p * q) ** 0.5, q + s]])[-1]) * DOWN
    except (OverflowError, np.linalg.LinAlgError):
        return alone
    return LowerBound(largest**0.5, state, observer) if largest**0.5 > alone.gamma else alone


@dataclass(frozen=True, eq=False)
class _Dual:
    """The numbers e and t and the matrix V = T^-T V_T T^-1 of a dual solution.

    Attributes:
        e, t: exact values of the numbers e and t of the dual solution. For the antistable part of an inequality, `e` is a lower
            bound on the exact number, and `t` is an upper bound.
        V: the matrix V_T in floats, which is close to I (identity matrix) on the central path.
        error_bound: bound on the error of each entry of V_T, same shape as V_T.
        T: matrix of floats, treated as exact, shape (a, a).
        Y: matrix of floats close to T^-T, treated as exact, shape (a, a).
    """

    e: Fraction
    t: Fraction
    V: Array
    error_bound: Array
    T: Array
    Y: Array


@np.errstate(all="ignore")  # a value that is infinite or NaN never counts as a proof
def dual_factors(side: SynthesisInequality, certificate: DualCertificate) -> tuple[Array, Array, Array] | None:
    """Returns L, T and Y of the dual solution W = L L' of a certificate (see `_Dual`); None if one of these matrices is not
    finite.

    Raises:
        ValueError: the shape of the certificate does not fit the plant.
    """
    a, n = side.J.shape
    if certificate.X.shape != (n, n):
        raise ValueError(f"a dual certificate has X of shape {certificate.X.shape}; expected {(n, n)}")
    try:
        J = floats(side.J) / floats(side.J[np.arange(a), side.coordinates])[:, None]
        X, part = J @ certificate.X @ J.T, side.antistable
        if part is not None:
            X = part.reduced(X)
        T = np.linalg.cholesky(X) if len(X) else np.zeros((0, 0))
        Y = np.linalg.inv(T).T
        L = _factor((np.eye(len(X)), part.Q, part.b, part.c) if part is not None else side.floats(), T, certificate.eta)
    except (np.linalg.LinAlgError, OverflowError):
        return None
    return (L, T, Y) if all(np.all(np.isfinite(each)) for each in (L, T, Y)) else None


@np.errstate(all="ignore")
def _dual(side: SynthesisInequality, certificate: DualCertificate) -> _Dual | None:
    """Returns the dual solution that belongs to a certificate; None if this solution proves no bound."""
    factors, part = dual_factors(side, certificate), side.antistable
    if factors is None:
        return None
    try:
        return _evaluate_dual(side, *factors) if part is None else _enclose_factors(part, *factors)
    except (np.linalg.LinAlgError, OverflowError):
        return None


def _factor(parts: tuple[Array, Array, Array, Array], T: Array, eta: float) -> Array:
    """Returns L with L L' = (c c' - He(Q X U') - eta b b')^-1, where X = T T'."""
    U, Q, b, c = parts
    half = (Q @ T) @ (U @ T).T
    slack = c @ c.T - half - half.T - eta * b @ b.T
    diagonal = np.diagonal(slack)
    if not np.all(diagonal > 0):
        raise np.linalg.LinAlgError("not strictly feasible")
    size = 1 / np.sqrt(diagonal)
    return size[:, None] * np.linalg.inv(np.linalg.cholesky(size[:, None] * slack * size)).T


def _evaluate_dual(side: SynthesisInequality, L: Array, T: Array, Y: Array) -> _Dual | None:
    """Returns the exact e, t and V_T of W = L L'; None if V is not proved positive definite, or if t is 0."""
    (factor, over), (coordinates, under) = integers(L), integers(T)
    low, steep = product(factor.T, product(side.U, coordinates)), product(factor.T, product(side.Q, coordinates))
    half = product(low.T, steep)
    size = side.scale * over
    V = floats(half + half.T, Fraction(1, side.unit * (size * under) ** 2))
    t = Fraction(int(np.sum(product(factor.T, side.c) ** 2)), size**2)
    e = Fraction(int(np.sum(product(factor.T, side.b) ** 2)), (size * side.unit) ** 2)
    return _Dual(e, t, V, UNIT * np.abs(V), T, Y) if t > 0 and definiteness(V).proved else None


def _enclose_factors(part: AntistablePart, L: Array, T: Array, Y: Array) -> _Dual | None:
    """Returns bounds on e, t and V_T of W = L L' that hold for all matrices in the enclosures; None if V > 0 is not proved."""
    _, off_q, off_b, off_c = part.off
    unit, low = SAFE * (len(L) + 4) * UNIT, np.abs(L).T
    left, right = L.T @ T, L.T @ part.Q @ T
    half = left.T @ right
    above = low @ np.abs(T)
    steep = unit * (low @ np.abs(part.Q) @ np.abs(T)) + off_q * low.sum(axis=1)[:, None] * np.abs(T).sum(axis=0)
    spread = above.T @ steep + unit * (above.T @ np.abs(right))
    V, lost = half + half.T, (1 + unit) * (spread + spread.T)

    def length(matrix: Array, off: float, sign: int) -> Fraction:
        rounding = float(np.linalg.norm(low @ (unit * np.abs(matrix) + off)))
        bound = float(np.linalg.norm(L.T @ matrix)) * (1 + sign * unit) + sign * (1 + unit) * rounding
        return Fraction(max(bound, 0.0)) ** 2

    e, t = length(part.b, off_b, -1), length(part.c, off_c, 1)
    return _Dual(e, t, V, lost, T, Y) if t > 0 and definite_beyond(V[None], lost[None]) else None


@dataclass(frozen=True, eq=False)
class CouplingMatrix:
    """Product J2 J1' of the matrices J of two inequalities, or the corresponding product for their antistable parts.

    Attributes:
        whole, over: the product as a matrix of integers and a common denominator, shape (a2, a1); approximate if `error_bound`
            is not zero.
        error_bound: bound on the error of each entry of the product, shape (a2, a1).
    """

    whole: Array
    over: int
    error_bound: Array

    @property
    def floats(self) -> Array:
        """The product `whole` / `over` in floats, shape (a2, a1)."""
        return floats(self.whole, Fraction(1, self.over))

    @classmethod
    def of(cls, one: SynthesisInequality, other: SynthesisInequality) -> "CouplingMatrix":
        """Returns the coupling matrix of the plant's inequality (`one`) and the transposed plant's inequality (`other`)."""
        exact, over = cross_gram(one, other)
        if one.antistable is None and other.antistable is None:
            return cls(exact, over, np.zeros(exact.shape))
        between = floats(exact, Fraction(1, over))
        parts = [(np.eye(n), np.ones(n), 0.0) for n in between.shape]
        for i, side in enumerate((other, one)):
            if side.antistable is not None:
                parts[i] = side.antistable.P, side.antistable.columns, side.antistable.off[0]
        (P2, columns2, off2), (P1, columns1, off1) = parts
        between = columns2[:, None] * between * columns1
        unit, size = SAFE * (sum(between.shape) + 4) * UNIT, np.abs(between)
        beyond = (np.abs(P2) + off2) @ size @ (np.abs(P1) + off1).T * (1 + unit)
        lost = beyond - np.abs(P2) @ size @ np.abs(P1).T * (1 - unit)
        return cls(*integers(P2 @ between @ P1.T), np.maximum(lost, 0.0) + unit * beyond)


def _best_coupling(first: _Dual, second: _Dual, between: CouplingMatrix) -> Fraction:
    """Returns f for the best V12 found for which V is proved positive definite; 0 if no such V12 is found."""
    if not between.whole.size:
        return Fraction(0)
    (Y1, over1), (Y2, over2), (T1, under1), (T2, under2) = map(integers, (first.Y, second.Y, first.T, second.T))
    coupling, size = product(product(Y1.T, between.whole.T), Y2), between.over * over1 * over2  # the matrix Y1' J1 J2' Y2
    lost = np.abs(first.Y).T @ between.error_bound.T @ np.abs(second.Y)
    R1, R2 = np.linalg.cholesky(first.V), np.linalg.cholesky(second.V)
    left, _, right = np.linalg.svd(R1.T @ floats(coupling, Fraction(1, size)) @ R2)
    k = min(left.shape[1], right.shape[0])
    best = R2 @ right[:k].T @ left[:, :k].T @ R1.T
    near2, near1 = product(T2.T, Y2), product(Y1.T, T1)
    for shrink in SHRINK:
        K, step = integers(-(1 - shrink) * best)
        off = floats(product(product(near2, K), near1), Fraction(1, step * over1 * over2 * under1 * under2))
        V, rounding = np.block([[second.V, off], [off.T, first.V]]), UNIT * np.abs(off)
        if definite_beyond(V[None], np.block([[second.error_bound, rounding], [rounding.T, first.error_bound]])[None]):
            less = Fraction(float(np.trace(np.abs(best) @ lost))) * (1 + Fraction(1, 1000))
            return max(-Fraction(np.trace(product(K, coupling)), step * size) - less, Fraction(0))
    return Fraction(0)
