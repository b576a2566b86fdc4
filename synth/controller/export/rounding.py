"""Rounding of exported code at every sample, from the readings and states that it computes with.

Binary floating point. A sum of products rounds every product and, from the second on, every partial sum. Rounding moves a
number v by at most half its last digit, and that by at most u |v| with the unit roundoff u. Errors are even over the last digit
d, so that their mean square is d^2 / 12. With mantissas from 1 to 2 that are even on a logarithmic scale, d^2 is (2 u v)^2 times
the mean 3 / (8 ln 2) of 1 / mantissa^2, and the mean square is (u v)^2 / (8 ln 2). Readings are rounded to the format first.

Coefficients are rounded once. Their error is known, and is no noise: it is that of another law.

Bounds are to first order in u; `SECOND` covers what is left.
"""

import math
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from synth.controller.export.c_law import NUMBERS, ExportedLaw

UNIT = {"double": 2.0**-53, "float": 2.0**-24}
SHARE = 1 / (8 * math.log(2))  # mean square of a rounding error over (u v)^2
SECOND = 1.001


@dataclass(frozen=True, eq=False)
class LocalErrors:
    """Errors of one computation, at S samples, of q readings, m forces and k next states.

    Attributes:
        known: of [forces; next states] by the law's rounded coefficients, shape (S, m + k).
        square: mean square of the errors of [readings; forces; next states], shape (S, q + m + k).
        most: bound on their magnitude, shape (S, q + m + k); that of the forces and states includes `known`.
    """

    known: Array
    square: Array
    most: Array


def rounded_law(law: ExportedLaw) -> tuple[Array, Array]:
    """Returns [D, C; B, A] as given, and as the code has it, shapes (m + k, q + k)."""
    exact = np.block([[law.D, law.C], [law.B, law.A]])
    return exact, exact.astype(NUMBERS[law.numbers]).astype(float)


def law_states(law: ExportedLaw, y: Array) -> Array:
    """Returns the states at S samples, shape (S, k), from rest, of readings, shape (S, q), that no limit clips."""
    x = np.zeros((len(y), law.states))
    driven = y @ law.B.T
    for i in range(len(y) - 1):
        x[i + 1] = law.A @ x[i] + driven[i]
    return x


def local_errors(law: ExportedLaw, y: Array) -> LocalErrors:
    """Returns the errors at S samples.

    Args:
        law: linear, without adjustable dampers.
        y: the readings, shape (S, q).
    """
    exact, held = rounded_law(law)
    values, q, m = np.hstack([y, law_states(law, y)]), law.readings, len(law.outputs)
    u = UNIT[law.numbers]
    known = values @ (held - exact).T
    square, most = np.empty((len(y), q + len(held))), np.empty((len(y), q + len(held)))
    square[:, :q], most[:, :q] = SHARE * (u * y) ** 2, u * np.abs(y)
    for i, row in enumerate(held):
        order = np.arange(q + law.states) if i < m else np.r_[q : q + law.states, :q]  # that of the code's sums
        used = order[row[order] != 0]  # a product with 0 is exact, and so is the sum
        products = values[:, used] * row[used]
        sums = np.cumsum(products, axis=1)[:, 1:]
        square[:, q + i] = SHARE * u**2 * (np.sum(products**2, axis=1) + np.sum(sums**2, axis=1))
        most[:, q + i] = u * (np.abs(products).sum(axis=1) + np.abs(sums).sum(axis=1)) + np.abs(known[:, i])
    flips = law.resolution  # a reading on the edge between two steps goes to either
    return LocalErrors(known, square, SECOND * most + np.r_[flips, np.zeros(len(held))])
