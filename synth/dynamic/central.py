"""The central H-infinity controller of a regular plant from two Riccati equations, for a given gamma.

Every force costs something in z, and every measurement has noise of its own (D and Dyw have full rank); no zero from u to z or
from w to y lies on the imaginary axis. Glover, Doyle 1988; Zhou, Doyle, Glover 1996, Robust and Optimal Control, theorem 17.1, in
its names: D11 = Dw, D12 = D, D21 = Dyw; X and Y, F and H, and the hats.

With any D11 the formulas want D12 = [0; I] and D21 = [0 I]: z and w are turned, u and y scaled, and both are taken back. The
solvers of the equations are not believed: near the gamma below which there is none they return what solves nothing.
"""

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.law import LinearLaw
from synth.errors import InfeasibleError
from synth.plant import GeneralizedPlant

RESIDUAL = 1e-6  # of its largest term: less, and a Riccati equation counts as solved
NEGATIVE = 1e-9  # of the largest eigenvalue: what rounding leaves of one that is zero
EDGE = 1e-9  # relative; a spectral radius this close to gamma^2 counts as one that reaches it


def central_law(plant: GeneralizedPlant, Cy: Array, Dyw: Array, gamma: float) -> LinearLaw:
    """A stabilising law of as many states as the plant whose closed loop has a norm below gamma.

    Its states are what it takes the plant's to be, under the worst disturbance.

    Args:
        plant: n states, m inputs, r disturbances, d controlled outputs; D of rank m.
        Cy: shape (q, n).
        Dyw: shape (q, r), of rank q.
        gamma: to be undercut.

    Raises:
        InfeasibleError: no law does, or rounding hides it.
    """
    A, n, (d, m), (q, r), square = plant.A, len(plant.A), plant.D.shape, Dyw.shape, gamma**2
    turn_z, from_u = _last(plant.D)  # turn_z' D from_u = [0; I]
    turn_w, from_y = _last(Dyw.T)  # turn_w' Dyw' from_y = [0; I]
    B1, B2, C1, C2 = plant.Bw @ turn_w, plant.B @ from_u, turn_z.T @ plant.C, from_y.T @ Cy
    D11, i, j = turn_z.T @ plant.Dw @ turn_w, d - m, r - q
    D1111, D1112, D1121, D1122 = D11[:i, :j], D11[:i, j:], D11[i:, :j], D11[i:, j:]
    if max(_size(D11[:i]), _size(D11[:, :j])) >= gamma:
        raise InfeasibleError("w reaches z at once by more than gamma")
    B, C = np.hstack([B1, B2]), np.vstack([C1, C2])
    D1 = np.hstack([D11, np.eye(d)[:, i:]])
    E1 = np.vstack([D11, np.eye(r)[j:]])
    X, F = _stabilising(A, B, C1, D1, D1.T @ D1 - square * np.diag([1.0] * r + [0.0] * m))
    Y, H = _stabilising(A.T, C.T, B1.T, E1.T, E1 @ E1.T - square * np.diag([1.0] * d + [0.0] * q))
    if np.abs(np.linalg.eigvals(X @ Y)).max(initial=0.0) >= square * (1 - EDGE):
        raise InfeasibleError("the spectral radius of X Y reaches gamma^2")
    F12, F2, H12, H2 = F[j:r], F[r:], H[i:d].T, H[d:].T
    through = -D1121 @ D1111.T @ np.linalg.solve(square * np.eye(i) - D1111 @ D1111.T, D1112) - D1122
    B_law = np.linalg.solve(np.eye(n) - Y @ X / square, (B2 + H12) @ through - H2)
    seen = C2 + F12
    A_law, C_law = A + B @ F - B_law @ seen, F2 - through @ seen
    return LinearLaw(A_law, B_law @ from_y.T, from_u @ C_law, from_u @ through @ from_y.T)


def _last(D: Array) -> tuple[Array, Array]:
    """An orthogonal T and an S with T' D S = [0; I], for a D of full column rank."""
    m = D.shape[1]
    turned, sizes, directions = np.linalg.svd(D)
    return np.hstack([turned[:, m:], turned[:, :m]]), directions.T / sizes


def _stabilising(A: Array, B: Array, C: Array, D: Array, R: Array) -> tuple[Array, Array]:
    """X >= 0 of A'X + X A - (X B + C'D) R^-1 (..)' + C'C = 0 with A + B F stable, and F = -R^-1 (B'X + D'C)."""
    try:
        X = linalg.solve_continuous_are(A, B, C.T @ C, R, s=C.T @ D)
        X = (X + X.T) / 2
        F = -np.linalg.solve(R, B.T @ X + D.T @ C)
        stable = np.linalg.eigvals(A + B @ F).real.max(initial=-1.0) < 0
        sizes = np.linalg.eigvalsh(X)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise InfeasibleError(f"a Riccati equation has no solution ({error})") from error
    terms = A.T @ X, C.T @ C, (X @ B + C.T @ D) @ F
    left = np.linalg.norm(terms[0] + terms[0].T + terms[1] + terms[2])
    if not (stable and left <= RESIDUAL * max(map(np.linalg.norm, terms)) and sizes[0] >= -NEGATIVE * sizes[-1]):
        raise InfeasibleError("a Riccati equation has no stabilising solution that is positive semidefinite")
    return X, F


def _size(matrix: Array) -> float:
    return float(np.linalg.norm(matrix, 2)) if matrix.size else 0.0
