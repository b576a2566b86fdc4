"""Oracles in rational arithmetic: what is true of matrices of floats, without any rounding."""

from fractions import Fraction

import numpy as np

from synth.plant.generalized import Feedback

Matrix = list[list[Fraction]]


def exact(matrix) -> Matrix:
    """A matrix of floats, each as the rational number that it is."""
    return [[Fraction(float(entry)) for entry in row] for row in np.atleast_2d(matrix)]


def times(A: Matrix, B: Matrix) -> Matrix:
    return [[sum((a * b for a, b in zip(row, column, strict=True)), Fraction(0)) for column in zip(*B, strict=True)] for row in A]


def plus(A: Matrix, B: Matrix) -> Matrix:
    return [[a + b for a, b in zip(one, other, strict=True)] for one, other in zip(A, B, strict=True)]


def solved(A: Matrix, B: Matrix) -> Matrix:
    """A^-1 B by elimination; A is regular."""
    rows = [[*a, *b] for a, b in zip(A, B, strict=True)]
    n = len(A)
    for i in range(n):
        pivot = max(range(i, n), key=lambda k: abs(rows[k][i]))
        rows[i], rows[pivot] = rows[pivot], rows[i]
        rows[i] = [entry / rows[i][i] for entry in rows[i]]
        for k in range(n):
            if k != i and rows[k][i]:
                factor = rows[k][i]
                rows[k] = [a - factor * b for a, b in zip(rows[k], rows[i], strict=True)]
    return [row[n:] for row in rows]


def positive_definite(M: Matrix) -> bool:
    """Returns True if all pivots of a symmetric matrix are positive."""
    rows = [list(row) for row in M]
    for i in range(len(rows)):
        if rows[i][i] <= 0:
            return False
        for k in range(i + 1, len(rows)):
            factor = rows[k][i] / rows[i][i]
            rows[k] = [a - factor * b for a, b in zip(rows[k], rows[i], strict=True)]
    return True


def stable(A: Matrix) -> bool:
    """Returns True if every eigenvalue lies left of the imaginary axis: Routh's table of the characteristic polynomial."""
    n = len(A)
    coefficients, M = [Fraction(1)], [[Fraction(0)] * n for _ in range(n)]
    for k in range(1, n + 1):  # Faddeev and LeVerrier
        M = plus(times(A, M), [[coefficients[-1] * (i == j) for j in range(n)] for i in range(n)])
        product = times(A, M)
        coefficients.append(-sum((product[i][i] for i in range(n)), Fraction(0)) / k)
    first, second = coefficients[0::2], coefficients[1::2]
    for _ in range(n):
        if first[0] <= 0 or not second or second[0] <= 0:
            return False
        padded = [*second, Fraction(0)]
        ratio = first[0] / second[0]
        first, second = second, [a - ratio * b for a, b in zip(first[1:], padded[1:], strict=False)]
    return first[0] > 0


def gain_squared(A: Matrix, Bw: Matrix, C: Matrix, omega: float | Fraction) -> Fraction:
    """|C (j omega - A)^-1 Bw|^2 for one disturbance: no norm can be smaller than its root."""
    n, w = len(A), Fraction(omega)
    # x = p + j q: [-A, -w; w, -A] [p; q] = [Bw; 0].
    minus = [[-entry for entry in row] for row in A]
    turn = [[w * (i == j) for j in range(n)] for i in range(n)]
    top = [[*a, *(-entry for entry in b)] for a, b in zip(minus, turn, strict=True)]
    low = [[*b, *a] for a, b in zip(minus, turn, strict=True)]
    x = solved(top + low, [*Bw, *[[Fraction(0)] for _ in range(n)]])
    z = [*times(C, x[:n]), *times(C, x[n:])]
    return sum((row[0] ** 2 for row in z), Fraction(0))


def bounded_real(plant, G, X) -> Matrix:
    """The matrix of (20) at eta = 0 for u = G x, or u = K y, of a discrete plant its discrete form; X is symmetric."""
    A, B, C, D, x = (exact(part) for part in (plant.A, plant.B, plant.C, plant.D, X))
    g = times(exact(G.K), exact(G.Cy)) if isinstance(G, Feedback) else exact(G)
    n, d = len(A), len(C)
    loop = [plus(A, times(B, g)), plus(C, times(D, g))] if g else [A, C]
    if plant.dt is not None:
        whole = loop[0] + loop[1]
        there = [[-x[i][j] if max(i, j) < n else -Fraction(i == j) for j in range(n + d)] for i in range(n + d)]
        return plus(times(times(whole, x), [list(column) for column in zip(*whole, strict=True)]), there)
    left = [[*row, *[Fraction(0)] * d] for part in loop for row in times(part, x)]
    for i in range(d):
        left[n + i][n + i] = Fraction(-1, 2)
    return plus(left, [list(column) for column in zip(*left, strict=True)])


def disturbed(plant) -> Matrix:
    """[Bw; Dw] [Bw; Dw]', what eta multiplies in (20)."""
    W = exact(np.vstack([plant.Bw, plant.Dw]))
    return [[sum((a * b for a, b in zip(one, other, strict=True)), Fraction(0)) for other in W] for one in W]


def largest_eta(plant, G, X) -> Fraction | None:
    """The eta below which (20) is negative definite, for one disturbance; None where it is not even at 0."""
    M = [[-entry for entry in row] for row in bounded_real(plant, G, X)]
    W = exact(np.vstack([plant.Bw, plant.Dw]))
    if not positive_definite(M):
        return None
    return 1 / sum((w[0] * y[0] for w, y in zip(W, solved(M, W), strict=True)), Fraction(0))
