"""A start for a search over static gains from a Riccati equation, n^3 work: for plants that are too large for problem (22).

The state feedback u = G x that is best for z under white noise needs all of x. Of what is measured, K C_y comes closest to it on
average with K = G X C_y' (C_y X C_y')^-1, where X is the covariance of the loop that G closes. Whether K stabilises is asked
afterwards: nothing here promises it.
"""

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from synth.scaling import size
from synth.search.landscape import Landscape

COUNTS = (1e-8, 1e-4, 1e-2)  # of z's power: what every state and force counts besides, so that there is a solution
EVERYWHERE = 1e-6  # of the disturbance's power: what disturbs states that w does not reach


def projected_starts(landscape: Landscape) -> list[Array]:
    """Points that come closest to the state feedback of a Riccati equation, shape (m q,) each; none where rounding leaves none.

    Args:
        landscape: of the plant.
    """
    A, Cy, C, D = landscape.A, landscape.Cy, landscape.C, landscape.D
    n, m = landscape.B.shape
    unit = size(A) / size(landscape.B)  # of the forces, with which they move the states as fast as these move
    B, D = landscape.B * unit, D * unit
    noise = landscape.Bw @ landscape.Bw.T
    noise += EVERYWHERE * size(noise) * np.eye(n)
    weight = size(np.hstack([C, D])) ** 2
    found = []
    for counts in COUNTS:
        try:
            P = linalg.solve_continuous_are(
                A, B, C.T @ C + counts * weight * np.eye(n), D.T @ D + counts * weight * np.eye(m), s=C.T @ D
            )
            G = -np.linalg.solve(D.T @ D + counts * weight * np.eye(m), B.T @ P + D.T @ C)
            X = linalg.solve_continuous_lyapunov(A + B @ G, -noise)
            K = unit * G @ X @ Cy.T @ np.linalg.inv(Cy @ X @ Cy.T)
        except (np.linalg.LinAlgError, ValueError):
            continue
        if np.all(np.isfinite(K)):
            found.append(landscape.point_acting(K))
    return found
