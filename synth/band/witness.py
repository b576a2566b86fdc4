"""A witness for a norm within a band: P and Q of the generalized KYP lemma, proposed by Clarabel through cvxpy.

What it proposes is proved by `proof.py`, or is no witness. The lemma is exact for a loop that is given: a bound just above the
norm has one. (For a design the same LMI with a slack variable is far too loose: it has 5.4 where 1.9 is attained.)
"""

from dataclasses import replace

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from synth.band.norm import norm_in_band
from synth.band.proof import BandProof, prove_in_band
from synth.certificate.stability import balance, is_stable
from synth.errors import DesignError
from synth.lmi.clarabel import answered
from synth.numerics import numerics
from synth.plant import Feedback, GeneralizedPlant, check_continuous
from synth.scaling import reachable, size

EVERYWHERE = 1e-9  # of the disturbance's power: what is taken to disturb states that w does not reach
MARGINS = (1e-5, 1e-4, 1e-3, 1e-2, 0.1)  # how far above the norm the bound lies, the first that the solver's P and Q prove


@numerics()
def band_witness(plant: GeneralizedPlant, G: Array | Feedback, low: float, high: float) -> BandProof:
    """P and Q that prove a bound just above the norm of the loop A + B G, C + D G within a band. They say nothing of stability.

    Args:
        plant: continuous, n states, m inputs.
        G: shape (m, n), or a gain from measurements.
        low: w1, from 0 [rad/s].
        high: w2, above low [rad/s]; may be infinite.

    Raises:
        InputError: the plant is discrete, or the band is none.
        DesignError: a pole lies on the band's stretch of the axis, or nothing that the solver proposed proves a bound.
    """
    check_continuous(plant)
    loop = plant.closed_loop(G)
    norm = norm_in_band(loop, low, high)
    if not 0 < norm.value < np.inf:
        raise DesignError(f"there is no bound to prove: the norm within the band is {norm.value:g}; choose another band")
    said = ""
    for margin in MARGINS:
        try:
            P, Q = _proposed(loop, norm.value * (1 + margin), low, high)
        except DesignError as error:
            said = said or str(error)
            continue
        proof = prove_in_band(plant, G, P, Q, norm.value * (1 + margin), low, high)
        if proof.holds:
            return proof
        said = f"its P and Q miss by rounding: {proof.negative.smallest:.1e} and {proof.positive.smallest:.1e} are too small"
    raise DesignError(f"no bound up to {1 + MARGINS[-1]:g} times the norm {norm.value:.7g} within the band has a witness: {said}")


def _proposed(loop: GeneralizedPlant, gamma: float, low: float, high: float) -> tuple[Array, Array]:
    """P and Q with as much to spare as there is, in coordinates and units in which all numbers have size one."""
    import cvxpy as cp  # 0.9 s, and only this function needs it

    (n, r), rate = loop.Bw.shape, high if np.isfinite(high) else max(low, size(loop.A))
    T = _coordinates(loop)
    own = loop.in_coordinates(T)
    into = rate / size(own.Bw)
    w1, w2 = low / rate, high / rate

    P, Q, spare = cp.Variable((n, n), hermitian=True), cp.Variable((n, n), hermitian=True), cp.Variable()
    if np.isfinite(high):
        multiplier = cp.bmat([[-Q, P + 0.5j * (w1 + w2) * Q], [P - 0.5j * (w1 + w2) * Q, -w1 * w2 * Q]])
    else:
        multiplier = cp.bmat([[Q, P], [P, -(w1**2) * Q]])
    F = np.block([[own.A / rate, own.Bw * into / rate], [np.eye(n), np.zeros((n, r))]])
    z = np.hstack([own.C / (gamma * into), own.Dw / gamma])
    M = F.T @ multiplier @ F + z.T @ z - np.diag([0.0] * n + [1.0] * r)
    answered(cp.Problem(cp.Maximize(spare), [M << -spare * np.eye(n + r), Q >> spare * np.eye(n), spare <= 1]))
    back, unit = np.linalg.inv(T), (gamma * into) ** 2
    P, Q = (back.T @ np.asarray(matrix.value) @ back for matrix in (P, Q))
    return unit / rate * P, unit / rate**2 * Q


def _coordinates(loop: GeneralizedPlant) -> Array:
    """Coordinates in which w disturbs all states alike, shape (n, n): white noise, or of an unstable loop what decays faster."""
    if not is_stable(loop.A):
        return reachable(replace(loop, B=loop.Bw, D=loop.Dw), 0)
    A, scale = balance(loop.A)
    Bw = loop.Bw / scale[:, None]
    noise = Bw @ Bw.T + EVERYWHERE * float(np.sum(Bw**2)) * np.eye(len(A))
    covariance = linalg.solve_continuous_lyapunov(A, -noise)
    return scale[:, None] * np.linalg.cholesky((covariance + covariance.T) / 2)
