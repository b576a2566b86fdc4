"""The array type of all signatures, the check of matrices given by users, and linear recursions.

Shapes and units are in the docstrings; entries are float64 unless those say complex.
"""

import itertools
import math
import sys

import numpy as np

from models.common.errors import InputError

Array = np.ndarray
MOST = 2000  # rows or columns; more needs methods for large sparse systems


def is_masked(value: object) -> bool:
    """Returns True for an array, or nested lists, in which a value is masked."""
    masks = sys.modules.get("numpy.ma")  # which takes time to import, and is there if a masked array is
    if masks is None or not isinstance(value, np.ndarray | list | tuple):
        return False
    return masks.is_masked(value) if isinstance(value, np.ndarray) else any(is_masked(one) for one in value)


def check_unmasked(name: str, value: object) -> None:
    """Refuses masked values, whose mask arithmetic would lose.

    Raises:
        InputError: a value is masked; the message names the array.
    """
    if is_masked(value):
        raise InputError(f"{name} has masked values; fill them, for example with filled(0.0), or remove them")


def real_matrix(value: object, name: str, largest: float, expected: str = "") -> tuple[Array, float]:
    """Returns a copy of a real matrix, and the size of its largest entry.

    Args:
        value: the matrix, or nested lists; complex numbers without imaginary part are allowed.
        largest: limit on the magnitude of an entry; infinite for no limit.
        expected: shape required, in words for messages; empty if any shape is allowed.

    Returns:
        The matrix, and the size of its largest entry, which callers need, too: computing it takes as long as the check.

    Raises:
        InputError: the value is not such a matrix; the message names the argument.
    """
    check_unmasked(name, value)
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
        raise InputError(f"{name} has an entry beyond {largest:g} in magnitude; use other units")
    return matrix, size


def recursion(Phi: Array, forcing: Array, start: Array | None = None) -> Array:
    """Returns x[k+1] = Phi x[k] + forcing[k] from x[0] = `start`, or 0, shape (..., T, n) like the forcing.

    Python takes a step for every sample of a stretch and for every stretch, not for every sample of all: the responses of all
    stretches from rest come first, side by side, and then what each adds to those behind it.
    """
    *runs, samples, n = forcing.shape
    if start is not None:  # a step from 0 leads to the start
        first = np.broadcast_to(start, (*runs, 1, n))
        return recursion(Phi, np.concatenate([first, forcing], axis=-2))[..., 1:, :]
    length = math.isqrt(samples) + 1
    stretches = -(-samples // length)
    padded = np.zeros((*runs, stretches * length, n))
    padded[..., 1:samples, :] = forcing[..., : samples - 1, :]
    states, transposed = padded.reshape(*runs, stretches, length, n), np.ascontiguousarray(Phi.T)
    with np.errstate(over="ignore", invalid="ignore"):  # an unstable loop may overflow; the run says so
        for k in range(1, length):
            states[..., k, :] += states[..., k - 1, :] @ transposed
        powers = np.stack(list(itertools.accumulate([transposed] * length, np.matmul)))
        for i in range(1, stretches):
            states[..., i, :, :] += np.vecmat(states[..., i - 1, -1:, :], powers)
    return padded[..., :samples, :]
