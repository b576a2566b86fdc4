"""LMI problems solved by Clarabel through cvxpy: the paper's, and a common gain for several plants.

This is an independent route to every bound: the designs come from the central path (`central_path.py`), which needs no solver.

For several plants i, with common W and Y and an X_i for each,

    [ -f He(W)     X_i - W + f (A_i W + B_i Y)'            f (C_i W + D_i Y)'                      ]
    [ *            He(A_i W + B_i Y) + eta Bw_i Bw_i'      (C_i W + D_i Y)' + eta Bw_i Dw_i'       ]
    [ *            *                                       -I + eta Dw_i Dw_i'                     ]  < 0,      X_i > 0.

Multiplied from the left by [A_i + B_i G, I, 0; C_i + D_i G, 0, I], G = Y W^-1, and from the right by its transpose, it is (20)
with X_i: so each X_i proves the bound eta^-1/2 of its loop. The gain Y W^-1 contains no X, so the plants need not share one.

W = Q W_Q + R W_R R' with any W_Q and any regular W_R, and Y = Y_R R', replace (12): C_y Q = 0 and C_y R = I give C_y W = W_R R',
hence Y W^-1 = K C_y with K = Y_R W_R^-1 (13). If W_R is block-diagonal, the zeros of Y_R are zeros of K.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.common.arrays import Array
from synth.plant.generalized import Plant
from synth.plant.numerics import DesignError, NoSolutionError


@dataclass(frozen=True, eq=False)
class LmiSolution:
    """The solver's solution: one point of the optimal face, up to its tolerance.

    Attributes:
        X: shape (n, n).
        Y: shape (m, n).
        eta: gamma^-2.
        status: status of the solver, "optimal" or "optimal_inaccurate".
    """

    X: Array
    Y: Array
    eta: float
    status: str

    @property
    def gamma(self) -> float:
        """The bound eta^-1/2, (23)."""
        return self.eta**-0.5


def solve_lmi(plant: Plant, Q: Array, R: Array, gain: Array | None = None) -> LmiSolution:
    """Solves (25): maximise eta subject to (24) with X = Q X_Q Q' + R X_R R', Y = Y_R R' (12), X_Q > 0, X_R > 0.

    With an empty Q and R = I it is (22); for a closed loop with B = 0 it is (27). For a discrete plant, the bordered matrix of
    `certificate.py` replaces (24).

    Args:
        Q: shape (n, n - q).
        R: shape (n, q).
        gain: K, shape (m, q): then Y_R = K X_R, and the optimum is the best bound of (25) for that gain.

    Raises:
        NoSolutionError: the solver reports it, or an eta that is zero to its tolerance.
        DesignError: the solver gave up.
    """
    import cvxpy as cp  # 0.9 s, and only this function needs it

    step, plant = plant.dt, plant.differences
    m = plant.B.shape[1]
    d = len(plant.C)
    X_R = cp.Variable((R.shape[1], R.shape[1]), symmetric=True)
    Y_R = cp.Variable((m, R.shape[1])) if gain is None else gain @ X_R
    eta = cp.Variable()
    X, positive = R @ X_R @ R.T, [X_R >> 0]
    if Q.shape[1]:
        X_Q = cp.Variable((Q.shape[1], Q.shape[1]), symmetric=True)
        X, positive = X + Q @ X_Q @ Q.T, [*positive, X_Q >> 0]
    Y = Y_R @ R.T

    top = plant.A @ X + plant.B @ Y
    low = plant.C @ X + plant.D @ Y
    disturbance = np.vstack([plant.Bw, plant.Dw])
    F = cp.bmat([[top + top.T, low.T], [low, -np.eye(d)]]) + eta * (disturbance @ disturbance.T)
    if step is not None:
        border = step**0.5 * cp.vstack([top, low])
        F = cp.bmat([[F, border], [border.T, -X]])
    problem = cp.Problem(cp.Maximize(eta), [F << 0, *positive])
    answered(problem)
    X_value, Y_value, eta_value = np.asarray(X.value), np.asarray(Y.value), float(eta.value)  # pyright: ignore[reportArgumentType]
    # Clarabel's tolerance of 1e-8, relative to X.
    if eta_value <= 1e-8 * np.linalg.norm(X_value, 2):
        raise NoSolutionError(
            f"the LMI problem has no solution with eta > 0: Clarabel reports {problem.status!r} with eta = {eta_value:.1e}"
        )
    per_step = 1.0 if step is None else step  # (21) in differences has X over it
    return LmiSolution(per_step * X_value, per_step * Y_value, eta_value, problem.status)


def answered(problem: Any, **settings: float) -> None:
    """Solves a `cvxpy.Problem` by Clarabel. The caller checks the values of its unknowns.

    Args:
        problem: problem with an objective.
        settings: settings of Clarabel other than its defaults.

    Raises:
        NoSolutionError: the solver reports it.
        DesignError: the solver gave up.
    """
    import cvxpy as cp

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # "may be inaccurate": the status says so, too
            problem.solve(solver=cp.CLARABEL, **settings)
    except cp.SolverError as error:
        raise DesignError(
            f"Clarabel could not solve the LMI problem: {error}; rescale the plant or use the central-path method"
        ) from error
    if problem.status not in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE):
        raise NoSolutionError(f"the LMI problem has no solution with eta > 0: Clarabel reports {problem.status!r}")


REGULARIZED = 1e-6  # static regularisation of Clarabel's linear systems; the default 1e-8 is too small for a full car
NOTHING = 1e-8  # relative to X: a smaller eta is zero to Clarabel's tolerance


@dataclass(frozen=True, eq=False)
class SlackSolution:
    """The solver's solution with a slack variable.

    Attributes:
        W: the slack variable, shape (n, n), regular.
        K: Y_R W_R^-1, shape (m, q).
        eta: gamma^-2.
    """

    W: Array
    K: Array
    eta: float


def first_step(plants: Sequence[Plant], f: float, blocks: Array) -> SlackSolution:
    """Maximises eta subject to the LMIs of all plants for state feedback, W and Y free, with K of shape (m, n).

    W_R = C_y W C_y' must have the blocks that the second step needs: this is a constraint here.

    Args:
        plants: plants in continuous time, with the same states, inputs, and C_y of the second step.
        f: time unit, above 0 [s].
        blocks: mask of the entries of W_R that may be nonzero, see `together`, shape (q, q).

    Raises:
        NoSolutionError: the solver reports it, or its eta is zero to its tolerance.
        DesignError: the solver gave up.
    """
    import cvxpy as cp  # 0.9 s, and only this function and the next need it

    (n, m), Cy = plants[0].B.shape, plants[0].Cy
    W, Y = cp.Variable((n, n)), cp.Variable((m, n))
    apart = np.nonzero(blocks == 0)
    eta = _solved(plants, f, W, Y, [(Cy @ W @ Cy.T)[apart] == 0] if len(apart[0]) else [])
    return SlackSolution(np.asarray(W.value), _ratio(Y, W), eta)


def second_step(plants: Sequence[Plant], f: float, Q: Array, R: Array, pattern: Array) -> SlackSolution:
    """Maximises eta subject to the same LMIs for output feedback, with W = Q W_Q + R W_R R' and Y = Y_R R'.

    Args:
        plants: plants in continuous time, with the same states and inputs.
        f: time unit, above 0 [s].
        Q: shape (n, n - q).
        R: shape (n, q); [Q R] is regular.
        pattern: mask of the entries of K that may be nonzero, shape (m, q).
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
    """Returns the value of Y W^-1 of cvxpy expressions."""
    return np.linalg.solve(np.asarray(W.value).T, np.asarray(Y.value).T).T


def together(pattern: Array) -> Array:
    """Returns a mask of the entries of W_R that may be nonzero: between measurements used by the same inputs, shape (q, q)."""
    return np.all(pattern[:, :, None] == pattern[:, None, :], axis=0).astype(float)


def _solved(plants: Sequence[Plant], f: float, W: Any, Y: Any, constraints: list[Any]) -> float:
    """Solves for W and Y, cvxpy expressions; returns the largest eta for which all LMIs hold."""
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
    optimum = float(eta.value)  # pyright: ignore[reportArgumentType]
    if optimum <= NOTHING * size:
        raise NoSolutionError(f"the LMI problem with a slack variable has no solution with eta > 0: Clarabel finds {optimum:.1e}")
    return optimum
