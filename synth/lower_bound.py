"""What no controller can beat: a lower bound on the norm under every controller, proved by a dual solution of problem (22).

Any positive semidefinite Z with [B' D'] Z[:, :n] = 0 and H = A' Z11 + Z11 A + C' Z21 + Z12 C >= 0 pairs with (21) to

    0 >= <Z, F(X, Y, eta)> = -tr Z22 + <H, X> + eta <Z, E>,     E = [Bw; Dw] [Bw; Dw]',

so eta <= tr Z22 / <Z, E> for every state feedback, and gamma >= (<Z, E> / tr Z22)^1/2. A controller that measures less, static or
dynamic, linear or not, does no better than state feedback with full information of x (Khargonekar, Petersen, Rotea 1988), so the
bound holds for every controller.

On the central path (-F)^-1 is such a Z: the stationarity in Y is the first condition, and H = X^-1 the second. What rounding and
an early stop leave of them is taken out by a projection, and numpy computes the bound from what is left.
"""

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from models.arrays import Array
from synth.bounded_real import bounded_real_matrix
from synth.central import CentralPoint
from synth.plant import GeneralizedPlant


@dataclass(frozen=True, eq=False)
class LowerBound:
    """No controller reaches a smaller norm.

    Attributes:
        gamma: the bound; 0, which is always true, where Z proves nothing.
        Z: the dual matrix, shape (n + d, n + d), in the user's coordinates.
        residual: smallest eigenvalue of H over its largest. Not negative where the bound is proved.
    """

    gamma: float
    Z: Array
    residual: float


def lower_bound(plant: GeneralizedPlant, point: CentralPoint) -> LowerBound:
    """The bound that a point on the path of (22) proves. Short of the limit it is weaker, by (2 n + d) mu, and rounds less.

    Args:
        plant: n states, m inputs.
        point: of `state_feedback`, say at mu = 1e-6.
    """
    n = len(plant.A)
    # In the coordinates of the point X is I, Y is 0 and H is I: there a projection leaves H positive.
    T = np.linalg.cholesky(point.X)
    moved = plant.closed_loop(point.K).in_coordinates(T)
    S = -bounded_real_matrix(moved, np.eye(n), np.zeros_like(point.K), point.eta)
    size = 1 / np.sqrt(np.diagonal(S))
    Z = size[:, None] * np.linalg.inv(size[:, None] * S * size) * size
    inputs = np.vstack([moved.B, moved.D])
    along = linalg.orth(inputs / np.linalg.norm(inputs, axis=0))
    # Z loses its part along the inputs in its own metric, a Schur complement: the rest stays positive semidefinite.
    Z = Z - Z @ along @ np.linalg.solve(along.T @ Z @ along, along.T @ Z)
    return evaluate(moved, (Z + Z.T) / 2)


def evaluate(plant: GeneralizedPlant, Z: Array) -> LowerBound:
    """What a positive semidefinite Z with [B' D'] Z[:, :n] = 0 proves."""
    n = len(plant.A)
    Z11, Z12, Z22 = Z[:n, :n], Z[:n, n:], Z[n:, n:]
    H = plant.A.T @ Z11 + Z12 @ plant.C
    H = H + H.T
    scale = 1 / np.sqrt(np.maximum(np.abs(np.diagonal(H)), np.finfo(float).tiny))
    values = np.linalg.eigvalsh(scale[:, None] * H * scale)
    residual = float(values[0] / np.abs(values).max())
    disturbance = np.vstack([plant.Bw, plant.Dw])
    # The part of Z that is not negative proves as much as Z.
    squared = float(np.sum(disturbance * (Z @ disturbance)) / np.trace(Z22)) if residual >= 0 else 0.0
    return LowerBound(max(squared, 0.0) ** 0.5, Z, residual)
