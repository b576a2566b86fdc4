"""Linear algebra for proofs: exact algebra in integers, and a test of definiteness in floats with bounded rounding errors.

Matrices of integers are numpy arrays of Python integers.

Whether M is positive definite is tested with a Cholesky decomposition of M - c I in floating point. If the decomposition
succeeds, M is positive definite in exact arithmetic, provided that c exceeds the rounding errors (Rump 2006, Verification of
positive definiteness, BIT 46, 433-452). The computed factor R satisfies R'R = M - c I + D with |D| <= d d', where d_j^2 =
gamma_j / (1 - gamma_j) M_jj, and gamma_j is about j times the unit roundoff. The definiteness test never accepts a matrix that
is not positive definite. The definiteness test rejects a positive definite matrix that rounding could make singular.
"""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from models.common.arrays import Array


def integers(matrix: Array) -> tuple[Array, int]:
    """Returns a matrix of integers N and a power of two s such that matrix = N / s exactly."""
    ratios = [float(x).as_integer_ratio() for x in np.ravel(matrix)]
    scale = max((bottom for _, bottom in ratios), default=1)
    whole = np.empty(len(ratios), dtype=object)
    whole[:] = [top * (scale // bottom) for top, bottom in ratios]
    return whole.reshape(np.shape(matrix)), scale


def floats(matrix: Array, unit: Fraction = Fraction(1)) -> Array:
    """Returns `unit` times a matrix of integers as floats. Every entry of the result is rounded once.

    Raises:
        OverflowError: an entry is too large for a float.
    """
    top, bottom = unit.numerator, unit.denominator
    return np.array([x * top / bottom for x in matrix.ravel()], dtype=float).reshape(matrix.shape)


def product(left: Array, right: Array) -> Array:
    """Returns the product left @ right for matrices of integers. If the inner dimension of the matrices is 0, the product is
    zero.
    """
    return left @ right if left.shape[1] else zeros(len(left), right.shape[1])


def zeros(*shape: int) -> Array:
    """Returns an array of Python integers, all zero."""
    empty = np.empty(shape, dtype=object)
    empty[...] = 0
    return empty


UNIT = np.finfo(float).eps / 2  # unit roundoff of double precision
SMALLEST = (
    # Lower limit of a diagonal entry; 1 / SMALLEST is the upper limit of all entries. Products of entries outside these limits
    # may underflow or overflow
    1e-200
)
TINY = 1e-100  # more than the sum of all underflow errors in one proof, if the diagonal entries are near 1


@dataclass(frozen=True)
class Definiteness:
    """Result of a definiteness test of a symmetric matrix that was scaled to diagonal entries between 1/2 and 2.

    Attributes:
        smallest: computed smallest eigenvalue; NaN if a diagonal entry is not positive or an entry is out of range.
        rounding: bound on the effect of rounding errors; for a proof, the smallest eigenvalue must exceed this bound.
        proved: True if the matrix is proved positive definite even with rounding errors.
    """

    smallest: float
    rounding: float
    proved: bool


def definiteness(M: Array) -> Definiteness:
    """Tests whether all symmetric matrices whose entries round to those of M are positive definite.

    The matrix M must be exactly symmetric.
    """
    scaled, shift, proved = _definite(M[None], UNIT * np.abs(M)[None])
    if scaled is None:
        return Definiteness(np.nan, np.nan, False)
    return Definiteness(float(np.linalg.eigvalsh(scaled[0])[0]) if len(M) else np.inf, float(shift[0]), proved)


def definite_beyond(M: Array, lost: Array) -> bool:
    """Returns True if all matrices of a stack are proved positive definite, even if their entries have errors of up to `lost`.

    Args:
        M: stack of V matrices, shape (V, k, k); only the symmetric parts of the matrices are used.
        lost: bound on the error of each matrix entry, shape (V, k, k).
    """
    return _definite((M + M.swapaxes(-1, -2)) / 2, lost)[2]


def _definite(M: Array, lost: Array) -> tuple[Array | None, Array, bool]:
    """Returns the scaled matrices, the sums of their rounding errors, and True if all matrices are proved positive definite."""
    diagonal = np.diagonal(M, axis1=-2, axis2=-1)
    # this condition is also false if the value is NaN
    if not (np.abs(M).max(initial=0.0) <= 1 / SMALLEST and np.all(diagonal >= SMALLEST)):
        return None, diagonal, False
    scale = np.exp2(-np.round(np.log2(diagonal) / 2))  # the scales are powers of two, so that scaling causes no rounding error
    across = scale[..., :, None] * scale[..., None, :]
    M, lost, k = M * across, lost * across, M.shape[-1]
    # Sum of the errors of the entries and of the decomposition. The sum is doubled for two reasons: libraries multiply by
    # reciprocals instead of dividing, and the sum itself is rounded.
    errors = lost.sum(axis=-1).max(axis=-1, initial=0.0) + (k + 5) * UNIT * np.trace(M, axis1=-2, axis2=-1)
    shift = 2 * errors + TINY
    try:
        factors = np.linalg.cholesky(M - shift[:, None, None] * np.eye(k))
    except np.linalg.LinAlgError:
        return M, shift, False
    return M, shift, bool(np.all(np.isfinite(factors)))
