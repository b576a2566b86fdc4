"""The array type of all signatures, and the check of matrices given by users.

Shapes and units are in the docstrings; entries are float64 unless those say complex.
"""

import numpy as np

from models.common.errors import InputError

Array = np.ndarray
MOST = 2000  # rows or columns; more needs methods for large sparse systems


def real_matrix(value: object, name: str, largest: float, expected: str = "") -> tuple[Array, float]:
    """Returns a copy of a real matrix, and the size of its largest entry.

    Args:
        value: the matrix, or nested lists; complex numbers without imaginary part are allowed.
        largest: allowed size of an entry; infinite for no limit.
        expected: its shape, for messages; empty if any is allowed.

    Returns:
        The matrix, and the size of its largest entry, which callers need, too: computing it takes as long as the check.

    Raises:
        InputError: it is not such a matrix; the message names it.
    """
    try:
        given = np.asarray(value)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} is not a matrix of numbers ({error}); give rows of the same length") from None
    if given.ndim != 2:
        raise InputError(f"{name} has shape {given.shape}; expected a matrix{expected and f' of shape {expected}'}")
    if max(given.shape) > MOST:  # before it is copied
        raise InputError(f"{name} has shape {given.shape}; no more than {MOST} rows or columns are allowed: reduce the model")
    if np.iscomplexobj(given):
        if np.any(np.imag(given)):
            raise InputError(f"{name} has complex entries; give real ones")
        given = np.real(given)
    try:
        matrix = np.array(given, dtype=float)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name} is not a matrix of numbers ({error}); give an array of floats") from None
    size = float(np.abs(matrix).max(initial=0.0))
    if not size < np.inf:
        raise InputError(f"{name} has an entry that is not finite; give numbers")
    if size > largest:
        raise InputError(f"{name} has an entry beyond {largest:g}, in size; give it in other units")
    return matrix, size
