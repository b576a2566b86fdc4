"""Fixed point: integers of 16 or 32 bits for readings, states and forces, each in a unit of its own.

A reading's unit follows from its range, which is given: at the range it is clipped. From these ranges follow peaks of the states,
by the sum of all their responses, and of the forces, so that nothing else ever overflows. What a unit is of follows its peak,
rounded up to a power of two; a quantised reading counts its own steps, if there are not too many.

A row of the law is a sum of whole coefficients times integers, in 64 bits without overflow, divided by 2^shift, rounded to
the nearest, of two the one away from 0, and clipped.
"""

import math
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.laws.linear import LinearLaw

BITS = {"int16": 16, "int32": 32}
MOST_SHIFT = 62
ABOVE = 1.01  # of a state's peak, for what rounding adds to it
LEAST_CHANGE = 16  # units of a force that its largest change has, so that rounding the change down takes at most 6 % of it
DECAYED, CHUNK, MOST_SAMPLES = 1e-9, 256, 1_000_000  # of a response whose rest is neglected; samples together, and at most


@dataclass(frozen=True, eq=False)
class FixedPoint:
    """Units and whole coefficients of a law with q readings, m forces and k states.

    Attributes:
        largest: integer at which everything is clipped.
        seen: units of the readings, shape (q,).
        given: units of the forces [N], shape (m,).
        state_units: units of the states, shape (k,).
        rows: coefficients of forces, then next states, on readings, states, then forces that a limit takes, shape
            (m + k, q + k + m).
        shifts: shift of each row, shape (m + k,).
        limit: largest force, in the units of each, shape (m,), or None.
        change: largest change of a force from sample to sample, in the units of each, shape (m,), or None.
    """

    largest: int
    seen: Array
    given: Array
    state_units: Array
    rows: Array
    shifts: Array
    limit: Array | None
    change: Array | None


def summed_responses(rows: Array, transition: Array, first: Array) -> Array:
    """Returns the sum over all samples and disturbances of |response|, of a stable loop, shape (r,).

    Args:
        rows: map from the state to r outputs.
        transition: map of the state from sample to sample.
        first: states after each disturbance.
    """
    together = [rows]
    while len(together) < CHUNK:  # a product of large matrices costs little more than one of small ones
        together.append(together[-1] @ transition)
    chunk, power = np.vstack(together), np.linalg.matrix_power(transition, CHUNK)
    total, state, small = np.zeros(len(chunk)), first, DECAYED * np.abs(first).sum()
    for _ in range(MOST_SAMPLES // CHUNK):
        total = total + np.abs(chunk @ state).sum(axis=1)
        if np.all(np.abs(state).sum(axis=1) <= small):
            break
        state = power @ state
    return total.reshape(CHUNK, -1).sum(axis=0)


def fixed_point(
    numbers: str,
    law: LinearLaw,
    L: Array | None,
    limit: float | None,
    change: float | None,
    resolution: Array,
    ranges: Array,
) -> FixedPoint:
    """Returns the units and coefficients of a law.

    Args:
        numbers: "int16" or "int32".
        law: q readings, m forces, k states.
        L: anti-windup, shape (k, m), or None.
        limit: largest force [N], or None.
        change: largest change of a force from sample to sample [N], or None.
        resolution: step of each reading, 0 for one that is not quantised, shape (q,).
        ranges: largest magnitude of each reading, shape (q,).

    Raises:
        InputError: a state has no peak, or a unit leaves no digits.
    """
    if change is not None and L is not None and limit is None:
        raise InputError(
            f"{numbers} code with anti_windup and force_rate needs a largest force, which bounds the controller states; give "
            "actuator_force"
        )
    A, B, C, D, largest = law.A, law.B, law.C, law.D, 2 ** (BITS[numbers] - 1) - 1
    m, k = len(D), len(A)
    A_own, pushed = A, B * ranges
    if L is not None:  # where a force is given, clipped or not, this is the law
        A_own, pushed = A - L @ C, np.hstack([(B - L @ D) * ranges, L * (limit or 0.0)])
    if k and np.abs(np.linalg.eigvals(A_own)).max() >= 1 - 1e-12:
        raise InputError(f"{numbers} needs bounded states, but a state of this law does not decay; give double or float")
    peaks = summed_responses(np.eye(k), A_own, pushed) if k else np.zeros(0)
    forces = np.abs(D) @ ranges + np.abs(C) @ peaks
    if limit is not None and L is None:
        forces = np.minimum(forces, limit)
    seen = np.where(resolution * largest >= ranges, resolution, _units(ranges, largest))
    apart = 1 if change is None else 2  # peaks between a force and the force of the sample before
    given, kept = _units(apart * ABOVE * forces, largest), _units(ABOVE * peaks, largest)
    whole = np.block([[D, C, np.zeros((m, m))], [B, A, np.zeros((k, m)) if L is None else L]])
    whole = whole * np.concatenate([seen, kept, given]) / np.concatenate([given, kept])[:, None]
    size = np.abs(whole).max(axis=1) if numbers == "int16" else np.abs(whole).sum(axis=1)
    room = np.floor(np.log2(largest / np.where(size > 0, size, 1.0) * (1 - 1e-9)))
    if np.any(room < 0):
        raise InputError(f"{numbers} has too few digits for these ranges and this law; give int32, float or double")
    shifts = np.minimum(room, MOST_SHIFT).astype(int)
    rows = np.rint(whole * 2.0 ** shifts[:, None])
    top = None if limit is None else np.minimum(np.floor(limit / given), largest)
    step = None if change is None else np.minimum(np.floor(change / given), largest)
    if step is not None and np.any(step < LEAST_CHANGE):
        raise InputError(
            f"{numbers} code has forces in steps of {given.max():g} N, too coarse for changes of {change:g} N per sample "
            "(force_rate); give int32, float or double"
        )
    return FixedPoint(largest, seen, given, kept, rows, shifts, top, step)


def _units(peaks: Array, largest: int) -> Array:
    """Returns powers of two in which peaks are at most the largest integer."""
    return np.array([2.0 ** math.ceil(math.log2(peak / largest)) if peak > 0 else 1.0 for peak in peaks])


def rounded_shift(total: int, shift: int, largest: int) -> int:
    """Returns a sum over 2^shift, rounded to the nearest, of two the one away from 0, and clipped."""
    half = 2 ** (shift - 1) if shift else 0
    result = (total + half) >> shift if total >= 0 else -((half - total) >> shift)
    return max(-largest, min(largest, result))
