"""Numbers in LMI certificates: floats are written as strings of rational numbers, and matrices are rounded to few bits."""

from collections.abc import Iterator, Sequence
from decimal import ROUND_FLOOR, Context
from fractions import Fraction

import numpy as np

from models.common.arrays import Array
from synth.analysis.lmi_certificate.check_certificate import SHAPES, ExactLoop, Matrix
from synth.plant.generalized import Plant

LONG = 10**20  # a decimal number is written as a decimal fraction only if its denominator is smaller than this
# numbers of bits to which an entry is rounded, relative to the diagonal; tried in this order
BITS = (10, 14, 18, 24, 32, 44, 53)


def rational(value: float | Fraction) -> str:
    """Returns the exact value of a number as text: an integer, a decimal fraction of at most 17 digits, or p/q."""
    exact = Fraction(value)
    short = repr(float(exact)) if 1 < exact.denominator < LONG else ""
    return short if short and "e" not in short and Fraction(short) == exact else str(exact)


def rows(matrix: Array | Sequence[Sequence[Fraction]]) -> list[list[str]]:
    """Returns a matrix of floats or rational numbers as rows of texts; each text is the exact value of an entry."""
    return [[rational(entry) for entry in row] for row in matrix]


def decimal(value: float) -> Fraction:
    """Returns the decimal number that Python prints for a float, as an exact `Fraction`."""
    return Fraction(repr(float(value)))


def rounded(value: float, count: int, direction: str = ROUND_FLOOR) -> float:
    """Returns a number rounded to `count` significant digits, by default downwards; `direction` is a rounding mode of the
    module `decimal`.
    """
    return float(Context(prec=count, rounding=direction).create_decimal(value))


def exact(matrix: Array) -> Matrix:
    """Converts a matrix of floats to rational numbers."""
    return Matrix([Fraction(float(x)) for x in row] for row in matrix)


def exact_loop(plant: Plant, K: Array) -> ExactLoop:
    """Returns the loop u = K y of a plant in rational arithmetic, as `check_certificate.py` computes it.

    Raises:
        ZeroDivisionError: the algebraic loop through the measurements has no solution.
    """
    return ExactLoop({name: exact(getattr(plant, name)) for name in SHAPES} | {"sampled": plant.dt is not None}, exact(K))


def floats(loop: ExactLoop, dt: float | None) -> Plant:
    """Returns the closed loop from w to z in floats, with each matrix entry rounded once."""
    n = len(loop.I.rows)
    S, W = (np.array(M.rows, dtype=float) for M in (loop.S, loop.W))
    return Plant.without_inputs(S[:n], W[:n], S[n:], W[n:], dt=dt)


def shortened(X: Array) -> Iterator[Array]:
    """Yields approximations of a symmetric matrix X with a positive diagonal; each approximation has more bits than the
    previous one.

    The last matrix is exactly X.
    """
    size = 2.0 ** np.round(np.log2(np.diagonal(X)) / 2)
    for bits in BITS[:-1]:
        unit = np.outer(size, size) * 2.0**-bits
        yield np.rint(X / unit) * unit
    yield (X + X.T) / 2
