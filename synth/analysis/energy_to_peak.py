"""Largest peak that a disturbance of limited energy can cause in a signal: the energy-to-peak norm (generalized H2 norm).

The energy of w is the integral of |w|^2. Consider a signal s = c x of a stable loop x' = A x + Bw w with x(0) = 0. If w has the
energy 1, |s| is at most (c P c')^1/2, where P solves A P + P A' + Bw Bw' = 0. The time-reversed impulse response of s, used as
a disturbance, comes arbitrarily close to the bound on |s| (Wilson 1989; Rotea 1993). For a disturbance of energy E, the bound
is larger by the factor E^1/2. For a vector C x of several signals, the length of this vector is at most the square root of the
largest eigenvalue of C P C'. If w acts directly (with a feedthrough) on a signal, the peak of this signal is unbounded. The
signals may also contain control forces.

**The proof** is a matrix X > 0 with A X + X A' + Bw Bw' < 0, which is slightly larger than P. A matrix X of the proof shows
that no peak exceeds (c X c')^1/2. The inequality A X + X A' + Bw Bw' < 0 is LMI (20) without z, so `certificate.prove_bound`
proves it in the same way as (20). The value of c X c' is computed exactly, in integers.
"""

from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.common.errors import InputError
from synth.analysis.certificate import LmiProof, prove_bound
from synth.analysis.rigorous import definiteness, floats, integers, product
from synth.analysis.stability import balance, stability
from synth.plant.generalized import Feedback, Plant, check_continuous, real_matrix
from synth.plant.numerics import DesignError, numerics

# power of the noise that is added to every state so that the inequality is strict, relative to the power of the disturbance
ABOVE = (1e-12, 1e-9, 1e-6, 1e-3)
# relative distances above the computed peak at which `bound_together` tries to prove a bound, in this order
HIGHER = (1e-12, 1e-9, 1e-6, 1e-3)


@dataclass(frozen=True, eq=False)
class EnergyPeaks:
    """Largest peaks of several signals for a disturbance of energy 1.

    Attributes:
        peaks: largest peak of each of the p signals, shape (p,) [unit of the signal / (unit of w s^1/2)].
        together: largest length (Euclidean norm) that the vector of all p signals reaches.
        bounds: proved upper bounds on `peaks`, shape (p,).
        bound_together: proved upper bound on `together`.
        proof: proof of the Lyapunov inequality.
    """

    peaks: Array
    together: float
    bounds: Array
    bound_together: float
    proof: LmiProof


@numerics()
def energy_peaks(plant: Plant, G: Array | Feedback, Cs: Array, Ds: Array) -> EnergyPeaks:
    """Returns the energy-to-peak norms of the signals s = (C_s + D_s G) x in the loop A + B G, with proved bounds.

    Args:
        plant: plant in continuous time with n states and m inputs.
        G: state gain, shape (m, n), or a gain from measurements.
        Cs: matrix from the states to the p signals, shape (p, n).
        Ds: feedthrough from the inputs to the p signals, shape (p, m).

    Raises:
        InputError: the plant is discrete, or the shape of C_s or D_s does not fit the plant.
        DesignError: the loop is not stable, or rounding prevents a proof.
    """
    check_continuous(plant)
    Cs, Ds = signals(plant, Cs, Ds)
    loop = plant.closed_loop(G)
    loop_stability = stability(loop.A)
    if not loop_stability.stable:
        raise DesignError(f"no bound on the peaks exists, because the loop is {loop_stability.words}; stabilise the loop first")
    A, scale = balance(loop.A)
    Bw = loop.Bw / scale[:, None]
    rows = (Cs + Ds @ (G.K @ G.Cy if isinstance(G, Feedback) else G)) * scale
    P = _gramian(A, Bw @ Bw.T)
    covariance = rows @ P @ rows.T
    without_z = replace(plant, C=np.zeros((1, len(A))), D=np.zeros((1, plant.B.shape[1])), Dw=np.zeros((1, Bw.shape[1])))
    for more in ABOVE:
        X = _gramian(A, (1 + more) * Bw @ Bw.T + more * (float(np.sum(Bw**2)) or 1.0) * np.eye(len(A)))
        proof = prove_bound(without_z, G, scale[:, None] * X * scale, 1.0)
        if proof.holds:
            bounds, together = _bounds(plant, G, Cs, Ds, proof.X)
            peaks = np.sqrt(np.maximum(np.diag(covariance), 0.0))
            return EnergyPeaks(peaks, float(np.linalg.eigvalsh(covariance)[-1]) ** 0.5, bounds, together, proof)
    raise DesignError(
        f"the bounds on the peaks are not proved: the loop is {loop_stability.words}, too close to marginal stability"
    )


def signals(plant: Plant, Cs: Array, Ds: Array) -> tuple[Array, Array]:
    """Returns C_s and D_s as arrays, and checks their shapes (p, n) and (p, m).

    Raises:
        InputError: the matrices of the signals do not fit the plant.
    """
    (n, m), C_signals = plant.B.shape, real_matrix(Cs, "Cs", f"(p, {plant.B.shape[0]})")
    through = real_matrix(Ds, "Ds", f"({len(C_signals)}, {m})")
    if not len(C_signals) or C_signals.shape[1] != n or through.shape != (len(C_signals), m):
        raise InputError(
            f"Cs has shape {C_signals.shape} and Ds {through.shape}; give the shapes (p, {n}) and (p, {m}), with one "
            "row for each of the p signals"
        )
    return C_signals, through


def _gramian(A: Array, noise: Array) -> Array:
    P = linalg.solve_continuous_lyapunov(A, -noise)
    return (P + P.T) / 2


def _bounds(plant: Plant, G: Array | Feedback, Cs: Array, Ds: Array, X: Array) -> tuple[Array, float]:
    """Returns proved bounds on the peaks of the signals.

    Returns:
        The bound (c X c')^1/2 of each signal, rounded up, and a proved bound on the square root of the largest eigenvalue of C
        X C'.
    """
    K, Cy = (G.K, G.Cy) if isinstance(G, Feedback) else (G, np.eye(len(plant.A)))
    (states, unit), (through, over), (gain, per), (rows, under), (unknown, one) = (integers(each) for each in (Cs, Ds, K, Cy, X))
    c = states * (over * per * under) + product(through, product(gain, rows)) * unit
    whole = unit * over * per * under
    square, scale = product(c, product(unknown, c.T)), whole**2 * one
    bounds = np.array([_root_above(Fraction(int(square[i, i]), scale)) for i in range(len(c))])
    together = float(np.linalg.eigvalsh(floats(square, Fraction(1, scale)))[-1]) ** 0.5
    for higher in HIGHER:
        bound = together * (1 + higher)
        limit = Fraction(bound) ** 2
        margin = -square * limit.denominator
        margin[np.arange(len(c)), np.arange(len(c))] += limit.numerator * scale
        if definiteness(floats(margin, Fraction(1, scale * limit.denominator))).proved:
            return bounds, bound
    # the sum is the trace of the matrix
    return bounds, _root_above(sum((Fraction(int(square[i, i]), scale) for i in range(len(c))), Fraction(0)))


def _root_above(square: Fraction) -> float:
    """Returns a float that is at least the square root of a number."""
    return float(np.nextafter(np.nextafter(float(square) ** 0.5, np.inf), np.inf)) if square > 0 else 0.0
