"""Proofs of lower bounds in rational numbers, converted from `lower_bound.py` and `invariant_point.py` in
`analysis/lower_bounds`.
"""

from collections.abc import Callable
from fractions import Fraction

import numpy as np

from models.common.arrays import Array
from synth.analysis.lmi_certificate.check_certificate import ExactLoop, Matrix
from synth.analysis.lmi_certificate.rational import decimal, rational, rounded, rows
from synth.analysis.lower_bounds.invariant_point import proof_at
from synth.analysis.lower_bounds.lower_bound import DualCertificate, LowerBound, dual_factors
from synth.analysis.lower_bounds.synthesis_inequality import SynthesisInequality, cross_gram
from synth.analysis.rigorous import floats, integers, product, zeros
from synth.plant.generalized import Plant

# Combinations that are tried: the number of bits of a dual solution, and the relative reduction of V12 below its largest
# possible size
SHORTER = ((24, 1e-6), (40, 1e-9), (53, 1e-9), (53, 1e-6), (53, 1e-3))
# relative distances below the claimed bound at which a proof is tried, in this order
LOWER = (1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2)
ENOUGH = 1e-8  # numbers with more bits are not tried if the proved level is within this relative distance of the claimed bound
IRRATIONAL = "its proof encloses stable zeros of the plant, which are irrational"


def lower_bound_claim(plant: Plant, loop: ExactLoop, below: LowerBound) -> dict | str:
    """Returns the claim of a lower bound, or the reason why a certificate cannot contain this claim.

    Args:
        plant: plant to which the lower bound applies. The states of `loop` are the states of this plant, followed by the states
            of the law.
        loop: closed loop with a controller, in rational arithmetic.
        below: lower bound, with the proof of this bound.
    """
    if below.limit_at is not None:
        return _invariant_point(plant, loop, below)
    if below.zeros or below.state is None:
        return IRRATIONAL if below.zeros else "no proof is known"
    best, claim, n = Fraction(0), None, len(plant.A)
    for bits, shrink in SHORTER:
        duals = _duals(plant, below.state, below.observer, bits, shrink)
        if duals is None:
            continue
        more = [n] * (len(loop.I.rows) - n)
        W1, W2, V12 = (np.insert(each, more, 0, axis=0) for each in duals)
        W1, W2, V12 = map(Matrix, (W1, W2, np.insert(V12, more, 0, axis=1)))
        bound = _largest(below.gamma, lambda bound, W1=W1, W2=W2, V12=V12: loop.lower_bound(bound, W1, W2, V12))
        if bound > best:
            matrices = {"W1": rows(W1.rows), "W2": rows(W2.rows), "V12": rows(V12.rows)}
            best, claim = bound, {"kind": "lower_bound", "bound": rational(bound), **matrices}
        if float(best) >= below.gamma * (1 - ENOUGH):
            break
    return claim or IRRATIONAL


def _largest(gamma: float, proves: Callable[[Fraction], bool]) -> Fraction:
    """Returns the largest proved lower bound among gamma and some values just below gamma; 0 if none of them is proved."""
    levels = [decimal(gamma), *(decimal(rounded(gamma * (1 - less), 15)) for less in LOWER)]
    return next((level for level in levels if proves(level)), Fraction(0)) if proves(levels[-1]) else Fraction(0)


def _invariant_point(plant: Plant, loop: ExactLoop, below: LowerBound) -> dict | str:
    """Returns the claim of the bound at an invariant point, or the reason why this bound is not proved."""
    assert below.limit_at is not None, "it is given"
    n, sampled = len(plant.A), plant.dt is not None
    t = Fraction(float(below.limit_at if plant.dt is None else np.tan(below.limit_at * plant.dt / 2)))
    _, pair = proof_at(plant, below.limit_at)
    if not len(pair):
        return "no proof is known"
    a, b = np.split(pair // np.gcd.reduce(pair) * (t.denominator if sampled else 1), 2)
    if sampled:  # the rows of the states are multiplied by 1 - j t
        turn = t.numerator * np.array([a, b])[:, :n] // t.denominator
        a[:n], b[:n] = a[:n] - turn[1], b[:n] + turn[0]
    r = np.insert(np.array([a, b]), [n] * (len(loop.I.rows) - n), 0, axis=1)
    bound = _largest(below.gamma, lambda bound: loop.invariant_point(bound, t, Matrix(r)))
    return (
        {"kind": "invariant_point", "bound": rational(bound), "frequency": rational(t), "r": rows(r)}
        if bound
        else "it is not proved"
    )


def _duals(
    plant: Plant, state: DualCertificate, observer: DualCertificate | None, bits: int, shrink: float
) -> tuple[Array, Array, Array] | None:
    """Returns the matrices W1, W2 and V12 of the dual certificates as arrays of `Fraction`; None if they cannot be computed."""
    n, r = plant.Bw.shape
    one = SynthesisInequality.of(plant)
    first = _rational(one, state, bits)
    if first is None:
        return None
    none = zeros(n + r, 1), zeros(n, n)
    other = SynthesisInequality.of(plant.transposed) if observer is not None else None
    second = _rational(other, observer, bits) if other is not None and observer is not None else None
    if other is None or second is None:
        return first, *none
    coupling, over = cross_gram(one, other)
    V1, V2 = _weights(plant, one, first), _weights(plant.transposed, other, second)
    try:
        R1, R2 = np.linalg.cholesky(V1), np.linalg.cholesky(V2)
    except np.linalg.LinAlgError:
        return first, *none
    left, _, right = np.linalg.svd(R2.T @ floats(coupling, Fraction(1, over)) @ R1, full_matrices=False)
    M = -(1 - shrink) * R1 @ right.T @ left.T @ R2.T
    size = [2.0 ** np.round(np.log2(np.diagonal(V)) / 2) for V in (V1, V2)]
    unit = np.outer(*size) * 2.0**-bits
    M = _fractions(*integers(np.rint(M / unit) * unit))
    J1, J2 = (_normal_rows(side) for side in (one, other))
    return first, second, J1.T.dot(M).dot(J2)


def _rational(side: SynthesisInequality, certificate: DualCertificate, bits: int) -> Array | None:
    """Returns the factor W of a dual solution W W' in exact fractions, shape (n + d, k).

    The entries of W that the equations leave free are rounded to at most `bits` bits.
    """
    factors = None if side.antistable is not None else dual_factors(side, certificate)
    if factors is None:
        return None
    L = factors[0] / 2.0 ** np.round(np.log2(np.abs(factors[0]).max()))
    mantissa, exponent = np.frexp(L)
    whole, over = integers(np.ldexp(np.rint(mantissa * 2.0**bits), exponent - bits))
    return _fractions(product(side.N, whole), over * side.scale)


def _weights(plant: Plant, side: SynthesisInequality, W: Array) -> Array:
    """Returns the matrix V that multiplies X in a dual solution, in the coordinates of the inequality and rounded to floats."""
    n, at = len(plant.A), side.coordinates
    system, over = integers(plant.system_matrix[:, :n])
    S = _fractions(system[:, at], over)
    if plant.dt is None:
        half = S.T.dot(W).dot(W[at].T)
        return (half + half.T).astype(float)
    return (S.T.dot(W).dot(W.T.dot(S)) - W[at].dot(W[at].T)).astype(float)


def _normal_rows(side: SynthesisInequality) -> Array:
    """Returns the matrix J, with its rows scaled so that the columns `coordinates` of J form the identity matrix."""
    return np.array([[Fraction(x, row[at]) for x in row] for row, at in zip(side.J, side.coordinates, strict=True)], dtype=object)


def _fractions(whole: Array, over: int) -> Array:
    """Returns integers, each divided by the same denominator, as an array of `Fraction`."""
    return np.array([[Fraction(x, over) for x in row] for row in whole], dtype=object).reshape(whole.shape)
