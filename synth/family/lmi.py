"""The bounded real lemma with a slack variable, for several plants at once, as it reads; solved by Clarabel through cvxpy.

For every plant i, with one W and one Y for all and an X_i of its own,

    [ -f He(W)     X_i - W + f (A_i W + B_i Y)'            f (C_i W + D_i Y)'                      ]
    [ *            He(A_i W + B_i Y) + eta Bw_i Bw_i'      (C_i W + D_i Y)' + eta Bw_i Dw_i'       ]
    [ *            *                                       -I + eta Dw_i Dw_i'                     ]  < 0,      X_i > 0.

Multiplied from the left by [A_i + B_i G, I, 0; C_i + D_i G, 0, I], G = Y W^-1, and from the right by its transpose, it is (20)
with X_i: so each X_i proves the bound eta^-1/2 of its own loop. The gain is Y W^-1, and no X is in it: a common X would have to
fit all plants, and here only W has to.

W = Q W_Q + R W_R R' with any W_Q and any regular W_R, and Y = Y_R R', take the place of (12): C_y Q = 0 and C_y R = I give
C_y W = W_R R', hence Y W^-1 = K C_y with K = Y_R W_R^-1 (13). With W_R block-diagonal and Y_R zero in places K is zero in them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.common.arrays import Array
from synth.errors import InfeasibleError
from synth.lmi.clarabel import answered
from synth.plant import GeneralizedPlant

REGULARIZED = 1e-6  # of Clarabel's linear systems; with its own 1e-8 it gives up on a full car, and on f that are large or small
NOTHING = 1e-8  # of the size of X: an eta below that is zero to Clarabel's tolerance


@dataclass(frozen=True, eq=False)
class SlackSolution:
    """What the solver returned.

    Attributes:
        W: the slack variable, shape (n, n), regular.
        K: Y_R W_R^-1, shape (m, q).
        eta: gamma^-2.
    """

    W: Array
    K: Array
    eta: float


def first_step(plants: Sequence[GeneralizedPlant], f: float, Cy: Array, blocks: Array) -> SlackSolution:
    """State feedback: maximises eta subject to the LMIs of all plants, W and Y free. Its K is one from all states, shape (m, n).

    With blocks in W_R the second step can have this W only if C_y W C_y', which W_R then is, has them: this is asked for here.

    Args:
        plants: continuous, alike in states and inputs.
        f: above 0 [s].
        Cy: what the second step measures, shape (q, n).
        blocks: which measurements a block of W_R joins, see `together`, shape (q, q).

    Raises:
        InfeasibleError: the solver says so, or its eta is zero to its tolerance.
        DesignError: the solver gave up.
    """
    import cvxpy as cp  # 0.9 s, and only this function and the next need it

    n, m = plants[0].B.shape
    W, Y = cp.Variable((n, n)), cp.Variable((m, n))
    apart = np.nonzero(blocks == 0)
    eta = _solved(plants, f, W, Y, [(Cy @ W @ Cy.T)[apart] == 0] if len(apart[0]) else [])
    return SlackSolution(np.asarray(W.value), _ratio(Y, W), eta)


def second_step(plants: Sequence[GeneralizedPlant], f: float, Q: Array, R: Array, pattern: Array) -> SlackSolution:
    """Output feedback: the same with W = Q W_Q + R W_R R' and Y = Y_R R'.

    Args:
        plants: continuous, alike in states and inputs.
        f: above 0 [s].
        Q: shape (n, n - q).
        R: shape (n, q); [Q R] is regular.
        pattern: where K may be other than zero, of bools, shape (m, q).

    Raises:
        InfeasibleError, DesignError: as `first_step`.
    """
    import cvxpy as cp

    (n, m), q = plants[0].B.shape, R.shape[1]
    blocks, used = together(pattern), pattern.astype(float)
    W_R, Y_R = cp.multiply(blocks, cp.Variable((q, q))), cp.multiply(used, cp.Variable((m, q)))
    W, Y = R @ W_R @ R.T, Y_R @ R.T
    if Q.shape[1]:
        W = W + Q @ cp.Variable((Q.shape[1], n))
    eta = _solved(plants, f, W, Y, [])
    return SlackSolution(np.asarray(W.value), used * _ratio(Y_R, W_R), eta)


def _ratio(Y: Any, W: Any) -> Array:
    """Y W^-1 of cvxpy's expressions."""
    return np.linalg.solve(np.asarray(W.value).T, np.asarray(Y.value).T).T


def together(pattern: Array) -> Array:
    """Which measurements one block of W_R may join: those that the same inputs use. Ones and zeros, shape (q, q)."""
    return np.all(pattern[:, :, None] == pattern[:, None, :], axis=0).astype(float)


def _solved(plants: Sequence[GeneralizedPlant], f: float, W: Any, Y: Any, constraints: list[Any]) -> float:
    """The largest eta for which all LMIs hold, of cvxpy's expressions W and Y."""
    import cvxpy as cp

    eta, X = cp.Variable(), [cp.Variable(W.shape, symmetric=True) for _ in plants]
    for plant, X_i in zip(plants, X, strict=True):
        top = plant.A @ W + plant.B @ Y
        low = plant.C @ W + plant.D @ Y
        disturbance = np.vstack([np.zeros_like(plant.Bw), plant.Bw, plant.Dw])
        F = cp.bmat(
            [
                [-f * (W + W.T), X_i - W + f * top.T, f * low.T],
                [X_i - W.T + f * top, top + top.T, low.T],
                [f * low, low, -np.eye(len(plant.C))],
            ]
        )
        constraints += [F + eta * (disturbance @ disturbance.T) << 0, X_i >> 0]
    answered(cp.Problem(cp.Maximize(eta), constraints), static_regularization_constant=REGULARIZED)
    size = max(float(np.linalg.norm(X_i.value, 2)) for X_i in X)  # pyright: ignore[reportArgumentType, reportCallIssue]
    found = float(eta.value)  # pyright: ignore[reportArgumentType]
    if found <= NOTHING * size:
        raise InfeasibleError(f"the LMI problem with a slack variable has no solution with eta > 0: Clarabel's is {found:.1e}")
    return found
