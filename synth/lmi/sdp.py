"""Solution of the LMI problems by the solver Clarabel through cvxpy.

The solver Clarabel serves only as an independent check of the bounds. The designs are computed with the central path
(`central_path.py`), which does not need a solver.
"""

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.common.arrays import Array
from synth.plant.generalized import Plant
from synth.plant.numerics import DesignError, NoSolutionError


@dataclass(frozen=True, eq=False)
class LmiSolution:
    """Solution that the solver returned; it is one of the optimal points, up to the tolerance of the solver.

    Attributes:
        X: matrix X of LMI (24), shape (n, n).
        Y: matrix Y of LMI (24), shape (m, n).
        eta: gamma^-2.
        status: status of the solver, "optimal" or "optimal_inaccurate".
    """

    X: Array
    Y: Array
    eta: float
    status: str

    @property
    def gamma(self) -> float:
        """Bound gamma = eta^-1/2 of the solution, as in (23)."""
        return self.eta**-0.5


def solve_lmi(plant: Plant, Q: Array, R: Array, gain: Array | None = None) -> LmiSolution:
    """Solves (25): maximises eta subject to (24) with X = Q X_Q Q' + R X_R R', Y = Y_R R' (12), X_Q > 0, X_R > 0.

    If Q is empty and R = I, the problem is (22). For a closed loop with B = 0, the problem is (27). For a discrete plant, the
    larger matrix of `certificate.py` replaces the matrix of (24).

    Args:
        plant: plant with n states and m inputs.
        Q: matrix of shape (n, n - q).
        R: matrix of shape (n, q).
        gain: fixed gain K, shape (m, q). If K is given, Y_R = K X_R, and the optimum is the best bound of (25) for the gain K.

    Raises:
        NoSolutionError: the solver reports that the problem has no solution, or eta is zero within the tolerance.
        DesignError: the solver failed.
    """
    import cvxpy as cp  # this import takes 0.9 s, and only this function needs it

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
    solve_sdp(problem)
    X_value, Y_value, eta_value = np.asarray(X.value), np.asarray(Y.value), float(eta.value)  # pyright: ignore[reportArgumentType]
    # The tolerance of Clarabel is 1e-8 and is relative to X.
    if eta_value <= 1e-8 * np.linalg.norm(X_value, 2):
        raise NoSolutionError(
            f"the LMI problem has no solution with eta > 0: Clarabel reports {problem.status!r} with eta = {eta_value:.1e}"
        )
    per_step = 1.0 if step is None else step  # for a plant in difference form, the X of (21) is divided by the step
    return LmiSolution(per_step * X_value, per_step * Y_value, eta_value, problem.status)


def solve_sdp(problem: Any) -> None:
    """Solves a `cvxpy.Problem` with Clarabel. The caller must check the values of the optimisation variables.

    Args:
        problem: problem to solve, with an objective.

    Raises:
        NoSolutionError: the solver reports that the problem has no solution.
        DesignError: the solver failed.
    """
    import cvxpy as cp

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the warning "may be inaccurate" repeats the status
            problem.solve(solver=cp.CLARABEL)
    except cp.SolverError as error:
        raise DesignError(
            f"Clarabel could not solve the LMI problem: {error}; rescale the plant or use the central-path method"
        ) from error
    if problem.status not in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE):
        raise NoSolutionError(f"the LMI problem has no solution with eta > 0: Clarabel reports {problem.status!r}")
