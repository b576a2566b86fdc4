"""The peak of a signal of a loop for a disturbance of given energy: the energy-to-peak, or generalized H2, norm.

For s = c x of a stable loop x' = A x + Bw w, x(0) = 0, no w with an integral of |w|^2 of 1 takes |s| beyond (c P c')^1/2, where
A P + P A' + Bw Bw' = 0; the time-reversed impulse response of s comes arbitrarily close to it (Wilson 1989; Rotea 1993). For a w
with the energy E the bound is E^1/2 times as large. The length of a vector of several signals stays within the root of the
largest eigenvalue of C P C'. The disturbance must not feed through to a signal, or no bound exists. A control force may be part
of a signal, or the signal itself: it is K C_y x.

**The proof** is an X > 0 with A X + X A' + Bw Bw' < 0, just above P: no peak exceeds (c X c')^1/2. The inequality is LMI (20)
without z, proved in the same way (`certificate.prove_bound`); c X c' is computed in integers.
"""

from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.common.errors import InputError
from synth.analysis.certificate import LmiProof, prove_bound
from synth.analysis.rigorous import definiteness, floats, integers, product, root_above
from synth.analysis.stability import balance, stability
from synth.plant.generalized import Feedback, GeneralizedPlant, check_continuous, real_matrix
from synth.plant.numerics import DesignError, numerics

ABOVE = (
    1e-12,
    1e-9,
    1e-6,
    1e-3,
)  # relative to the disturbance's power: added for X, so that the strict inequality can be proved
HIGHER = (
    1e-12,
    1e-9,
    1e-6,
    1e-3,
)  # relative distance of the bound on all signals together from the root of the largest eigenvalue


@dataclass(frozen=True, eq=False)
class EnergyPeaks:
    """Peaks of signals for a disturbance whose square has the integral 1.

    Attributes:
        peaks: of each signal, in its unit over the disturbance's times the root of a second, shape (p,).
        together: peak of the length of their vector.
        bounds: proved, on each peak, shape (p,).
        bound_together: proved, on `together`.
        proof: of the Lyapunov inequality.
    """

    peaks: Array
    together: float
    bounds: Array
    bound_together: float
    proof: LmiProof


@numerics()
def energy_peaks(plant: GeneralizedPlant, G: Array | Feedback, Cs: Array, Ds: Array) -> EnergyPeaks:
    """Returns the energy-to-peak norms of s = (C_s + D_s G) x in the loop A + B G, with a proof.

    Args:
        plant: continuous, n states, m inputs.
        G: the gain, shape (m, n), or one from measurements.
        Cs: shape (p, n).
        Ds: feedthrough from the inputs to the signals, shape (p, m).

    Raises:
        InputError: the plant is discrete, or C_s or D_s does not fit it.
        DesignError: the loop is not stable, or rounding leaves no proof.
    """
    check_continuous(plant)
    Cs, Ds = signals(plant, Cs, Ds)
    loop = plant.closed_loop(G)
    found = stability(loop.A)
    if not found.stable:
        raise DesignError(f"no peak is bounded, for the loop is {found.words}; stabilise it first")
    A, scale = balance(loop.A)
    Bw = loop.Bw / scale[:, None]
    rows = (Cs + Ds @ (G.K @ G.Cy if isinstance(G, Feedback) else G)) * scale
    P = _gramian(A, Bw @ Bw.T)
    shown = rows @ P @ rows.T
    alone = replace(plant, C=np.zeros((1, len(A))), D=np.zeros((1, plant.B.shape[1])), Dw=np.zeros((1, Bw.shape[1])))
    for more in ABOVE:
        X = _gramian(A, (1 + more) * Bw @ Bw.T + more * (float(np.sum(Bw**2)) or 1.0) * np.eye(len(A)))
        proof = prove_bound(alone, G, scale[:, None] * X * scale, 1.0)
        if proof.holds:
            bounds, together = _bounds(plant, G, Cs, Ds, proof.X)
            peaks = np.sqrt(np.maximum(np.diag(shown), 0.0))
            return EnergyPeaks(peaks, float(np.linalg.eigvalsh(shown)[-1]) ** 0.5, bounds, together, proof)
    raise DesignError(f"rounding leaves no proof of a peak: the loop is {found.words}, too near to marginal for floats to tell")


def signals(plant: GeneralizedPlant, Cs: Array, Ds: Array) -> tuple[Array, Array]:
    """Returns C_s and D_s after checking their shapes (p, n) and (p, m).

    Raises:
        InputError: they do not fit the plant.
    """
    (n, m), found = plant.B.shape, real_matrix(Cs, "Cs", f"(p, {plant.B.shape[0]})")
    through = real_matrix(Ds, "Ds", f"({len(found)}, {m})")
    if not len(found) or found.shape[1] != n or through.shape != (len(found), m):
        raise InputError(
            f"Cs has shape {found.shape} and Ds {through.shape}; expected (p, {n}) and (p, {m}), a row for each of p signals"
        )
    return found, through


def _gramian(A: Array, noise: Array) -> Array:
    P = linalg.solve_continuous_lyapunov(A, -noise)
    return (P + P.T) / 2


def _bounds(plant: GeneralizedPlant, G: Array | Feedback, Cs: Array, Ds: Array, X: Array) -> tuple[Array, float]:
    """Returns the roots of c X c' of all signals, rounded upwards, and a proved bound on the root of the largest eigenvalue."""
    K, Cy = (G.K, G.Cy) if isinstance(G, Feedback) else (G, np.eye(len(plant.A)))
    (states, unit), (through, over), (gain, per), (rows, under), (unknown, one) = (integers(each) for each in (Cs, Ds, K, Cy, X))
    c = states * (over * per * under) + product(through, product(gain, rows)) * unit
    whole = unit * over * per * under
    square, scale = product(c, product(unknown, c.T)), whole**2 * one
    bounds = np.array([root_above(Fraction(int(square[i, i]), scale)) for i in range(len(c))])
    together = float(np.linalg.eigvalsh(floats(square, Fraction(1, scale)))[-1]) ** 0.5
    for higher in HIGHER:
        bound = together * (1 + higher)
        least = Fraction(bound) ** 2
        room = -square * least.denominator
        room[np.arange(len(c)), np.arange(len(c))] += least.numerator * scale
        if definiteness(floats(room, Fraction(1, scale * least.denominator))).proved:
            return bounds, bound
    return bounds, root_above(sum((Fraction(int(square[i, i]), scale) for i in range(len(c))), Fraction(0)))  # the trace
