"""Coordinates of gains in which measurements count alike.

Where a measurement is large and another nearly equal to it, a gain may be free to grow in their difference and hardly free to
move in their sum: of a reference that wanders slowly and a position that follows it, the difference is small. In the landscape's
own coordinates that is a narrow valley. In those where the measurements of the loop under white noise are uncorrelated and of one
size, it is none: for a quadratic cost they are what makes the curvature alike (the natural gradient).
"""

import numpy as np
from scipy import linalg

from models.arrays import Array
from synth.landscape import Landscape

SMALLEST = 1e-12  # of the largest variance of a combination of measurements; what is smaller counts as this


def uncorrelated(landscape: Landscape, x: Array) -> Array:
    """M, shape (m q, m q): with x + M t for the point, t has these coordinates.

    Args:
        landscape: of the plant.
        x: a stable point.
    """
    A, _ = landscape.loop(x)
    m, q = landscape.shape
    covariance = linalg.solve_continuous_lyapunov(A, -landscape.Bw @ landscape.Bw.T)
    seen = landscape.Cy @ covariance @ landscape.Cy.T
    variances, directions = np.linalg.eigh((seen + seen.T) / 2)
    if not variances[-1] > 0:  # nothing measured answers to w
        return np.eye(m * q)
    root = directions / np.sqrt(np.maximum(variances, SMALLEST * variances[-1])) @ directions.T
    M = np.kron(np.eye(m), root) / landscape.scale.ravel()[:, None]
    return M / np.linalg.norm(M, 2)
