"""Positive definiteness that is proved and not merely computed, in plain floating point.

If the Cholesky decomposition of M - c I runs to its end in floating point, M is positive definite in exact arithmetic, provided
that c is at least what rounding can have done (Rump 2006, Verification of positive definiteness, BIT 46, 433-452): the computed
factor R satisfies R'R = M - c I + D with |D| <= d d', d_j^2 = gamma_j / (1 - gamma_j) M_jj, gamma_j about j unit roundoffs. The
answer errs on one side only: what is singular to rounding is not proved.
"""

from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array

UNIT = np.finfo(float).eps / 2  # unit roundoff
SMALLEST = 1e-200  # of a diagonal entry; the largest entry is 1 / SMALLEST. Beyond, numbers may under- or overflow
TINY = 1e-100  # more than all underflows of one proof together, where the diagonal has size one


@dataclass(frozen=True)
class Definiteness:
    """What is known of a symmetric matrix, scaled to a diagonal between 1/2 and 2.

    Attributes:
        smallest: its smallest eigenvalue, as computed; NaN where a diagonal entry is not positive, or an entry is out of range.
        rounding: by how much that must exceed 0 at least, for a proof.
        proved: whether the matrix is positive definite beyond any rounding.
    """

    smallest: float
    rounding: float
    proved: bool


def definiteness(M: Array) -> Definiteness:
    """Whether every symmetric matrix is positive definite whose entries are those of M to the nearest float.

    Args:
        M: shape (k, k), symmetric to the last bit.
    """
    k = len(M)
    diagonal = np.diagonal(M)
    if not (np.abs(M).max(initial=0.0) <= 1 / SMALLEST and np.all(diagonal >= SMALLEST)):  # not if there is a NaN, either
        return Definiteness(np.nan, np.nan, False)
    scale = np.exp2(-np.round(np.log2(diagonal) / 2))  # powers of two: nothing is rounded, and no sign changes
    M = M * scale * scale[:, None]
    # What rounding did to the entries, and what it does in the decomposition; doubled, as libraries multiply by reciprocals where
    # they divide, and these sums are rounded themselves.
    entries = UNIT * float(np.abs(M).sum(axis=1).max(initial=0.0))
    decomposition = (k + 5) * UNIT * float(np.trace(M))
    shift = 2 * (entries + decomposition) + TINY
    try:
        factor = np.linalg.cholesky(M - shift * np.eye(k))
    except np.linalg.LinAlgError:
        factor = np.full_like(M, np.nan)
    smallest = float(np.linalg.eigvalsh(M)[0]) if k else np.inf
    return Definiteness(smallest, shift, bool(np.all(np.isfinite(factor))))


def definite_beyond(M: Array, lost: Array) -> bool:
    """Whether all matrices of a stack are positive definite whose entries are within a distance of those of M.

    Args:
        M: shape (V, k, k); their symmetric parts are meant.
        lost: the distance of each entry, shape (V, k, k).
    """
    M = (M + M.swapaxes(-1, -2)) / 2
    diagonal = np.diagonal(M, axis1=-2, axis2=-1)
    if not (np.all(diagonal >= SMALLEST) and np.abs(M).max() <= 1 / SMALLEST):  # not if there is a NaN, either
        return False
    scale = np.exp2(-np.round(np.log2(diagonal) / 2))  # powers of two: nothing is rounded
    across = scale[..., :, None] * scale[..., None, :]
    M, lost, k = M * across, lost * across, M.shape[-1]
    shift = 2 * (lost.sum(axis=-1).max(axis=-1) + (k + 5) * UNIT * np.trace(M, axis1=-2, axis2=-1)) + TINY
    try:
        factors = np.linalg.cholesky(M - shift[:, None, None] * np.eye(k))
    except np.linalg.LinAlgError:
        return False
    return bool(np.all(np.isfinite(factors)))
