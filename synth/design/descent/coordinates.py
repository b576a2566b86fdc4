"""Coordinates of gains, and directions among them, in which all entries count alike.

Where a measurement is large and another nearly equal to it, a gain may be free to grow in their difference and hardly free to
move in their sum: of a reference that wanders slowly and a position that follows it, the difference is small. So with forces: two
may nearly cancel in z. In the landscape's own coordinates that is a narrow valley. A change dK of the gain changes z by
T_zu dK T_yw w. There is no valley in coordinates in which measurements are uncorrelated and of one size under white noise w,
and the answers of z to white noise of the forces are orthogonal and of one size. For a quadratic cost they make
the curvature alike (the natural gradient).
"""

import numpy as np
from scipy import linalg
from scipy.linalg import lapack

from models.common.arrays import Array
from synth.design.descent.landscape import Landscape

# pyright: reportAttributeAccessIssue=false
# scipy.linalg.lapack is made by f2py and carries no stubs.


SMALLEST = 1e-12  # of the largest variance of a combination of measurements, or of forces; what is smaller counts as this


def balanced_coordinates(landscape: Landscape, x: Array) -> Array:
    """Returns M, shape (N, N), at a stable point x: with x + M t for the point, t has these coordinates."""
    loop = landscape.loop(x)
    triangle, basis = linalg.schur(loop.A)  # pyright: ignore[reportAssignmentType]
    w, y, u, z = basis.T @ loop.Bw, loop.Cy @ basis, basis.T @ loop.B, loop.C @ basis
    # Gramians: what w reaches, and what z sees. On the border of stability LAPACK moves the poles a little: as good a scale.
    reached, scale, _ = lapack.dtrsyl(triangle, triangle, -w @ w.T, trana="N", tranb="T")
    seen, other, _ = lapack.dtrsyl(triangle, triangle, -z.T @ z, trana="T", tranb="N")
    measured = _root(y @ (reached / scale) @ y.T)
    forced = _root(u.T @ (seen / other) @ u)
    M = np.kron(forced, measured) / landscape.scale.ravel()[:, None]
    M = M if landscape.free is None else _within(M, landscape.free)
    return M / np.linalg.norm(M, 2)


def _root(variance: Array) -> Array:
    """The inverse square root of a variance; I where nothing varies, or without end."""
    if not np.all(np.isfinite(variance)):  # of a loop on the border of stability
        return np.eye(len(variance))
    sizes, directions = np.linalg.eigh((variance + variance.T) / 2)
    if not sizes[-1] > 0:
        return np.eye(len(variance))
    return directions / np.sqrt(np.maximum(sizes, SMALLEST * sizes[-1])) @ directions.T


def directions(landscape: Landscape, x: Array, free: Array) -> Array:
    """Returns the directions as columns, shape (N, free).

    Args:
        free: indices of the entries of a point that may be other than zero.
    """
    try:
        M = balanced_coordinates(landscape, x)
        within = _within(M, free)
    except np.linalg.LinAlgError:
        return np.eye(len(x))[:, free]
    if len(free) == len(x):
        return M
    restricted = np.zeros((len(x), len(free)))
    restricted[free] = within
    return restricted


def _within(M: Array, free: Array) -> Array:
    """The coordinates of the free entries alone, of the same metric, shape (N, N).

    Raises:
        LinAlgError: M is singular.
    """
    inverse = np.linalg.inv(M)
    sizes, vectors = np.linalg.eigh((inverse.T @ inverse)[free][:, free])
    return vectors / np.sqrt(np.maximum(sizes, 1e-12 * sizes[-1])) @ vectors.T
