"""A bound on the norm in a band that holds for a whole box of errors: P and Q that move with them, proposed by Clarabel.

`synth/analysis/uncertainty_box.py` proves or rejects the proposed bound. For a given gain it is almost tight: the slack variable
W is conservative in a design (see `lmi/sdp.py`), but hardly in a proof.
"""

from dataclasses import replace

import numpy as np

from models.common.arrays import Array
from synth.analysis.uncertainty_box import Box, ParameterDependentKYP, ScaledGain
from synth.design.uncertainty.parameter_dependent_lyapunov import own_coordinates
from synth.lmi.sdp import answered
from synth.plant.numerics import DesignError

CLOSER = (1e-4, 1e-3, 1e-2)  # relative; how far above the least bound that the solver sees one is proved
SPARE = (1e-6, 1e-4)  # of the inequalities, in coordinates and units in which all numbers have size one; more costs the bound
MOST = 25_000  # numbers in all inequalities of one problem: some seconds


def proof_in_band(gain: ScaledGain, box: Box, low: float, high: float, unit: float) -> ParameterDependentKYP | None:
    """Returns about the least provable bound on a norm in a band for a whole box; it does not imply stability.

    Args:
        gain: loops of the gain, in continuous time, the middle one stable.
        low, high: the band [rad/s]; `high` may be infinite.
        unit: magnitude of the bound.
    """
    (n, r), d, V = gain.plant.Bw.shape, len(gain.plant.C), 2 ** len(box.uncertain)
    if V * (2 * n + r + d) ** 2 > MOST or not gain.well_posed(box) or not 0 < unit < np.inf:
        return None
    for spare in SPARE:
        try:
            least = _proposed(gain, box, low, high, unit, spare)
        except (DesignError, np.linalg.LinAlgError):
            continue
        tried = (replace(least, gamma=least.gamma * (1 + above)) for above in CLOSER)
        if proof := next((one for one in tried if one.holds(gain, box)), None):
            return proof
    return None


def _proposed(gain: ScaledGain, box: Box, low: float, high: float, unit: float, spare: float) -> ParameterDependentKYP:
    """P, Q and W of the least bound, in coordinates and units in which all numbers have size one."""
    import cvxpy as cp  # 0.9 s, and only this function needs it

    loops, middle = gain.loops(box.vertices), gain.loops(box.middle)
    (V, n, r), d = loops.Bw.shape, loops.C.shape[1]
    T, fastest = own_coordinates(middle.A)
    inverse, rate = np.linalg.inv(T), high if np.isfinite(high) else max(low, fastest)
    size = float(np.linalg.norm(inverse @ middle.Bw, 2)) / rate  # what w moves x by
    T, inverse = T * size, inverse / size
    A, Bw, C, Dw = inverse @ loops.A @ T / rate, inverse @ loops.Bw / rate, loops.C @ T / unit, loops.Dw / unit
    w1, w2 = low / rate, high / rate
    a, c, b = (-1.0, (w1 + w2) / 2, -w1 * w2) if np.isfinite(high) else (1.0, 0.0, -(w1**2))
    W, bound = cp.Variable((n, 2 * n + r), complex=True), cp.Variable()
    P, Q = ([cp.Variable((n, n), hermitian=True) for _ in range(V)] for _ in range(2))
    constraints, k = [], 2 * n + r + d
    for i in range(V):
        upper = cp.bmat([[a * Q[i], P[i] + 1j * c * Q[i]], [P[i] - 1j * c * Q[i], b * Q[i]]])
        into = np.vstack([np.eye(2 * n), np.zeros((r + d, 2 * n))])
        fixed = np.zeros((k, k))
        fixed[2 * n + r :, n : 2 * n + r] = np.hstack([C[i], Dw[i]])
        motion = np.hstack([-np.eye(n), A[i], Bw[i], np.zeros((n, d))])
        of_motion = motion.T @ W @ np.eye(2 * n + r, k)
        M = into @ upper @ into.T + fixed + fixed.T - bound * np.diag([0.0] * (2 * n) + [1.0] * (r + d))
        M = M + of_motion + of_motion.H
        constraints += [(M + M.H) / 2 << -spare * np.eye(k), Q[i] >> spare * np.eye(n)]
    answered(cp.Problem(cp.Minimize(bound), constraints))
    S = np.zeros((2 * n + r, 2 * n + r))
    S[:n, :n], S[n : 2 * n, n : 2 * n], S[2 * n :, 2 * n :] = inverse / rate, inverse, np.eye(r)

    def hermitian(parts: list, over: float) -> Array:
        matrices = unit / over * np.stack([inverse.T @ np.asarray(part.value) @ inverse for part in parts])
        return (matrices + matrices.conj().swapaxes(-1, -2)) / 2

    of_w = unit / rate * inverse.T @ np.asarray(W.value) @ S
    return ParameterDependentKYP(
        hermitian(P, rate), hermitian(Q, rate**2), of_w, low, high, unit * float(np.asarray(bound.value))
    )
