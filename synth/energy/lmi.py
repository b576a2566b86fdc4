"""Problems (22) and (25) with hard limits: no peak of some signals beyond a bound for a disturbance of given energy.

The X of (21) satisfies He(A X + B Y) + eta Bw Bw' < 0, so that X / eta lies above the P of `peaks.py`, and a signal
s = (C_s + D_s G) x, in units of its limit, is within 1 for every w of energy 1 if (C_s + D_s G) X (C_s + D_s G)' <= eta: that is

    [ eta     C_s X + D_s Y ]
    [ *       X             ]  >= 0,

affine in X, Y and eta (Scherer, Gahinet, Chilali 1997). So (12) and both steps are the paper's own. X is one for norm and peaks,
which is a price: a gain attains less in peaks than its X says.
"""

from typing import Any

import numpy as np

from models.common.arrays import Array
from synth.errors import InfeasibleError
from synth.lmi.clarabel import LmiSolution, answered
from synth.plant import GeneralizedPlant

REGULARIZED = 1e-6  # of Clarabel's linear systems; with its own 1e-8 it gives up where limits are hardly met
NOTHING = 1e-8  # of the size of X: an eta below that is zero to Clarabel's tolerance


def solve_limited(plant: GeneralizedPlant, Q: Array, R: Array, Cs: Array, Ds: Array) -> LmiSolution:
    """Maximises eta subject to (24) with (12), and to the limits; with an empty Q and R = I it is (22).

    Args:
        plant: continuous, n states, m inputs.
        Q: shape (n, n - q).
        R: shape (n, q).
        Cs: signals in units of their limits, shape (p, n).
        Ds: what the inputs do at once to them, shape (p, m).

    Raises:
        InfeasibleError: the solver says so, or its eta is zero to its tolerance.
        DesignError: the solver gave up.
    """
    import cvxpy as cp  # 0.9 s, and only this function needs it

    m, d = plant.B.shape[1], len(plant.C)
    X_R, Y_R, eta = cp.Variable((R.shape[1], R.shape[1]), symmetric=True), cp.Variable((m, R.shape[1])), cp.Variable()
    X, constraints = R @ X_R @ R.T, list[Any]([X_R >> 0])
    if Q.shape[1]:
        X_Q = cp.Variable((Q.shape[1], Q.shape[1]), symmetric=True)
        X = X + Q @ X_Q @ Q.T
        constraints.append(X_Q >> 0)
    Y = Y_R @ R.T

    top = plant.A @ X + plant.B @ Y
    low = plant.C @ X + plant.D @ Y
    disturbance = np.vstack([plant.Bw, plant.Dw])
    F = cp.bmat([[top + top.T, low.T], [low, -np.eye(d)]]) + eta * (disturbance @ disturbance.T)
    constraints.append(F << 0)
    for c, through in zip(Cs, Ds, strict=True):
        row = c[None] @ X + through[None] @ Y
        constraints.append(cp.bmat([[cp.reshape(eta, (1, 1), order="C"), row], [row.T, X]]) >> 0)
    problem = cp.Problem(cp.Maximize(eta), constraints)
    answered(problem, static_regularization_constant=REGULARIZED)
    X_value, Y_value, found = np.asarray(X.value), np.asarray(Y.value), float(eta.value)  # pyright: ignore[reportArgumentType]
    if found <= NOTHING * np.linalg.norm(X_value, 2):
        raise InfeasibleError(f"the LMI problem with limits has no solution with eta > 0: Clarabel's is {found:.1e}")
    return LmiSolution(X_value, Y_value, found, problem.status)
