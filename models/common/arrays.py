"""The type of all arrays in function signatures, a check of matrices from users, and the solution of linear recursions.

Docstrings give the shape and unit of each array. Entries of an array are float64 unless a docstring describes the array as
complex.
"""

import itertools
import math
import sys

import numpy as np

from models.common.errors import InputError

Array = np.ndarray
MOST = 2000  # largest number of rows or columns; larger models need methods for large sparse systems


def is_masked(value: object) -> bool:
    """Returns True for an array, or nested lists, with a masked value."""
    # Importing `numpy.ma` takes time; if a masked array exists, the module is already imported
    masks = sys.modules.get("numpy.ma")
    if masks is None or not isinstance(value, np.ndarray | list | tuple):
        return False
    return masks.is_masked(value) if isinstance(value, np.ndarray) else any(is_masked(one) for one in value)


def check_unmasked(name: str, value: object) -> None:
    """Refuses an array with masked values, because calculations would ignore the mask.

    Raises:
        InputError: a value of the array is masked. The message gives the name of the array.
    """
    if is_masked(value):
        raise InputError(f"{name} has masked values; fill them, for example with filled(0.0), or remove them")


def real_matrix(value: object, name: str, largest: float, expected: str = "") -> tuple[Array, float]:
    """Returns a copy of a real matrix, and the magnitude of its largest entry.

    Args:
        value: the matrix as an array or as nested lists. Complex numbers are allowed if all imaginary parts are 0.
        name: name of the argument, for messages.
        largest: largest allowed magnitude of an entry; infinity for no limit.
        expected: required shape as text, for messages; empty if any shape is allowed.

    Returns:
        The matrix, and the magnitude of its largest entry. The magnitude is returned because callers need it, and because a
        second computation would take as long as the check.

    Raises:
        InputError: the value is not a real matrix of the expected shape, or an entry is larger than `largest`. The message
            gives the name of the argument.
    """
    check_unmasked(name, value)
    try:
        given = np.asarray(value)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} is not a matrix of numbers ({error}); give rows of the same length") from None
    if given.ndim != 2:
        raise InputError(f"{name} has shape {given.shape}; expected a matrix{expected and f' of shape {expected}'}")
    if max(given.shape) > MOST:  # the size is checked before the matrix is copied
        raise InputError(
            f"{name} has shape {given.shape}; at most {MOST} rows and columns are allowed; reduce the order of the model"
        )
    if np.iscomplexobj(given):
        if np.any(np.imag(given)):
            raise InputError(f"{name} has complex entries; give real numbers")
        given = np.real(given)
    try:
        matrix = np.array(given, dtype=float)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name} is not a matrix of numbers ({error}); give an array of floats") from None
    size = float(np.abs(matrix).max(initial=0.0))
    if not size < np.inf:
        raise InputError(f"{name} has an entry that is not finite; give finite numbers")
    if size > largest:
        raise InputError(f"{name} has an entry with a magnitude above {largest:g}; use units in which the entries are smaller")
    return matrix, size


def recursion(Phi: Array, forcing: Array, start: Array | None = None) -> Array:
    """Solves the recursion x[k+1] = Phi x[k] + forcing[k] with x[0] = `start`; returns x, shape (..., T, n).

    A Python loop over all T samples would be slow. The samples are therefore divided into about sqrt(T) stretches of about
    sqrt(T) samples. The responses of all stretches are computed together, each from x = 0. Finally, the effect of each stretch
    on the stretches after it is added.

    Args:
        Phi: transition matrix from one sample to the next, shape (n, n).
        forcing: effect of the inputs on the state in each sample, shape (..., T, n).
        start: initial state, shape (n,) or (..., n); None for 0.
    """
    *runs, samples, n = forcing.shape
    if start is not None:  # one additional forcing before the first sample moves the state from 0 to `start`
        first = np.broadcast_to(start, (*runs, 1, n))
        return recursion(Phi, np.concatenate([first, forcing], axis=-2))[..., 1:, :]
    length = math.isqrt(samples) + 1
    stretches = -(-samples // length)
    padded = np.zeros((*runs, stretches * length, n))
    padded[..., 1:samples, :] = forcing[..., : samples - 1, :]
    states, transposed = padded.reshape(*runs, stretches, length, n), np.ascontiguousarray(Phi.T)
    with np.errstate(over="ignore", invalid="ignore"):  # the numbers of an unstable loop may overflow, which the run reports
        for k in range(1, length):
            states[..., k, :] += states[..., k - 1, :] @ transposed
        powers = np.stack(list(itertools.accumulate([transposed] * length, np.matmul)))
        for i in range(1, stretches):
            states[..., i, :, :] += np.vecmat(states[..., i - 1, -1:, :], powers)
    return padded[..., :samples, :]
