"""Fixed-point arithmetic: integers of 16 or 32 bits for measurements, states and forces, each with its own unit.

The range of each measurement is known in advance, and the measurement is clipped at this range. The ranges of the measurements
determine the peaks of the states, through sums of the state responses, and then the peaks of the forces. If the units are
chosen for the peaks of the states and forces, no value can overflow. The unit of a quantity is its peak divided by the largest
integer, rounded up to a power of two. If the range of a quantised measurement contains few enough quantisation steps, one
quantisation step is the unit of the measurement.

Each force and each next state is a sum of products of integer coefficients with integer measurements or states. Each sum is
computed in 64 bits without overflow, divided by 2^shift, rounded to the nearest integer (ties away from 0), and clipped.
"""

import math
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.laws.linear import LinearLaw

BITS = {"int16": 16, "int32": 32}
MOST_SHIFT = 62
ABOVE = 1.01  # factor that enlarges the peak of a state, to allow for rounding
# the largest change of a force per sample is at least this many integer units; rounding the change down then reduces it by at
# most 6 %
LEAST_CHANGE = 16
# For impulse responses: relative size below which the rest is neglected, number of samples that are computed together, and
# largest number of samples
DECAYED, CHUNK, MOST_SAMPLES = 1e-9, 256, 1_000_000


@dataclass(frozen=True, eq=False)
class FixedPoint:
    """Units and integer coefficients of a law with q measurements, m forces and k states.

    Attributes:
        largest: integer at which all values are clipped.
        seen: size of one integer step of each measurement, in the measurement's unit, shape (q,).
        given: size of one integer step of each force [N], shape (m,).
        state_units: size of one integer step of each state, shape (k,).
        rows: integer coefficients, shape (m + k, q + k + m). The first m rows belong to the forces, the other rows to the next
            states. The columns belong to the measurements, the states, and the parts of the forces that a limit removes.
        shifts: exponent for each row; the sum of the row's products is divided by 2 to this power, shape (m + k,).
        limit: largest allowed magnitude of each force, in the units `given`, shape (m,); None without limit.
        change: largest allowed change of each force per sample, in the units `given`, shape (m,); None without limit.
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
    """Returns, for each of r outputs of a stable loop, the sum of |response| over all samples and disturbances, shape (r,).

    Args:
        rows: matrix from the n states to r outputs, shape (r, n).
        transition: transition matrix of the states from one sample to the next, shape (n, n).
        first: states immediately after each of d disturbances, shape (n, d).
    """
    together = [rows]
    while len(together) < CHUNK:  # one product of large matrices takes less time than many products of small matrices
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
    """Returns the units and the integer coefficients of a law.

    Args:
        numbers: number format, "int16" or "int32".
        law: discrete law with q measurements, m forces and k states.
        L: anti-windup gain, shape (k, m); None without anti-windup.
        limit: largest allowed magnitude of each force [N]; None without limit.
        change: largest allowed change of a force per sample [N]; None without limit.
        resolution: quantisation step of each measurement, shape (q,); 0 for a measurement that is not quantised.
        ranges: largest magnitude of each measurement, shape (q,).

    Raises:
        InputError: the peak of a state is unbounded, or the number format has too few digits.
    """
    if change is not None and L is not None and limit is None:
        raise InputError(
            f"{numbers} code with anti_windup and force_rate needs a largest force, so that the states of the "
            "controller are bounded; give actuator_force"
        )
    A, B, C, D, largest = law.A, law.B, law.C, law.D, 2 ** (BITS[numbers] - 1) - 1
    m, k = len(D), len(A)
    A_own, pushed = A, B * ranges
    if L is not None:  # law whose input is the acting force, so that the law is the same whether the force is clipped or not
        A_own, pushed = A - L @ C, np.hstack([(B - L @ D) * ranges, L * (limit or 0.0)])
    if k and np.abs(np.linalg.eigvals(A_own)).max() >= 1 - 1e-12:
        raise InputError(f"{numbers} code needs bounded states, but a state of this law does not decay; give double or float")
    peaks = summed_responses(np.eye(k), A_own, pushed) if k else np.zeros(0)
    forces = np.abs(D) @ ranges + np.abs(C) @ peaks
    if limit is not None and L is None:
        forces = np.minimum(forces, limit)
    seen = np.where(resolution * largest >= ranges, resolution, _units(ranges, largest))
    apart = 1 if change is None else 2  # the difference between two successive forces can be twice the peak force
    given, kept = _units(apart * ABOVE * forces, largest), _units(ABOVE * peaks, largest)
    whole = np.block([[D, C, np.zeros((m, m))], [B, A, np.zeros((k, m)) if L is None else L]])
    whole = whole * np.concatenate([seen, kept, given]) / np.concatenate([given, kept])[:, None]
    size = np.abs(whole).max(axis=1) if numbers == "int16" else np.abs(whole).sum(axis=1)
    room = np.floor(np.log2(largest / np.where(size > 0, size, 1.0) * (1 - 1e-9)))
    if np.any(room < 0):
        raise InputError(f"{numbers} numbers have too few digits for these ranges and this law; give int32, float or double")
    shifts = np.minimum(room, MOST_SHIFT).astype(int)
    rows = np.rint(whole * 2.0 ** shifts[:, None])
    top = None if limit is None else np.minimum(np.floor(limit / given), largest)
    step = None if change is None else np.minimum(np.floor(change / given), largest)
    if step is not None and np.any(step < LEAST_CHANGE):
        raise InputError(
            f"{numbers} code rounds forces to steps of {given.max():g} N, which are too coarse for changes of "
            f"{change:g} N per sample (force_rate); give int32, float or double"
        )
    return FixedPoint(largest, seen, given, kept, rows, shifts, top, step)


def _units(peaks: Array, largest: int) -> Array:
    """Returns units that are powers of two, and so large that no peak, as a multiple of its unit, exceeds the largest integer."""
    return np.array([2.0 ** math.ceil(math.log2(peak / largest)) if peak > 0 else 1.0 for peak in peaks])


def rounded_shift(total: int, shift: int, largest: int) -> int:
    """Returns total / 2^shift, rounded to the nearest integer (ties away from 0) and clipped to the largest integer."""
    half = 2 ** (shift - 1) if shift else 0
    result = (total + half) >> shift if total >= 0 else -((half - total) >> shift)
    return max(-largest, min(largest, result))
